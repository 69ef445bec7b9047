# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Date, beam, band and celestial coordinates of an image from its FITS header."""

import re
import warnings

import astropy.units as u
from astropy.io import fits
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.epochs.beam import Beam
from astro_scc.epochs.keywords import get, parse_date

__all__ = [
    "celestial_wcs",
    "epoch_header",
    "header_beam",
    "header_facts",
    "observing_time",
]

_DATE_KEYWORDS = ("DATE-OBS", "DATE_OBS", "DATE-BEG", "DATE-AVG")
_MJD_KEYWORDS = ("MJD-OBS", "MJD-BEG", "MJD-AVG", "EXPSTART", "MJD")
_TIME_SCALES = {
    "TAI": "tai",
    "IAT": "tai",
    "TT": "tt",
    "TDT": "tt",
    "ET": "tt",
    "TDB": "tdb",
    "TCB": "tcb",
    "TCG": "tcg",
}
_NUMBER = r"([-+]?[\d.]+(?:[EeDd][-+]?\d+)?)"
_CLEAN_BEAM = re.compile(
    rf"CLEAN\s+BMAJ\s*=\s*{_NUMBER}\s+BMIN\s*=\s*{_NUMBER}\s+BPA\s*=\s*{_NUMBER}"
)
_FREQUENCY_KEYWORDS = ("FREQ", "FREQUENCY", "OBSFREQ", "RESTFRQ", "RESTFREQ")
_WCS_NUMBER = re.compile(r"((CRPIX|CRVAL|CDELT|CROTA)\d+|(PC|CD)\d+_\d+)$")
_COMMENTARY = ("HISTORY", "COMMENT", "")
_STOKES = {1: "I", 2: "Q", 3: "U", 4: "V", -1: "RR", -2: "LL", -5: "XX", -6: "YY"}


def observing_time(header):
    """
    Date of observation, UTC.

    ``DATE-OBS`` (with ``TIME-OBS``, where the time of day is apart), or
    ``DATE-BEG``, ``DATE-AVG``, ``MJD-OBS``, ``EXPSTART``.  ``DATE``, the
    date at which a file was written, is not looked at.

    Parameters
    ----------
    header : `~astropy.io.fits.Header` or dict

    Returns
    -------
    `~astropy.time.Time` or None
        None where the header has no date.

    Raises
    ------
    ValueError
        If there is a date that cannot be read, and no other.
    """
    system = (get(header, "TIMESYS", kind=str) or "UTC").upper()
    scale = _TIME_SCALES.get(system, "utc")
    problem = None
    time = None
    for keyword in _DATE_KEYWORDS:
        value = get(header, keyword)
        if isinstance(value, Time):
            return value
        text = get(header, keyword, kind=str)
        if text is None:
            continue
        clock = get(header, "TIME-OBS", kind=str)
        if clock and keyword == "DATE-OBS" and ":" in clock and ":" not in text:
            text = f"{text}T{clock}"
        try:
            time = parse_date(text, scale)
            break
        except ValueError as error:
            problem = problem or f"{keyword}: {error}"
    if time is None:
        for keyword in _MJD_KEYWORDS:
            mjd = get(header, keyword, kind=float)
            if mjd is not None and mjd > 0:
                time = Time(mjd, format="mjd", scale=scale)
                break
    if time is None:
        if problem:
            raise ValueError(problem)
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        time = time.utc
    time.format = "isot"
    return time


def header_beam(header, tables=()):
    """
    The restoring beam.

    From ``BMAJ``, ``BMIN`` and ``BPA`` (degrees), else from an ``AIPS CG``
    or ``BEAMS`` table, else from the last ``CLEAN BMAJ=`` that AIPS wrote to
    the history.

    Parameters
    ----------
    header : `~astropy.io.fits.Header` or dict
    tables : iterable of `~astropy.io.fits.BinTableHDU`, optional

    Returns
    -------
    `Beam` or None
        None where there is none.

    Raises
    ------
    ValueError
        If the numbers are not those of a beam.
    """
    beam = get(header, "BEAM")
    if hasattr(beam, "major"):
        return Beam(u.Quantity(beam.major), u.Quantity(beam.minor), u.Quantity(beam.pa))
    major = get(header, "BMAJ", kind=float)
    if major is not None and major != 0:
        minor = get(header, "BMIN", kind=float)
        return _beam(major, major if minor is None else minor, get_pa(header))
    for table in tables:
        if table.name.upper() in ("AIPS CG", "BEAMS") and len(table.data):
            return _table_beam(table)
    found = None
    for line in _history(header):
        found = _CLEAN_BEAM.search(line.upper()) or found
    if found:
        values = [float(number.upper().replace("D", "E")) for number in found.groups()]
        if values[0] > 0:
            return _beam(*values)
    return None


def get_pa(header):
    """Position angle of the beam in degrees, 0 where there is none."""
    return get(header, "BPA", kind=float) or 0.0


def _beam(major, minor, pa, unit=u.deg):
    if not (major > 0 and minor > 0):
        raise ValueError(f"the beam {major:g} x {minor:g} {unit} is not positive")
    if minor > major:
        major, minor, pa = minor, major, pa + 90
    return Beam(major * unit, minor * unit, pa * u.deg)


def _table_beam(table):
    """The first row of a table with columns BMAJ, BMIN, BPA."""
    units = {}
    for column in table.columns:
        text = (column.unit or "deg").strip().lower().rstrip("s")
        units[column.name.upper()] = {"degree": u.deg}.get(text) or u.Unit(text)
    row = table.data[0]
    major, minor, pa = (
        (float(row[name]) * units[name]).to_value(u.deg)
        for name in ("BMAJ", "BMIN", "BPA")
    )
    return _beam(major, minor, pa)


def _history(header):
    if isinstance(header, fits.Header):
        return (str(c.value) for c in header.cards if c.keyword == "HISTORY")
    lines = header.get("HISTORY") or header.get("history") or ()
    return (lines,) if isinstance(lines, str) else (str(line) for line in lines)


def header_facts(header):
    """
    What tells whether images belong together.

    Parameters
    ----------
    header : `~astropy.io.fits.Header` or dict

    Returns
    -------
    dict
        Those of ``object``, ``telescope``, ``frequency`` (Hz), ``filter``
        and ``stokes`` that the header has.
    """
    facts = {
        "object": get(header, "OBJECT", "TARGNAME", kind=str),
        "telescope": get(header, "TELESCOP", kind=str),
        "frequency": _axis_value(header, "FREQ")
        or get(
            header, "FREQ", "FREQUENCY", "OBSFREQ", "RESTFRQ", "RESTFREQ", kind=float
        ),
        "filter": get(header, "FILTER", kind=str) or _wheels(header),
        "stokes": _stokes(header),
    }
    return {key: value for key, value in facts.items() if value is not None}


def _wheels(header):
    """What two filter wheels of HST have in the way of the light."""
    for keyword in ("FILTER", "FILTNAM"):
        names = (get(header, f"{keyword}{wheel}", kind=str) or "" for wheel in (1, 2))
        found = [name for name in names if name and not name.startswith("CLEAR")]
        if found:
            return " + ".join(found)
    return None


def _stokes(header):
    value = _axis_value(header, "STOKES")
    if value is not None:
        return _STOKES.get(round(value))
    return get(header, "STOKES", kind=str)


def _axis_value(header, name):
    """World coordinate of the first pixel of a degenerate axis."""
    for axis in range(1, 10):
        if (get(header, f"CTYPE{axis}", kind=str) or "").upper().startswith(name):
            value = get(header, f"CRVAL{axis}", kind=float)
            if value is None:
                return None
            pixel = get(header, f"CRPIX{axis}", kind=float)
            step = get(header, f"CDELT{axis}", kind=float)
            return value + (1 - (1 if pixel is None else pixel)) * (step or 0)
    return None


def celestial_wcs(header, fobj=None):
    """
    The celestial axes of a header as a two-dimensional WCS.

    Repairs what AIPS, difmap and others write: ``DEC---SIN`` with three
    dashes, ``EPOCH`` for the equinox, units in capitals.  Without
    ``CRVALn`` the reference pixel is at (0, 0).

    Parameters
    ----------
    header : `~astropy.io.fits.Header`
    fobj : `~astropy.io.fits.HDUList`, optional
        Needed for distortions that are kept in tables.

    Returns
    -------
    `~astropy.wcs.WCS`

    Raises
    ------
    ValueError
        If there are no celestial axes, longitude first, or no pixel scale.
    """
    clean = fits.Header()
    for card in header.cards:
        try:
            keyword, value = card.keyword, card.value
        except (fits.VerifyError, ValueError):
            continue
        # Dates are read elsewhere; WCS would warn about them on every file.
        if keyword in _COMMENTARY or keyword.startswith(("DATE", "MJD", "TIMESYS")):
            continue
        if keyword.startswith("CTYPE"):
            value = _standard_ctype(str(value))
        elif keyword.startswith("CUNIT") and str(value).upper().startswith("DEG"):
            value = "deg"
        elif _WCS_NUMBER.match(keyword):
            number = get({keyword: value}, keyword, kind=float)
            if number is None:
                raise ValueError(f"{keyword} = {value!r} is not a finite number")
            value = number
        try:
            clean[keyword] = value
        except (fits.VerifyError, ValueError):
            continue
    if "EQUINOX" not in clean and (epoch := get(header, "EPOCH", kind=float)):
        clean["EQUINOX"] = epoch
    _check_celestial(clean)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            wcs = WCS(clean, fobj=fobj).celestial
            wcs.wcs.set()
        except Exception as error:
            reason = str(error).strip().splitlines()
            raise ValueError(
                f"its celestial coordinates cannot be read: {' '.join(reason[:2])}"
            ) from None
    return wcs


def axis_kind(ctype):
    """
    What a celestial CTYPE stands for.

    Parameters
    ----------
    ctype : str

    Returns
    -------
    {"longitude", "latitude", None}
    """
    ctype = ctype.strip().upper()
    if re.match(r"(RA|[A-Z]LON|[A-Z]{2}LN)(-|$)", ctype):
        return "longitude"
    if re.match(r"(DEC|[A-Z]LAT|[A-Z]{2}LT)(-|$)", ctype):
        return "latitude"
    return None


def _check_celestial(header):
    kinds = [axis_kind(str(header.get(f"CTYPE{axis}", ""))) for axis in range(1, 8)]
    if not {"longitude", "latitude"} <= set(kinds):
        raise ValueError(
            "it has no celestial coordinates (CTYPE); use EpochCube.from_arrays, "
            "which takes the pixel scale"
        )
    if kinds.index("longitude") > kinds.index("latitude"):
        raise ValueError("latitude is its first axis; transpose the image")
    for axis in (kinds.index("longitude") + 1, kinds.index("latitude") + 1):
        rows = [key for key in header if re.match(rf"CD{axis}_\d+$", key)]
        if not any(header[key] for key in (*rows, f"CDELT{axis}") if key in header):
            raise ValueError("its celestial axes have no pixel scale (CDELT or CD)")


def _standard_ctype(ctype):
    """Coordinate name padded with dashes to five characters, then projection."""
    ctype = ctype.strip().upper()
    match = re.fullmatch(r"([A-Z]{2,4})-+([A-Z]{3})(-SIP)?", ctype)
    if match:
        return f"{match[1]:-<5}{match[2]}{match[3] or ''}"
    # AIPS and difmap leave the projection out, which is orthographic there.
    return {"RA": "RA---SIN", "DEC": "DEC--SIN"}.get(ctype, ctype)


def epoch_header(*, time, label, beam=None, noise=None, facts=None):
    """
    The facts of one epoch as a header that this module reads back.

    Parameters
    ----------
    time : `~astropy.time.Time`
    label : str
    beam : `Beam`, optional
    noise : `~astropy.units.Quantity`, optional
    facts : dict, optional
        As of `header_facts`.

    Returns
    -------
    `~astropy.io.fits.Header`
    """
    header = fits.Header()
    header["DATE-OBS"] = time.isot
    header["TIMESYS"] = time.scale.upper()
    header["LABEL"] = label.encode("ascii", "replace").decode()
    if beam is not None:
        header["BMAJ"] = beam.major.to_value(u.deg)
        header["BMIN"] = beam.minor.to_value(u.deg)
        header["BPA"] = beam.pa.to_value(u.deg)
    if noise is not None:
        header["NOISE"] = noise.value, f"rms, {noise.unit}"
    keywords = {
        "object": "OBJECT",
        "telescope": "TELESCOP",
        "frequency": "FREQ",
        "filter": "FILTER",
        "stokes": "STOKES",
    }
    for fact, keyword in keywords.items():
        if fact in (facts or {}):
            header[keyword] = facts[fact]
    return header
