# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Quantities and dates as people write them."""

import re
import warnings

__all__ = [
    "NUMBER",
    "named",
    "one_quantity",
    "parse_quantities",
    "parse_unit",
    "shortened",
    "to_quantity",
    "to_time",
]

#: Regular expression of a number.
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"


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
    >>> from astro_scc.quantities import parse_quantities
    >>> parse_quantities("1.0 mas 0.5 mas -7 deg")
    [<Quantity 1. mas>, <Quantity 0.5 mas>, <Quantity -7. deg>]
    >>> parse_quantities("0.5, 1.5 mas / yr")
    [<Quantity 0.5 mas / yr>, <Quantity 1.5 mas / yr>]
    """
    import astropy.units as u

    numbers, units = [], []
    # Of printed pages, where minus is a letter of its own.
    text = text.replace("\N{MINUS SIGN}", "-")
    for word in re.findall(r"[^\s,]+", text):
        number, unit = re.fullmatch(rf"({NUMBER})?(.*)", word).groups()
        if number is not None:
            numbers.append(float(number))
            units.append(unit)
        elif not units:
            raise ValueError(f"has {unit!r} where a number is expected")
        else:
            # A unit may have blanks in it.
            units[-1] = f"{units[-1]} {unit}".strip()
    if not units or not units[-1]:
        raise ValueError("has no unit at its end")
    for i in reversed(range(len(units))):
        units[i] = parse_unit(units[i]) if units[i] else units[i + 1]
    return [u.Quantity(*pair) for pair in zip(numbers, units, strict=True)]


def to_quantity(value, unit, wanted):
    """
    Return a quantity that is given as one, or as text.

    Parameters
    ----------
    value : str, list of str or `~astropy.units.Quantity`
        Text of several quantities gives an array, text of one a scalar.
        `~astropy.units.Quantity` itself reads "1 7 Mpc" as 1 x 7 Mpc.
    unit : unit-like
        Of the kind that it must have; it keeps its own.
    wanted : str
        What it must be, for the message.

    Returns
    -------
    `~astropy.units.Quantity`

    Raises
    ------
    ValueError
        If it is no quantity, a `~astropy.units.UnitConversionError` if its
        unit is of another kind or missing.
    """
    import astropy.units as u
    import numpy as np
    from astropy.utils.masked import Masked

    if isinstance(value, list | tuple) and all(isinstance(v, str) for v in value):
        value, scalar = " ".join(value), False
    else:
        scalar = True
    if isinstance(value, str):
        try:
            found = parse_quantities(value)
        except ValueError as error:
            raise ValueError(f"{error}; it {wanted}") from None
        value = found[0] if scalar and len(found) == 1 else found
    try:
        found = u.Quantity(value, dtype=float)
        if np.ma.is_masked(value):
            # Of a column, which Quantity forgets.
            found = Masked(found, mask=value.mask)
    except (TypeError, ValueError):
        raise ValueError(wanted) from None
    if not found.unit.is_equivalent(unit):
        raise u.UnitConversionError(wanted)
    return found


def finite_quantities(value, unit, wanted):
    """Return finite quantities, at most a list of them, see `to_quantity`."""
    import numpy as np

    found = to_quantity(value, unit, wanted)
    if found.size == 0 or found.ndim > 1 or not np.all(np.isfinite(found)):
        raise ValueError(wanted)
    return found


def parse_unit(text):
    """
    A unit from text.

    Parameters
    ----------
    text : str

    Returns
    -------
    `~astropy.units.UnitBase`

    Raises
    ------
    ValueError
        If it is none.
    """
    import astropy.units as u

    try:
        return u.Unit(text)
    except (ValueError, TypeError):
        raise ValueError(f"has the unknown unit {text!r}") from None


def one_quantity(value, kind, example, positive=True):
    """
    Return one finite quantity, see `to_quantity`.

    Parameters
    ----------
    value : str or `~astropy.units.Quantity`
    kind, example : str
        For the message, "an angle" and "2 mas", whose unit is of the kind
        that it must have.
    positive : bool, optional
        Whether it must be above 0.

    Returns
    -------
    `~astropy.units.Quantity`

    Raises
    ------
    ValueError
        If it is none.
    """
    import astropy.units as u

    wanted = f"must be {kind} with a unit, such as {example!r}"
    found = to_quantity(value, u.Quantity(example).unit, wanted)
    if not found.isscalar:
        raise ValueError(wanted)
    if not (0 if positive else float("-inf")) < found.value < float("inf"):
        raise ValueError(f"must be finite{' and above 0' * positive}")
    return found


def named(name, parse, value, *more):
    """
    Return what a parser makes of an argument, or name the argument.

    Parameters
    ----------
    name : str
    parse : callable
        Takes the value and ``more``; raises a ValueError that goes on after
        the value.
    value : object
    *more
        Of ``parse``.

    Returns
    -------
    object

    Raises
    ------
    ValueError
        Of the class that ``parse`` raised.
    """
    try:
        return parse(value, *more)
    except ValueError as error:
        # An option is named as it is typed.
        name = name if name.startswith("--") else f"{name} ="
        raise type(error)(f"{name} {shortened(value)} {error}") from None


def shortened(value):
    """
    Return a value as text that fits in a line.

    Parameters
    ----------
    value : object

    Returns
    -------
    str
    """
    text = str(value) if hasattr(value, "unit") else repr(value)
    text = " ".join(text.split())
    return text if len(text) < 80 else f"{text[:70]}..."


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
    >>> from astro_scc.quantities import to_time
    >>> to_time("2011.5").iso
    '2011-07-02 21:00:00.000'
    """
    from astropy.time import Time

    with warnings.catch_warnings(record=True) as dubious:
        # ERFA calls dates dubious for which leap seconds are unknown; in atomic
        # time they can be compared.
        warnings.simplefilter("always")
        try:
            if re.fullmatch(r"\d{4}(\.\d*)?", text.strip()):
                time = Time(float(text), format="jyear", scale="utc")
            else:
                time = Time(text.strip(), scale="utc")
        except ValueError:
            raise ValueError("is no date such as 2011-01-01") from None
        atomic = time.tai
    return atomic if dubious else time
