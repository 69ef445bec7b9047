# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Local maxima of correlation maps, sub-pixel."""

import numpy as np

from astro_scc.decomposition import quadratic_peak

__all__ = ["find_peaks"]


def find_peaks(coefficient, threshold):
    """
    Local maxima of stacked maps at or above a threshold.

    A pixel is a maximum if none of its eight neighbours is larger or NaN;
    of equal neighbours the last counts, row by row.  Positions are those of
    the least-squares quadratic through the nine.

    Parameters
    ----------
    coefficient : `~numpy.ndarray`, shape (n, ny, nx)
        Pixels of the border are no maxima.
    threshold : float

    Returns
    -------
    index : `~numpy.ndarray` of int, shape (k,)
        Which map.
    y, x : `~numpy.ndarray`, shape (k,)
        Position in pixels of the map.
    value : `~numpy.ndarray`, shape (k,)
        Value of the quadratic at its maximum, at least the pixel's own and
        at most 1.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.correlation import find_peaks
    >>> y, x = np.mgrid[:9, :9]
    >>> index, py, px, value = find_peaks(
    ...     0.9 - 0.01 * ((y - 4) ** 2 + (x - 5.25) ** 2)[None], 0.5)
    >>> py.round(3), px.round(3), value.round(3)
    (array([4.]), array([5.25]), array([0.9]))
    """
    n, ny, nx = coefficient.shape
    if ny < 3 or nx < 3:
        return tuple(np.empty(0, int if k == 0 else float) for k in range(4))
    # One index for all axes: that is the quickest way to look up values.
    flat = np.ascontiguousarray(coefficient).reshape(-1)
    at = np.flatnonzero(coefficient[:, 1:-1, 1:-1] >= threshold)
    index, at = np.divmod(at, (ny - 2) * (nx - 2))
    y, x = np.divmod(at, nx - 2)
    y += 1
    x += 1
    at = (index * ny + y) * nx + x
    value = flat[at]
    # Four neighbours first: most candidates fall here, at half the price.
    keep = (
        (value >= flat[at - nx])
        & (value >= flat[at - 1])
        & (value > flat[at + 1])
        & (value > flat[at + nx])
    )
    index, y, x, at, value = (a[keep] for a in (index, y, x, at, value))
    step = np.arange(-1, 2)
    around = flat[at[:, None, None] + (step[:, None] * nx + step)]
    keep = (value >= around[:, 0, 0]) & (value >= around[:, 0, 2])
    keep &= (value > around[:, 2, 0]) & (value > around[:, 2, 2])
    return placed(index[keep], y[keep], x[keep], around[keep])


def placed(index, y, x, around):
    """
    Maxima by the quadratic through their surroundings.

    Parameters
    ----------
    index, y, x : `~numpy.ndarray` of int, shape (k,)
        Map and pixel.
    around : `~numpy.ndarray`, shape (k, 3, 3)
        Values.

    Returns
    -------
    tuple of `~numpy.ndarray`, shape (k,)
        As of `find_peaks`.
    """
    dy, dx, height = quadratic_peak(around)
    return index, y + dy, x + dx, np.minimum(height, 1.0)
