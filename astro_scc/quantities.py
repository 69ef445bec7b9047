# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Parsing and checks of values that users write: quantities, dates, numbers, text."""

import math
import operator
import re
import warnings
from datetime import datetime
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    import numpy as np

#: What `random_generator` makes a generator of.
Seed: TypeAlias = "np.random.Generator | int"

#: Number of the largest scale, far above that of any image.
LARGEST_SCALE = 20
_ISO = re.compile(
    r"(\d{4})(?:([-/. ])(\d{1,2}|[A-Z]{3})\2(\d{1,2})|(\d\d|[A-Z]{3})(\d\d))"
    r"(?:[T ]+([\d:.]+))?$"
)

#: Regular expression of a number.
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"


def parse_quantities(text):
    """
    Read several quantities from one text.

    Parameters
    ----------
    text : str
        Numbers with units, separated by blanks or commas.  A number without
        a unit takes the unit of the next number that has one.

    Returns
    -------
    list of `~astropy.units.Quantity`

    Raises
    ------
    ValueError
        If the text does not begin with a number, or a unit is missing or unknown.

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
    # Text copied from printed pages has minus signs instead of hyphens.
    text = text.replace("\N{MINUS SIGN}", "-")
    for word in re.findall(r"[^\s,]+", text):
        number, unit = re.fullmatch(rf"({NUMBER})?(.*)", word).groups()
        if number is not None:
            numbers.append(float(number))
            units.append(unit)
        elif not units:
            raise ValueError(f"has {unit!r} where a number is expected")
        else:
            # A unit may contain blanks.
            units[-1] = f"{units[-1]} {unit}".strip()
    if not units or not units[-1]:
        raise ValueError("has no unit at its end")
    for i in reversed(range(len(units))):
        try:
            units[i] = u.Unit(units[i]) if units[i] else units[i + 1]
        except (ValueError, TypeError):
            raise ValueError(f"has the unknown unit {units[i]!r}") from None
    return [u.Quantity(*pair) for pair in zip(numbers, units, strict=True)]


def to_quantity(value, unit, wanted):
    """
    Return a quantity that is given as a quantity or as text.

    Parameters
    ----------
    value : str, list of str or `~astropy.units.Quantity`
        Text of several quantities gives an array, text of one a scalar.
        `~astropy.units.Quantity` itself reads "1 7 Mpc" as 1 x 7 Mpc.
    unit : unit-like
        A unit of the required kind.  The result keeps its own unit.
    wanted : str
        What the value must be, for the error message.

    Returns
    -------
    `~astropy.units.Quantity`

    Raises
    ------
    ValueError
        If the value is not a quantity; a `~astropy.units.UnitConversionError`
        if its unit is of another kind or missing.
    """
    import astropy.units as u
    import numpy as np
    from astropy.utils.masked import Masked

    scalar = not isinstance(value, list | tuple)
    if not scalar and all(isinstance(v, str) for v in value):
        value = " ".join(value)
    if isinstance(value, str):
        try:
            found = parse_quantities(value)
        except ValueError as error:
            raise ValueError(f"{error}; it {wanted}") from None
        value = found[0] if scalar and len(found) == 1 else found
    try:
        found = u.Quantity(value, dtype=float)
        if np.ma.is_masked(value):
            # Quantity drops the mask of a column.
            found = Masked(found, mask=value.mask)
    except (TypeError, ValueError):
        raise ValueError(wanted) from None
    if not found.unit.is_equivalent(unit):
        raise u.UnitConversionError(wanted)
    return found


def finite_quantities(value, unit, wanted):
    """Return a finite quantity, or a list of them as an array, see `to_quantity`."""
    import numpy as np

    found = to_quantity(value, unit, wanted)
    if found.size == 0 or found.ndim > 1 or not np.all(np.isfinite(found)):
        raise ValueError(wanted)
    return found


def one_quantity(value, kind, example, positive=True):
    """
    Return one finite quantity, above 0 if ``positive``, see `to_quantity`.

    ``kind`` and ``example`` are for the error message, such as "an angle" and "2 mas";
    the unit of the example is of the required kind.
    """
    wanted = f"must be {kind} with a unit, such as {example!r}"
    found = to_quantity(value, example.split()[-1], wanted)
    if not found.isscalar:
        raise ValueError(wanted)
    if not (0 if positive else -math.inf) < found.value < math.inf:
        raise ValueError(f"must be finite{' and above 0' * positive}")
    return found


def named(name, parse, value, *more):
    """
    Parse an argument by a function of its value and ``more``; errors name the argument.

    The message of the ValueError of ``parse`` is put after the name and the value.
    """
    try:
        return parse(value, *more)
    except ValueError as error:
        # A command-line option is named as it is typed.
        name = name if name.startswith("--") else f"{name} ="
        # The value must fit on the line.
        text = str(value) if hasattr(value, "unit") else repr(value)
        text = " ".join(text.split())
        text = text if len(text) < 80 else f"{text[:70]}..."
        raise type(error)(f"{name} {text} {error}") from None


def parse_date(text, scale="utc"):
    """
    Return the Time of a date in a header, a table or an option.

    The date may be ``2006-03-09``, with a time of day of any precision and a
    trailing ``Z``, ``2006/03/09``, ``2006_03_09``, ``20060309``, ``2006 Mar 09``,
    the old ``21/03/95`` (day, month, year), or a decimal year, ``2006.185``.

    Parameters
    ----------
    text : str
    scale : str, optional
        Time scale.

    Returns
    -------
    `~astropy.time.Time`

    Raises
    ------
    ValueError
        If the text is not a date.
    """
    from astropy.time import Time

    plain = re.sub(r"(Z|\+00:?00| ?UTC?)$", "", str(text).strip().upper())
    plain, clock = plain.strip().replace("_", "-"), None
    # ERFA warns of years whose leap seconds are unknown.
    with warnings.catch_warnings(action="ignore"):
        try:
            if re.match(r"\d{4}\.(\d{2,3}|\d{5,})$", plain):
                time = Time(float(plain), format="decimalyear", scale=scale)
                return Time(time, format="isot")
            if match := re.match(r"(\d{1,2})/(\d{1,2})/(\d{2}|\d{4})$", plain):
                day, month, year = match.groups()
                if len(year) == 2:
                    # Digital images are of 1950 to 2049.
                    year = f"{20 if int(year) < 50 else 19}{year}"
            elif match := _ISO.match(plain):
                year, _, *parts, clock = match.groups()
                month, day = filter(None, parts)
                if month.isalpha():
                    month = datetime.strptime(month, "%b").month
                if clock and ":" not in clock:
                    clock += ":00"
            else:
                raise ValueError
            # A day may end at 24:00, the midnight of the next.
            ends = re.fullmatch(r"24(:00)+(\.0*)?", clock or "")
            clock = "00:00:00" if ends or not clock else clock
            iso = f"{year}-{int(month):02d}-{int(day):02d}T{clock}"
            time = Time(iso, format="isot", scale=scale)
            if ends:
                time = Time(time.jd1 + 1, time.jd2, format="jd", scale=scale)
            return Time(time, format="isot")
        except ValueError:
            raise ValueError(f"{text!r} is no date; write it as 2006-03-09") from None


def without_doubt(times):
    """Return dates, in atomic time if leap seconds are unknown, as every use warns."""
    with warnings.catch_warnings(record=True, action="always") as dubious:
        atomic = times.tai
    return atomic if dubious else times


def to_time(text):
    """
    Return the date that a text gives.

    Parameters
    ----------
    text : str
        Such as 2011-01-01, with or without a time of day, or in any form of
        `parse_date`; or a Julian year, 2011.5.

    Returns
    -------
    `~astropy.time.Time`

    Raises
    ------
    ValueError
        If the text is not a date.

    Examples
    --------
    >>> from astro_scc.quantities import to_time
    >>> to_time("2011.5").iso
    '2011-07-02 21:00:00.000'
    """
    from astropy.time import Time

    if re.fullmatch(r"\d{4}(\.\d*)?", text.strip()):
        with warnings.catch_warnings(action="ignore"):
            return without_doubt(Time(float(text), format="jyear", scale="utc"))
    try:
        return without_doubt(parse_date(text))
    except ValueError:
        raise ValueError("is no date such as 2011-01-01") from None


def with_error(value, error, sign="\N{PLUS-MINUS SIGN}"):
    """Return a value and its error as text, the error to two significant digits."""
    if not math.isfinite(value):
        return "-"
    if not math.isfinite(error):
        return f"{value:.3g} (error unknown)"
    if error <= 0:
        return f"{value:.3g}"
    digits = decimals(error)
    return f"{value:.{digits}f} {sign} {error:.{digits}f}"


def decimals(error):
    """Return the decimals that show a positive error to two significant digits."""
    return max(0, 1 - math.floor(math.log10(float(f"{error:.1e}"))))


# -- checks of values ------------------------------------------------------------
#
# Each function takes a value from a TOML file, the command line or Python and returns
# it, or raises a ValueError whose message continues "NAME = VALUE ...".


def check_text(value):
    """Return text that is not empty."""
    if not isinstance(value, str) or not value.strip():
        raise ValueError("must be text")
    return value


def check_paths(value):
    """Return paths as a list."""
    items = [value] if isinstance(value, str) else value
    if not isinstance(items, list | tuple) or not items:
        raise ValueError("must be a list of files")
    return [check_text(item) for item in items]


def check_boolean(value):
    """Return a boolean."""
    # numpy's booleans are of another class.
    if type(value).__name__ not in ("bool", "bool_"):
        raise ValueError("must be true or false")
    return bool(value)


def _converted(value, convert, kind):
    try:
        # Booleans do not count as numbers.
        return convert(None if isinstance(value, bool) else value)
    except OverflowError:
        return math.inf
    except (TypeError, ValueError):
        raise ValueError(f"must be a {kind}") from None


def check_number(value, low=-math.inf, high=math.inf, wanted=""):
    """Return a finite number between two limits, which are not allowed themselves."""
    number = _converted(value, float, "number")
    if not math.isfinite(number):
        raise ValueError("must be a finite number")
    if not low < number < high:
        raise ValueError(wanted)
    return number


def check_integer(value, least, most=math.inf):
    """Return a whole number in a range, limits included."""
    convert = int if isinstance(value, str) else operator.index
    number = _converted(value, convert, "whole number")
    if not least <= number <= most:
        limit = "or more" if most == math.inf else f"to {most}"
        raise ValueError(f"must be {least} {limit}")
    return number


def check_choice(value, *choices):
    """Return a word that is one of ``choices``."""
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"must be one of {', '.join(choices)}")
    return value


def seeded(rng):
    """Return a generator, of a random seed for None, and its seed if it is known."""
    import numpy as np

    if rng is None:
        rng = int(np.random.SeedSequence().entropy % 2**63)
    seed = int(rng) if isinstance(rng, int | np.integer) else None
    return random_generator(rng), seed


def random_generator(rng):
    """
    Return the `~numpy.random.Generator` of a seed, a generator or None.

    Parameters
    ----------
    rng : int, `~numpy.random.Generator`, `~numpy.random.RandomState` or None

    Returns
    -------
    `~numpy.random.Generator`

    Raises
    ------
    ValueError
        If numpy makes no generator of it.

    Examples
    --------
    >>> from astro_scc.quantities import random_generator
    >>> int(random_generator(1).integers(100))
    47
    """
    import numpy as np

    if isinstance(rng, np.random.RandomState):
        # Generators of the older kind have the same source of bits.
        rng = rng._bit_generator
    try:
        return np.random.default_rng(rng)
    except (TypeError, ValueError):
        what = f"rng must be a seed of 0 or more, or a numpy Generator, got {rng!r}"
        raise ValueError(what) from None


#: Estimates of the noise of wavelet planes.
NOISES = ("plane", "local", "propagated")


def check_range(
    value, wanted, example, least=-math.inf, ordered=operator.lt, number=2
):  # fmt: skip
    """Return quantities in increasing order, ``number`` of them or, for None, any."""
    wanted = f"must be {wanted}, such as {example!r}"
    found = finite_quantities(value, example.split()[-1], wanted).reshape(-1)
    in_order = all(map(ordered, found.value[:-1], found.value[1:]))
    if len(found) != (number or len(found)) or found.value[0] < least or not in_order:
        raise ValueError(wanted)
    return found


def check_position_angle(value):
    """Return an angle of 0 to 360 deg, a frame or the name of a frame."""
    # A frame of astro_scc.kinematics checks itself.
    if hasattr(value, "matrix") or (
        isinstance(value, str) and value in ("radial", "ridge", "fit", "any")
    ):
        return value
    unit = str(getattr(value, "unit", value))
    if re.search(r"(?<![a-z])(?:[mu]?as|arc(?:sec|min))\s*$", unit):
        raise ValueError("must be in degrees or radians, such as '65 deg'")
    import astropy.units as u

    what = "radial, ridge, fit, any or an angle"
    return one_quantity(value, what, "65 deg", False) % (360 * u.deg)


def check_alignment_error(value):
    """Return one error per epoch, or one for all epochs."""
    wanted = "must be an angle or a list of them, such as '0.02 mas'"
    errors = finite_quantities(value, "mas", wanted)
    if not (errors >= 0).all():
        raise ValueError("must be 0 or above")
    return errors


def check_scales(value):
    """Return scales as numbers or as angles."""
    wanted = "must be scale numbers such as 1,2,3 or angles such as '0.2,0.4 mas'"
    items = re.findall(r"[^\s,]+", value) if isinstance(value, str) else value
    try:
        items = items if hasattr(items, "__len__") else [items]
        numbers = tuple(check_number(item) for item in items)
    except (TypeError, ValueError):
        angles = finite_quantities(value, "mas", wanted).reshape(-1)
        if not (angles > 0).all():
            raise ValueError("must be above 0") from None
        return angles
    if not numbers:
        raise ValueError(wanted)
    if len(set(numbers)) < len(numbers):
        raise ValueError("must differ: leave out what is there twice")
    if not all(0 <= j <= LARGEST_SCALE and j % 0.5 == 0 for j in numbers):
        series = f"must be of the series 0, 0.5, 1, 1.5, ..., {LARGEST_SCALE}"
        raise ValueError(f"{series}: scale j is 2^j pixels")
    return numbers


def check_scale_groups(value):
    """Return groups of scales by their names, of text "1,2; 3,4" or a mapping."""
    wanted = "must be two groups of scales or more, such as '1,2; 3,4'"
    if isinstance(value, str):
        texts = [text.strip() for text in value.split(";")]
        value = {", ".join(re.findall(r"[^\s,]+", text)): text for text in texts}
    if not hasattr(value, "items") or len(value) < 2 or not all(value):
        raise ValueError(wanted)
    return {str(name): check_scales(scales) for name, scales in value.items()}


def check_date(value):
    """Return a date as text."""
    # TOML has a type for dates.
    text = value.isoformat() if hasattr(value, "isoformat") else str(value)
    to_time(text)
    return text.strip()
