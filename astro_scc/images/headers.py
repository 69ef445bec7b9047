# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The facts about an epoch in the header of its image, in one record."""

import re
import warnings
from contextlib import suppress
from functools import cache
from numbers import Integral

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.images.beam import Beam, as_beam
from astro_scc.quantities import parse_date

_DATES = ("DATE-OBS", "DATE_OBS", "DATE-BEG", "DATE-AVG")
_MJDS = ("MJD-OBS", "MJD-BEG", "MJD-AVG", "EXPSTART", "MJD")
_TIME_SCALES = {name.upper(): name for name in ("tai", "tt", "tdb", "tcb", "tcg")}
_TIME_SCALES |= {"IAT": "tai", "TDT": "tt", "ET": "tt"}
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
#: Keywords of the axes and the angle of a beam.
BEAM = "BMAJ", "BMIN", "BPA"
_NUMBER = r"([-+]?[\d.]+(?:[EeDd][-+]?\d+)?)"
_CLEAN_BEAM = re.compile(
    rf"CLEAN\s+BMAJ\s*=\s*{_NUMBER}\s+BMIN\s*=\s*{_NUMBER}\s+BPA\s*=\s*{_NUMBER}"
)
_STOKES = {1: "I", 2: "Q", 3: "U", 4: "V", -1: "RR", -2: "LL", -5: "XX", -6: "YY"}
#: Facts about an image, and their keywords; the first one is written.
FACTS = {
    "object": ("OBJECT", "TARGNAME"),
    "telescope": ("TELESCOP",),
    "frequency": ("FREQ", "FREQUENCY", "OBSFREQ", "RESTFRQ", "RESTFREQ"),
    "filter": ("FILTER",),
    "stokes": ("STOKES",),
}
_WCS_NUMBER = re.compile(r"((CRPIX|CRVAL|CDELT|CROTA)\d+|(PC|CD)\d+_\d+)$")
_SIP = re.compile(r"[AB]P?_(ORDER|DMAX|\d+_\d+)$")
_CELESTIAL = re.compile(r"((RA|[A-Z]LON|[A-Z]{2}LN)|DEC|[A-Z]LAT|[A-Z]{2}LT)(-|$)")


class ContentError(ValueError):
    """The file is FITS, but its image cannot be used."""


def read_header(header, tables=()):
    """
    Return what a FITS header or a dict tells about an image, by the fields of `Plane`.

    ``time`` (UTC) and ``beam`` are None if the header has none, or if they cannot be
    read; then ``date_problem`` and ``beam_problem`` say why.  ``facts`` are those of
    `header_facts`.

    The date is taken from ``DATE-OBS`` (with ``TIME-OBS`` if that has the time of
    day), or from ``DATE-BEG``, ``DATE-AVG``, ``MJD-OBS`` or ``EXPSTART``, but never
    from ``DATE``, the date at which a file was written.  The beam is taken from
    ``BMAJ``, ``BMIN`` and ``BPA`` (degrees), else from an ``AIPS CG`` or ``BEAMS``
    table among ``tables``, else from the last ``CLEAN BMAJ=`` in the history.
    """
    found = {"time": None, "beam": None, "facts": header_facts(header)}
    try:
        found["time"] = _observing_time(header)
    except ValueError as error:
        found["date_problem"] = str(error)
    try:
        found["beam"] = _header_beam(header, tables)
    except (KeyError, TypeError, ValueError) as error:
        found["beam_problem"] = str(error)
    return found


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


def first_line(error):
    """Return the first line of an error's message."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def some(names, most=3):
    """Return the first of many names as text, with the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


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


def _observing_time(header):
    system = (get(header, "TIMESYS", kind=str) or "UTC").upper()
    scale = _TIME_SCALES.get(system, "utc")
    problem = None
    for keyword in _DATES:
        value, text = get(header, keyword), get(header, keyword, kind=str)
        if isinstance(value, Time):
            return value
        if text is None:
            continue
        clock = get(header, "TIME-OBS", kind=str) or ""
        if keyword == "DATE-OBS" and ":" in clock and ":" not in text:
            text = f"{text}T{clock}"
        try:
            return _in_utc(parse_date(text, scale))
        except ValueError as error:
            problem = problem or f"{keyword}: {error}"
    for keyword in _MJDS:
        if (day := get(header, keyword, kind=float) or 0) > 0:
            return _in_utc(Time(day, format="mjd", scale=scale))
    if problem:
        raise ValueError(problem)
    return None


def _in_utc(time):
    with warnings.catch_warnings(action="ignore"):
        return Time(time.utc, format="isot")


def _header_beam(header, tables):
    beam = get(header, "BEAM")
    if hasattr(beam, "major"):
        return as_beam(beam)
    major, minor, pa = (get(header, keyword, kind=float) for keyword in BEAM)
    if major:
        if pa is None and minor not in (None, major):
            raise ValueError("BPA is missing or no number, and BMAJ and BMIN differ")
        return _beam(major, major if minor is None else minor, pa or 0.0)
    for table in tables:
        if table.name.upper() in ("AIPS CG", "BEAMS") and len(table.data):
            return _beam(*(_of_table(table, name) for name in BEAM))
    # Of a header, str would break the lines.
    lines = header.get("HISTORY") or header.get("history") or ()
    lines = lines if isinstance(lines, str) else "; ".join(map(str, lines))
    found = _CLEAN_BEAM.findall(lines.upper())
    numbers = [float(text.replace("D", "E")) for text in found[-1]] if found else [0]
    return _beam(*numbers) if numbers[0] > 0 else None


def _of_table(table, name):
    """Return an angle of the first row of a table, in degrees."""
    text = (table.columns[name].unit or "deg").strip().lower()
    unit = parse_unit(text) or parse_unit(text.rstrip("s")) or u.Unit(text)
    return (float(table.data[0][name]) * unit).to_value(u.deg)


def _beam(major, minor, pa):
    """Return the beam of three numbers in degrees, with the larger axis first."""
    if not (major > 0 and minor > 0):
        raise ValueError(f"the beam {major:g} x {minor:g} deg is not positive")
    if minor > major:
        major, minor, pa = minor, major, pa + 90
    return Beam(major * u.deg, minor * u.deg, pa * u.deg)


def header_facts(header):
    """
    Return the facts that tell whether images belong together.

    These are ``object``, ``telescope``, ``frequency`` (Hz), ``filter`` and
    ``stokes``, as far as the header has them.
    """
    facts = {
        fact: get(header, *keywords, kind=float if fact == "frequency" else str)
        for fact, keywords in FACTS.items()
    }
    facts["frequency"] = _axis_value(header, "FREQ") or facts["frequency"]
    if facts["filter"] is None:
        # Of HST's two filter wheels, those in the light path.
        for name in ("FILTER", "FILTNAM"):
            wheels = (get(header, f"{name}{k}", kind=str) or "CLEAR" for k in (1, 2))
            found = [wheel for wheel in wheels if not wheel.startswith("CLEAR")]
            facts["filter"] = facts["filter"] or " + ".join(found) or None
    if (stokes := _axis_value(header, "STOKES")) is not None:
        facts["stokes"] = _STOKES.get(round(stokes))
    return {key: value for key, value in facts.items() if value is not None}


def axis_numbers(header, axis):
    """Return CRVAL (or None), CRPIX and CDELT (or their defaults) of an axis."""
    pixel = get(header, f"CRPIX{axis}", kind=float)
    return (
        get(header, f"CRVAL{axis}", kind=float),
        1.0 if pixel is None else pixel,
        get(header, f"CDELT{axis}", kind=float) or 0.0,
    )


def _axis_value(header, name):
    """Return the world coordinate of the first pixel of a degenerate axis."""
    for axis in range(1, 10):
        if (get(header, f"CTYPE{axis}", kind=str) or "").upper().startswith(name):
            value, pixel, step = axis_numbers(header, axis)
            return None if value is None else value + (1 - pixel) * step
    return None


def celestial_wcs(header, fobj=None):
    """
    Return the celestial axes of a FITS header as a two-dimensional WCS.

    Faults of AIPS, difmap and others are repaired: ``DEC---SIN`` with three dashes,
    ``EPOCH`` for the equinox, units in capitals.  Without ``CRVALn`` the reference
    pixel is at (0, 0).  Other faults raise a `ContentError`.  Distortions that are
    stored in tables need the `~astropy.io.fits.HDUList` ``fobj``.
    """
    clean = _repaired(header)
    kinds = [axis_kind(str(clean.get(f"CTYPE{axis}", ""))) for axis in range(1, 8)]
    if not {"longitude", "latitude"} <= set(kinds):
        raise ContentError(
            "it has no celestial coordinates (CTYPE); use EpochCube.from_arrays"
        )
    axes = [kinds.index(kind) + 1 for kind in ("longitude", "latitude")]
    if axes[0] > axes[1]:
        raise ContentError("latitude is its first axis; transpose the image")
    for axis in axes:
        rows = [key for key in clean if re.match(rf"CD{axis}_\d+$|CDELT{axis}$", key)]
        if not any(clean[key] for key in rows):
            raise ContentError("its celestial axes have no pixel scale (CDELT or CD)")
    with warnings.catch_warnings(action="ignore"):
        try:
            wcs = WCS(clean, fobj=fobj).celestial
            wcs.wcs.set()
        except Exception as error:
            reason = " ".join(str(error).strip().splitlines()[:2])
            # Where in its source wcslib noticed it helps nobody.
            reason = re.sub(r"ERROR \d+ in \S+ at line \d+ of file \S+: ", "", reason)
            raise ContentError(f"its coordinates cannot be read: {reason}") from None
    return as_celestial(wcs)


def _repaired(header):
    """Return the cards of a header that WCS reads, corrected to the standard."""
    cards = {}
    for card in header.cards:
        try:
            keyword, value = card.keyword, card.value
        except (fits.VerifyError, ValueError):
            continue
        # Dates are read elsewhere; WCS would warn of them in every file.
        if not re.match(r"(HISTORY|COMMENT|)$|DATE|MJD|TIMESYS", keyword):
            value = _standard(keyword, value)
            with suppress(fits.VerifyError, ValueError):
                cards[keyword] = fits.Card(keyword, value)
    clean = fits.Header(cards.values())
    if not any("-SIP" in str(clean.get(f"CTYPE{axis}")) for axis in (1, 2)):
        # Images that were resampled keep the coefficients of the distorted ones.
        for keyword in [key for key in clean if _SIP.match(key)]:
            del clean[keyword]
    if "EQUINOX" not in clean and (epoch := get(header, "EPOCH", kind=float)):
        clean["EQUINOX"] = epoch
    return clean


def _standard(keyword, value):
    """Return the value of a keyword, corrected to the standard."""
    if keyword.startswith("CTYPE"):
        # The coordinate's name, filled with dashes to five characters, and projection.
        ctype = str(value).strip().upper()
        if match := re.fullmatch(r"([A-Z]{2,4})-+([A-Z]{3})(-SIP)?", ctype):
            return f"{match[1]:-<5}{match[2]}{match[3] or ''}"
        # AIPS and difmap omit the projection if it is orthographic.
        return {"RA": "RA---SIN", "DEC": "DEC--SIN"}.get(ctype, ctype)
    if keyword.startswith("CUNIT") and str(value).upper().startswith("DEG"):
        return "deg"
    if not _WCS_NUMBER.match(keyword):
        return value
    number = get({keyword: value}, keyword, kind=float)
    if number is None:
        raise ContentError(f"{keyword} = {value!r} is not a finite number")
    return number


def fits_wcs(wcs):
    """
    Return the FITS WCS behind a WCS that was sliced or resampled.

    Images that were sliced or rebinned have a
    `~astropy.wcs.wcsapi.SlicedLowLevelWCS` or a
    `ndcube.wcs.wrappers.ResampledLowLevelWCS` around a WCS; both are understood.

    Returns
    -------
    wcs : `~astropy.wcs.WCS`
        With all axes; an axis sliced to one pixel starts at that pixel.
    size : `~numpy.ndarray`
        Number of original pixels per pixel along each axis.
    kept : `~numpy.ndarray` of bool
        Axes that the image still has.
    """
    wcs = getattr(wcs, "low_level_wcs", wcs)
    if isinstance(wcs, WCS):
        return wcs, np.ones(wcs.naxis), np.ones(wcs.naxis, dtype=bool)
    single, step = False, 1.0
    if hasattr(wcs, "_slices_pixel"):
        single = [isinstance(part, Integral) for part in wcs._slices_pixel]
        start = [getattr(part, "start", part) or 0 for part in wcs._slices_pixel]
    elif hasattr(wcs, "_factor"):
        start, step = wcs._offset, wcs._factor
    else:
        raise TypeError(f"wcs must be a WCS, or one sliced, got {type(wcs).__name__}")
    wcs, size, kept = fits_wcs(wcs._wcs)
    wcs, kept = wcs.deepcopy(), kept.copy()
    axes = np.flatnonzero(kept)
    crpix = wcs.wcs.crpix.copy()
    crpix[axes] = (crpix[axes] - 0.5 - start) / step + 0.5
    if np.any(step != 1):
        size[axes] *= step
        matrix = wcs.pixel_scale_matrix
        matrix[:, axes] *= step
        del wcs.wcs.cd, wcs.wcs.crota
        wcs.wcs.cdelt, wcs.wcs.pc = np.ones(len(matrix)), matrix
    wcs.wcs.crpix = crpix
    wcs.wcs.set()
    wcs.pixel_shape = None
    kept[axes] = np.logical_not(single)
    return wcs, size, kept


def as_celestial(wcs):
    """Return the celestial part of a WCS, two axes without distortions."""
    wcs, _, kept = fits_wcs(wcs)
    if not wcs.has_celestial:
        raise ContentError(f"wcs must have celestial axes, got {list(wcs.wcs.ctype)}")
    if not kept[[wcs.wcs.lng, wcs.wcs.lat]].all():
        raise ContentError("wcs has lost a celestial axis by slicing; slice images")
    if wcs.naxis != 2:
        wcs = wcs.celestial
    if wcs.wcs.lng > wcs.wcs.lat:
        raise ContentError("wcs has latitude on its first axis; transpose the images")
    if wcs.sip is not None and not any("-SIP" in code for code in wcs.wcs.ctype):
        # Left over from the image that was resampled.
        wcs = wcs.deepcopy()
        wcs.sip = None
    if wcs.has_distortion:
        raise ContentError("wcs has distortions (SIP); resample the images first")
    return wcs


def axis_kind(ctype):
    """Return "longitude" or "latitude" for a celestial CTYPE, None for others."""
    match = _CELESTIAL.match(ctype.strip().upper())
    return match and ("longitude" if match[2] else "latitude")


def epoch_header(cube, i):
    """Return the date, label, beam, noise and facts of an epoch as a FITS header."""
    time = cube.times[i]
    header = fits.Header()
    header["DATE-OBS"] = time.isot
    header["TIMESYS"] = time.scale.upper()
    header["LABEL"] = cube.labels[i].encode("ascii", "replace").decode()
    if cube.beams is not None:
        axes = (getattr(cube.beams[i], name) for name in ("major", "minor", "pa"))
        header.update(zip(BEAM, (axis.to_value(u.deg) for axis in axes), strict=True))
    if cube.noise is not None:
        header["NOISE"] = cube.noise[i].value, f"rms, {cube.noise.unit}"
    facts = cube.epoch_meta[i]
    header.update({key[0]: facts[fact] for fact, key in FACTS.items() if fact in facts})
    return header
