# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The settings of a measurement: what each may be, and how it is written."""

import operator
import re
from datetime import date

from astro_scc.quantities import named, one_quantity, to_quantity, to_time

__all__ = ["SETTINGS", "parse_setting", "plain_settings", "require"]

# FITS and TOML keep integers of 64 bits.
_LARGEST_SEED = 2**63 - 1


# -- what a setting may be -------------------------------------------------------
#
# Each function takes what a TOML file, the command line or Python has and returns
# the value, or raises a ValueError that continues "NAME = VALUE ...".


def _text(value):
    if not isinstance(value, str) or not value.strip():
        raise ValueError("must be text")
    return value


def _paths(value):
    items = [value] if isinstance(value, str) else value
    if not isinstance(items, list | tuple) or not items:
        raise ValueError("must be a list of files")
    return [_text(item) for item in items]


def _boolean(value):
    # That of numpy is another class.
    if type(value).__name__ not in ("bool", "bool_"):
        raise ValueError("must be true or false")
    return bool(value)


def _number(value):
    try:
        if isinstance(value, bool):
            raise TypeError
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError("must be a number") from None
    except OverflowError:
        number = float("inf")
    if not abs(number) < float("inf"):
        raise ValueError("must be a finite number")
    return number


def _positive(value):
    number = _number(value)
    if not number > 0:
        raise ValueError("must be above 0")
    return number


def _fraction(largest, of=""):
    def parse(value):
        number = _number(value)
        if not 0 < number < largest:
            raise ValueError(f"must be {of}between 0 and {largest}")
        return number

    return parse


def _integer(smallest, largest=None):
    def parse(value):
        try:
            if isinstance(value, bool):
                raise TypeError
            number = int(value) if isinstance(value, str) else operator.index(value)
        except (TypeError, ValueError):
            raise ValueError("must be a whole number") from None
        if not smallest <= number <= (number if largest is None else largest):
            limit = "or more" if largest is None else f"to {largest}"
            raise ValueError(f"must be {smallest} {limit}")
        return number

    return parse


def _choice(*choices):
    def parse(value):
        if not isinstance(value, str) or value not in choices:
            raise ValueError(f"must be one of {', '.join(choices)}")
        return value

    return parse


def _quantity(kind, example):
    return lambda value: one_quantity(value, kind, example)


def _quantities(value, unit, wanted):
    """Finite quantities of one kind."""
    import numpy as np

    found = to_quantity(value, unit, wanted)
    if found.size == 0 or found.ndim > 1 or not np.all(np.isfinite(found)):
        raise ValueError(wanted)
    return found


def _position_angle(value):
    # A frame of astro_scc.kinematics says itself what it is.
    if hasattr(value, "matrix") or (
        isinstance(value, str) and value in ("radial", "ridge", "fit")
    ):
        return value
    return one_quantity(value, "radial, ridge, fit or an angle", "65 deg", False)


def _baseline(value):
    wanted = "must be a shortest and a longest time, such as '0.2 yr 1.0 yr'"
    times = _quantities(value, "yr", wanted)
    if times.shape != (2,) or not 0 <= times[0] <= times[1]:
        raise ValueError(wanted)
    return times


def _speeds(value):
    wanted = "must be a smallest and a largest speed, such as '-1 4 mas/yr'"
    speeds = _quantities(value, "mas/yr", wanted)
    if speeds.shape != (2,) or not speeds[0] < speeds[1]:
        raise ValueError(wanted)
    return speeds


def _alignment_error(value):
    wanted = "must be an angle or a list of them, such as '0.02 mas'"
    errors = _quantities(value, "mas", wanted)
    if not (errors >= 0).all():
        raise ValueError("must be 0 or above")
    return errors


def _bins(value):
    wanted = "must be increasing distances, such as '0.5 1.5 2.5 mas'"
    edges = _quantities(value, "mas", wanted).reshape(-1)
    if not (edges[0] >= 0 and all(edges[1:] > edges[:-1])):
        raise ValueError(wanted)
    return edges


def _scales(value):
    wanted = "must be scale numbers such as 1,2,3 or angles such as '0.2,0.4 mas'"
    items = value
    if isinstance(value, str):
        items = re.findall(r"[^\s,]+", value)
    elif not hasattr(value, "__len__"):
        items = [value]
    try:
        numbers = tuple(_number(item) for item in items)
    except (TypeError, ValueError):
        angles = _quantities(value, "mas", wanted).reshape(-1)
        if not (angles > 0).all():
            raise ValueError("must be above 0") from None
        return angles
    if not numbers:
        raise ValueError(wanted)
    if len(set(numbers)) < len(numbers):
        raise ValueError("must differ: leave out what is there twice")
    return numbers


def _redshift(value):
    from astro_scc.kinematics.cosmology import to_redshift

    redshift = to_redshift(value)
    if not isinstance(redshift, float):
        raise ValueError("must be one redshift")
    return redshift


def _distance(value):
    from astro_scc.kinematics.cosmology import to_distance

    distance = to_distance(value)
    if not distance.isscalar:
        raise ValueError("must be one distance")
    return distance


def _cosmology(value):
    from astro_scc.kinematics.cosmology import to_cosmology

    to_cosmology(_text(value))
    return value.strip()


def _date(value):
    # TOML has dates of its own.
    text = value.isoformat() if isinstance(value, date) else str(value)
    to_time(text)
    return text.strip()


_speed = _quantity("an angle per time", "2 mas/yr")
_angle = _quantity("an angle", "2 mas")

#: Name of each setting, and the function that makes its value.
SETTINGS = {
    "epochs": _paths,
    "after": _date,
    "before": _date,
    "align": _text,
    "common_beam": _boolean,
    "crop": _text,
    "region": _text,
    "scales": _scales,
    "max_speed": _speed,
    "position_angle": _position_angle,
    "baseline": _baseline,
    "kernel": _fraction(5, "a part of the beam "),
    "kappa": _positive,
    "target": _choice("segments", "plane"),
    "min_overlap": _positive,
    "wavelet": _choice("b1", "b3"),
    "detection": _positive,
    "segmentation": _positive,
    "noise": _choice("plane", "local", "propagated"),
    "level": _fraction(1),
    "outward": _boolean,
    "alignment_error": _alignment_error,
    "small_displacement_correction": _boolean,
    "n_trials": _integer(2, 10**9),
    "seed": _integer(0, _LARGEST_SEED),
    "redshift": _redshift,
    "cosmology": _cosmology,
    "distance": _distance,
    "bins": _bins,
    "window": _angle,
}
#: Those of tracking alone, which no file has.
TRACKING = {
    "along": _speeds,
    "across": _speeds,
    "tolerance": _fraction(5, "a part of the beam "),
    "max_gap": _integer(0),
    "max_interval": _quantity("a time", "1 yr"),
    "min_epochs": _integer(3),
    "half_width": _angle,
}
#: Units that are computed with.
UNITS = {
    "max_speed": "mas / yr",
    "position_angle": "deg",
    "baseline": "yr",
    "alignment_error": "mas",
    "along": "mas / yr",
    "across": "mas / yr",
    "max_interval": "yr",
}


def parse_setting(name, value):
    """
    The value of a setting from what a file or the command line has.

    Parameters
    ----------
    name : str
        Key of the configuration, or option of the tracking.
    value
        As TOML gives it, or as text, or what it is in Python.

    Returns
    -------
    object
        Quantities where the setting has a unit; files, dates and cosmologies
        as text, but checked.

    Raises
    ------
    ValueError
        With what the value must be, to follow after its name; a
        `~astropy.units.UnitConversionError` if it is the unit.
    KeyError
        If there is no such setting.

    Examples
    --------
    >>> from astro_scc.config import parse_setting
    >>> parse_setting("max_speed", "2 mas/yr")
    <Quantity 2. mas / yr>
    >>> parse_setting("scales", "1,2,3")
    (1.0, 2.0, 3.0)
    """
    return (SETTINGS | TRACKING)[name](value)


def require(name, value):
    """
    Return the value of a setting that is given in Python.

    Parameters
    ----------
    name : str
        See `parse_setting`.
    value : object
        None stays None.

    Returns
    -------
    object
        Quantities in the units that are computed with.

    Raises
    ------
    ValueError
        In one line with name, value and what it must be; a
        `~astropy.units.UnitConversionError` if it is the unit.

    Examples
    --------
    >>> from astro_scc.config.settings import require
    >>> require("baseline", "73.05 d 1 yr")
    <Quantity [0.2, 1. ] yr>
    """
    if value is None:
        return None
    found = named(name, (SETTINGS | TRACKING)[name], value)
    return found.to(UNITS[name]) if name in UNITS and hasattr(found, "to") else found


def plain_settings(settings):
    """
    Settings as text, numbers and lists, in the order of the configuration.

    Parameters
    ----------
    settings : dict
        As `read_config` gives them; those that are None are left out.

    Returns
    -------
    dict
        From which `parse_setting` makes the same values, to the last bit.

    Raises
    ------
    KeyError
        If there is no such setting.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.config import plain_settings
    >>> plain_settings({"n_trials": 500, "max_speed": 2 * u.mas / u.yr})
    {'max_speed': '2.0 mas / yr', 'n_trials': 500}
    """
    unknown = set(settings) - set(SETTINGS)
    if unknown:
        raise KeyError(f"unknown settings {', '.join(sorted(unknown))}")
    return {
        name: _plain(settings[name])
        for name in SETTINGS
        if settings.get(name) is not None
    }


def _plain(value):
    if hasattr(value, "unit"):
        if value.shape:
            return [_plain(item) for item in value]
        return f"{float(value.value)!r} {value.unit}"
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    # Whole numbers read better without a point, and numpy's are no TOML.
    if isinstance(value, float):
        return int(value) if value.is_integer() and abs(value) < 1e15 else float(value)
    return value
