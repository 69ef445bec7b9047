# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Probabilities of components that were searched for in many places at once."""

import numpy as np
from astropy.table import Column, Table

__all__ = ["false_discovery_rate"]

METHODS = ("bh", "by")
NAME = "p_fdr"
DESCRIPTION = "p_global adjusted for all searches: share of false discoveries up to it"


def false_discovery_rate(tables, *, method="bh"):
    """
    Adjust the probabilities of components of regions searched together.

    Of m velocities that were tested in all regions, bins or groups of
    scales together, with :math:`p_{(1)} \\le \\ldots \\le p_{(m)}` their
    ``p_global``, the k-th smallest becomes

    .. math:: q_{(k)} = \\min_{l \\ge k}\\ \\min(1,\\ c_m\\, m\\, p_{(l)} / l),

    with :math:`c_m = 1` [1]_, or :math:`c_m = \\sum_{l=1}^{m} 1 / l` [2]_.  Of
    the components with ``p_fdr <= q`` a share of at most q is expected to be
    false.

    Parameters
    ----------
    tables : sequence of `~astropy.table.QTable`, or a mapping to them
        Components, see `SCCResult.components`: one table for each region,
        bin or group of scales, *those without components included*.
    method : {"bh", "by"}, optional
        Benjamini & Hochberg, which holds for independent tests and for
        those that depend on one another positively, as regions that share
        features and scales that see the same feature do; or Benjamini &
        Yekutieli, which holds for any dependence and costs the factor
        :math:`c_m`, 3.6 for m = 20.

    Returns
    -------
    list or dict of `~astropy.table.QTable`
        Copies with the column ``p_fdr`` behind ``p_global_err``; its meta
        has the method and the number of tests.

    Raises
    ------
    TypeError
        If ``tables`` is one table.
    ValueError
        If a table has no column ``p_global`` or one that is no probability,
        or for another ``method``.

    Notes
    -----
    ``p_global`` enters because it has paid already for all the velocities at
    which one region was searched; ``p_local`` has not.  Every velocity that
    was tested counts, those "not significant" too, and a table without any
    counts as one test with a probability of 1.  Were only those counted that
    are significant by themselves, a lone false alarm among twenty regions
    would have nothing to pay for the other nineteen.  What is "stationary" is
    not tested and does not count.  ``kind`` is not changed: a component is a
    discovery of the whole search if it is "moving" *and* its ``p_fdr`` is
    small.

    With n trials no ``p_fdr`` of a lone component is below m / (n + 1).

    References
    ----------
    .. [1] Benjamini, Y. & Hochberg, Y. 1995, J. R. Stat. Soc. B 57, 289.
    .. [2] Benjamini, Y. & Yekutieli, D. 2001, Ann. Statist. 29, 1165.

    Examples
    --------
    >>> from astropy.table import QTable
    >>> from astro_scc.measurement import false_discovery_rate
    >>> kinds = ["moving", "not significant"]
    >>> inner = QTable({"kind": kinds, "p_global": [0.004, 0.3]})
    >>> outer = QTable({"kind": ["moving"], "p_global": [0.04]})
    >>> inner, outer = false_discovery_rate([inner, outer])
    >>> inner["p_fdr"].tolist(), outer["p_fdr"].tolist()
    ([0.012, 0.3], [0.06])
    """
    from scipy.stats import false_discovery_control

    if method not in METHODS:
        raise ValueError(f"unknown method {method!r}: use 'bh' or 'by'")
    if isinstance(tables, Table):
        raise TypeError("tables must be a sequence of tables, got one: give [table]")
    if hasattr(tables, "items"):
        names, tables = list(tables), list(tables.values())
    else:
        names, tables = None, list(tables)
    tested = [
        _probabilities(t, k if names is None else names[k])
        for k, t in enumerate(tables)
    ]
    moved = [_tested(table) for table in tables]
    # Where nothing could be tested was searched all the same.
    p = [
        own[use] if use.any() else np.ones(1)
        for own, use in zip(tested, moved, strict=True)
    ]
    adjusted = false_discovery_control(np.concatenate(p), method=method) if p else []
    ends = np.cumsum([len(own) for own in p])
    parts = np.split(adjusted, ends[:-1]) if p else []
    meta = {"false_discovery": {"method": method, "n_tests": len(adjusted)}}
    done = []
    for table, own, use, q in zip(tables, tested, moved, parts, strict=True):
        values = own.copy()
        values[use] = q[: use.sum()]
        done.append(_with_column(table, values, meta))
    return done if names is None else dict(zip(names, done, strict=True))


def _probabilities(table, name):
    if "p_global" not in table.colnames:
        raise ValueError(
            f"table {name!r} has no column p_global: give tables of components"
        )
    p = np.asarray(table["p_global"], dtype=float)
    # A comparison with NaN is false.
    if not np.all((p >= 0) & (p <= 1)):
        raise ValueError(f"table {name!r}: p_global must be from 0 to 1, got {p}")
    return p


def _tested(table):
    """Which velocities were tested: not those of what stands still."""
    if "kind" not in table.colnames:
        return np.ones(len(table), dtype=bool)
    return np.asarray(table["kind"], dtype=str) != "stationary"


def _with_column(table, values, meta):
    table = table.copy()
    if NAME in table.colnames:
        table.remove_column(NAME)
    column = Column(np.array(values, dtype=float), description=DESCRIPTION)
    before = "p_global_err" if "p_global_err" in table.colnames else "p_global"
    table.add_column(column, name=NAME, index=table.colnames.index(before) + 1)
    table.meta.update(meta)
    return table
