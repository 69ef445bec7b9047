# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Flow planes: what changes in the wavelet planes of all epochs, along the flow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

#: Largest value of a plane, in standard deviations over time: no flare decides.
CLIP = 4.0
#: Noises that are added to the variance over time, so that places where it dominates
#: weigh little; between 3 and 12 the power of the test is the same.
NOISES = 4.0
#: Width of the window in which the variance over time is averaged, in sizes of the
#: scale.
WINDOW = 4.0
#: Largest displacement of a diagram in beams: patterns that keep their shape over three
#: beams have lost four fifths of their correlation there.
REACH = 5.0
TINY = np.finfo(float).tiny


@dataclass(frozen=True, eq=False, repr=False)
class FlowPlanes:
    """
    Changes of the wavelet planes on a grid along and across the flow.

    Attributes
    ----------
    values : `~numpy.ndarray`, shape (n_scales, n_epochs, n_along, n_across)
        Planes less their means over the epochs, over their standard deviation in time
        at each place; zero outside the mask.
    mask : `~numpy.ndarray` of bool, shape (n_along, n_across)
        Where the flow is seen.
    along, across : `~numpy.ndarray`, shapes (n_along,) and (n_across,)
        Coordinates in beams, evenly spaced.
    years : `~numpy.ndarray`, shape (n_epochs,)
        Dates in increasing order.
    scales : tuple of float
        Numbers of the scales.
    reach : float
        Largest displacement at which epochs are compared, in beams.
    """

    values: np.ndarray
    mask: np.ndarray
    along: np.ndarray
    across: np.ndarray
    years: np.ndarray
    scales: tuple[float, ...]
    reach: float = REACH

    @property
    def step(self) -> float:
        """Distance of two points along the flow, in beams."""
        return float(self.along[1] - self.along[0])

    def of_scales(self, scales):
        """Return the planes of some scales."""
        use = [k for k, scale in enumerate(self.scales) if scale in scales]
        chosen = tuple(self.scales[k] for k in use)
        return replace(self, values=self.values[use], scales=chosen)

    def of_epochs(self, epochs):
        """Return the planes of some epochs, less their means over these."""
        values = self.values[:, epochs]
        values = values - values.mean(axis=1, keepdims=True)
        return replace(self, values=values, years=self.years[epochs])

    @cached_property
    def square_root(self) -> FlowPlanes:
        """
        Planes with the signed square root of all values, less its mean in time.

        Bright features weigh less in a speed than by their brightness.
        """
        values = np.sign(self.values) * np.sqrt(np.abs(self.values))
        values -= values.mean(axis=1, keepdims=True)
        return replace(self, values=values * self.mask)


def flow_planes(
    planes, valid, mask, noise, *, along, across, years, scales, sizes, weight=None,
    normalise="local", reach=REACH,
):  # fmt: skip
    """
    Return the flow planes of wavelet planes that were resampled along the flow.

    With the plane w_a of epoch a, its mean over the epochs, its variance over time V,
    averaged in a Gaussian window, and its noise s,

    .. math:: q_a = \\mathrm{sgn}(w_a - \\bar w)\\,
              \\min(|w_a - \\bar w| / \\sqrt{V}, 4)\\, \\sqrt{V / (V + (4 s)^2)}.

    Parameters
    ----------
    planes : `~numpy.ndarray`, shape (n_scales, n_epochs, n_along, n_across)
    valid : `~numpy.ndarray` of bool, shape (n_epochs, n_along, n_across)
        False where an epoch has no image.
    mask : `~numpy.ndarray` of bool, shape (n_along, n_across)
    noise : `~numpy.ndarray`, shape (n_scales,)
        Standard deviation of the noise of each plane.
    along, across, years, scales, reach
        See `FlowPlanes`.
    sizes : sequence of float
        Size of the structures of each scale, in points of the grid.
    weight : `~numpy.ndarray`, shape (n_along, 1), optional
        Weight of places, of products of two values.
    normalise : {"local", "along"}
        Whether the variance is that of each place, or the mean across the flow; the
        second one keeps what differs across the flow, as scales do.

    Returns
    -------
    `FlowPlanes`
    """
    number = np.maximum(valid.sum(axis=0), 1)
    mask = mask & (2 * number > len(valid))
    inside, values = mask.astype(float), np.empty(planes.shape, dtype=np.float32)
    for k, (plane, size) in enumerate(zip(planes, sizes, strict=True)):
        rest = plane - np.where(valid, plane, 0).sum(axis=0) / number
        rest = np.where(valid, rest, 0.0)
        variance = (rest**2).sum(axis=0) / number * inside
        if normalise == "local":
            width = WINDOW * size
            area = np.maximum(scipy.ndimage.gaussian_filter(inside, width), 1e-3)
            variance = scipy.ndimage.gaussian_filter(variance, width) / area
        else:
            width = WINDOW * max(sizes)
            area = scipy.ndimage.gaussian_filter1d(inside.sum(axis=1), width)
            variance = scipy.ndimage.gaussian_filter1d(variance.sum(axis=1), width)
            variance = (variance / np.maximum(area, 1e-3))[:, None]
        variance = np.maximum(variance, TINY)
        share = np.sqrt(variance / (variance + (NOISES * noise[k]) ** 2))
        q = np.clip(rest / np.sqrt(variance), -CLIP, CLIP) * share * inside
        values[k] = q if weight is None else q * np.sqrt(weight)
    dates = np.asarray(years)
    return FlowPlanes(values, mask, along, across, dates, tuple(scales), reach)
