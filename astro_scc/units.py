# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Units of proper motions, and units and tables that are easy to read."""

import astropy.units as u
import numpy as np

from astro_scc.quantities import decimals

PM_UNIT = u.mas / u.yr
#: Formats of numbers without errors in tables that are printed.
FORMATS = {"coefficient": ".3f", "z_score": ".1f", "pm_limit": ".2g"}


def offset_unit(span, unit=None):
    """Return a unit that is easy to read for offsets over a span in mas."""
    if unit is not None:
        return _unit_like(u.mas, unit, "an angle, such as 'mas'")
    units = ((u.deg, 3.0), (u.arcmin, 5.0), (u.arcsec, 3.0), (u.mas, 0.3))
    large = (own for own, least in units if (span * u.mas).to_value(own) >= least)
    return next(large, u.uas)


def speed_unit(fastest, unit=None):
    """Return a unit that is easy to read for proper motions up to one in mas/yr."""
    if unit is not None:
        return _unit_like(PM_UNIT, unit, "an angle over a time, such as 'mas/yr'")
    if (fastest * PM_UNIT).to_value(u.arcsec / u.h) >= 0.3:
        return u.arcsec / u.h
    return u.arcsec / u.yr if fastest >= 3000 else PM_UNIT


def _unit_like(kind, unit, wanted):
    unit = u.Unit(unit)
    if not unit.is_equivalent(kind):
        raise ValueError(f"unit must be {wanted}, got {unit}")
    return unit


def unit_name(unit):
    """Return a unit as text for a label."""
    return u.Unit(unit).to_string().replace(" / ", "/")


def time_unit(years):
    """Return a unit that is easy to read for intervals up to one in years."""
    return next((v for v in (u.yr, u.day, u.h) if years >= 0.3 * v.to(u.yr)), u.min)


def comparable(value):
    """Return a value, or for a quantity what can be compared as a whole and hashed."""
    if isinstance(value, u.Quantity):
        return value.shape, tuple(value.si.value.flat), str(value.si.unit)
    return value


def in_easy_units(table):
    """
    Return a table with proper motions in a unit that is easy to read.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        With a column ``pm``, whose largest value decides.

    Returns
    -------
    `~astropy.table.QTable`
        The same table if it already has that unit.
    """
    own = table["pm"].unit
    unit = speed_unit(table["pm"].to_value(PM_UNIT).max(initial=0))
    if unit == own:
        return table
    easy = table.copy()
    for name in table.colnames:
        column = table[name]
        if getattr(column, "unit", None) == own:
            easy[name] = column.to(unit)
            easy[name].info.description = column.info.description
    return easy


def round_to_errors(table):
    """
    Set formats that round columns to their errors when a table is printed, in place.

    Parameters
    ----------
    table : `~astropy.table.Table`
        A column and its error, of which the name ends with ``_err``, show the smallest
        error to two significant digits.  Other numbers show four, p-values two.

    Returns
    -------
    `~astropy.table.Table`
        The same, with the same numbers.
    """
    for name in table.colnames:
        column = table[name]
        if getattr(getattr(column, "dtype", None), "kind", "") != "f":
            continue
        error = f"{name.removesuffix('_err')}_err"
        is_p = name.startswith("p_")
        form = FORMATS.get(name, ".2g" if is_p or "_err" in name else ".4g")
        if error in table.colnames and not is_p:
            errors = np.asarray(getattr(table[error], "unmasked", table[error]))
            known = errors[np.isfinite(errors) & (errors > 0)]
            form = f".{decimals(known.min())}f" if known.size else form
        # Years have more digits before the point.
        column.info.format = None if column.unit == "yr" and form[-1] == "g" else form
    return table
