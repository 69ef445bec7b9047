# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Units that are easy to read."""

import astropy.units as u

PM_UNIT = u.mas / u.yr
ACCELERATION = u.mas / u.yr**2
#: Units of time, and how long a series must be for them; shorter ones are in hours.
TIMES = {u.yr: 0.1 * u.yr, u.day: 2 * u.day}


def offset_unit(span, unit=None):
    """Return a unit that is easy to read for offsets over a span in mas."""
    if unit is not None:
        return unit_like(u.mas, unit, "an angle, such as 'mas'")
    units = ((u.deg, 3.0), (u.arcmin, 5.0), (u.arcsec, 1.0), (u.mas, 0.3))
    large = (name for name, least in units if (span * u.mas).to_value(name) >= least)
    return next(large, u.uas)


def speed_unit(span, resolution, interval):
    """
    Return a unit that is easy to read for the proper motions of a series.

    Parameters
    ----------
    span : `~astropy.units.Quantity`
        Time from the first epoch to the last, which decides on the unit of time.
    resolution, interval : `~astropy.units.Quantity`
        A beam in the median interval decides on the unit of length: arcsec if it is one
        or more.
    """
    time = next((candidate for candidate, least in TIMES.items() if span > least), u.h)
    coarse = (resolution / interval).to_value(u.arcsec / time) >= 1
    return (u.arcsec if coarse else u.mas) / time


def unit_like(kind, unit, wanted):
    """Return a unit given by a user, which must be of some kind."""
    unit = u.Unit(unit)
    if not unit.is_equivalent(kind):
        raise ValueError(f"unit must be {wanted}, got {unit}")
    return unit


def unit_name(unit):
    """Return a unit as text for a label."""
    return u.Unit(unit).to_string().replace(" / ", "/")


def in_speed_unit(table, unit):
    """Convert proper motions in mas/yr, and accelerations, to a unit, in place."""
    length, time = unit.bases
    for standard, wanted in ((PM_UNIT, unit), (ACCELERATION, length / time**2)):
        for name in table.colnames if standard != wanted else ():
            if getattr(table[name], "unit", None) == standard:
                about = table[name].info.description
                table[name] = table[name].to(wanted)
                table[name].info.description = about
    return table
