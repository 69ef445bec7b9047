# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Single values of FITS headers: numbers, dates and units as people write them."""

import re
import warnings

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.time import Time

__all__ = ["get", "parse_date", "parse_unit"]

_ISO = re.compile(r"(\d{4})[-/.]?(\d{1,2})[-/.]?(\d{1,2})(?:[T ]+([\d:.]+))?$")
_OLD = re.compile(r"(\d{1,2})/(\d{1,2})/(\d{2}|\d{4})$")
# Headers of digital images with two-digit years below this are of 20xx.
_CENTURY = 50
_UNIT_WORDS = {
    "jy": "Jy",
    "jansky": "Jy",
    "janskys": "Jy",
    "mjy": "mJy",
    "ujy": "uJy",
    "beam": "beam",
    "bm": "beam",
    "pixel": "pix",
    "pixels": "pix",
    "pix": "pix",
    "count": "ct",
    "counts": "ct",
    "cts": "ct",
    "electron": "electron",
    "electrons": "electron",
    "photons": "ph",
    "dn": "DN",
    "adu": "adu",
    "kelvin": "K",
    "k": "K",
    "second": "s",
    "seconds": "s",
    "sec": "s",
    "s": "s",
    "sr": "sr",
    "arcsec": "arcsec",
}


def get(header, *keywords, kind=None):
    """
    The first of some keywords that has a value.

    Parameters
    ----------
    header : `~astropy.io.fits.Header` or dict
        Keys of a dict are taken in upper or lower case.
    *keywords : str
    kind : {float, str}, optional
        Values that cannot be turned into it count as absent, and so do
        empty strings and numbers that are not finite.

    Returns
    -------
    value or None
    """
    for keyword in keywords:
        for key in (keyword, keyword.lower()):
            try:
                value = header[key]
            except (KeyError, fits.VerifyError):
                continue
            if value is None or isinstance(value, fits.card.Undefined):
                continue
            if kind is float:
                try:
                    value = float(str(value).replace("D", "E"))
                except ValueError:
                    continue
                if not np.isfinite(value):
                    continue
            elif kind is str:
                value = str(value).strip()
                if not value:
                    continue
            return value
    return None


def parse_date(text, scale="utc"):
    """
    A date as FITS headers write it.

    Understood are ``2006-03-09``, with a time of day of any precision and a
    trailing ``Z``, ``2006/03/09``, ``20060309`` and the old ``21/03/95``
    (day, month, year).

    Parameters
    ----------
    text : str
    scale : str
        Time scale.

    Returns
    -------
    `~astropy.time.Time`

    Raises
    ------
    ValueError
        If the text is no date.

    Examples
    --------
    >>> from astro_scc.epochs.keywords import parse_date
    >>> parse_date("21/03/95").isot
    '1995-03-21T00:00:00.000'
    """
    stripped = re.sub(r"(Z|\+00:?00| ?UTC?)$", "", str(text).strip().upper()).strip()
    if match := _OLD.match(stripped):
        day, month, year = (int(part) for part in match.groups())
        if year < 100:
            year += 2000 if year < _CENTURY else 1900
        clock = None
    elif match := _ISO.match(stripped):
        year, month, day = (int(part) for part in match.groups()[:3])
        clock = match.group(4)
        if clock and ":" not in clock:
            clock += ":00"
    else:
        raise ValueError(f"{text!r} is no date; write it as 2006-03-09")
    try:
        with warnings.catch_warnings():
            # ERFA calls dates dubious for which leap seconds are unknown.
            warnings.simplefilter("ignore")
            return Time(
                f"{year:04d}-{month:02d}-{day:02d}T{clock or '00:00:00'}",
                format="isot",
                scale=scale,
            )
    except ValueError:
        raise ValueError(f"{text!r} is no date; write it as 2006-03-09") from None


def parse_unit(text):
    """
    A unit as FITS headers write it.

    Besides what astropy reads: ``JY/BEAM``, ``JY/PIXEL``,
    ``counts / pixel`` and such.

    Parameters
    ----------
    text : str or None

    Returns
    -------
    `~astropy.units.Unit` or None
        Dimensionless for no text, None for one that is not understood.

    Examples
    --------
    >>> from astro_scc.epochs.keywords import parse_unit
    >>> parse_unit("JY/BEAM")
    Unit("Jy / beam")
    """
    if text is None or isinstance(text, u.UnitBase):
        return text or u.dimensionless_unscaled
    text = str(text).strip()
    upper = re.sub(r"\s+PER\s+", "/", text.upper())
    # Upper case has lost whether M was milli or mega.
    ambiguous = text == text.upper() and "MJY" in upper
    if upper == "MJY/SR":
        return u.MJy / u.sr
    words = re.sub(
        r"[A-Za-z]+",
        lambda word: _UNIT_WORDS.get(word.group().lower(), word.group()),
        re.sub(r"\s+per\s+", "/", text, flags=re.IGNORECASE),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for candidate in (text, words):
            try:
                return None if ambiguous else u.Unit(candidate)
            except (TypeError, ValueError):
                continue
    return None
