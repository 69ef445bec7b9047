# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Numbers, units and lists as a reader expects them."""

import math

import astropy.units as u

__all__ = [
    "listed",
    "number_word",
    "plain_value",
    "plural",
    "row_text",
    "unit_text",
    "with_error",
]

NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


def with_error(value, error):
    """A value and its error, to two digits of the error."""
    if not math.isfinite(value):
        return "-"
    if not math.isfinite(error):
        return f"{value:.3g} \N{PLUS-MINUS SIGN} ?"
    if error <= 0:
        return f"{value:.3g}"
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{digits}f} \N{PLUS-MINUS SIGN} {error:.{digits}f}"


def plain_value(item):
    """A plain number, or text, of a cell."""
    item = getattr(item, "value", item)
    return item if isinstance(item, str) else float(item)


def row_text(row, name):
    """A number of a row with its error, of the columns ``name`` and ``name_err``."""
    return with_error(plain_value(row[name]), plain_value(row[f"{name}_err"]))


def unit_text(unit):
    """A unit without blanks; nothing for none."""
    return "" if unit is None else u.Unit(unit).to_string().replace(" / ", "/")


def number_word(n):
    """A small number as a word."""
    return NUMBERS[n] if n < len(NUMBERS) else str(n)


def plural(n, word):
    """A word for so many."""
    return word if n == 1 else f"{word}s"


def listed(words):
    """Words with commas, and an "and" before the last."""
    return ", ".join(words[:-1]) + " and " + words[-1] if len(words) > 1 else words[0]
