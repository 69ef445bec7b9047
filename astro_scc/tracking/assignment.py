# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The best one-to-one choice among weighted pairs."""

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import (
    connected_components,
    min_weight_full_bipartite_matching,
)

__all__ = ["assign", "groups_of"]

#: Rows of a group above which the sparse algorithm is the faster one.
DENSE = 150


def groups_of(row, column):
    """
    Number the groups of rows and columns that pairs connect.

    Parameters
    ----------
    row, column : array_like of int, shape (n,)
        Not negative; rows and columns are counted apart.

    Returns
    -------
    `~numpy.ndarray` of int, shape (n,)
        Group of each pair, from 0.

    Examples
    --------
    >>> from astro_scc.tracking import groups_of
    >>> groups_of([0, 0, 1, 2], [5, 6, 6, 7]).tolist()
    [0, 0, 0, 1]
    """
    row, column = np.asarray(row, dtype=int), np.asarray(column, dtype=int)
    if len(row) == 0:
        return np.empty(0, dtype=int)
    n, m = row.max() + 1, column.max() + 1
    graph = coo_array((np.ones(len(row)), (row, n + column)), shape=(n + m,) * 2)
    _, label = connected_components(graph, directed=False)
    return np.unique(label[row], return_inverse=True)[1]


def assign(row, column, weight):
    """
    The choice of pairs of the largest total weight, none used twice.

    Rows and columns may stay without a partner, so only pairs of positive
    weight are chosen.  Exact and polynomial: pairs that outweigh the best
    others of their row and column together are certain; what is left falls
    into groups, each solved by `scipy.optimize.linear_sum_assignment` (at
    most cubic in the size of the group) or, beyond 150 rows, by
    `scipy.sparse.csgraph.min_weight_full_bipartite_matching`.

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
    group = groups_of(row[left], column[left])
    order = np.argsort(group, kind="stable")
    for own in np.split(left[order], np.flatnonzero(np.diff(group[order])) + 1):
        chosen[own[_solve(row[own], column[own], weight[own])]] = True
    return chosen


def _certain(row, column, weight):
    """Pairs not lighter than the best others of row and column together."""
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
    """Largest weight of the other entries with the same key, or 0."""
    order = np.lexsort((-weight, key))
    sorted_key = key[order]
    first = np.ones(len(key), bool)
    first[1:] = sorted_key[1:] != sorted_key[:-1]
    start = np.flatnonzero(first)
    number = np.cumsum(first) - 1
    size = np.diff([*start, len(key)])
    best = weight[order[start]]
    second = np.where(size > 1, weight[order[np.minimum(start + 1, len(key) - 1)]], 0.0)
    other = np.empty(len(key))
    other[order] = np.where(first, second[number], best[number])
    return other


def _solve(row, column, weight):
    """Indices of the chosen pairs of one group."""
    rows, r = np.unique(row, return_inverse=True)
    columns, c = np.unique(column, return_inverse=True)
    n, m = len(rows), len(columns)
    # Of pairs that are there twice the heavier.
    order = np.lexsort((weight, c, r))
    if n <= DENSE or m <= DENSE:
        table, index = np.zeros((n, m)), np.full((n, m), -1)
        table[r[order], c[order]] = weight[order]
        index[r[order], c[order]] = order
        found = index[linear_sum_assignment(table, maximize=True)]
        return found[found >= 0]
    last = np.ones(len(order), bool)
    last[:-1] = np.diff(r[order] * m + c[order]) != 0
    order = order[last]
    # A seat of its own for each row makes a full matching possible.  Weights
    # must not be zero, and the same shift of all of them changes nothing.
    cost = np.concatenate([-weight[order], np.zeros(n)]) - weight.max() - 1.0
    graph = coo_array(
        (cost, (np.r_[r[order], np.arange(n)], np.r_[c[order], m + np.arange(n)])),
        shape=(n, m + n),
    ).tocsr()
    at, seat = min_weight_full_bipartite_matching(graph)
    index = dict(zip(zip(r[order].tolist(), c[order].tolist(), strict=True), order,
                     strict=True))  # fmt: skip
    return np.array(
        [index[pair] for pair in zip(at.tolist(), seat.tolist(), strict=True)
         if pair[1] < m], dtype=int
    )  # fmt: skip
