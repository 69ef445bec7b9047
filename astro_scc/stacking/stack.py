# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stacked cross-correlation on a grid of velocities."""

import numpy as np

__all__ = ["gaussian_sum", "stack"]

#: Matches that are summed at once; bounds memory.
BLOCK = 16384
#: Beyond this many standard deviations a Gaussian does not count.
REACH_SIGMA = 5.0


def gaussian_sum(x, y, sx, sy, weight, grid_x, grid_y):
    """
    Sum of axis-parallel Gaussians of unit height on a grid.

    A Gaussian is the product of its profiles, so the sum over K of them
    is one matrix product, (ny x K) (K x nx).

    Parameters
    ----------
    x, y, sx, sy, weight : `~numpy.ndarray`, shape (k,)
        Centres, standard deviations, and weights.
    grid_x, grid_y : `~numpy.ndarray`, shapes (nx,) and (ny,)

    Returns
    -------
    `~numpy.ndarray`, shape (ny, nx)

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import gaussian_sum
    >>> one, x = np.ones(2), np.array([0.0, 1.0])
    >>> grid = np.array([0.0, 0.5]), np.array([0.0])
    >>> gaussian_sum(x, 0 * x, one, one, one, *grid).round(2)
    array([[1.61, 1.76]])
    """
    total = np.zeros((len(grid_y), len(grid_x)))
    for start in range(0, len(x), BLOCK):
        k = slice(start, start + BLOCK)
        profile_x = np.exp(-0.5 * ((grid_x - x[k, None]) / sx[k, None]) ** 2)
        profile_y = np.exp(-0.5 * ((grid_y - y[k, None]) / sy[k, None]) ** 2)
        total += (profile_y * weight[k, None]).T @ profile_x
    return total


def velocities(displacements, pairs, order=None):
    """
    The matches of a stack as velocities with errors and weights.

    Parameters
    ----------
    displacements : `Displacements`
    pairs : `DatePairs`
    order : array_like of int, shape (n_dates,), optional
        Image at each date; their own by default.

    Returns
    -------
    index : `~numpy.ndarray` of int, shape (k,)
        Match; one can enter with more than one pair of dates.
    v1, v2, s1, s2 : `~numpy.ndarray`, shape (k,)
    weight : `~numpy.ndarray`, shape (k,)
    """
    order = np.arange(pairs.n_dates) if order is None else order
    reference, target = pairs.images(order)
    n = displacements.n_epochs
    # Each ordered pair of images meets at most one pair of dates.
    slot = np.full((n, n), -1)
    slot[reference, target] = np.arange(len(pairs))
    of_match = slot[displacements.reference, displacements.target]
    index = np.flatnonzero(of_match >= 0)
    rate = 1 / pairs.interval[of_match[index]]
    return (
        index,
        displacements.d1[index] * rate,
        displacements.d2[index] * rate,
        displacements.s1[index] * rate,
        displacements.s2[index] * rate,
        displacements.weight[index] * pairs.weight[of_match[index]],
    )


def number_of_ssps(displacements, pairs, order=None):
    """
    The normalisation of a stack: SSPs of all its reference images.

    Parameters
    ----------
    displacements : `Displacements`
    pairs : `DatePairs`
    order : array_like of int, shape (..., n_dates), optional
        Image at each date.

    Returns
    -------
    float or `~numpy.ndarray`, shape (...)
        ``sum_t w_t N_SSP(t)``, w the weights of the pairs; infinite where
        there are none, so that a stack of nothing is zero.
    """
    order = np.arange(pairs.n_dates) if order is None else order
    reference, _ = pairs.images(order)
    number = (displacements.n_ssps[reference] * pairs.weight).sum(axis=-1)
    return np.where(number > 0, number, np.inf)


def stack(displacements, pairs, grid, *, order=None):
    r"""
    Stack the correlation peaks of all SSPs and pairs of epochs.

    .. math:: C_\mathrm{SCC}(v) = \frac{\sum_t \sum_j \sum_i \sum_p
              \gamma_{i,j,t}(p)\, g(v - p / \Delta t,\ \sigma / \Delta t)}
              {\sum_t \sum_j N^t_{\mathrm{SSP},j}},

    g a Gaussian of unit height (Mertens & Lobanov 2016, Eqs. 5 and 6).
    SSPs without a peak count in the denominator.

    Parameters
    ----------
    displacements : `Displacements`
    pairs : `DatePairs`
    grid : `VelocityGrid`
        In the unit of the displacements per year.
    order : array_like of int, shape (n_dates,), optional
        Image at each date, to stack a shuffled order of epochs.

    Returns
    -------
    `~numpy.ndarray`, shape ``grid.shape``

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import (
    ...     Displacements, VelocityGrid, consecutive_pairs, stack)
    >>> one = np.ones(1)
    >>> match = Displacements(
    ...     d1=one, d2=0 * one, s1=0.2 * one, s2=0.2 * one, weight=0.9 * one,
    ...     reference=np.array([0]), target=np.array([1]), ssp=np.array([0]),
    ...     target_ssp=np.array([1]), n_ssps=np.array([1, 1]))
    >>> grid = VelocityGrid.covering(4.0, 0.5)
    >>> scc = stack(match, consecutive_pairs([0.0, 0.5]), grid)
    >>> row, column = np.unravel_index(scc.argmax(), scc.shape)
    >>> float(grid.v1[column]), float(grid.v2[row]), float(scc.max())
    (2.0, 0.0, 0.9)
    """
    _, v1, v2, s1, s2, weight = velocities(displacements, pairs, order)
    near = (np.abs(v1) < grid.v_max[0] + REACH_SIGMA * s1) & (
        np.abs(v2) < grid.v_max[1] + REACH_SIGMA * s2
    )
    total = gaussian_sum(*(a[near] for a in (v1, v2, s1, s2, weight)), grid.v1, grid.v2)
    return total / number_of_ssps(displacements, pairs, order)
