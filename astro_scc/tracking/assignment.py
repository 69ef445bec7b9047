# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The best one-to-one choice among weighted pairs."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import (
    connected_components,
    min_weight_full_bipartite_matching,
)

from astro_scc.tracking.candidates import rank_in_group


def connected(one, other, n):
    """Number the groups of n nodes that pairs of nodes connect."""
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(n, n))
    return connected_components(graph, directed=False)[1]


def assign(row, column, weight):
    """
    Return the choice of pairs of the largest total weight, none used twice.

    Rows and columns may stay without a partner, so only pairs of positive
    weight are chosen.  Exact and polynomial: pairs that outweigh the best
    others of their row and column together are certain; what is left is
    solved by `scipy.sparse.csgraph.min_weight_full_bipartite_matching`.

    Parameters
    ----------
    row, column : array_like of int, shape (n,)
        Not negative; rows and columns are counted apart.
    weight : array_like, shape (n,)

    Returns
    -------
    `~numpy.ndarray` of bool, shape (n,)

    Examples
    --------
    Two that want the same: together they do better otherwise.

    >>> from astro_scc.tracking import assign
    >>> assign([0, 0, 1], [0, 1, 0], [3.0, 2.5, 2.5]).tolist()
    [False, True, True]
    """
    row, column = np.asarray(row, dtype=int), np.asarray(column, dtype=int)
    weight = np.asarray(weight, dtype=float)
    chosen = np.zeros(len(row), bool)
    left = np.flatnonzero(weight > 0)
    while len(left):
        certain = _certain(row[left], column[left], weight[left])
        if not certain.any():
            break
        won = left[certain]
        chosen[won] = True
        taken = np.isin(row[left], row[won]) | np.isin(column[left], column[won])
        left = left[~taken]
    chosen[left[_solve(row[left], column[left], weight[left])]] = True
    return chosen


def _certain(row, column, weight):
    """Return the pairs not lighter than the best others of row and column together."""
    total = weight - _best_other(row, weight) - _best_other(column, weight)
    certain = np.flatnonzero(total >= 0)
    # Of equal ones that share a row or column, the first.
    keep = np.zeros(len(row), bool)
    first = np.intersect1d(
        np.unique(row[certain], return_index=True)[1],
        np.unique(column[certain], return_index=True)[1],
    )
    keep[certain[first]] = True
    return keep


def _best_other(key, weight):
    """Return the largest weight of the other entries with the same key, or 0."""
    order = np.lexsort((-weight, key))
    weight, rank = weight[order], rank_in_group(key[order])
    best = weight[np.arange(len(order)) - rank]
    second = np.append(np.where(rank == 1, weight, 0.0), 0.0)[1:]
    other = np.empty(len(key))
    other[order] = np.where(rank == 0, second, best)
    return other


def _solve(row, column, weight):
    """Return the indices of the chosen pairs."""
    # Of pairs that are there twice the heavier.
    order = np.lexsort((-weight, column, row))
    order = order[rank_in_group(row[order], column[order]) == 0]
    rows, r = np.unique(row[order], return_inverse=True)
    columns, c = np.unique(column[order], return_inverse=True)
    n, m = len(rows), len(columns)
    if n == 0:
        return order
    # A seat of its own for each row makes a full matching possible.  Weights
    # must not be zero, and the same shift of all of them changes nothing.
    cost = np.concatenate([-weight[order], np.zeros(n)]) - weight.max() - 1.0
    seats = np.concatenate([r, np.arange(n)]), np.concatenate([c, m + np.arange(n)])
    graph = coo_array((cost, seats), shape=(n, m + n)).tocsr()
    at, seat = min_weight_full_bipartite_matching(graph)
    # Ordered by row and column, as the pairs are.
    place = np.searchsorted(r * (m + n) + c, (at * (m + n) + seat)[seat < m])
    return order[place]
