# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Quantities, cosmologies and dates as people write them."""

import re
import warnings

__all__ = ["NUMBER", "parse_quantities", "parse_unit", "to_cosmology", "to_time"]

#: Regular expression of a number.
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_PARAMETER = re.compile(rf"\s*(\w+)\s*=\s*({NUMBER})\s*")


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
        match = re.fullmatch(rf"({NUMBER})?(.*)", word)
        number, unit = match.groups()
        if number is not None:
            numbers.append(float(number))
            units.append(None)
        if unit and (not units or units[-1] is not None):
            raise ValueError(f"has {unit!r} where a number is expected")
        if unit:
            units[-1] = parse_unit(unit)
    if not units or units[-1] is None:
        raise ValueError("has no unit at its end")
    for i in reversed(range(len(units))):
        units[i] = units[i] or units[i + 1]
    return [u.Quantity(*pair) for pair in zip(numbers, units, strict=True)]


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
