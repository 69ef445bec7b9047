# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Values of the cards of a header, or of a dict: units, and facts about an image."""

import re
import tomllib
import warnings
from contextlib import suppress
from functools import cache
from importlib import resources

import astropy.units as u
import numpy as np
from astropy.io import fits

#: Keywords and words of headers, and what they mean.
KEYWORDS = tomllib.loads(
    resources.files(__package__).joinpath("keywords.toml").read_text("utf-8")
)
#: The spellings in headers of units that astropy knows.
_UNITS = {word: unit for unit, words in KEYWORDS["units"].items() for word in words}
#: Units that are logarithms of brightness, as text.
_LOGARITHM = re.compile(r"(?<![a-z])(mag|mags|magnitudes?|dex|db|log|log10)(?![a-z])")


def get(header, *keywords, kind=None):
    """
    Return the value of the first of some keywords that has one, or None.

    Keys of a dict may be in upper or lower case.  Values that cannot be converted
    to ``kind`` (float or str), empty strings and numbers that are not finite count
    as absent.
    """
    for keyword in (key for name in keywords for key in (name, name.lower())):
        with suppress(KeyError, ValueError, fits.VerifyError):
            value = header[keyword]
            if value is None or isinstance(value, fits.card.Undefined):
                continue
            if kind is str:
                value = str(value).strip()
            elif kind is float:
                value = float(str(value).replace("D", "E"))
            if value if kind is str else kind is None or np.isfinite(value):
                return value
    return None


def axis_numbers(header, axis):
    """Return CRVAL (or None), CRPIX and CDELT (or their defaults) of an axis."""
    pixel = get(header, f"CRPIX{axis}", kind=float)
    value, step = (get(header, f"{k}{axis}", kind=float) for k in ("CRVAL", "CDELT"))
    return value, 1.0 if pixel is None else pixel, step or 0.0


def axis_of(header, name):
    """Return the number of the axis whose CTYPE starts with a name, None without."""
    for axis in range(1, 10):
        if (get(header, f"CTYPE{axis}", kind=str) or "").upper().startswith(name):
            return axis
    return None


def axis_value(header, name):
    """Return the world coordinate of the first pixel of a degenerate axis."""
    axis = axis_of(header, name)
    if axis is None:
        return None
    value, pixel, step = axis_numbers(header, axis)
    return None if value is None else value + (1 - pixel) * step


def header_facts(header):
    """
    Return the facts that tell whether images belong together.

    These are ``object``, ``telescope``, ``frequency`` (Hz), ``filter``, ``stokes``,
    ``wavelength``, ``band``, ``polarisation``, ``channel`` (on an axis of wavelengths
    or velocities) and ``type`` (of image), as far as the header has them.
    """
    facts = {
        fact: get(header, *row["keywords"], kind=float if fact == "frequency" else str)
        for fact, row in KEYWORDS["facts"].items()
    }
    if frequency := axis_value(header, "FREQ"):
        facts["frequency"] = frequency * _hertz(header)
    facts["filter"] = _filters(header, facts["filter"])
    if (stokes := axis_value(header, "STOKES")) is not None:
        facts["stokes"] = KEYWORDS["stokes"].get(str(round(stokes)))
    if facts["wavelength"] and not facts["wavelength"].endswith(("m", "A")):
        unit = get(header, "WAVEUNIT", kind=str) or ""
        # A power of ten stands for metres.
        unit = {"-9": "nm", "-10": "angstrom"}.get(unit, unit)
        value = get(header, *KEYWORDS["facts"]["wavelength"]["keywords"], kind=float)
        value = facts["wavelength"] if value is None else f"{value:g}"
        facts["wavelength"] = f"{value} {unit}".strip()
    for name in KEYWORDS["spectral"]["axes"]:
        if (value := axis_value(header, name)) is not None:
            unit = get(header, f"CUNIT{axis_of(header, name)}", kind=str) or ""
            facts["channel"] = f"{name} {value:.7g} {unit}".strip()
    return {key: value for key, value in facts.items() if value is not None}


def bandwidth(header):
    """Return the width of a frequency channel in Hz, None without one."""
    axis = axis_of(header, "FREQ")
    step = axis and get(header, f"CDELT{axis}", kind=float)
    return abs(step) * _hertz(header) if step else None


def _hertz(header):
    """Return the unit of the axis of frequencies in Hz."""
    text = get(header, f"CUNIT{axis_of(header, 'FREQ')}", kind=str) or ""
    # In whatever case it is written, M is mega.
    unit = parse_unit(text.upper())
    return unit.to(u.Hz) if unit is not None and unit.is_equivalent(u.Hz) else 1.0


def _filters(header, name):
    """Return the filters in the light path, of all wheels."""
    found = [] if name is None else [name]
    wheel = KEYWORDS["wheels"]
    for start in wheel["keywords"] if name is None else ():
        wheels = (get(header, start + k, kind=str) or "CLEAR" for k in wheel["numbers"])
        found = found or [w for w in wheels if not w.upper().startswith("CLEAR")]
    # JWST has narrow filters in the wheel of the pupil.
    pupil = get(header, "PUPIL", kind=str) or "CLEAR"
    if name is not None and not pupil.upper().startswith(("CLEAR", "IMAGING")):
        found.append(pupil)
    return " + ".join(found) or None


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
        r"[A-Za-z]+", lambda word: _UNITS.get(word[0].lower(), word[0]), text
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
