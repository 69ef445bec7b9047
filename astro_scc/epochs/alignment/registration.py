# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""How far one masked image is displaced from another, to parts of a pixel."""

import numpy as np
from scipy import ndimage, optimize

from astro_scc.correlation import correlate_windows
from astro_scc.epochs.grids.resampling import BAD_WEIGHT, fill_masked

__all__ = ["displacement"]

# Share of the pixels in use that must fall on good pixels.
MIN_OVERLAP = 0.5
FLAT = 0.01
FEWEST = 10


def displacement(image, mask, reference, use, reach, start=None):
    """
    Displacement of an image from a reference image.

    The zero-mean normalised cross-correlation of the good pixels gives it
    to a pixel.  From there the sum of squares of
    ``a I(x + d) + b - R(x)`` over the pixels in use is minimised over d,
    with gain a and level b solved for, and I interpolated with cubic
    splines.  Pixels where R is flat, its slope less than 1% of the
    steepest, say nothing about d and are left out.

    Parameters
    ----------
    image : `~numpy.ndarray`, shape (ny, nx)
    mask : `~numpy.ndarray` of bool, shape (ny, nx)
        True marks bad pixels of ``image``.
    reference : `~numpy.ndarray`, shape (ny, nx)
    use : `~numpy.ndarray` of bool, shape (ny, nx)
        Pixels of ``reference`` to compare; they must be good.
    reach : float
        Longest displacement to search, in pixels.
    start : array_like, shape (2,), optional
        (dx, dy) known to a pixel; nothing is searched then.

    Returns
    -------
    shift : `~numpy.ndarray`, shape (2,)
        (dx, dy): a source at x in the reference is at x + dx here.
    covariance : `~numpy.ndarray`, shape (2, 2)
        Of the shift, for residuals that are independent from pixel to
        pixel.  Where the beam spans several pixels it is too small by half
        the beam's area in pixels.

    Raises
    ------
    ValueError
        If nothing correlates inside ``reach``, or fewer than ten good
        pixels can be compared.

    Examples
    --------
    >>> import numpy as np
    >>> y, x = np.mgrid[:40, :50]
    >>> def spot(x0, y0):
    ...     return np.exp(-((x - x0) ** 2 + (y - y0) ** 2) / 18)
    >>> good = np.ones((40, 50), dtype=bool)
    >>> shift, _ = displacement(spot(22.7, 15.3), ~good, spot(25, 20), good, 10)
    >>> shift.round(2)
    array([-2.3, -4.7])
    """
    filled = fill_masked(image, mask)
    if start is None:
        start = _whole_pixels(filled, mask, reference, use, reach)
    start = np.asarray(start, dtype=float)

    slope = np.hypot(*np.gradient(fill_masked(reference, ~use)))
    use = use & (slope >= FLAT * slope[use].max())
    y, x = np.nonzero(use)
    # The spline carries what the bad pixels were filled with two pixels far,
    # and the fit moves on by one and a half.
    around = ndimage.binary_dilation(mask, iterations=3).astype(float)
    far = ndimage.map_coordinates(
        around, [y + start[1], x + start[0]], order=1, cval=1.0
    )
    keep = far <= BAD_WEIGHT
    if keep.sum() < FEWEST:
        raise ValueError("too few good pixels to compare with the reference")
    y, x, target = y[keep], x[keep], reference[use][keep]
    spline = ndimage.spline_filter(filled, order=3)

    def residual(d):
        values = ndimage.map_coordinates(
            spline, [y + d[1], x + d[0]], order=3, prefilter=False, mode="mirror"
        )
        basis = np.stack([values, np.ones_like(values)], axis=1)
        solution = np.linalg.lstsq(basis, target, rcond=None)[0]
        return basis @ solution - target

    # One and a half pixels are more than the whole-pixel peak can be off.
    fit = optimize.least_squares(
        residual, start, bounds=(start - 1.5, start + 1.5), diff_step=1e-3, xtol=1e-10
    )
    freedom = max(len(target) - 4, 1)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * 2 * fit.cost / freedom
    return fit.x, covariance


def _whole_pixels(filled, mask, reference, use, reach):
    """The displacement (dx, dy) of the largest correlation."""
    steps = int(np.ceil(reach)) + 1
    rows, columns = (np.flatnonzero(use.any(axis=k)) for k in (1, 0))
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    # Windows reach past the box on all sides, and past the image.
    window = tuple(slice(s.start, s.stop + 2 * steps) for s in box)
    coefficient, _ = correlate_windows(
        np.where(use, reference, 0)[box],
        use[box],
        np.pad(filled, steps)[window],
        (steps, steps),
        valid=np.pad(~mask, steps)[window],
        min_overlap=MIN_OVERLAP,
    )
    dy, dx = np.mgrid[-steps : steps + 1, -steps : steps + 1]
    coefficient = np.where(np.hypot(dx, dy) <= max(reach, 0.5), coefficient, 0)
    if coefficient.max() <= 0:
        raise ValueError("nothing in the image correlates with the reference")
    best = np.unravel_index(np.argmax(coefficient), coefficient.shape)
    return dx[best], dy[best]
