# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What a measurement found, in the sentences of the terminal and of the report."""

import numpy as np

from astro_scc.columns import cell
from astro_scc.measurement.tables import printed
from astro_scc.units import unit_name

#: Most features that are named in a sentence.
NAMED = 10


def headline(components):
    """
    Return the result of a measurement as a sentence.

    It is *motion*, *motion not confirmed*, or *no motion found* between the slowest
    and the fastest speed that was searched.

    Parameters
    ----------
    components : `~astropy.table.QTable`
        See `~astro_scc.measurement.SCCResult.components`.

    Returns
    -------
    str

    Examples
    --------
    >>> from astro_scc.measurement.tables import component_table
    >>> from astro_scc.report.answer import headline
    >>> headline(component_table([]))
    'No motion found: no pattern has a match in another epoch.'
    """
    if len(components) == 0:
        return "No motion found: no pattern has a match in another epoch."
    rows = printed(components)
    kinds = np.asarray(rows["kind"])
    if moving := [_motion(row) for row in rows[kinds == "moving"]]:
        return f"Motion: {'; and '.join(moving)}."
    if len(some := rows[kinds == "not confirmed"]):
        row = some[0]
        why = f"p_global {row['p_global']:.2g}, but {row['caution']}"
        speed = f"{_speed(row)} with " if row["n_features"] else ""
        return f"Motion not confirmed: {speed}{why}."
    text, unit = "No motion found", rows["pm"].unit
    if "fastest_searched" in components.meta:
        ends = (components.meta[f"{k}_searched"] for k in ("slowest", "fastest"))
        low, high = (f"{end.to_value(unit):.2g}" for end in ends)
        text += f" between {low} and {high} {unit_name(unit)}"
    if len(some := rows[kinds == "not significant"]):
        return f"{text}: the strongest peak has p_global {some['p_global'][0]:.2g}."
    return f"{text}: all features are stationary within their errors."


def _speed(row):
    """Return the speed of a row with its error, in units of c too if it has them."""
    text = f"{cell(row, 'pm', '+-')} {unit_name(row['pm'].unit)}"
    if "beta_app" in row.colnames:
        text += f" ({cell(row, 'beta_app', '+-')} c)"
    return text


def _motion(row):
    """Return the motion of a stream in words."""
    n, angle = row["n_features"], row["pm_pa"].value
    mean = _speed(row)
    if np.isfinite(angle):
        towards = f" towards PA {angle:.0f} deg"
        if "towards the core" in row["caution"]:
            towards += ", which is towards the core"
    else:
        towards = " outward" if row["pm_parallel"] > 0 else " inward"
    spread, slow, fast = (row[k].value for k in ("dispersion", "pm_min", "pm_max"))
    # The features differ by more than their errors.
    if n > 1 and spread > 2 * row["dispersion_err"].value:
        unit = unit_name(row["pm"].unit)
        mean = f"{slow:.2g} to {fast:.2g} {unit}, mean {mean}"
    return f"{mean}{towards}, {n} {'feature' if n == 1 else 'features'}"


def notes(components, features):
    """
    Return what has to be known of each stream, and upper limits, as lines.

    Parameters
    ----------
    components, features : `~astropy.table.QTable`
        Of an `~astro_scc.measurement.SCCResult`.

    Returns
    -------
    list of str
        Without a full stop, and without what the headline says.  An upper limit is
        that of the mean speed of features that are named; there is none if one of
        them is faster.
    """
    lines, rows, said = [], printed(components), headline(components)
    for row in rows:
        own = features[features["component"] == row["component"]]
        limit, number = row["pm_limit"], row["component"]
        if row["caution"] != "-" and row["caution"] not in said:
            lines.append(f"Stream {number} ({row['kind']}): {row['caution']}")
        if len(own) and own["pm"].max() <= limit:
            named = ", ".join(map(str, own["feature"]))
            named = f" ({named})" if len(own) <= NAMED else ""
            lines.append(
                f"Stream {number}: {limit.value:.2g} {unit_name(limit.unit)} is the "
                f"upper limit (95%) of the mean speed of these features{named}"
            )
    hidden = np.setdiff1d(components["component"], rows["component"])
    lines += [f"Row {n} of components.ecsv is the core, the reference" for n in hidden]
    return lines
