# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Significant structural patterns (SSPs) of wavelet planes, and their catalogue."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from skimage.feature import peak_local_max
from skimage.segmentation import watershed

from astro_scc.decomposition.wavelet import scale_size

if TYPE_CHECKING:
    from astro_scc.decomposition.decompose import Decomposition


@dataclass(frozen=True, eq=False, repr=False)
class SSPs:
    """
    The significant structural patterns of one or more images on all scales.

    Attributes
    ----------
    scale : `~numpy.ndarray`, shape (n,)
        Scale number.
    y, x : `~numpy.ndarray`, shape (n,)
        Position of the maximum of the plane, sub-pixel.
    y_centroid, x_centroid : `~numpy.ndarray`, shape (n,)
        Mean position of the pixels, weighted by the plane.
    peak : `~numpy.ndarray`, shape (n,)
        Largest wavelet coefficient.
    flux : `~numpy.ndarray`, shape (n,)
        Sum of the wavelet coefficients.
    snr : `~numpy.ndarray`, shape (n,)
        ``peak`` divided by the noise of the plane there.
    bbox : `~numpy.ndarray` of int, shape (n, 4)
        Bounding box ``y0, x0, y1, x1``, ends excluded.
    starts : `~numpy.ndarray` of int, shape (n + 1,)
        Start of the pixels of each SSP in ``pixels``.
    pixels : `~numpy.ndarray` of int, shape (starts[-1],)
        Indices into the flattened image of the pixels of all SSPs.
    epoch : `~numpy.ndarray` of int, shape (n,)
        Index of the image that shows the SSP.

    Examples
    --------
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> images = simulate_two_fluid(n_epochs=2, rng=1).cube.data
    >>> ssps = SSPs.of_epochs([Decomposer(scales=[2])(image) for image in images])
    >>> sorted(set(ssps.epoch.tolist())), bool((ssps.snr >= 4).all())
    ([0, 1], True)
    """

    scale: np.ndarray
    y: np.ndarray
    x: np.ndarray
    y_centroid: np.ndarray
    x_centroid: np.ndarray
    peak: np.ndarray
    flux: np.ndarray
    snr: np.ndarray
    bbox: np.ndarray
    starts: np.ndarray
    pixels: np.ndarray
    epoch: np.ndarray

    def __len__(self) -> int:
        return len(self.scale)

    def __repr__(self):
        counts = ", ".join(
            f"{number} on scale {scale:g}"
            for scale, number in zip(
                *np.unique(self.scale, return_counts=True), strict=True
            )
        )
        return f"<SSPs: {counts or 'none'}>"

    @property
    def n_pixels(self) -> np.ndarray:
        """Number of pixels of each SSP, shape (n,)."""
        return np.diff(self.starts)

    def pixels_of(self, index: int) -> np.ndarray:
        """
        Return the indices into the flattened image of the pixels of one SSP.

        Parameters
        ----------
        index : int

        Returns
        -------
        `~numpy.ndarray` of int
        """
        return self.pixels[self.starts[index] : self.starts[index + 1]]

    def select(self, keep: np.ndarray) -> SSPs:
        """
        Return the SSPs for which ``keep``, of shape (n,), is true.

        Parameters
        ----------
        keep : `~numpy.ndarray` of bool, shape (n,)

        Returns
        -------
        `SSPs`
        """
        chosen = {
            f.name: getattr(self, f.name)[keep]
            for f in fields(self)
            if f.name not in ("starts", "pixels")
        }
        starts = np.concatenate([[0], np.cumsum(self.n_pixels[keep])])
        pixels = self.pixels[np.repeat(keep, self.n_pixels)]
        return SSPs(**chosen, starts=starts, pixels=pixels)

    @classmethod
    def empty(cls) -> SSPs:
        """Return a catalogue without SSPs."""
        return cls(
            *(np.empty(0) for _ in range(8)),
            bbox=np.empty((0, 4), dtype=int),
            starts=np.zeros(1, dtype=int),
            pixels=np.empty(0, dtype=np.int32),
            epoch=np.empty(0, dtype=int),
        )

    @classmethod
    def concatenate(cls, catalogues: Sequence[SSPs]) -> SSPs:
        """
        Join catalogues, of several scales or of several epochs.

        Parameters
        ----------
        catalogues : sequence of `SSPs`

        Returns
        -------
        `SSPs`
        """
        catalogues = [cls.empty(), *catalogues]
        shifts = np.cumsum([0] + [c.starts[-1] for c in catalogues[:-1]])
        joined = {
            f.name: np.concatenate([getattr(c, f.name) for c in catalogues])
            for f in fields(cls)
            if f.name != "starts"
        }
        starts = [c.starts[1:] + s for c, s in zip(catalogues, shifts, strict=True)]
        return cls(**joined, starts=np.concatenate([[0], *starts]))

    @classmethod
    def of_epochs(cls, decompositions: Sequence[Decomposition]) -> SSPs:
        """
        Join the SSPs of all decompositions, numbered by ``epoch``.

        Parameters
        ----------
        decompositions : sequence of `~astro_scc.decomposition.Decomposition`

        Returns
        -------
        `SSPs`
        """
        return cls.concatenate(
            [
                replace(d.ssps, epoch=np.full(len(d.ssps), epoch))
                for epoch, d in enumerate(decompositions)
            ]
        )


def require_ssps(ssps, scales):
    """Raise a ValueError if no epoch shows an SSP on the scales."""
    if len(ssps) == 0:
        raise ValueError(
            "no significant pattern (SSP) in any epoch on scale "
            f"{', '.join(f'{scale:g}' for scale in scales)}: try other scales, or a "
            "lower detection; if the images have no empty sky, give their noise and "
            "noise='propagated'"
        )


def quadratic_peak(values):
    """
    Find the maximum of the least-squares quadratic surface through 3 x 3 values.

    ``values`` has the shape (..., 3, 3), and the central one is the largest.  Returns
    dy and dx from the centre, within half a pixel and zero if the surface has no
    maximum, and the height there, which is never below the central value.
    """
    v = np.asarray(values, dtype=float)
    column, row = v.sum(axis=-2), v.sum(axis=-1)
    gx = (column[..., 2] - column[..., 0]) / 6
    gy = (row[..., 2] - row[..., 0]) / 6
    hxx = (column[..., 2] - 2 * column[..., 1] + column[..., 0]) / 3
    hyy = (row[..., 2] - 2 * row[..., 1] + row[..., 0]) / 3
    hxy = (v[..., 2, 2] - v[..., 2, 0] - v[..., 0, 2] + v[..., 0, 0]) / 4
    level = (5 * v.sum(axis=(-2, -1)) - 3 * (column[..., 0] + column[..., 2])
             - 3 * (row[..., 0] + row[..., 2])) / 9  # fmt: skip
    determinant = hxx * hyy - hxy**2
    peaked = (determinant > 0) & (hxx < 0)
    safe = np.where(peaked, determinant, 1.0)
    dx = np.where(peaked, (hxy * gy - hyy * gx) / safe, 0.0)
    dy = np.where(peaked, (hxy * gx - hxx * gy) / safe, 0.0)
    inside = (np.abs(dx) <= 0.5) & (np.abs(dy) <= 0.5)
    dx, dy = np.clip(dx, -0.5, 0.5), np.clip(dy, -0.5, 0.5)
    height = np.where(peaked & inside, level + 0.5 * (gx * dx + gy * dy), v[..., 1, 1])
    return dy, dx, np.maximum(height, v[..., 1, 1])


def check_thresholds(detection, segmentation):
    """Raise a ValueError if the thresholds can give no SSPs."""
    if not 0 < segmentation <= detection:
        raise ValueError(
            "thresholds must satisfy 0 < segmentation <= detection, "
            f"got segmentation {segmentation} and detection {detection}"
        )


def _beside_outside(valid):
    """Return the pixels that touch the image's edge, or missing pixels joined to it."""
    if valid.all():
        edge = np.ones(valid.shape, dtype=bool)
        edge[1:-1, 1:-1] = False
        return edge
    outside, _ = ndimage.label(np.pad(~valid, 1, constant_values=True))
    beside = ndimage.binary_dilation(outside == outside[0, 0], np.ones((3, 3)))
    return beside[1:-1, 1:-1]


def _positions(plane, valid, peaks):
    """Return the sub-pixel positions of maxima given as (y, x) pixels."""
    # Beside a missing pixel the curvature is unknown, and the whole pixel is kept.
    padded = np.pad(np.where(valid, plane, np.nan), 1, mode="reflect")
    step = np.arange(3)
    rows = peaks[:, 0, None, None] + step[:, None]
    columns = peaks[:, 1, None, None] + step[None, :]
    dy, dx, _ = quadratic_peak(padded[rows, columns])
    return peaks[:, 0] + dy, peaks[:, 1] + dx


def find_ssps(
    plane: np.ndarray, scale: float, noise: float | np.ndarray, *,
    mask: ArrayLike | None = None, detection: float = 4.0, segmentation: float = 3.0,
) -> SSPs:  # fmt: skip
    """
    Find the significant structural patterns of a wavelet plane.

    Local maxima of at least ``detection`` times the noise, about a scale
    apart, are the seeds of a watershed of the negative plane within the
    pixels above ``segmentation`` times the noise (Mertens & Lobanov 2015,
    Sect. 2.1).  A pixel at the edge of the image, or of its valid part, is
    not a maximum, because the image may rise further beyond it.  A pixel
    beside a hole within the image can be one.

    Parameters
    ----------
    plane : `~numpy.ndarray`, shape (ny, nx)
        Wavelet coefficients; only positive ones make SSPs.
    scale : float
        Scale number.
    noise : float or `~numpy.ndarray`, shape (ny, nx)
        Standard deviation of the noise of the plane.
    mask : array_like of bool, shape (ny, nx), optional
        True marks missing pixels, which belong to no SSP.
    detection, segmentation : float
        Thresholds in units of the noise.

    Returns
    -------
    `SSPs`
        Without rows if nothing is significant.

    Raises
    ------
    ValueError
        If a threshold is not positive or ``segmentation > detection``.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.decomposition import find_ssps
    >>> y, x = np.mgrid[:40, :60]
    >>> plane = np.exp(-((x - 20.3) ** 2 + (y - 15) ** 2) / 18)
    >>> ssps = find_ssps(plane, 1, 0.01)
    >>> len(ssps), float(ssps.x_centroid[0].round(1))
    (1, 20.3)
    """
    check_thresholds(detection, segmentation)
    plane = np.asarray(plane, dtype=float)
    noise = np.broadcast_to(np.asarray(noise, dtype=float), plane.shape)
    valid = np.ones(plane.shape, dtype=bool) if mask is None else ~np.asarray(mask)
    significant = valid & (plane > segmentation * noise)
    peaks = peak_local_max(
        np.where(significant, plane, 0.0),
        min_distance=max(1, int(round(scale_size(scale)))),
        threshold_abs=0.0,
        exclude_border=False,
    )
    rows, columns = peaks.T
    peaks = peaks[
        (plane[rows, columns] >= detection * noise[rows, columns])
        & ~_beside_outside(valid)[rows, columns]
    ]
    if len(peaks) == 0:
        return SSPs.empty()
    markers = np.zeros(plane.shape, dtype=np.int32)
    markers[tuple(peaks.T)] = np.arange(1, len(peaks) + 1)
    labels = watershed(-plane, markers, connectivity=1, mask=significant)
    return _catalogue(plane, scale, noise, valid, labels, peaks)


def _catalogue(plane, scale, noise, valid, labels, peaks):
    pixels = np.flatnonzero(labels)
    pixels = pixels[np.argsort(labels.flat[pixels], kind="stable")].astype(np.int32)
    owner = labels.flat[pixels] - 1
    n = len(peaks)
    counts = np.bincount(owner, minlength=n)
    starts = np.concatenate([[0], np.cumsum(counts)])
    py, px = np.unravel_index(pixels, plane.shape)
    weight = plane.flat[pixels]
    flux = np.bincount(owner, weight, n)
    y, x = _positions(plane, valid, peaks)
    peak = plane[tuple(peaks.T)]
    first = starts[:-1]
    low = [np.minimum.reduceat(p, first) for p in (py, px)]
    high = [np.maximum.reduceat(p, first) + 1 for p in (py, px)]
    return SSPs(
        scale=np.full(n, float(scale)),
        y=y,
        x=x,
        y_centroid=np.bincount(owner, weight * py, n) / flux,
        x_centroid=np.bincount(owner, weight * px, n) / flux,
        peak=peak,
        flux=flux,
        snr=peak / noise[tuple(peaks.T)],
        bbox=np.stack([*low, *high], axis=1),
        starts=starts,
        pixels=pixels,
        epoch=np.zeros(n, dtype=int),
    )
