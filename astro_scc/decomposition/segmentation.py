# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""From a wavelet plane to its significant structural patterns."""

import numpy as np
from scipy import ndimage
from skimage.feature import peak_local_max
from skimage.segmentation import watershed

from astro_scc.decomposition.ssp import SSPs
from astro_scc.decomposition.wavelet import scale_size

__all__ = ["find_ssps", "quadratic_peak"]


def quadratic_peak(values):
    """
    Maximum of the quadratic surface through 3 x 3 values, by least squares.

    Parameters
    ----------
    values : array_like, shape (..., 3, 3)
        The central value is the largest.

    Returns
    -------
    dy, dx : `~numpy.ndarray`, shape (...)
        Offset from the centre, within half a pixel; zero where the surface
        has no maximum.
    height : `~numpy.ndarray`, shape (...)
        Value at the maximum, never below the central one.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.decomposition import quadratic_peak
    >>> y, x = np.mgrid[-1:2, -1:2]
    >>> dy, dx, height = quadratic_peak(1 - (x - 0.25) ** 2 - (y + 0.125) ** 2)
    >>> float(dy), float(dx), float(height)
    (-0.125, 0.25, 1.0)
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
    """
    Refuse thresholds that make no SSPs.

    Parameters
    ----------
    detection, segmentation : float
        In units of the noise.

    Raises
    ------
    ValueError
        If a threshold is not positive or ``segmentation > detection``.
    """
    if not 0 < segmentation <= detection:
        raise ValueError(
            "thresholds must satisfy 0 < segmentation <= detection, "
            f"got segmentation {segmentation} and detection {detection}"
        )


def _beside_outside(valid):
    """Pixels that touch the outside: the image's edge, or what is missing there."""
    if valid.all():
        edge = np.ones(valid.shape, dtype=bool)
        edge[1:-1, 1:-1] = False
        return edge
    outside, _ = ndimage.label(np.pad(~valid, 1, constant_values=True))
    return ndimage.binary_dilation(outside == outside[0, 0], np.ones((3, 3)))[
        1:-1, 1:-1
    ]


def _positions(plane, valid, peaks):
    """Sub-pixel positions of maxima given as (y, x) pixels."""
    # Beside a missing pixel there is no curvature, and the pixel counts.
    padded = np.pad(np.where(valid, plane, np.nan), 1, mode="reflect")
    step = np.arange(3)
    rows = peaks[:, 0, None, None] + step[:, None]
    columns = peaks[:, 1, None, None] + step[None, :]
    dy, dx, _ = quadratic_peak(padded[rows, columns])
    return peaks[:, 0] + dy, peaks[:, 1] + dx


def find_ssps(plane, scale, noise, *, mask=None, detection=4.0, segmentation=3.0):
    """
    Find the significant structural patterns of a wavelet plane.

    Local maxima of at least ``detection`` times the noise and about a scale
    apart are the seeds of a watershed of the negative plane inside the
    pixels above ``segmentation`` times the noise (Mertens & Lobanov 2015,
    Sect. 2.1).  A pixel at the edge of the image, or of what exists of it,
    is no maximum: the image may well go on rising beyond.  Beside a hole
    within the image it can be one.

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
        Zero rows if nothing is significant.

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
        threshold_rel=None,
        exclude_border=False,
        num_peaks=np.inf,
        footprint=None,
        labels=None,
        num_peaks_per_label=np.inf,
        p_norm=np.inf,
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
    bbox = np.stack(
        [
            np.minimum.reduceat(py, first),
            np.minimum.reduceat(px, first),
            np.maximum.reduceat(py, first) + 1,
            np.maximum.reduceat(px, first) + 1,
        ],
        axis=1,
    )
    return SSPs(
        scale=np.full(n, float(scale)),
        y=y,
        x=x,
        y_centroid=np.bincount(owner, weight * py, n) / flux,
        x_centroid=np.bincount(owner, weight * px, n) / flux,
        peak=peak,
        flux=flux,
        snr=peak / noise[tuple(peaks.T)],
        bbox=bbox,
        starts=starts,
        pixels=pixels,
        epoch=np.zeros(n, dtype=int),
    )
