# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images with bad pixels moved inside their grid or onto another one."""

import numpy as np
from astropy.wcs.utils import pixel_to_pixel
from scipy import ndimage

__all__ = [
    "BAD_WEIGHT",
    "WHOLE_PIXEL",
    "cut_wcs",
    "fill_masked",
    "grid_step",
    "moved_wcs",
    "probe_pixels",
    "resample",
    "shift_image",
]

# Shifts nearer than this to whole pixels are copies; sky coordinates in
# degrees carry pixels of microarcseconds to about 1e-4.
WHOLE_PIXEL = 1e-4
# A resampled pixel is bad if bad pixels had more than this weight in it.
BAD_WEIGHT = 0.01


def fill_masked(image, mask, n_iterations=20):
    """
    Replace masked pixels by a smooth continuation of their surroundings.

    Interpolation with splines needs a value everywhere, and a jump at the
    edge of the mask would ring into the good pixels.  The nearest good
    values are relaxed towards a solution of Laplace's equation.

    Parameters
    ----------
    image : `~numpy.ndarray`, shape (ny, nx)
    mask : `~numpy.ndarray` of bool, shape (ny, nx)
        True marks bad pixels; their values are never looked at.
    n_iterations : int, optional
        Steps of the relaxation, about the width in pixels of the holes
        that it smooths.

    Returns
    -------
    `~numpy.ndarray`, shape (ny, nx)
        Finite everywhere, zero if no pixel is good.

    Examples
    --------
    >>> import numpy as np
    >>> ramp = np.tile(np.arange(5.0), (5, 1))
    >>> hole = np.zeros((5, 5), dtype=bool)
    >>> hole[2, 2] = True
    >>> float(fill_masked(np.where(hole, np.nan, ramp), hole)[2, 2])
    2.0
    """
    if not mask.any():
        return np.array(image, dtype=float)
    if mask.all():
        return np.zeros(image.shape)
    nearest = ndimage.distance_transform_edt(
        mask, return_distances=False, return_indices=True
    )
    filled = np.asarray(image, dtype=float)[tuple(nearest)]
    neighbours = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]]) / 4
    for _ in range(n_iterations):
        filled[mask] = ndimage.convolve(filled, neighbours, mode="nearest")[mask]
    return filled


def shift_image(image, mask, shift):
    """
    Move an image by a number of pixels.

    Whole pixels are copied, anything else is interpolated with cubic
    splines.  Pixels that would come from outside the image or to which bad
    pixels contribute are masked.

    Parameters
    ----------
    image : `~numpy.ndarray`, shape (ny, nx)
    mask : `~numpy.ndarray` of bool, shape (ny, nx)
        True marks bad pixels.
    shift : (float, float)
        Steps (dx, dy) that every source is moved by, in pixels.

    Returns
    -------
    image : `~numpy.ndarray`, shape (ny, nx)
        NaN where masked.
    mask : `~numpy.ndarray` of bool, shape (ny, nx)

    Notes
    -----
    Cubic splines damp the smallest structures: white noise loses up to 30%
    of its rms at half a pixel, noise correlated over a beam of five pixels
    or more loses nothing that can be measured.

    Examples
    --------
    >>> import numpy as np
    >>> image = np.arange(6.0).reshape(2, 3)
    >>> shift_image(image, np.zeros((2, 3), dtype=bool), (1, 0))[0]
    array([[nan,  0.,  1.],
           [nan,  3.,  4.]])
    """
    step = np.asarray(shift, dtype=float)[::-1]
    whole = np.rint(step)
    if np.all(np.abs(step - whole) < WHOLE_PIXEL):
        moved = np.full(image.shape, np.nan)
        moved_mask = np.ones(image.shape, dtype=bool)
        pairs = [
            (slice(max(s, 0), max(n + s, 0)), slice(max(-s, 0), max(n - s, 0)))
            for s, n in zip(whole.astype(int), image.shape, strict=True)
        ]
        target, source = (tuple(p[k] for p in pairs) for k in (0, 1))
        moved[target] = image[source]
        moved_mask[target] = mask[source]
    else:
        moved = ndimage.shift(
            fill_masked(image, mask), step, order=3, mode="constant", cval=np.nan
        )
        weight = ndimage.shift(mask.astype(float), step, order=1, cval=1.0)
        moved_mask = (weight > BAD_WEIGHT) | ~np.isfinite(moved)
    return np.where(moved_mask, np.nan, moved), moved_mask


def grid_step(wcs, target, shape, tolerance=0.01):
    """
    Shift between two pixel grids, and whether nothing else lies between them.

    Parameters
    ----------
    wcs, target : `~astropy.wcs.WCS`
        Two-dimensional and celestial.
    shape : (int, int)
        Shape (ny, nx) of the image on the grid of ``wcs``.
    tolerance : float, optional
        Largest departure from a shift at any corner, in pixels.

    Returns
    -------
    step : `~numpy.ndarray`, shape (2,)
        (dx, dy) from the centre of the image on ``wcs`` to the pixel of
        ``target`` at the same place of the sky.
    pure : bool
        Whether all corners have the same step.
    """
    pixels = probe_pixels(shape)
    step = np.array(pixel_to_pixel(wcs, target, *pixels)) - pixels
    return step[:, 0], bool(np.all(np.abs(step - step[:, :1]) < tolerance))


def probe_pixels(shape):
    """
    The centre and the corners of an image.

    Parameters
    ----------
    shape : (int, int)
        (ny, nx).

    Returns
    -------
    `~numpy.ndarray`, shape (2, 5)
        (x, y), counted from 0.
    """
    ny, nx = shape
    return np.array(
        [[(nx - 1) / 2, 0, nx - 1, 0, nx - 1], [(ny - 1) / 2, 0, 0, ny - 1, ny - 1]]
    )


def moved_wcs(wcs, shift):
    """
    WCS of a grid whose content has been moved.

    Parameters
    ----------
    wcs : `~astropy.wcs.WCS`
    shift : (float, float)
        Steps (dx, dy) that the content was moved by, in pixels.

    Returns
    -------
    `~astropy.wcs.WCS`
    """
    moved = wcs.deepcopy()
    moved.wcs.crpix = moved.wcs.crpix + np.asarray(shift, dtype=float)
    moved.wcs.set()
    return moved


def cut_wcs(wcs, window, shape):
    """
    WCS of a part of a grid.

    Parameters
    ----------
    wcs : `~astropy.wcs.WCS`
    window : (slice, slice)
        Rows and columns of the part.
    shape : (int, int)
        Of the whole, (ny, nx).

    Returns
    -------
    `~astropy.wcs.WCS`
    """
    bounds = [part.indices(n)[:2] for part, n in zip(window, shape, strict=True)]
    (top, bottom), (left, right) = bounds
    part = moved_wcs(wcs, (-left, -top))
    part.array_shape = (bottom - top, right - left)
    return part


def resample(data, bad, wcs, new_wcs, *, shape, method="bicubic"):
    """
    Lay images with bad pixels on another grid.

    Parameters
    ----------
    data : `~numpy.ndarray`, shape (n, ny, nx)
    bad : `~numpy.ndarray` of bool, shape (n, ny, nx)
    wcs, new_wcs : `~astropy.wcs.WCS`
    shape : (int, int)
        Of the new grid.
    method : str, optional
        ``"exact"``, ``"adaptive"``, or an order of `reproject.reproject_interp`.

    Returns
    -------
    data, bad : `~numpy.ndarray`, shape (n, *shape)
        NaN where bad.
    """
    import reproject

    filled = np.stack([fill_masked(d, b) for d, b in zip(data, bad, strict=True)])
    options = {"shape_out": shape, "return_footprint": False}
    if method in ("exact", "adaptive"):
        lay, order, linear = getattr(reproject, f"reproject_{method}"), {}, {}
    else:
        lay, order, linear = (
            reproject.reproject_interp, {"order": method}, {"order": "bilinear"}
        )  # fmt: skip
    # reproject broadcasts the images over one mapping of the pixels.
    moved = lay((filled, wcs), new_wcs, **order, **options)
    weight = lay((bad.astype(float), wcs), new_wcs, **linear, **options)
    mask = ~(weight <= BAD_WEIGHT) | ~np.isfinite(moved)
    return np.where(mask, np.nan, moved), mask
