# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Zero-mean normalised cross-correlation of a masked template with windows."""

from functools import cached_property

import numpy as np
import scipy

from astro_scc.decomposition.segmentation import gaussian_peak

#: Local variances below this fraction of a window's energy are rounding errors,
#: which were measured as 7e-16.  A pattern beside a core a million times brighter
#: still counts, with an error of 0.002.
VARIANCE_FLOOR = 5e-15


class Template:
    """
    The pixels of one pattern, transformed once for all windows.

    ``values`` and ``footprint`` have the shape of the pattern's bounding box; only
    pixels of the footprint count.  Windows have the ``window_shape``, or the
    ``fft_shape`` so that they need no padding; their values beyond the former do not
    matter.  Results have the ``result_shape``.
    """

    def __init__(self, values, footprint, search_radius):
        inside = values[footprint].astype(float)
        deviation, self.n_pixels = inside - inside.mean(), len(inside)
        self.energy, self.values = 0.0, np.zeros(footprint.shape)
        # Patterns that vary less, relative to their values, are flat.
        if np.abs(deviation).max() > 1e-14 * np.abs(inside).max():
            self.energy = float((deviation**2).sum())
            self.values[footprint] = deviation / self.energy**0.5
        self.footprint = footprint.astype(float)
        self.result_shape = tuple(2 * r + 1 for r in search_radius)
        self.window_shape = tuple(
            n + 2 * r for n, r in zip(footprint.shape, search_radius, strict=True)
        )
        # Circular correlation is exact at displacements where nothing wraps.
        self.fft_shape = tuple(
            scipy.fft.next_fast_len(int(n), real=True) for n in self.window_shape
        )

    @cached_property
    def _transforms(self):
        """Conjugate transforms of the values and of the footprint."""
        arrays = self.values, self.footprint
        return [np.conj(scipy.fft.rfft2(array, self.fft_shape)) for array in arrays]

    def _correlate(self, window_fft, template_fft):
        # Rows that belong to no displacement are dropped after the first axis.
        ny, nx = self.result_shape
        columns = scipy.fft.ifft(window_fft * template_fft, axis=-2, overwrite_x=True)
        rows = scipy.fft.irfft(columns[..., :ny, :], self.fft_shape[1], axis=-1)
        return rows[..., :nx]

    def _overlap(self, valid):
        """
        Return the effect of missing pixels of windows, at each displacement.

        These are the share of the template's pixels that fall on valid ones, and the
        inverse of that; the scaled mean of the template over valid pixels, and the
        inverse square root of its variance there.
        """
        valid_fft = scipy.fft.rfft2(valid.astype(float), self.fft_shape)
        values_fft, footprint_fft = self._transforms
        number = np.rint(self._correlate(valid_fft, footprint_fft))
        some = np.maximum(number, 1.0)
        own_mean = self._correlate(valid_fft, values_fft)
        squares_fft = np.conj(scipy.fft.rfft2(self.values**2, self.fft_shape))
        variance = self._correlate(valid_fft, squares_fft) - own_mean**2 / some
        flat = variance <= VARIANCE_FLOOR
        share, ratio = number / self.n_pixels, self.n_pixels / some
        own_mean = own_mean * self.n_pixels**0.5 / some
        scale = np.where(flat, 0.0, np.where(flat, 1.0, variance) ** -0.5)
        return share, ratio, own_mean, scale

    def of_windows(self, windows, valid=None, min_overlap=0.0):
        """
        Return the coefficients of windows, and the overlap, shape (..., ny, nx).

        Windows are in double precision and zero where pixels are missing; if
        some are, ``valid`` tells which are there, and coefficients are NaN where
        the share of the template that falls on them is too small.
        """
        transform = scipy.fft.rfft2(windows, self.fft_shape)
        squares = windows * windows
        floor = VARIANCE_FLOOR * squares.sum(axis=(-2, -1), keepdims=True)
        squares_fft = scipy.fft.rfft2(squares, self.fft_shape)
        values_fft, footprint_fft = self._transforms
        variance = self._correlate(squares_fft, footprint_fft)
        total = self._correlate(transform, footprint_fft * self.n_pixels**-0.5)
        covariance = self._correlate(transform, values_fft)
        if valid is None:
            share = np.broadcast_to(1.0, covariance.shape)
            variance -= np.multiply(total, total, out=total)
        else:
            share, ratio, own_mean, scale = self._overlap(valid)
            covariance -= total * own_mean
            covariance *= scale
            total *= total
            variance -= np.multiply(total, ratio, out=total)
        np.copyto(variance, np.inf, where=variance <= floor)
        coefficient = covariance / np.sqrt(variance, out=variance)
        # Beside a displacement that cannot be judged there is no maximum, as the
        # pattern may have moved further.
        np.copyto(coefficient, np.nan, where=share < min_overlap)
        return coefficient, share


def correlate_windows(
    values: np.ndarray, footprint: np.ndarray, windows: np.ndarray,
    search_radius: tuple[int, int], *, valid: np.ndarray | None = None,
    min_overlap: float = 0.8,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    r"""
    Correlate a masked pattern with windows at every displacement.

    Each coefficient is that of the pattern's own pixels a with the pixels b that they
    fall on,

    .. math:: C = \frac{\sum \bar a_i \bar b_i}
                       {\sqrt{\sum \bar a_i^2 \sum \bar b_i^2}},

    where bars mark values minus their mean (Mertens & Lobanov 2016, Eq. 3;
    Giachetti 2000), and 0 if either has no variance.  It is computed with real
    Fourier transforms in double precision.

    Parameters
    ----------
    values : `~numpy.ndarray`, shape (h, w)
        Bounding box of the pattern.
    footprint : `~numpy.ndarray` of bool, shape (h, w)
        The pattern's own pixels.
    windows : `~numpy.ndarray`, shape (..., h + 2 ry, w + 2 rx)
        Parts of the target images centred on the box.
    search_radius : tuple of int
        Largest displacement ``(ry, rx)``.
    valid : `~numpy.ndarray` of bool, shape of ``windows``, optional
        False marks missing pixels; pixels that are not finite are missing as
        well.  Both means are then over the valid pixels.
    min_overlap : float, optional
        Fraction of the pattern's pixels that must fall on valid ones; where it
        is smaller, the coefficient is zero.

    Returns
    -------
    coefficient : `~numpy.ndarray`, shape (..., 2 ry + 1, 2 rx + 1)
        Entry ``[ry + dy, rx + dx]`` is for displacement (dy, dx).
    overlap : `~numpy.ndarray`, same shape
        Fraction of the pattern's pixels that fall on valid ones.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.images.zncc import correlate_windows
    >>> window = np.random.default_rng(3).normal(size=(20, 20))
    >>> pattern = window[7:13, 9:15]
    >>> coefficient, _ = correlate_windows(
    ...     pattern, np.ones((6, 6), bool), window, (7, 7))
    >>> np.argwhere(coefficient > 0.999) - 7
    array([[0, 2]])
    """
    template = Template(values, footprint, search_radius)
    exists = np.isfinite(windows)
    if valid is not None:
        exists &= valid
    windows = np.where(exists, windows, 0.0)
    # A large offset would swamp the local variances with rounding errors.
    number = np.maximum(exists.sum(axis=(-2, -1), keepdims=True), 1)
    windows -= windows.sum(axis=(-2, -1), keepdims=True) / number
    windows[~exists] = 0.0
    coefficient, overlap = template.of_windows(windows, exists, min_overlap)
    return np.nan_to_num(coefficient, copy=False), overlap


def find_peaks(coefficient, threshold):
    """
    Find the local maxima of stacked maps at or above a threshold.

    A pixel is a maximum if none of its eight neighbours is larger or NaN.  Of
    equal neighbours the last one counts, row by row; pixels at the border are not
    maxima.  Positions are those of the Gaussian through the nine values.

    ``coefficient`` has the shape (n, ny, nx).  Returns for each peak the index of
    its map, y and x in pixels, and the value of the Gaussian at its maximum, which
    is at least that of the pixel and at most 1.
    """
    n, ny, nx = coefficient.shape
    # One index for all axes is the fastest way to look up values.
    flat = np.ascontiguousarray(coefficient).reshape(-1)
    at = np.flatnonzero(coefficient[:, 1:-1, 1:-1] >= threshold)
    index, at = np.divmod(at, (ny - 2) * (nx - 2))
    y, x = np.divmod(at, nx - 2)
    at = (index * ny + y + 1) * nx + x + 1
    value = flat[at]
    # Four neighbours first: they rule out most candidates at half the cost.
    before = (value >= flat[at - nx]) & (value >= flat[at - 1])
    at = at[before & (value > flat[at + 1]) & (value > flat[at + nx])]
    value, step = flat[at], np.arange(-1, 2)
    around = flat[at[:, None, None] + (step[:, None] * nx + step)]
    keep = (value >= around[:, 0, 0]) & (value >= around[:, 0, 2])
    keep &= (value > around[:, 2, 0]) & (value > around[:, 2, 2])
    index, y, x = np.unravel_index(at[keep], coefficient.shape)
    dy, dx, height = gaussian_peak(around[keep])
    return index, y + dy, x + dx, np.minimum(height, 1.0)
