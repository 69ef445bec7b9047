# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""One table of all components of a survey."""

from pathlib import Path

import astropy.units as u
from astropy.table import Column, QTable, vstack

from astro_scc.measurement import component_table, false_discovery_rate, versions

__all__ = ["survey_table"]

#: Columns that name a row, and what is said of it.
HEAD = {
    "source": "name of the source",
    "region": "name of the region, all without one",
    "scale_group": "name of the scale group, all without one",
    "status": "measured, empty (searched, nothing to test) or failed",
    "message": "why there is no component",
}
IN_C = ("beta_app", "beta_app_err")
HOW = ("redshift", "cosmology", "distance")


def survey_table(outcomes, output):
    """
    The components of all sources as one table.

    Parameters
    ----------
    outcomes : sequence of `Outcome`
    output : path
        Folder of the survey, where their products are.

    Returns
    -------
    `~astropy.table.QTable`
        A row for each source, region, scale group and component, with the
        columns of `~astro_scc.measurement.SCCResult.components` and ``p_fdr``,
        see `~astro_scc.measurement.false_discovery_rate`, over all that was
        searched; a row with masked numbers for each region and scale group
        without a component.

    Examples
    --------
    >>> from astro_scc.survey import Outcome, survey_table
    >>> gone = Outcome("M87", "all", "all", "failed", "no file m87/*.fits")
    >>> table = survey_table([gone], "out")
    >>> table["status"].tolist(), "p_fdr" in table.colnames
    (['failed'], True)
    """
    tables = {
        outcome: QTable.read(
            Path(output, outcome.folder, "components.ecsv"), format="ascii.ecsv"
        )
        for outcome in outcomes
        if outcome.folder
    }
    adjusted = false_discovery_rate(tables)
    empty, *_ = false_discovery_rate([component_table([])])
    for name in IN_C:
        if any(name in table.colnames for table in adjusted.values()):
            empty[name] = [] * u.one
    rows = [_with_head(empty, None)]
    for outcome in outcomes:
        own = adjusted.get(outcome)
        if own is None or len(own) == 0:
            own = None
        rows.append(_with_head(own, outcome))
    table = vstack(rows, metadata_conflicts="silent")
    table.meta.clear()
    table.meta["versions"] = versions()
    searched = sum(max(len(own), 1) for own in adjusted.values())
    table.meta["false_discovery"] = {"method": "bh", "n_tests": searched}
    # A source has one redshift and cosmology, or one distance, in all its parts.
    table.meta["speeds_in_c"] = {
        outcome.source: {name: own.meta[name] for name in HOW if name in own.meta}
        for outcome, own in tables.items()
        if "beta_app" in own.colnames
    }
    return table


def _with_head(components, outcome):
    n = 1 if components is None else len(components)
    table = QTable()
    for name, description in HEAD.items():
        values = [] if outcome is None else [getattr(outcome, name)] * n
        table[name] = Column(values, dtype=None if values else "U1",
                             description=description)  # fmt: skip
    if components is not None:
        for name in components.colnames:
            table[name] = components[name]
    return table
