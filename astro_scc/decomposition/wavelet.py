# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The isotropic undecimated ("a trous") wavelet transform."""

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

#: Low-pass filters by name: linear and cubic B-spline.
KERNELS = {
    "b1": np.array([1.0, 2.0, 1.0]) / 4,
    "b3": np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16,
}


def scale_size(scale: float) -> float:
    """
    Return the size of a scale in pixels.

    Scale number j means 2^j pixels; j + 1/2 means the intermediate scale of
    1.5 x 2^j pixels.

    Parameters
    ----------
    scale : float
        Scale number, a multiple of one half.

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If there is no such scale.

    Examples
    --------
    >>> from astro_scc.decomposition.wavelet import scale_size
    >>> scale_size(1), scale_size(1.5), scale_size(2)
    (2.0, 3.0, 4.0)
    """
    if not (0 <= scale < np.inf and scale % 1 in (0, 0.5)):
        raise ValueError(f"scale {scale} is not a number of the series 0, 0.5, 1, ...")
    return 2.0 ** int(scale) * (1.5 if scale % 1 else 1.0)


def scale_kernel(scale, kernel="b1"):
    """
    Return the filter and the level of the transform that give a scale.

    Intermediate scales are planes of the wider cubic spline, which lie between
    those of the linear one.  Raises a ValueError for an unknown filter, a number
    that is not a scale, or an intermediate scale of "b3".
    """
    if kernel not in KERNELS:
        raise ValueError(f"unknown wavelet kernel {kernel!r}: use 'b1' or 'b3'")
    scale_size(scale)
    level = int(np.floor(scale))
    if scale == level:
        return kernel, level
    if kernel != "b1":
        raise ValueError(f"scale {scale} exists between those of kernel 'b1' only")
    return "b3", level


def _smooth(image, kernel, level):
    """Return an image convolved with the filter dilated by 2^level, edges mirrored."""
    dilated = np.zeros((len(kernel) - 1) * 2**level + 1)
    dilated[:: 2**level] = kernel
    for axis in (0, 1):
        image = ndimage.convolve1d(image, dilated, axis=axis, mode="mirror")
    return image


def missing_pixels(image, mask):
    """Return an image as floats, and a mask of its missing pixels."""
    image = np.asarray(image, dtype=float)
    missing = ~np.isfinite(image)
    if mask is not None:
        mask = np.asarray(mask, dtype=bool)
        if mask.shape != image.shape:
            raise ValueError(
                f"the mask has shape {mask.shape}, the image {image.shape}: "
                "give one value for each pixel"
            )
        missing |= mask
    return image, missing


def atrous_transform(image, n_levels, *, kernel="b1", mask=None):
    """
    Decompose an image into wavelet planes of doubling scale.

    The image a_0 is smoothed to a_{j+1} = h_j * a_j, where h_j is the low-pass
    filter dilated by 2^j.  The planes are ``w_j = a_j - a_{j+1}``, and the image is
    exactly ``sum_j w_j + a_J`` [1]_.  Edges are mirrored.

    The ``image`` and the ``mask`` of missing pixels have the shape (ny, nx); pixels
    that are not finite are missing as well.  Each smoothing is normalised by the
    weight of the valid pixels (``h * (m a) / h * m``), and the planes are zero where
    the image is missing.  Returns the planes, shape (n_levels, ny, nx), and the smooth
    image a_J.  Raises a ValueError if the image does not have two dimensions, the mask
    has another shape, or the largest filter does not fit the image.

    References
    ----------
    .. [1] Starck, J.-L. & Murtagh, F. 2006, Astronomical Image and Data
       Analysis (Springer), chapter 2.
    """
    image, missing = missing_pixels(image, mask)
    if image.ndim != 2:
        raise ValueError(f"an image has two dimensions, this has {image.ndim}")
    filter_ = KERNELS[kernel]
    # Half a filter must fit the image, or mirrored edges would be mirrored again.
    if (len(filter_) // 2) * 2 ** (n_levels - 1) >= min(image.shape):
        raise ValueError(
            f"an image of {image.shape[1]} x {image.shape[0]} px is too small for "
            f"wavelet scale {n_levels - 1} ({2 ** (n_levels - 1)} px): "
            "leave out the largest scales"
        )
    planes = np.empty((n_levels, *image.shape))
    smooth = np.where(missing, 0.0, image)
    valid = (~missing).astype(float)
    for level in range(n_levels):
        following = _smooth(smooth, filter_, level)
        if missing.any():
            weight = _smooth(valid, filter_, level)
            # A valid pixel contributes to its own weight, which is thus positive.
            following = np.divide(
                following, weight, out=np.zeros_like(smooth), where=~missing
            )
        planes[level] = smooth - following
        smooth = following
    return planes, smooth


def wavelet_planes(
    image: ArrayLike, scales: ArrayLike, *, kernel: str = "b1",
    mask: ArrayLike | None = None,
) -> np.ndarray:  # fmt: skip
    """
    Return the wavelet planes of chosen scales.

    Parameters
    ----------
    image : array_like, shape (ny, nx)
    scales : sequence of float
        Scale numbers, see `scale_size`.
    kernel : {"b1", "b3"}
    mask : array_like of bool, shape (ny, nx), optional
        True marks missing pixels.

    Returns
    -------
    `~numpy.ndarray`, shape (n_scales, ny, nx)

    Raises
    ------
    ValueError
        If `scale_size` or ``atrous_transform`` raises one.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.decomposition.wavelet import wavelet_planes
    >>> wavelet_planes(np.eye(32), [1, 1.5, 2]).shape
    (3, 32, 32)
    """
    places = [scale_kernel(scale, kernel) for scale in scales]
    transforms = {}
    for name in {name for name, _ in places}:
        n_levels = 1 + max(level for key, level in places if key == name)
        transforms[name], _ = atrous_transform(image, n_levels, kernel=name, mask=mask)
    return np.stack([transforms[name][level] for name, level in places])
