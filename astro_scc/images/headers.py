# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The facts about an epoch in the header of its image, in one record."""

import re
import warnings
from contextlib import suppress
from itertools import product
from numbers import Integral

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.wcs import WCS

from astro_scc.images.beam import BEAM, SeveralBeamsError, header_beam
from astro_scc.images.cards import KEYWORDS, get, header_facts
from astro_scc.images.dates import observing_time

_WCS_NUMBER = re.compile(r"((CRPIX|CRVAL|CDELT|CROTA)\d+|(PC|CD)\d+_\d+)$")
_SIP = re.compile(r"[AB]P?_(ORDER|DMAX|\d+_\d+)$")
_MATRIX = re.compile(r"PV|CDELT|CROTA|(PC|CD)\d+_|WCSAXES|NAXIS|CRPIX[3-9]")
_CELESTIAL = re.compile(r"((RA|[A-Z]LON|[A-Z]{2}LN)|DEC|[A-Z]LAT|[A-Z]{2}LT)(-|$)")


class ContentError(ValueError):
    """The file is FITS, but its image cannot be used."""


def read_header(header, tables=()):
    """
    Return what a FITS header or a dict tells about an image, by the fields of `Plane`.

    ``time`` (UTC) and ``beam`` are None if the header has none, or if they cannot be
    read; then ``date_problem`` and ``beam_problem`` say why.  ``facts`` are those of
    `header_facts`.

    For the date see `observing_time`, of whose doubts ``remarks`` tell.  The beam is
    taken from ``BMAJ``, ``BMIN`` and ``BPA`` (degrees), else from an ``AIPS CG`` or
    ``BEAMS`` table among ``tables``, else from the last ``CLEAN BMAJ=`` in the
    history; ``beam_choice`` says that a table has several and none is the image's.
    """
    found = {"time": None, "beam": None, "facts": header_facts(header), "remarks": []}
    try:
        found["time"], remark = observing_time(header)
        found["remarks"] += [remark] if remark else []
    except ValueError as error:
        found["date_problem"] = str(error)
    try:
        found["beam"] = header_beam(header, tables)
    except SeveralBeamsError as error:
        found["beam_choice"] = str(error)
    except (KeyError, TypeError, ValueError) as error:
        found["beam_problem"] = str(error)
    return found


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
    for axis in set(range(1, 8)) - {*axes}:
        # What is wrong with axes of frequencies, dates or others does not matter.
        for name in ("CTYPE", "CUNIT", "CRVAL", "CDELT"):
            clean.remove(f"{name}{axis}", ignore_missing=True)
        for key in [key for key in clean if re.match(rf"P[SV]{axis}_\d+$", key)]:
            del clean[key]
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
    if not any("-SIP" in str(value) for value in clean["CTYPE*"].values()):
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
    if keyword.startswith("CUNIT"):
        text = str(value).strip().lower()
        units = KEYWORDS["angles"].items()
        return next((unit for start, unit in units if text.startswith(start)), value)
    if keyword in ("RADESYS", "RADECSYS"):
        return _frame_name(keyword, str(value).strip().upper())
    if not _WCS_NUMBER.match(keyword):
        return value
    number = get({keyword: value}, keyword, kind=float)
    if number is None:
        raise ContentError(f"{keyword} = {value!r} is not a finite number")
    return number


def _frame_name(keyword, name):
    """Return the name of a frame as the standard has it, "" if it is left out."""
    name = {"J2000": "FK5", "B1950": "FK4", "GAPPT": "", "UNKNOWN": ""}.get(name, name)
    if name not in ("", "ICRS", "FK5", "FK4", "FK4-NO-E"):
        raise ContentError(f"{keyword} = {name!r} is no frame; write ICRS, FK5 or FK4")
    return name


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
    for fact, row in KEYWORDS["facts"].items():
        if fact in facts:
            header[row["keywords"][0]] = facts[fact]
    return header
