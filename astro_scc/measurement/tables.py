# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Velocity components as a table, its cells as text, and adjusted p-values."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import astropy.units as u
import numpy as np
from astropy.table import Column, QTable, Table, vstack

from astro_scc.columns import (
    build_table,
    cells,
    describe,
    round_to_errors,
    with_errors,
)
from astro_scc.units import PM_UNIT, in_speed_unit

#: Standard errors above the mean at the one-sided 95% limit of a normal distribution.
LIMIT = 1.645
#: Columns of a table in a paper, in their order.
PAPER = (
    "source redshift feature component r_min r_max kind scale n_epochs first last "
    "separation position_angle pm beta_app pm_pa published published_pm dispersion "
    "t_ej p_false p_global p_fdr n_features n_pairs secure"
).split()


def versions() -> dict[str, str]:
    """
    Return the versions of this package and of the packages its numbers depend on.

    Returns
    -------
    dict of str

    Examples
    --------
    >>> from astro_scc.measurement.tables import versions
    >>> {"astro_scc", "numpy", "scipy"} <= set(versions())
    True
    """
    needed = ("astro_scc", "numpy", "scipy", "astropy", "scikit-image")
    found = dict.fromkeys(needed, "unknown")
    for name in found:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def component_table(
    rows: Sequence[dict[str, Any]], *, meta: dict[str, Any] | None = None,
    unit: u.UnitBase = PM_UNIT,
) -> QTable:  # fmt: skip
    """
    Return velocity components as a table.

    Parameters
    ----------
    rows : sequence of dict
        One per component: the columns as plain numbers, proper motions in
        mas/yr and angles in degrees.  May be empty.
    meta : dict, optional
    unit : `~astropy.units.Unit`, optional
        Unit of the proper motions of the table.

    Returns
    -------
    `~astropy.table.QTable`
        It has all columns with their units even if there is no row.

    Examples
    --------
    >>> from astro_scc.measurement.tables import component_table
    >>> empty = component_table([])
    >>> len(empty), empty["pm"].unit
    (0, Unit("mas / yr"))
    """
    table = in_speed_unit(build_table("components", rows), unit)
    table.meta.update(meta or {})
    return round_to_errors(table)


def printed(table):
    """
    Return velocity components, or features, as they are printed.

    The core is not among the components, as it is the reference; what has no feature
    has no speed, and a limit that one of the features exceeds is none.  Features that
    stand still like the core are of no stream.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        See `SCCResult.components` and `SCCResult.features`.

    Returns
    -------
    `~astropy.table.QTable`
        A copy, with NaN for such speeds and limits.

    Examples
    --------
    >>> from astro_scc.measurement.tables import component_table
    >>> from astro_scc.measurement.tables import printed
    >>> len(printed(component_table([])))
    0
    """
    core = np.isin(table["component"], table.meta.get("core", ()))
    if "n_features" not in table.colnames:
        shown = table.copy()
        shown["component"][core] = 0
        return shown
    shown = table[~(core & (table["kind"] == "stationary"))]
    blank = np.asarray(shown["n_features"]) == 0
    for name in shown.colnames:
        if name.startswith(("pm", "beta_app", "dispersion")):
            shown[name][blank] = np.nan
    shown["pm_limit"][shown["pm_max"] > shown["pm_limit"]] = np.nan
    return shown


def paper_table(table, *, sign="±"):
    """
    Return the main columns of a table as text, values with their errors.

    Parameters
    ----------
    table : `~astropy.table.Table`
        Components, features or a profile.
    sign : str, optional
        What stands between a value and its error.

    Returns
    -------
    `~astropy.table.Table`
        Of the columns in `PAPER` those that the table has.  Values are rounded to
        two significant digits of their own errors; "-" is what is not known.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> from astro_scc.measurement.tables import paper_table
    >>> table = QTable({"pm": [2.1279], "pm_err": [0.072]}, units=[u.mas / u.yr] * 2)
    >>> print(paper_table(table)["pm"][0])
    2.128 ± 0.072
    """
    shown, paper = table.copy(copy_data=False), Table()
    if "p_global_err" in shown.colnames:
        shown.remove_column("p_global_err")
    for name, texts in cells(shown, PAPER, sign=sign).items():
        unit = shown[name].info.unit
        unit = None if unit == u.one else unit
        paper[name] = Column(np.array(texts, dtype=str), unit=unit)
    return paper


def component_row(result, number):
    """Return the columns of one component as plain numbers."""
    peak, stream = result.maxima[number - 1], result.search.streams[number - 1]
    velocity, jitter = result.velocities[number - 1], result.jitters[number - 1]
    member, permutations = result.members(number), result.search.permutations
    epochs = np.sort([member["epoch"], member["target_epoch"]], axis=0)
    p, n = stream.p_global, len(permutations.permuted)
    row, by_jitter, by_alignment = (
        velocity_columns(
            velocity.value, covariance, result.frame, result.position_angle
        )
        for covariance in (velocity.covariance, jitter.covariance, velocity.alignment)
    )
    still = stream.kind != "moving"
    cautions = [stream.reason, result.sensitivity_line if number == 1 else ""]
    if not still and row["pm_parallel"] < -abs(row["pm_transverse"]):
        cautions.insert(0, "moves towards the core")
    cautions = [text for text in cautions if text]
    return row | {
        "component": number,
        "kind": stream.kind,
        "dispersion": velocity.dispersion,
        "dispersion_err": velocity.dispersion_error,
        "pm_limit": row["pm"] + LIMIT * row["pm_err"] if still else np.nan,
        "pm_err_jitter": by_jitter["pm_err"],
        "pm_err_alignment": by_alignment["pm_err"],
        "coefficient": peak.coefficient,
        "z_score": float(result.z_score[peak.row, peak.column]),
        "p_local": stream.p_local,
        "p_global": p,
        "p_global_err": np.sqrt(p * (1 - p) / n),
        "p_distinct": stream.p_distinct,
        "p_smallest": permutations.smallest_p,
        "n_ssp": len(np.unique(member["ssp"])),
        "n_pairs": len(np.unique(epochs, axis=1).T),
        "n_features": len(stream.features),
        "pm_min": velocity.slowest,
        "pm_max": velocity.fastest,
        # ECSV reads empty text as a missing value.
        "caution": "; ".join(cautions) or "-",
    }


def velocity_columns(velocity, covariance, frame, position_angle):
    """
    Return the components of a velocity, on the sky and relative to the jet.

    Each has an error, which is NaN if the data do not determine it.
    """
    known = np.all(np.isfinite(covariance))
    covariance = covariance if known else np.full((2, 2), np.nan)
    if frame.uniform:
        to_sky = np.linalg.inv(frame.matrix(0.0, 0.0))
        sky, sky_covariance = to_sky @ velocity, to_sky @ covariance @ to_sky.T
        pa = position_angle.to_value(u.rad)
        jet = np.array([[np.sin(pa), np.cos(pa)], [np.cos(pa), -np.sin(pa)]])
        along, along_covariance = jet @ sky, jet @ sky_covariance @ jet.T
    else:
        # The axes of radial and curved frames have no single direction on the sky.
        sky, sky_covariance = np.full(2, np.nan), np.full((2, 2), np.nan)
        along, along_covariance = velocity, covariance
    speed = float(np.hypot(*along))
    unit = along / speed if speed > 0 else np.array([1.0, 0.0])
    across = np.array([-unit[1], unit[0]])
    names = ("pm_ra_cosdec", "pm_dec", "pm_parallel", "pm_transverse", "pm")
    variances = [*np.diag(sky_covariance), *np.diag(along_covariance)]
    variances += [axis @ along_covariance @ axis for axis in (unit, across)]
    # Rounding can make a variance negative that should be zero.
    *errors, across_err = np.sqrt(np.maximum(variances, 0.0)).tolist()
    pa_err = np.pi if known and frame.uniform else np.nan
    if speed > 0:
        # A direction cannot be wrong by more than half a turn.
        pa_err = np.minimum(across_err, pa_err * speed) / speed
    values = zip(map(float, (*sky, *along, speed)), errors, strict=True)
    pa = float(np.degrees(np.arctan2(*sky)) % 360), float(np.degrees(pa_err))
    return with_errors(**dict(zip(names, values, strict=True)), pm_pa=pa)


def stack_tables(tables, meta):
    """Return one table of the rows of all, with a meta of its own."""
    filled = [table for table in tables if len(table)] or tables[:1]
    stacked = vstack(filled, metadata_conflicts="silent")
    stacked.meta.clear()
    stacked.meta.update(meta)
    return round_to_errors(stacked)


def false_discovery_rate(
    tables: Sequence[QTable] | Mapping[Any, QTable], *, method: str = "bh"
) -> Any:
    """
    Adjust the p-values of components for the number of regions searched.

    Let :math:`p_{(1)} \\le \\ldots \\le p_{(m)}` be the ``p_global`` of the m
    velocities that were tested in all regions, bins or groups of scales
    together.  The k-th smallest becomes

    .. math:: q_{(k)} = \\min_{l \\ge k}\\ \\min(1,\\ c_m\\, m\\, p_{(l)} / l),

    with :math:`c_m = 1` [1]_, or :math:`c_m = \\sum_{l=1}^{m} 1 / l` [2]_.  Of
    the components with ``p_fdr <= q``, a share of at most q is expected to be
    false.

    Parameters
    ----------
    tables : sequence of `~astropy.table.QTable`, or a mapping to them
        Components, see `SCCResult.components`: one table for each region,
        bin or group of scales, *those without components included*.
    method : {"bh", "by"}, optional
        Benjamini & Hochberg, which holds for independent and for positively
        dependent tests, for example of regions that share features or of
        scales that see the same feature; or Benjamini & Yekutieli, which
        holds for any dependence and costs the factor :math:`c_m`, 3.6 for
        m = 20.

    Returns
    -------
    list or dict of `~astropy.table.QTable`
        Copies with the column ``p_fdr`` after ``p_global_err``; their meta
        holds the method and the number of tests.

    Raises
    ------
    TypeError
        If ``tables`` is one table.
    ValueError
        If a table has no column ``p_global``, if a value in it is no
        probability, or if ``method`` is unknown.

    Notes
    -----
    ``p_global`` is adjusted because it already accounts for all velocities at
    which one region was searched; ``p_local`` does not.  Every velocity that
    was tested counts, including those "not significant", and a table without
    any counts as one test with a p-value of 1.  If only significant velocities
    counted, a single false alarm among twenty regions would not be corrected
    for the other nineteen.  "stationary" components are not tested and do not
    count.  ``kind`` is not changed: a component is a discovery of the whole
    search if it is "moving" *and* its ``p_fdr`` is small.

    With n trials, the ``p_fdr`` of a single small p-value cannot be below
    m / (n + 1).

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

    if method not in ("bh", "by"):
        raise ValueError(f"unknown method {method!r}: use 'bh' or 'by'")
    if isinstance(tables, Table):
        raise TypeError("tables must be a sequence of tables, got one: give [table]")
    is_mapping = hasattr(tables, "items")
    tables = dict(tables.items() if is_mapping else enumerate(tables))
    tested = {name: _tested(table, name) for name, table in tables.items()}
    # A region where nothing could be tested was searched all the same.
    p = [p[use] if use.any() else np.ones(1) for p, use in tested.values()]
    adjusted = false_discovery_control(np.concatenate(p), method=method) if p else []
    meta = {"false_discovery": {"method": method, "n_tests": len(adjusted)}}
    parts = np.split(adjusted, np.cumsum([len(part) for part in p])[:-1])
    done = {}
    for (name, (values, use)), part in zip(tested.items(), parts, strict=False):
        values = values.copy()
        values[use] = part[: use.sum()]
        done[name] = table = tables[name].copy()
        if "p_fdr" in table.colnames:
            table.remove_column("p_fdr")
        before = "p_global_err" if "p_global_err" in table.colnames else "p_global"
        index = table.colnames.index(before) + 1
        table.add_column(values, index, name="p_fdr")
        describe(table, "added").meta.update(meta)
    return done if is_mapping else list(done.values())


def _tested(table, name):
    """Return the p-values, and which were tested: stationary components are not."""
    if "p_global" not in table.colnames:
        raise ValueError(f"table {name!r} has no column p_global: give components")
    p = np.asarray(table["p_global"], dtype=float)
    # A comparison with NaN is false.
    if not np.all((p >= 0) & (p <= 1)):
        raise ValueError(f"table {name!r}: p_global must be from 0 to 1, got {p}")
    if "kind" not in table.colnames:
        return p, np.ones(len(p), dtype=bool)
    return p, np.asarray(table["kind"], dtype=str) != "stationary"
