# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The settings of a measurement: what each may be, and how it is written."""

import re
from datetime import date

from astro_scc.config.text import (
    NUMBER,
    parse_quantities,
    parse_unit,
    to_cosmology,
    to_time,
)

__all__ = ["SETTINGS", "parse_setting", "plain_settings"]

#: Redshift of the microwave background, beyond which nothing is seen.
LAST_SCATTERING = 1090
# FITS and TOML keep integers of 64 bits.
_LARGEST_SEED = 2**63 - 1


# -- what a setting may be -------------------------------------------------------
#
# Each function takes what a TOML file or the command line has and returns the
# value, or raises a ValueError that continues "NAME = VALUE ...".


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
    if not isinstance(value, bool):
        raise ValueError("must be true or false")
    return value


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


def _redshift(value):
    number = _positive(value)
    if not number < LAST_SCATTERING:
        raise ValueError(f"must be below {LAST_SCATTERING}")
    return number


def _integer(smallest, largest):
    def parse(value):
        try:
            if not isinstance(value, str | int) or isinstance(value, bool):
                raise TypeError
            number = int(value)
        except (TypeError, ValueError):
            raise ValueError("must be a whole number") from None
        if not smallest <= number <= largest:
            raise ValueError(f"must be {smallest} to {largest}")
        return number

    return parse


def _choice(*choices):
    def parse(value):
        if value not in choices:
            raise ValueError(f"must be one of {', '.join(choices)}")
        return value

    return parse


def _quantity(value, kind, example, positive=True):
    """One quantity, whose unit may have blanks in it."""
    import astropy.units as u

    wanted = f"must be {kind} with a unit, such as {example!r}"
    if not isinstance(value, str):
        raise ValueError(wanted)
    match = re.fullmatch(rf"\s*({NUMBER})\s*(\D.*?)\s*", value)
    if match is None:
        raise ValueError(wanted)
    unit = parse_unit(match.group(2))
    if not unit.is_equivalent(u.Quantity(example).unit):
        raise ValueError(wanted)
    found = u.Quantity(float(match.group(1)), unit)
    if positive and not found.value > 0:
        raise ValueError("must be above 0")
    return found


def _speed(value):
    return _quantity(value, "an angle per time", "2 mas/yr")


def _distance(value):
    return _quantity(value, "a length", "16.7 Mpc")


def _position_angle(value):
    if value in ("radial", "ridge", "fit"):
        return value
    example = "65 deg"
    kind = "radial, ridge, fit or an angle"
    return _quantity(value, kind, example, positive=False)


def _quantities(value, unit, wanted):
    """Several quantities of one kind, as one `~astropy.units.Quantity`."""
    import astropy.units as u

    if isinstance(value, list | tuple) and all(isinstance(v, str) for v in value):
        value = " ".join(value)
    if not isinstance(value, str):
        raise ValueError(wanted)
    try:
        items = parse_quantities(value)
    except ValueError as error:
        raise ValueError(f"{error}; it {wanted}") from None
    if not all(item.unit.is_equivalent(unit) for item in items):
        raise ValueError(wanted)
    return u.Quantity(items)


def _baseline(value):
    import astropy.units as u

    wanted = "must be a shortest and a longest time, such as '0.2 yr 1.0 yr'"
    times = _quantities(value, u.yr, wanted)
    if len(times) != 2 or not 0 <= times[0] < times[1]:
        raise ValueError(wanted)
    return times


def _nulls(value):
    names = re.split(r"[\s,]+", value.strip()) if isinstance(value, str) else value
    if not isinstance(names, list | tuple) or not set(names) <= set(NULLS):
        raise ValueError(f"must be of {', '.join(NULLS)}")
    return tuple(names)


def _alignment_error(value):
    import astropy.units as u

    if isinstance(value, str):
        return _quantity(value, "an angle", "0.02 mas")
    wanted = "must be an angle or a list of them, such as '0.02 mas'"
    return _quantities(value, u.mas, wanted)


def _bins(value):
    import astropy.units as u

    wanted = "must be increasing distances, such as '0.5 1.5 2.5 mas'"
    edges = _quantities(value, u.mas, wanted)
    if not (edges[0] >= 0 and all(edges[1:] > edges[:-1])):
        raise ValueError(wanted)
    return edges


def _window(value):
    return _quantity(value, "an angle", "2 mas")


def _scales(value):
    import astropy.units as u

    wanted = "must be scale numbers such as 1,2,3 or angles such as '0.2,0.4 mas'"
    if isinstance(value, str):
        value = [word for word in re.split(r"[\s,]+", value.strip()) if word]
    elif not isinstance(value, list | tuple):
        value = [value]
    if not value:
        raise ValueError(wanted)
    try:
        return tuple(_number(item) for item in value)
    except ValueError:
        pass
    angles = _quantities(value, u.deg, wanted)
    if not all(angles > 0):
        raise ValueError("must be above 0")
    return angles


def _cosmology(value):
    to_cosmology(_text(value))
    return value.strip()


def _date(value):
    # TOML has dates of its own.
    text = value.isoformat() if isinstance(value, date) else str(value)
    to_time(text)
    return text.strip()


#: Null hypotheses, as `astro_scc.stacking.NULL_HYPOTHESES` names them.
NULLS = ("scramble", "shuffle", "blocks", "reversal", "paper")
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
    "kernel": _positive,
    "kappa": _positive,
    "target": _choice("segments", "plane"),
    "min_overlap": _positive,
    "wavelet": _choice("b1", "b3"),
    "detection": _positive,
    "segmentation": _positive,
    "noise": _choice("plane", "local", "propagated"),
    "level": _positive,
    "nulls": _nulls,
    "alignment_error": _alignment_error,
    "small_displacement_correction": _boolean,
    "n_trials": _integer(2, 10**9),
    "seed": _integer(0, _LARGEST_SEED),
    "redshift": _redshift,
    "cosmology": _cosmology,
    "distance": _distance,
    "bins": _bins,
    "window": _window,
}


def parse_setting(name, value):
    """
    The value of a setting from what a file or the command line has.

    Parameters
    ----------
    name : str
        Key of the configuration.
    value
        As TOML gives it, or as text.

    Returns
    -------
    object
        Quantities where the setting has a unit; files, dates and cosmologies
        as text, but checked.

    Raises
    ------
    ValueError
        With what the value must be, to follow after its name.
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
    return SETTINGS[name](value)


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
