# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Flow planes, and the displacement-interval diagram: their correlation over time."""

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
#: Displacements at which fewer pairs of places than this share are inside the mask are
#: left out, and sums are divided by at least the other share.
LEAST_OVERLAP, LEAST_NORM = 0.05, 0.15


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
    normalised : {"local", "along"}
        Whether the standard deviation is that at each place, or along the flow.
    """

    values: np.ndarray
    mask: np.ndarray
    along: np.ndarray
    across: np.ndarray
    years: np.ndarray
    scales: tuple[float, ...]
    reach: float = REACH
    normalised: str = "local"

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
    def fitted(self) -> FlowPlanes:
        """
        Planes to which streams are fitted: signed roots, less their mean in time.

        Bright features weigh less in a speed than by their brightness.  Planes that are
        normalised along the flow, on which scales are compared, are fitted themselves.
        """
        if self.normalised == "along":
            return self
        values = np.sign(self.values) * np.sqrt(np.abs(self.values))
        values -= values.mean(axis=1, keepdims=True)
        return replace(self, values=values * self.mask)


@dataclass(frozen=True, eq=False, repr=False)
class SampledPlanes:
    """
    Wavelet planes of all epochs on a grid along and across the flow.

    Attributes
    ----------
    planes : `~numpy.ndarray`, shape (n_scales, n_epochs, n_along, n_across)
    valid : `~numpy.ndarray` of bool, shape (n_epochs, n_along, n_across)
        False where an epoch has no image.
    mask : `~numpy.ndarray` of bool, shape (n_along, n_across)
    noise : `~numpy.ndarray`, shape (n_scales,)
        Standard deviation of the noise of each plane.
    along, across, years, scales, reach
        See `FlowPlanes`.
    weight : `~numpy.ndarray`, shape (n_along, 1)
        Weight of places, of products of two values.
    sizes : tuple of float
        Size of the structures of each scale, in points of the grid.
    """

    planes: np.ndarray
    valid: np.ndarray
    mask: np.ndarray
    noise: np.ndarray
    along: np.ndarray
    across: np.ndarray
    weight: np.ndarray
    years: np.ndarray
    scales: tuple[float, ...]
    sizes: tuple[float, ...]
    reach: float = REACH

    def changes(self, normalise: str = "local") -> FlowPlanes:
        """
        Return what changes in the planes, normalised.

        With the plane w_a of epoch a, its mean over the epochs, its variance over time
        V, averaged in a Gaussian window, and its noise s,

        .. math:: q_a = \\mathrm{sgn}(w_a - \\bar w)\\,
                  \\min(|w_a - \\bar w| / \\sqrt{V}, 4)\\, \\sqrt{V / (V + (4 s)^2)}.

        Parameters
        ----------
        normalise : {"local", "along"}
            Whether the variance is that of each place, or the mean across the flow; the
            second one keeps what differs across the flow, as scales do.

        Returns
        -------
        `FlowPlanes`
        """
        number = np.maximum(self.valid.sum(axis=0), 1)
        mask = self.mask & (2 * number > len(self.valid))
        inside = mask.astype(float)
        values = np.empty(self.planes.shape, dtype=np.float32)
        each = zip(self.planes, self.sizes, self.noise, strict=True)
        for k, (plane, size, noise) in enumerate(each):
            rest = plane - np.where(self.valid, plane, 0).sum(axis=0) / number
            rest = np.where(self.valid, rest, 0.0)
            variance = (rest**2).sum(axis=0) / number * inside
            if normalise == "local":
                width = WINDOW * size
                area = np.maximum(scipy.ndimage.gaussian_filter(inside, width), 1e-3)
                variance = scipy.ndimage.gaussian_filter(variance, width) / area
            else:
                width = WINDOW * max(self.sizes)
                area = scipy.ndimage.gaussian_filter1d(inside.sum(axis=1), width)
                variance = scipy.ndimage.gaussian_filter1d(variance.sum(axis=1), width)
                variance = (variance / np.maximum(area, 1e-3))[:, None]
            variance = np.maximum(variance, TINY)
            share = np.sqrt(variance / (variance + (NOISES * noise) ** 2))
            q = np.clip(rest / np.sqrt(variance), -CLIP, CLIP) * share * inside
            values[k] = q * np.sqrt(self.weight)
        return FlowPlanes(
            values, mask, self.along, self.across, self.years, self.scales, self.reach,
            normalise,
        )  # fmt: skip


@dataclass(frozen=True, eq=False, repr=False)
class Diagram:
    """
    Correlation of every epoch with every other at displacements along the flow.

    Attributes
    ----------
    sums : `~numpy.ndarray`, shape (n_epochs, n_epochs, n_d)
        ``sum_x q_a(x - d/2) q_b(x + d/2)``, the mean over scales, over the number of
        places x; symmetric: ``sums[a, b, d] = sums[b, a, -d]``.
    overlap : `~numpy.ndarray`, shape (n_d,)
        Share of places for which both ends are inside the mask.
    displacement : `~numpy.ndarray`, shape (n_d,)
        In beams, evenly spaced and symmetric about zero.
    years : `~numpy.ndarray`, shape (n_epochs,)
    """

    sums: np.ndarray
    overlap: np.ndarray
    displacement: np.ndarray
    years: np.ndarray

    @property
    def norm(self) -> np.ndarray:
        """Factor of the sums at each displacement, 0 where few places are known."""
        known = self.overlap > LEAST_OVERLAP
        return np.where(known, 1 / np.maximum(self.overlap, LEAST_NORM), 0.0)

    @property
    def means(self) -> np.ndarray:
        """The sums over the number of pairs of places, shape of ``sums``."""
        return self.sums * self.norm.astype(np.float32)

    @property
    def power(self) -> float:
        """Mean correlation of an epoch with itself, at zero displacement."""
        epochs = np.arange(len(self.years))
        return float(self.sums[epochs, epochs, self.zero].mean())

    @property
    def zero(self) -> int:
        """Index of the displacement zero."""
        return len(self.displacement) // 2


def lags(flow, points=6.0):
    """
    Return the displacements of a diagram in points of the grid, from zero.

    There are at most so many ``points`` in a beam.
    """
    step = max(1, int(1 / (points * flow.step)))
    most = min(int(np.ceil(flow.reach / flow.step)), len(flow.along) - 2)
    return np.arange(0, max(most, step) + 1, step)


def ends(lag, n):
    """Return the slices of the earlier and later ends of displacements by a lag."""
    return (slice(0, n - lag), slice(lag, n)) if lag >= 0 else ends(-lag, n)[::-1]


def middles(weight, lag):
    """Return the weight of places at the middles of displacements by a lag >= 0."""
    low = weight[lag // 2 :][: len(weight) - lag]
    high = weight[(lag + 1) // 2 :][: len(weight) - lag]
    return (low + high) / 2


def correlate(flow, *, region=None, across=0):
    """
    Correlate all pairs of epochs at all displacements along the flow.

    Parameters
    ----------
    flow : ``FlowPlanes``
    region : `~numpy.ndarray`, shape (n_along, n_across), optional
        Weight of places.  A displacement belongs to the place of its middle, so that
        the ends of a region do not favour one speed.
    across : int, optional
        Displacement across the flow, in points of the grid.

    Returns
    -------
    `Diagram`
    """
    steps, mask = lags(flow), flow.mask.astype(np.float32)
    both = np.concatenate([-steps[:0:-1], steps])
    weight = mask if region is None else np.asarray(region, np.float32)
    total = max((mask * weight).sum(), 1.0)
    # Without a displacement across, negative ones are the same products.
    asked = both if across else steps
    weights = [weight_of_pairs(mask, weight, lag, across) for lag in asked]
    overlap = np.array([at.sum() for at in weights]) / total
    if not across:
        overlap = np.concatenate([overlap[:0:-1], overlap])
    if region is None:
        sums = _sums_by_waves(flow, both, across)
    else:
        sums = _sums_by_points(flow, asked, weights, across)
        if not across:
            back = sums[:, :, :0:-1].transpose(1, 0, 2)
            sums = np.concatenate([back, sums], axis=2)
    sums[:, :, overlap <= LEAST_OVERLAP / 2] = 0
    sums /= total * len(flow.values)
    return Diagram(sums, overlap, both * flow.step, flow.years)


def weight_of_pairs(mask, weight, lag, across):
    """Return the weight of the places from which a displacement starts."""
    here, there = ends(lag, len(mask))
    left, right = ends(across, mask.shape[1])
    at = middles(weight, abs(lag))[:, left if lag >= 0 else right]
    return at * mask[here, left] * mask[there, right]


def _sums_by_points(flow, displacements, weights, across):
    """Return the weighted sums over the products at all places."""
    n, mask = len(flow.years), flow.mask
    left, right = ends(across, mask.shape[1])
    # Values of all epochs at one place stand together.
    values, number = _at_points(flow)
    sums = np.empty((n, n, len(displacements)), np.float32)
    for k, (lag, at) in enumerate(zip(displacements, weights, strict=True)):
        here, there = ends(lag, len(mask))
        used = at > 0
        first, second = number[here, left][used], number[there, right][used]
        found = np.zeros((n, n), np.float32)
        for plane in values:
            found += (plane[first] * at[used][:, None]).T @ plane[second]
        sums[:, :, k] = found
    return sums


def _at_points(flow):
    """Return the values inside the mask by scale and point, and numbers of points."""
    values = np.ascontiguousarray(flow.values[:, :, flow.mask].swapaxes(1, 2))
    return values, np.cumsum(flow.mask).reshape(flow.mask.shape) - 1


def _transformed(flow):
    """Return the planes by wave number along the flow, and the length they have."""
    # Displacements must not lead around from one end to the other.
    length = scipy.fft.next_fast_len(len(flow.along) + lags(flow)[-1], real=True)
    values = flow.values.transpose(2, 1, 0, 3)
    return scipy.fft.rfft(values, length, axis=0), length


def _sums_by_waves(flow, displacements, across):
    """Return the sums over the products at all places, by their Fourier transform."""
    n, (planes, length) = len(flow.years), _transformed(flow)
    left, right = ends(across, len(flow.across))
    first = planes[..., left].conj().reshape(len(planes), n, -1)
    second = planes[..., right].reshape(len(planes), n, -1)
    sums = scipy.fft.irfft(first @ second.swapaxes(1, 2), length, axis=0)
    return np.ascontiguousarray(sums[displacements % length].transpose(1, 2, 0))


def correlate_aside(flow, lags_across, *, region=None):
    """
    Return diagrams at displacements across the flow, for both signs of these.

    Parameters
    ----------
    flow, region
        As in `correlate`.
    lags_across : sequence of int
        From 1, in points of the grid.

    Returns
    -------
    list of `Diagram`
        From the most negative displacement to the most positive one.
    """
    middle = correlate(flow, region=region)
    high = [correlate(flow, region=region, across=lag) for lag in lags_across]
    # The same products, seen from their other ends.
    low = [
        replace(d, sums=d.sums.transpose(1, 0, 2)[:, :, ::-1], overlap=d.overlap[::-1])
        for d in high
    ]
    return [*low[::-1], middle, *high]


def influences(flow, diagram, functions, *, region=None):
    """
    Return what each place of each epoch adds to linear functions of the diagram.

    .. math:: I_a(x) = q_a(x) \\sum_b \\sum_d h_{ab}(d)\\, q_b(x + d)

    Parameters
    ----------
    flow, region
        As in `correlate`.
    diagram : `Diagram`
    functions : sequence of `~numpy.ndarray`, shape (n_epochs, n_epochs, n_d)
        Functions h of the ``means``, symmetric as the diagram is.

    Returns
    -------
    list of `~numpy.ndarray`, shape (n_epochs, n_along)
        Summed across the flow; half of each product is counted at either end.
    """
    mask = flow.mask
    weight = np.asarray(mask if region is None else region, np.float32)
    total = max((mask * weight).sum(), 1.0) * len(flow.values)
    norm = (diagram.norm / total).astype(np.float32)
    if region is None:
        return _influences_by_waves(flow, diagram, functions, norm)
    return _influences_by_points(flow, diagram, functions, norm, weight)


def _influences_by_waves(flow, diagram, functions, norm):
    """Return the influences without weights, by their Fourier transform."""
    n, (planes, length) = len(flow.years), _transformed(flow)
    planes = planes.reshape(len(planes), n, -1)
    at = np.rint(diagram.displacement / flow.step).astype(int) % length
    values = flow.values.transpose(2, 1, 0, 3)
    found = []
    for function in functions:
        h = np.zeros((length, n, n), np.float32)
        h[at] = (function * norm).transpose(2, 0, 1)
        sums = scipy.fft.rfft(h, axis=0).conj() @ planes
        sums = scipy.fft.irfft(sums, length, axis=0)[: len(values)]
        found.append(np.einsum("xasy,xasy->ax", values, sums.reshape(values.shape)))
    return found


def _influences_by_points(flow, diagram, functions, norm, weight):
    """Return the influences with the weights of a region."""
    n, mask = len(flow.years), flow.mask.astype(np.float32)
    values, number = _at_points(flow)
    found = [np.zeros((len(mask), n)) for _ in functions]
    for k, lag in enumerate(lags(flow)):
        at = weight_of_pairs(mask, weight, lag, 0)
        used = at > 0
        if norm[diagram.zero + k] == 0 or not used.any():
            continue
        here, there = ends(lag, len(mask))
        first, second = number[here][used], number[there][used]
        rows = np.nonzero(used)[0]
        starts = np.flatnonzero(np.diff(rows, prepend=-1))
        rows = rows[starts]
        # The negative displacements are the same products.
        share = at[used][:, None] * (1 if k else 0.5)
        slices = [f[:, :, diagram.zero + k] * norm[diagram.zero + k] for f in functions]
        for plane in values:
            one, other = plane[first] * share, plane[second]
            for sums, h in zip(found, slices, strict=True):
                sums[here][rows] += np.add.reduceat(one * (other @ h.T), starts)
                sums[there][rows] += np.add.reduceat(other * (one @ h), starts)
    return [sums.T for sums in found]
