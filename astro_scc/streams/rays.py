# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Along the ray of a stream: its correlation, and its speed across the grid."""

import numpy as np
import scipy

from astro_scc.spectrum.permutations import LENGTH, autocorrelation

#: Smallest error relative to the speed along the flow.
LEAST_ERROR = 0.05
#: Displacements in beams at which patterns keep their correlation along the lines of a
#: flow, and not along others.
FROM, TO = 0.3, 4.0


def transverse_speed(sheet, aside, speed):
    r"""
    Return the speed of a stream across the grid, and its error.

    The diagram is compared at displacements h and -h across the flow.  Along the ray of
    the stream its expectation is ``A R(h - u tau)``, so the difference of both is to
    first order proportional to the transverse speed u and the interval,

    .. math:: D(h) - D(-h) = 2 A \frac{h}{s^2} R(h)\, u \tau ,

    for a Gaussian R with the standard deviation s.

    Parameters
    ----------
    sheet : sequence of ``Diagram``
        At displacements -h, 0 and h across the flow; empty if it is too narrow.
    aside : float
        The displacement h in beams.
    speed : float
        Along the grid, in beams/yr.

    Returns
    -------
    speed, error : float
        In beams/yr, the error from the deletion of epochs; 0 and NaN if it is not
        known to the speed along the grid.
    """
    if len(sheet) < 3:
        return 0.0, np.nan
    middle = len(sheet) // 2
    below, on, above = sheet[middle - 1 : middle + 2]
    years, x = on.years, on.displacement
    tau = years - years[:, None]
    top, beside = on.power, (above.power + below.power) / 2
    if not 0 < beside < top:
        return 0.0, np.nan
    variance = aside**2 / (2 * np.log(top / beside))
    moved = (speed * tau)[..., None]
    ray = np.interp(x - moved, x, autocorrelation(on), left=0, right=0)
    ray *= on.overlap * np.exp(-np.abs(moved) / LENGTH)
    odd = (ray * (above.sums - below.sums)).sum(axis=2) * tau
    even = (ray * (on.sums - on.sums.mean(axis=(0, 1)))).sum(axis=2) * tau**2
    np.fill_diagonal(even, 0.0)
    gain = 2 * aside / variance * beside / top
    parts, ratio = without_each(even), without_each(odd) / gain
    if not (parts > 0).all():
        return 0.0, np.nan
    found = ratio / parts
    error = deletion_error(found)
    if not error < abs(speed):
        return 0.0, np.nan
    return float(found[0]), float(np.hypot(error, LEAST_ERROR * abs(speed)))


def correlation_kept(diagram, speed):
    """
    Return the mean correlation of patterns that move at a speed, over that at rest.

    Parameters
    ----------
    diagram : ``Diagram``
    speed : float
        In beams/yr.

    Returns
    -------
    `~numpy.ndarray`, shape (n_epochs + 1,)
        Of all epochs, and of all but each of them.
    """
    n, x = len(diagram.years), diagram.displacement
    tau = diagram.years - diagram.years[:, None]
    moved = speed * tau
    odd = diagram.means - diagram.means[:, :, ::-1]
    where = *np.indices((n, n)), (moved - x[0]) / (x[1] - x[0])
    found = scipy.ndimage.map_coordinates(odd, where, order=1)
    far = np.abs(moved)
    weight = np.exp(-far / LENGTH) * ((far > FROM) & (far < TO) & (tau > 0))
    power = np.diagonal(diagram.sums[:, :, diagram.zero])
    rest = without_each(np.diag(power)) / np.append(n, np.full(n, n - 1))
    total = without_each(weight) * rest
    return without_each(weight * found) / np.maximum(total, np.finfo(float).tiny)


def without_each(pairs):
    """
    Return the sum over all pairs of epochs, and over those without each epoch.

    Parameters
    ----------
    pairs : `~numpy.ndarray`, shape (n_epochs, n_epochs)

    Returns
    -------
    `~numpy.ndarray`, shape (n_epochs + 1,)
    """
    pairs = np.asarray(pairs, dtype=float)
    each = pairs.sum(axis=0) + pairs.sum(axis=1) - np.diagonal(pairs)
    return pairs.sum() - np.append(0.0, each)


def deletion_error(values):
    """Return the standard error of the first value from those without each epoch."""
    n = len(values) - 1
    return np.sqrt((n - 1) * values[1:].var())
