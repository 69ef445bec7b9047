# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Zero-mean normalised cross-correlation of a masked template with windows."""

import numpy as np
from scipy import fft

__all__ = ["Template", "correlate_windows", "zncc"]

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
    """

    def __init__(self, values, footprint, reach):
        self.n_pixels = int(footprint.sum())
        self.values = np.zeros(footprint.shape)
        self.values[footprint] = _zero_mean(values[footprint])
        self.energy = float((self.values**2).sum())
        self.footprint = footprint.astype(float)
        #: Shape of the result: all displacements up to ``reach``.
        self.result_shape = tuple(2 * r + 1 for r in reach)
        #: Shape of the windows.
        self.window_shape = tuple(
            n + 2 * r for n, r in zip(footprint.shape, reach, strict=True)
        )
        # Circular correlation is exact where the template does not wrap.
        self.fft_shape = tuple(
            fft.next_fast_len(n, real=True) for n in self.window_shape
        )
        self._values_fft = self._transform(self.values)
        self._footprint_fft = self._transform(self.footprint)

    def _transform(self, array):
        return np.conj(fft.rfft2(array, self.fft_shape))

    def _correlate(self, window_fft, template_fft):
        full = fft.irfft2(window_fft * template_fft, self.fft_shape, overwrite_x=True)
        return full[..., : self.result_shape[0], : self.result_shape[1]]

    def of_windows(self, windows):
        """
        Coefficients for windows without missing pixels.

        Parameters
        ----------
        windows : `~numpy.ndarray`, shape (..., h, w)

        Returns
        -------
        `~numpy.ndarray`, shape (..., ny, nx)
        """
        transform = fft.rfft2(windows, self.fft_shape)
        energy_fft = fft.rfft2(windows * windows, self.fft_shape)
        total = self._correlate(transform, self._footprint_fft * self.n_pixels**-0.5)
        variance = self._correlate(energy_fft, self._footprint_fft) - total * total
        covariance = self._correlate(transform, self._values_fft)
        return _coefficient(covariance, variance, self.energy, windows)

    def of_masked_windows(self, windows, valid, min_overlap):
        """
        Coefficients, and overlaps, for windows with missing pixels.

        Parameters
        ----------
        windows : `~numpy.ndarray`, shape (..., h, w)
        valid : `~numpy.ndarray` of bool, same shape
        min_overlap : float

        Returns
        -------
        coefficient, overlap : `~numpy.ndarray`, shape (..., ny, nx)
        """
        windows = np.where(valid, windows, 0.0)
        valid = valid.astype(float)
        transform = fft.rfft2(windows, self.fft_shape)
        energy_fft = fft.rfft2(windows * windows, self.fft_shape)
        valid_fft = fft.rfft2(valid, self.fft_shape)
        number = self._correlate(valid_fft, self._footprint_fft)
        number = np.rint(number)
        some = np.maximum(number, 1.0)
        total = self._correlate(transform, self._footprint_fft)
        variance = self._correlate(energy_fft, self._footprint_fft) - total**2 / some
        own_total = self._correlate(valid_fft, self._values_fft)
        squares_fft = self._transform(self.values**2)
        own = self._correlate(valid_fft, squares_fft) - own_total**2 / some
        covariance = (
            self._correlate(transform, self._values_fft) - own_total * total / some
        )
        own = np.where(own > VARIANCE_FLOOR * self.energy, own, np.inf)
        coefficient = _coefficient(covariance, variance, own, windows)
        overlap = number / self.n_pixels
        return np.where(overlap >= min_overlap, coefficient, 0.0), overlap


def _coefficient(covariance, variance, own_variance, windows):
    own_variance = np.where(own_variance > 0, own_variance, np.inf)
    floor = VARIANCE_FLOOR * (windows * windows).sum(axis=(-2, -1), keepdims=True)
    flat = variance <= floor
    norm = np.sqrt(own_variance * np.where(flat, np.inf, variance))
    return covariance / norm


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
    if exists.all():
        coefficient = template.of_windows(windows)
        return coefficient, np.ones_like(coefficient)
    return template.of_masked_windows(windows, exists, min_overlap)
