# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The speed of a stream across the direction of the grid."""

import numpy as np

from astro_scc.spectrum.permutations import LENGTH, autocorrelation

#: Smallest error relative to the speed along the flow.
LEAST_ERROR = 0.05


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
    tau, epochs = years - years[:, None], np.arange(len(years))
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
    # All pairs, and all but those with each of the epochs.
    keep = np.ones((len(epochs) + 1, len(epochs)))
    keep[1:][epochs, epochs] = 0
    parts = np.einsum("ka,ab,kb->k", keep, even, keep)
    ratio = np.einsum("ka,ab,kb->k", keep, odd, keep) / gain
    if not (parts > 0).all():
        return 0.0, np.nan
    found, *left = ratio / parts
    n = len(left)
    error = np.sqrt((n - 1) / n * ((left - np.mean(left)) ** 2).sum())
    if not error < abs(speed):
        return 0.0, np.nan
    return float(found), float(np.hypot(error, LEAST_ERROR * abs(speed)))
