# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Arguments with a unit, and numbers of trials that can tell anything."""

import astropy.units as u
import numpy as np

__all__ = ["PM_UNIT", "check_trials", "in_unit", "positive"]

PM_UNIT = u.mas / u.yr


def in_unit(name, value, unit):
    """
    A quantity in a unit, or an error that names the argument.

    Parameters
    ----------
    name : str
    value : `~astropy.units.Quantity`
    unit : `~astropy.units.Unit`

    Returns
    -------
    `~astropy.units.Quantity`

    Raises
    ------
    `~astropy.units.UnitConversionError`
        If the unit does not fit.
    """
    try:
        return u.Quantity(value).to(unit)
    except u.UnitConversionError:
        raise u.UnitConversionError(
            f"{name} must be in a unit like {unit}, got {value}"
        ) from None


def positive(name, value, unit):
    """
    One positive number of a unit.

    Parameters
    ----------
    name : str
    value : `~astropy.units.Quantity`
    unit : `~astropy.units.Unit`

    Returns
    -------
    float

    Raises
    ------
    ValueError
        If it is none.
    """
    value = in_unit(name, value, unit)
    if not (value.isscalar and 0 < value.value < np.inf):
        raise ValueError(f"{name} must be one positive number, got {value}")
    return float(value.value)


def check_trials(n_trials, level):
    """
    Refuse trials that allow no probability as small as a level.

    Parameters
    ----------
    n_trials : int
    level : float

    Raises
    ------
    ValueError
        If ``1 / (n_trials + 1)`` is above the level.
    """
    if not n_trials >= 2:
        raise ValueError(f"n_trials must be at least 2, got {n_trials}")
    if 1 / (n_trials + 1) > level:
        raise ValueError(
            f"{n_trials} trials allow no p_global below {1 / (n_trials + 1):.2g}, so "
            f"nothing can be found at level {level:g}: give more n_trials"
        )
