# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
What determines a measurement, as settings in TOML files.

The keys are those of the command line, ``max_speed`` for ``--max-speed``.
Quantities are text with a unit, ``"2 mas / yr"``.
"""

import re
import tomllib
from datetime import date
from pathlib import Path

__all__ = [
    "format_config",
    "parse_quantities",
    "parse_setting",
    "plain_settings",
    "read_config",
    "to_cosmology",
    "to_time",
]

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_PARAMETER = re.compile(rf"\s*(\w+)\s*=\s*({_NUMBER})\s*")
# FITS and TOML keep integers of 64 bits.
_LARGEST_SEED = 2**63 - 1


def parse_quantities(text):
    """
    Read several quantities in one text.

    Parameters
    ----------
    text : str
        Numbers with units, separated by blanks or commas.  A number without
        a unit has that of the next number that has one.

    Returns
    -------
    list of `~astropy.units.Quantity`

    Raises
    ------
    ValueError
        If something is no number, or a unit is missing or unknown.

    Examples
    --------
    >>> from astro_scc.config import parse_quantities
    >>> parse_quantities("1.0 mas 0.5 mas -7 deg")
    [<Quantity 1. mas>, <Quantity 0.5 mas>, <Quantity -7. deg>]
    >>> parse_quantities("0.5, 1.5 yr")
    [<Quantity 0.5 yr>, <Quantity 1.5 yr>]
    """
    import astropy.units as u

    numbers, units = [], []
    for word in re.split(r"[\s,]+", text.strip()):
        match = re.fullmatch(rf"({_NUMBER})?(.*)", word)
        number, unit = match.groups()
        if number is not None:
            numbers.append(float(number))
            units.append(None)
        if unit and (not units or units[-1] is not None):
            raise ValueError(f"has {unit!r} where a number is expected")
        if unit:
            units[-1] = _unit(unit)
    if not units or units[-1] is None:
        raise ValueError("has no unit at its end")
    for i in reversed(range(len(units))):
        units[i] = units[i] or units[i + 1]
    return [u.Quantity(*pair) for pair in zip(numbers, units, strict=True)]


def _unit(text):
    import astropy.units as u

    try:
        return u.Unit(text)
    except (ValueError, TypeError):
        raise ValueError(f"has the unknown unit {text!r}") from None


def to_cosmology(text):
    """
    A cosmology from its name or its parameters.

    Parameters
    ----------
    text : str
        Name of a realization of `astropy.cosmology`, such as ``Planck18``,
        or parameters in km/s/Mpc and as fractions, ``H0=71, Om0=0.27`` for
        a flat universe and with ``Ode0`` for any.

    Returns
    -------
    `~astropy.cosmology.FLRW`

    Raises
    ------
    ValueError
        If it is neither.

    Examples
    --------
    >>> from astro_scc.config import to_cosmology
    >>> to_cosmology("H0=71, Om0=0.27").H0
    <Quantity 71. km / (Mpc s)>
    """
    from astropy.cosmology import FlatLambdaCDM, LambdaCDM, realizations

    name = text.strip()
    if name in realizations.available:
        return getattr(realizations, name)
    matches = [_PARAMETER.fullmatch(part) for part in name.split(",")]
    if all(matches):
        values = {m.group(1): float(m.group(2)) for m in matches}
        if len(values) == len(matches) and values.get("H0", 0) > 0:
            if set(values) == {"H0", "Om0"}:
                return FlatLambdaCDM(**values)
            if set(values) == {"H0", "Om0", "Ode0"}:
                return LambdaCDM(**values)
    raise ValueError(
        "is no cosmology; give H0=71,Om0=0.27 (and Ode0 unless it is flat) or one of "
        f"{', '.join(sorted(realizations.available))}"
    )


def to_time(text):
    """
    A date from text.

    Parameters
    ----------
    text : str
        As 2011-01-01, with or without a time of day, or a year with
        decimals, 2011.5.

    Returns
    -------
    `~astropy.time.Time`

    Raises
    ------
    ValueError
        If it is none.

    Examples
    --------
    >>> from astro_scc.config import to_time
    >>> to_time("2011.5").iso
    '2011-07-02 21:00:00.000'
    """
    from astropy.time import Time

    try:
        if re.fullmatch(r"\d{4}(\.\d*)?", text.strip()):
            return Time(float(text), format="jyear", scale="utc")
        return Time(text.strip(), scale="utc")
    except ValueError:
        raise ValueError("is no date such as 2011-01-01") from None


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
    if not abs(number) < float("inf"):
        raise ValueError("must be a finite number")
    return number


def _positive(value):
    number = _number(value)
    if not number > 0:
        raise ValueError("must be above 0")
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
    match = re.fullmatch(rf"\s*({_NUMBER})\s*(\D.*?)\s*", value)
    if match is None:
        raise ValueError(wanted)
    unit = _unit(match.group(2))
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
    if value == "radial":
        return value
    example = "65 deg"
    return _quantity(value, "radial or an angle", example, positive=False)


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


def _scales(value):
    import astropy.units as u

    wanted = "must be scale numbers such as 1,2,3 or angles such as '0.2,0.4 mas'"
    if isinstance(value, str):
        value = [word for word in re.split(r"[\s,]+", value.strip()) if word]
    elif not isinstance(value, list | tuple):
        value = [value]
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


_PARSERS = {
    "epochs": _paths,
    "after": _date,
    "before": _date,
    "align": _text,
    "common_beam": _boolean,
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
    "min_z_score": _number,
    "small_displacement_correction": _boolean,
    "n_trials": _integer(2, 10**9),
    "seed": _integer(0, _LARGEST_SEED),
    "redshift": _positive,
    "cosmology": _cosmology,
    "distance": _distance,
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
    return _PARSERS[name](value)


def read_config(path):
    """
    Read the settings of a measurement.

    Parameters
    ----------
    path : path
        A TOML file.  Its table ``versions``, which says what wrote it, is
        returned as it is.

    Returns
    -------
    settings : dict
        Those that the file has, see `parse_setting`.
    versions : dict of str

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is no TOML, or a key or a value in it makes no sense.

    Examples
    --------
    >>> from pathlib import Path
    >>> from astro_scc.config import read_config
    >>> _ = Path("jet.toml").write_text('epochs = ["jet/*.fits"]\\nn_trials = 500\\n')
    >>> read_config("jet.toml")
    ({'epochs': ['jet/*.fits'], 'n_trials': 500}, {})
    """
    path = Path(path)
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is not a TOML file: {error}") from None
    versions = values.pop("versions", {})
    if not isinstance(versions, dict):
        raise ValueError(f"{path}: versions must be a table")
    settings = {}
    for name, value in values.items():
        if name not in _PARSERS:
            raise ValueError(
                f"{path}: unknown key {name!r}{_nearest(name)}; "
                "see astro-scc measure --help"
            )
        try:
            settings[name] = parse_setting(name, value)
        except ValueError as error:
            raise ValueError(f"{path}: {name} = {value!r} {error}") from None
    return settings, versions


def _nearest(name):
    from difflib import get_close_matches

    near = get_close_matches(name.replace("-", "_"), _PARSERS, 1)
    return f", did you mean {near[0]}?" if near else ""


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
    unknown = set(settings) - set(_PARSERS)
    if unknown:
        raise KeyError(f"unknown settings {', '.join(sorted(unknown))}")
    return {
        name: _plain(settings[name])
        for name in _PARSERS
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


def format_config(settings, *, versions=None, remarks=()):
    """
    Settings as the text of a TOML file.

    Parameters
    ----------
    settings : dict
        See `plain_settings`.
    versions : dict of str, optional
    remarks : sequence of str, optional
        Comments for the head of the file.

    Returns
    -------
    str

    Examples
    --------
    >>> from astro_scc.config import format_config
    >>> print(format_config({"n_trials": 500}, remarks=["A try."]))
    # A try.
    <BLANKLINE>
    n_trials = 500
    <BLANKLINE>
    """
    import tomli_w

    plain = plain_settings(settings)
    if versions:
        plain["versions"] = dict(versions)
    head = "".join(f"# {line}\n" for line in remarks)
    return head + "\n" * bool(head) + tomli_w.dumps(plain)
