# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Units of brightness as headers write them."""

import re
import warnings
from contextlib import suppress
from functools import cache

import astropy.units as u

#: Spellings of units in headers, and the unit that astropy knows.
_UNIT_WORDS = {
    **{name.lower(): name for name in "Jy mJy uJy beam pix ct electron DN K s".split()},
    **dict.fromkeys(("jansky", "janskys"), "Jy"),
    **dict.fromkeys(("pixel", "pixels"), "pix"),
    **dict.fromkeys(("count", "counts", "cts"), "ct"),
    **dict.fromkeys(("second", "seconds", "sec"), "s"),
    **{"bm": "beam", "electrons": "electron", "photons": "ph", "kelvin": "K"},
    **{name: name for name in ("adu", "sr", "arcsec")} | {"degrees": "deg"},
}
#: Units that are logarithms of brightness, as text.
_LOGARITHM = re.compile(r"(?<![a-z])(mag|mags|magnitudes?|dex|db|log|log10)(?![a-z])")


def parse_unit(text):
    """
    Return the unit in a FITS header, such as ``JY/BEAM``.

    It is dimensionless for no text, and None for a text that is not understood.
    """
    if text is None or isinstance(text, u.UnitBase):
        return text or u.dimensionless_unscaled
    text = re.sub(r"\s+per\s+", "/", str(text).strip(), flags=re.IGNORECASE)
    if text.upper() == "MJY/SR":
        return u.MJy / u.sr
    if text == text.upper() and "MJY" in text:
        # In upper case M may be milli or mega.
        return None
    words = re.sub(
        r"[A-Za-z]+", lambda word: _UNIT_WORDS.get(word[0].lower(), word[0]), text
    )
    return _unit(text) or _unit(words)


@cache
def _unit(text):
    # For a text that is no unit astropy looks for similar ones, which takes long.
    with warnings.catch_warnings(action="ignore"), suppress(TypeError, ValueError):
        unit = u.Unit(text)
        # A comma makes a structured unit, which no image has.
        return unit if isinstance(unit, u.UnitBase) else None
    return None


def logarithm(unit):
    """
    Return why a unit, or the text of one, is a logarithm of brightness, or "".

    Sources in such an image do not add up, and cannot be correlated.
    """
    if unit is None or not _LOGARITHM.search(str(unit).lower()):
        return ""
    return (
        f"its unit is {unit}, a logarithm of brightness, in which sources do not add "
        "up; convert it to flux"
    )
