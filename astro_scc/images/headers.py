# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Headers, also as dicts: values of their cards, facts, units and coordinates."""

import re
import tomllib
import warnings
from contextlib import suppress
from functools import cache
from importlib import resources
from itertools import product
from numbers import Integral

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.wcs import WCS

#: Keywords and words of headers, and what they mean.
KEYWORDS = tomllib.loads(
    resources.files(__package__).joinpath("keywords.toml").read_text("utf-8")
)
#: The spellings in headers of units that astropy knows.
_UNITS = {word: unit for unit, words in KEYWORDS["units"].items() for word in words}
#: Units that are logarithms of brightness, as text.
_LOGARITHM = re.compile(r"(?<![a-z])(mag|mags|magnitudes?|dex|db|log|log10)(?![a-z])")
_WCS_NUMBER = re.compile(r"((CRPIX|CRVAL|CDELT|CROTA)\d+|(PC|CD)\d+_\d+)$")
#: The keywords of matrices, of which a header has one kind and WCS takes the first.
_MATRICES = {"PC": r"PC\d+_\d+$", "CD": r"CD\d+_\d+$", "CROTA": r"CROTA\d+$"}
_SIP = re.compile(r"[AB]P?_(ORDER|DMAX|\d+_\d+)$")
_MATRIX = re.compile(r"PV|CDELT|CROTA|(PC|CD)\d+_|WCSAXES|NAXIS|CRPIX[3-9]")
_CELESTIAL = re.compile(
    r"((RA|[A-Z]LON|[A-Z]{2}LN|SOLAR.?X)|DEC|[A-Z]LAT|[A-Z]{2}LT|SOLAR.?Y)(-|$)"
)


class ContentError(ValueError):
    """The file is FITS, but its image cannot be used."""


def get(header, *keywords, kind=None):
    """
    Return the value of the first of some keywords that has one, or None.

    Keys of a dict may be in upper or lower case.  Values that cannot be converted
    to ``kind`` (float or str), empty strings and numbers that are not finite count
    as absent.
    """
    if not isinstance(header, fits.Header):
        keywords = [key for name in keywords for key in (name, name.lower())]
    for keyword in keywords:
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


def without(header, pattern):
    """Remove the cards whose keywords match a pattern from a header; return it."""
    for keyword in [key for key in header if re.match(pattern, key)]:
        del header[keyword]
    return header


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


def some(names, most=3):
    """Return the first of many names as text, with the number of the others."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def celestial_wcs(header, fobj=None):
    """
    Return the celestial axes of a FITS header as a two-dimensional WCS.

    Faults of AIPS, difmap and others are repaired: ``DEC---SIN`` with three dashes,
    ``EPOCH`` for the equinox, units in capitals.  Without ``CRVALn`` the reference
    pixel is at (0, 0).  Other faults raise a `ContentError`.  Distortions that are
    stored in tables need the `~astropy.io.fits.HDUList` ``fobj``.
    """
    clean = _repaired(header)
    if (axes := celestial_axes(clean)) is None:
        raise ContentError(
            "it has no celestial coordinates (CTYPE); use EpochCube.from_arrays"
        )
    if axes[0] > axes[1]:
        raise ContentError("latitude is its first axis; transpose the image")
    for axis in axes:
        rows = [key for key in clean if re.match(rf"CD{axis}_\d+$|CDELT{axis}$", key)]
        if not any(clean[key] for key in rows):
            raise ContentError("its celestial axes have no pixel scale (CDELT or CD)")
    # What is wrong with axes of frequencies, dates or others does not matter.
    other = f"[^{axes[0]}{axes[1]}]"
    without(clean, rf"(CTYPE|CUNIT|CRVAL|CDELT){other}$|P[SV]{other}_\d+$")
    with warnings.catch_warnings(action="ignore"):
        try:
            _complete_polynomials(clean, axes)
            wcs = WCS(clean, fobj=fobj).celestial
            wcs.wcs.set()
        except Exception as error:
            reason = _reason(str(error))
            raise ContentError(f"its coordinates cannot be read: {reason}") from None
    if np.linalg.matrix_rank(wcs.pixel_scale_matrix) < 2:
        raise ContentError("its axes are parallel by its PC or CD; correct them")
    return as_celestial(wcs)


def contradicting_matrices(header, within=0.01):
    """
    Return a remark on matrices of a header that are not one, or "".

    They may differ ``within`` a part of their pixels, as angles are rounded.
    """
    written = [
        kind for kind, keys in _MATRICES.items()
        if any(re.match(keys, key) for key in header)
    ]  # fmt: skip
    if len(written) < 2:
        return ""
    clean, found = _repaired(header), {}
    # Angles of zero are left over where there is a matrix.
    kinds = [
        kind for kind in written
        if any(clean[key] for key in clean if re.match(_MATRICES[kind], key))
    ]  # fmt: skip
    for kind in kinds if len(kinds) > 1 else ():
        others = "|".join(keys for name, keys in _MATRICES.items() if name != kind)
        with warnings.catch_warnings(action="ignore"), suppress(ValueError):
            wcs = WCS(without(clean.copy(), others)).celestial
            found[kind] = wcs.pixel_scale_matrix
    first, *rest = found.values() or [np.zeros(1)]
    if all(np.allclose(first, one, 0, within * np.abs(first).max()) for one in rest):
        return ""
    return (
        f"its {' and '.join(found)} are of different scales or directions, and "
        f"{kinds[0]} is taken; remove what is wrong"
    )


def _complete_polynomials(header, axes):
    """
    Put the pixel scale of ``TPV`` into the matrix of two axes, in place.

    wcslib takes the polynomials for those of pixels where ``CDELT`` is not 1 and for
    zero where their linear terms are missing, and has none beside other axes.
    """
    if not any("TPV" in str(header[f"CTYPE{axis}"]) for axis in axes):
        return
    plain = header.copy()
    for i in axes:
        plain[f"CTYPE{i}"] = plain[f"CTYPE{i}"].replace("TPV", "TAN")
    for key in [key for key in header if _MATRIX.match(key)]:
        del (plain if key.startswith("PV") else header)[key]
    matrix = WCS(plain).celestial.pixel_scale_matrix
    for (i, j), part in zip(product(axes, axes), matrix.flat, strict=True):
        header[f"CD{i}_{j}"] = part
    for i in axes:
        header.setdefault(f"PV{i}_1", 1.0)


def _reason(text):
    """Return what wcslib says of a header, without where in its source it noticed."""
    text = re.sub(r"ERROR \d+ in \S+ at line \d+ of file \S+:", "", text)
    lines = [line.strip() for line in text.splitlines()]
    said = [line for line in lines if line and not line.endswith(":")][:2]
    if not said or "NULL error" in said[0]:
        return "the values of CTYPE, CRVAL, PC, CD or PV do not go together"
    return " ".join(said)


def _repaired(header):
    """Return the cards of a header that WCS reads, corrected to the standard."""
    cards = {}
    for card in header.cards:
        # Dates are read elsewhere; WCS would warn of them in every file.
        if re.match(r"(HISTORY|COMMENT|)$|DATE|MJD|TIMESYS", card.keyword):
            continue
        try:
            keyword, value = card.keyword, card.value
        except (fits.VerifyError, ValueError):
            continue
        value = _standard(keyword, value)
        with suppress(fits.VerifyError, ValueError):
            cards[keyword] = fits.Card(keyword, value)
    clean = fits.Header(cards.values())
    if not any("-SIP" in str(value) for value in clean["CTYPE*"].values()):
        # Images that were resampled keep the coefficients of the distorted ones.
        without(clean, _SIP)
    longitude, latitude = celestial_axes(clean) or (1, 2)
    standard = f"CROTA{latitude}"
    if not any(re.match(f"(CD|PC)[0-9]|{standard}$", key) for key in clean):
        # Others write the rotation elsewhere.
        elsewhere = f"CROTA{longitude}", *KEYWORDS["rotation"]["keywords"]
        if angle := get(header, *elsewhere, kind=float):
            clean[standard] = angle
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
        if match := re.fullmatch(r"SOLAR.?([XY])", ctype):
            # Older than the standard: SOHO, MDI, XRT.
            return "HPLN-TAN" if match[1] == "X" else "HPLT-TAN"
        # AIPS and difmap omit the projection if it is orthographic.
        return {"RA": "RA---SIN", "DEC": "DEC--SIN"}.get(ctype, ctype)
    if keyword.startswith("CUNIT"):
        text = str(value).strip().lower()
        units = KEYWORDS["angles"].items()
        return next((unit for start, unit in units if text.startswith(start)), value)
    if keyword in ("RADESYS", "RADECSYS"):
        name = str(value).strip().upper()
        old = {"J2000": "FK5", "B1950": "FK4", "GAPPT": "", "UNKNOWN": ""}
        name = old.get(name, name)
        if name not in ("", "ICRS", "FK5", "FK4", "FK4-NO-E"):
            what = f"{keyword} = {name!r} is no frame; write ICRS, FK5 or FK4"
            raise ContentError(what)
        return name
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
        kind = f"{type(wcs).__module__.partition('.')[0]}.{type(wcs).__name__}"
        advice = "; give WCS(wcs.to_fits_sip()), astropy's" if "gwcs" in kind else ""
        what = kind if advice else type(wcs).__name__
        raise TypeError(f"wcs must be a WCS, or one sliced, got {what}{advice}")
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


def celestial_axes(header):
    """Return the numbers of the axes of longitude and latitude, None without both."""
    kinds = [axis_kind(str(header.get(f"CTYPE{axis}", ""))) for axis in range(1, 8)]
    both = "longitude", "latitude"
    return [kinds.index(kind) + 1 for kind in both] if {*both} <= {*kinds} else None


def axis_kind(ctype):
    """Return "longitude" or "latitude" for a celestial CTYPE, None for others."""
    match = _CELESTIAL.match(ctype.strip().upper())
    return match and ("longitude" if match[2] else "latitude")
