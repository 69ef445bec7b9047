# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Sums of elliptical Gaussians on a pixel grid, in pixels."""

import numpy as np

__all__ = ["add_gaussians"]

# Half side of the box in which a Gaussian is evaluated, in standard
# deviations: exp(-7**2 / 2) = 2e-11 of the peak is left out.
REACH = 7.0


def add_gaussians(image, x, y, peak, covariance):
    """
    Add elliptical Gaussians to an image, in place.

    Each is evaluated at the pixel centres of a box of 7 standard deviations
    on each side; what falls outside the image is left out.

    Parameters
    ----------
    image : `numpy.ndarray` of float, shape (ny, nx)
    x, y : array_like, shape (n,)
        Centres, in pixels from 0.
    peak : array_like, shape (n,)
        Values at the centres.
    covariance : array_like, shape (n, 2, 2)
        Covariances over (x, y) in pixels squared.

    Returns
    -------
    `numpy.ndarray`
        ``image``.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.epochs.components.gaussians import add_gaussians
    >>> image = add_gaussians(np.zeros((5, 5)), [2], [1], [3.0], [np.eye(2)])
    >>> float(image[1, 2]), float((image[2, 2] / image[1, 2]).round(4))
    (3.0, 0.6065)
    """
    ny, nx = image.shape
    for x0, y0, p, c in zip(x, y, peak, np.asarray(covariance), strict=True):
        if p == 0:
            continue
        reach_x, reach_y = REACH * np.sqrt(np.diag(c))
        left, right = _bounds(x0, reach_x, nx)
        bottom, top = _bounds(y0, reach_y, ny)
        if left >= right or bottom >= top:
            continue
        dx = np.arange(left, right) - x0
        dy = (np.arange(bottom, top) - y0)[:, None]
        (a, b), (_, d) = np.linalg.inv(c)
        if b == 0:
            box = p * np.exp(-0.5 * d * dy**2) * np.exp(-0.5 * a * dx**2)
        else:
            box = p * np.exp(-0.5 * (a * dx**2 + 2 * b * dx * dy + d * dy**2))
        image[bottom:top, left:right] += box
    return image


def _bounds(centre, reach, length):
    start = max(int(np.ceil(centre - reach)), 0)
    return start, min(int(np.floor(centre + reach)) + 1, length)
