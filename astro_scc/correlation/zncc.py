# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Zero-mean normalised cross-correlation of a masked template with windows."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import fft

__all__ = ["Overlap", "Template", "correlate_windows", "zncc"]

#: Local variances below this share of a window's energy are rounding, of
#: which 7e-16 was measured.  A pattern then still counts beside a core a
#: million times brighter, with an error of 0.002.
VARIANCE_FLOOR = 5e-15
#: Patterns that vary by less than this, relative to their values, are flat.
FLAT = 1e-14


def zncc(a, b):
    r"""
    Zero-mean normalised cross-correlation of two sets of pixels.

    .. math:: C = \frac{\sum \bar a_i \bar b_i}
                       {\sqrt{\sum \bar a_i^2 \sum \bar b_i^2}},

    bars marking values minus their mean (Mertens & Lobanov 2016, Eq. 3;
    Giachetti 2000).  This is the definition; `correlate_windows` is
    equivalent to it.

    Parameters
    ----------
    a, b : array_like, same shape

    Returns
    -------
    float
        Between -1 and 1; 0 if either has no variance.

    Examples
    --------
    >>> from astro_scc.correlation import zncc
    >>> round(zncc([1, 2, 3, 5], [2, 4, 6, 10]), 6)
    1.0
    """
    a, b = _zero_mean(a), _zero_mean(b)
    norm = np.sqrt(np.sum(a * a) * np.sum(b * b))
    return float(np.sum(a * b) / norm) if norm > 0 else 0.0


def _zero_mean(values):
    """Values minus their mean, exactly zero where that is only rounding."""
    values = np.asarray(values, dtype=float)
    deviation = values - values.mean()
    flat = np.abs(deviation).max() <= FLAT * np.abs(values).max()
    return np.zeros_like(deviation) if flat else deviation


def fft_shape(shape, reach):
    """
    Shape of the transforms of a template.

    Circular correlation is exact where the template does not wrap.

    Parameters
    ----------
    shape : tuple of int
        Of the template.
    reach : tuple of int
        Largest displacement.

    Returns
    -------
    tuple of int
    """
    return tuple(
        fft.next_fast_len(int(n + 2 * r), real=True)
        for n, r in zip(shape, reach, strict=True)
    )


@dataclass(frozen=True, eq=False)
class Overlap:
    """
    What missing pixels do to a template, the same for all windows with them.

    Attributes
    ----------
    share : `~numpy.ndarray`, shape (..., ny, nx)
        Share of the template's pixels on existing pixels, a displacement.
    unjudged : `~numpy.ndarray` of bool, same shape
        Where that is below the smallest that counts.
    """

    share: np.ndarray
    unjudged: np.ndarray
    # Pixels of the template over those that exist.
    ratio: np.ndarray
    # Sum of the template over existing pixels, per pixel, and one over the
    # root of its variance there.
    own_mean: np.ndarray
    scale: np.ndarray


class Template:
    """
    The pixels of one pattern, transformed once for all windows.

    Parameters
    ----------
    values : `~numpy.ndarray`, shape (h, w)
        Bounding box of the pattern.
    footprint : `~numpy.ndarray` of bool, shape (h, w)
        The pattern's own pixels; nothing else of the box counts.
    reach : tuple of int
        Largest displacement ``(y, x)`` of the windows in pixels.

    Attributes
    ----------
    window_shape : tuple of int
        Pixels that take part, (h + 2 ry, w + 2 rx).
    fft_shape : tuple of int
        That of the transforms: windows of this shape need not be padded,
        whatever they hold beyond ``window_shape``.
    result_shape : tuple of int
        (2 ry + 1, 2 rx + 1).

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.correlation import Template
    >>> values = np.arange(12.0).reshape(3, 4)
    >>> template = Template(values, np.ones((3, 4), bool), (2, 5))
    >>> template.window_shape, template.result_shape
    ((7, 14), (5, 11))
    """

    def __init__(self, values, footprint, reach):
        self.n_pixels = int(footprint.sum())
        own = _zero_mean(values[footprint])
        self.energy = float((own**2).sum())
        self.values = np.zeros(footprint.shape)
        if self.energy > 0:
            self.values[footprint] = own / self.energy**0.5
        self.footprint = footprint.astype(float)
        self.result_shape = tuple(2 * r + 1 for r in reach)
        self.window_shape = tuple(
            n + 2 * r for n, r in zip(footprint.shape, reach, strict=True)
        )
        self.fft_shape = fft_shape(footprint.shape, reach)

    @cached_property
    def _values_fft(self):
        return self._transform(self.values)

    @cached_property
    def _footprint_fft(self):
        return self._transform(self.footprint)

    @cached_property
    def _mean_fft(self):
        return self._footprint_fft * self.n_pixels**-0.5

    def _transform(self, array):
        return np.conj(fft.rfft2(array, self.fft_shape))

    def _correlate(self, window_fft, template_fft):
        # Rows that are of no displacement are dropped half way.
        ny, nx = self.result_shape
        columns = fft.ifft(window_fft * template_fft, axis=-2, overwrite_x=True)
        rows = fft.irfft(columns[..., :ny, :], self.fft_shape[1], axis=-1)
        return rows[..., :nx]

    def overlap(self, valid, min_overlap):
        """
        Prepare for windows with missing pixels.

        Parameters
        ----------
        valid : `~numpy.ndarray` of bool, shape (..., h, w)
            False marks missing pixels; one for all windows, or for each.
        min_overlap : float

        Returns
        -------
        `Overlap`
        """
        valid_fft = fft.rfft2(valid.astype(float), self.fft_shape)
        number = np.rint(self._correlate(valid_fft, self._footprint_fft))
        some = np.maximum(number, 1.0)
        own_mean = self._correlate(valid_fft, self._values_fft)
        squares_fft = self._transform(self.values**2)
        own = self._correlate(valid_fft, squares_fft) - own_mean**2 / some
        flat = own <= VARIANCE_FLOOR
        share = number / self.n_pixels
        return Overlap(
            share=share,
            unjudged=share < min_overlap,
            ratio=self.n_pixels / some,
            own_mean=own_mean * self.n_pixels**0.5 / some,
            scale=np.where(flat, 0.0, np.where(flat, 1.0, own) ** -0.5),
        )

    def of_windows(self, windows, overlap=None):
        """
        Coefficients for windows.

        Parameters
        ----------
        windows : `~numpy.ndarray`, shape (..., h, w)
            Of ``window_shape`` or ``fft_shape``, in double precision, zero
            where pixels are missing.
        overlap : `Overlap`, optional
            That of the pixels which exist, if some do not.

        Returns
        -------
        `~numpy.ndarray`, shape (..., ny, nx)
            NaN where the overlap is too small.
        """
        transform = fft.rfft2(windows, self.fft_shape)
        squares = windows * windows
        floor = VARIANCE_FLOOR * squares.sum(axis=(-2, -1), keepdims=True)
        squares_fft = fft.rfft2(squares, self.fft_shape)
        variance = self._correlate(squares_fft, self._footprint_fft)
        total = self._correlate(transform, self._mean_fft)
        covariance = self._correlate(transform, self._values_fft)
        if overlap is None:
            variance -= np.multiply(total, total, out=total)
        else:
            covariance -= total * overlap.own_mean
            covariance *= overlap.scale
            total *= total
            variance -= np.multiply(total, overlap.ratio, out=total)
        np.copyto(variance, np.inf, where=variance <= floor)
        coefficient = covariance / np.sqrt(variance, out=variance)
        if overlap is not None:
            # Beside a displacement that cannot be judged there is no
            # maximum: the pattern may well have gone further.
            np.copyto(coefficient, np.nan, where=overlap.unjudged)
        return coefficient


def correlate_windows(
    values, footprint, windows, reach, *, valid=None, min_overlap=0.8
):
    """
    Correlate a masked pattern with windows at every displacement.

    Equivalent to `zncc` of the pattern's own pixels with the pixels that
    they fall on, for each displacement; computed with real Fourier
    transforms in double precision.

    Parameters
    ----------
    values : array_like, shape (h, w)
        Bounding box of the pattern.
    footprint : array_like of bool, shape (h, w)
        The pattern's own pixels.
    windows : array_like, shape (..., h + 2 ry, w + 2 rx)
        Parts of the target images centred on the box.
    reach : tuple of int
        Largest displacement ``(ry, rx)``.
    valid : array_like of bool, shape of ``windows``, optional
        False marks missing pixels, and so does what is not finite; both
        means are then over the pixels that exist.
    min_overlap : float, optional
        Share of the pattern's pixels that must fall on existing ones, or
        else the coefficient is zero.

    Returns
    -------
    coefficient : `~numpy.ndarray`, shape (..., 2 ry + 1, 2 rx + 1)
        Entry ``[ry + dy, rx + dx]`` is the one for displacement (dy, dx).
    overlap : `~numpy.ndarray`, same shape
        Share of the pattern's pixels that fall on existing ones.

    Raises
    ------
    ValueError
        If the shapes do not fit together, the footprint is empty or the
        reach not two numbers of pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.correlation import correlate_windows
    >>> window = np.random.default_rng(3).normal(size=(20, 20))
    >>> pattern = window[7:13, 9:15]
    >>> coefficient, _ = correlate_windows(
    ...     pattern, np.ones((6, 6), bool), window, (7, 7))
    >>> np.argwhere(coefficient > 0.999) - 7
    array([[0, 2]])
    """
    values = np.asarray(values, dtype=float)
    footprint = np.asarray(footprint, dtype=bool)
    windows = np.asarray(windows, dtype=float)
    if values.shape != footprint.shape or not footprint.any():
        raise ValueError("the footprint must have the pattern's shape and some pixels")
    reach = tuple(int(r) for r in reach)
    if len(reach) != 2 or min(reach) < 0:
        raise ValueError(f"reach must be two numbers of pixels, got {reach}")
    template = Template(values, footprint, reach)
    if windows.shape[-2:] != template.window_shape:
        raise ValueError(
            f"windows must have shape {template.window_shape}, got {windows.shape[-2:]}"
        )
    exists = np.isfinite(windows)
    if valid is not None:
        exists &= np.asarray(valid, dtype=bool)
    windows = np.where(exists, windows, 0.0)
    # An offset would swamp the local variances.
    number = np.maximum(exists.sum(axis=(-2, -1), keepdims=True), 1)
    windows -= windows.sum(axis=(-2, -1), keepdims=True) / number
    windows[~exists] = 0.0
    if exists.all():
        coefficient = template.of_windows(windows)
        return coefficient, np.ones_like(coefficient)
    overlap = template.overlap(exists, min_overlap)
    coefficient = template.of_windows(windows, overlap)
    return np.nan_to_num(coefficient, copy=False), overlap.share
