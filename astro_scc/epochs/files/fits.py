# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""One FITS image of VLBI, CASA, HST and others as CCDData."""

import gzip
import mmap
import os
import re
import warnings
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.io import fits, registry
from astropy.nddata import (
    CCDData,
    InverseVariance,
    NDData,
    StdDevUncertainty,
    VarianceUncertainty,
)

from astro_scc.epochs.files.headers import (
    axis_kind,
    celestial_wcs,
    header_beam,
    header_facts,
)
from astro_scc.epochs.grid import cut_wcs
from astro_scc.epochs.keywords import get, parse_unit
from astro_scc.exceptions import EpochWarning

__all__ = ["as_image", "read_grid", "read_image", "read_vlbi_fits"]

# What the files of EpochCube.write are known by.
CUBE_CREATOR = "astro_scc EpochCube"
#: What to do about a beam that cannot be.
CORRECT_BEAM = "write BMAJ, BMIN and BPA in degrees to its header"
#: Kinds of uncertainty, as astropy calls them in FITS (UTYPE).
UNCERTAINTIES = {
    kind.__name__: kind
    for kind in (StdDevUncertainty, VarianceUncertainty, InverseVariance)
}
_AXES = re.compile(rb"NAXIS   = *(\d{4,})")
# What describes the array and its axes in the file, which the CCDData says
# itself, in two dimensions.
_STRUCTURE = re.compile(
    r"(SIMPLE|XTENSION|BITPIX|NAXIS\d*|EXTEND|EXTNAME|PCOUNT|GCOUNT|GROUPS|BLOCKED"
    r"|BSCALE|BZERO|BLANK|BUNIT|DATAMIN|DATAMAX|CHECKSUM|DATASUM|WCSAXES|EPOCH"
    r"|EQUINOX|RADESYS|RADECSYS|LONPOLE|LATPOLE|(CTYPE|CRVAL|CRPIX|CDELT|CUNIT|CROTA)\d"
    r"|(PC|CD|PV|PS)\d+_\d+|PC\d{6}|CD\d{6}|BMAJ|BMIN|BPA|FREQ|STOKES)$"
)


def read_vlbi_fits(path, hdu=None):
    """
    Read one FITS image, with the habits of AIPS, difmap, CASA and HST.

    This is what ``CCDData.read(path, format="vlbi-fits")`` calls once
    ``astro_scc.epochs`` has been imported.

    Parameters
    ----------
    path : str or path-like
    hdu : int or str, optional
        The extension that holds the image, by default the first image.

    Returns
    -------
    `~astropy.nddata.CCDData`, shape (ny, nx)
        Axes of length one are dropped, and of several Stokes parameters I
        is taken.  The data are float64, pixels that are not finite are
        masked, the WCS is the celestial one.  The beam is in ``meta`` as
        ``BMAJ``, ``BMIN`` and ``BPA`` in degrees wherever the file had it,
        the frequency as ``FREQ`` in Hz.

    Raises
    ------
    OSError
        If the file is missing, broken, or holds no image.
    ValueError
        If the image has more than two axes, no celestial coordinates, or no
        valid pixel.

    Warns
    -----
    EpochWarning
        If something in the header could not be understood.

    Examples
    --------
    >>> from astropy.nddata import CCDData
    >>> import astro_scc.epochs
    >>> image = CCDData.read("../shared/data/0003+380/0003+380.u.2006_03_09.fits",
    ...                      format="vlbi-fits")
    >>> image.shape, image.unit
    ((256, 256), Unit("Jy / beam"))
    """
    image, notes = read_image(path, hdu=hdu)
    for note in notes:
        warnings.warn(f"{path}: {note}", EpochWarning, stacklevel=2)
    return image


def read_image(path, hdu=None, *, window=None):
    """
    As `read_vlbi_fits`, with the warnings as text.

    Parameters
    ----------
    path : str or path-like
    hdu : int or str, optional
    window : (slice, slice), optional
        Rows and columns to read of a file that `read_grid` has read; others
        are not loaded.

    Returns
    -------
    image : `~astropy.nddata.CCDData`
    notes : list of str
    """
    return _from_path(
        path, hdu, lambda *found: _image(*found, window), known=window is not None
    )


def read_grid(path, hdu=None):
    """
    What the header of an image says, without its pixels.

    Parameters
    ----------
    path : str or path-like
    hdu : int or str, optional

    Returns
    -------
    wcs : `~astropy.wcs.WCS`
    shape : (int, int)
        (ny, nx).
    header : `~astropy.io.fits.Header`

    Raises
    ------
    OSError, ValueError
        See `read_vlbi_fits`.
    """
    return _from_path(path, hdu, _grid)


def _from_path(path, hdu, take, *, known=False):
    """What a function takes from the open file, the extension and the path."""
    from astro_scc.epochs.interchange.casa import is_casa_image, read_casa_image

    path = Path(os.fspath(path))
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    casa = is_casa_image(path)
    if path.is_dir() and not casa:
        raise IsADirectoryError(f"{path}: is a directory; give {path}/*.fits")
    check_ordinary(path)
    try:
        if casa:
            return take(read_casa_image(path), hdu, path)
        return _open(path, hdu, take, known)
    except _ContentError as error:
        raise ValueError(f"{path}: {error}") from None
    except _NoImageError as error:
        raise OSError(f"{path}: {error}") from None


def check_ordinary(path):
    """
    Refuse what is neither file nor directory, which may be read without end.

    Parameters
    ----------
    path : str or path-like

    Raises
    ------
    OSError
        For pipes, sockets and devices.
    """
    path = Path(path)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise OSError(f"{path}: is no ordinary file; give the name of one")


def as_image(image, name):
    """
    An image of another package as NDData.

    Parameters
    ----------
    image : `~astropy.nddata.NDData`, or an object with an ``hdu``
        A `spectral_cube.Projection`, or a SpectralCube of one channel.
    name : str
        What it is called in messages.

    Returns
    -------
    `~astropy.nddata.NDData`

    Raises
    ------
    ValueError
        If it has more than one plane, or no celestial coordinates.
    TypeError
        If it is of another kind.
    """
    if isinstance(image, NDData):
        return image
    hdu = getattr(image, "hdu", None)
    if not getattr(hdu, "is_image", False):
        raise TypeError(
            f"{name}: is a {type(image).__name__}; give NDData, such as CCDData, or "
            "images of spectral-cube"
        )
    try:
        return _image(fits.HDUList([hdu]), None, Path(name))[0]
    except (_ContentError, _NoImageError) as error:
        raise ValueError(f"{name}: {error}") from None


class _ContentError(Exception):
    """The file is FITS, but the image in it is not what is needed."""


class _NoImageError(OSError):
    """The file is not FITS, is broken, or holds no image."""


def _open(path, hdu, take, known):
    with warnings.catch_warnings():
        # AIPS and difmap files break small rules of the standard throughout.
        warnings.simplefilter("ignore")
        try:
            # astropy.io.fits forgets to close files that it fails to open.
            with path.open("rb") as file, open_fits(file, known=known) as hdus:
                return take(hdus, hdu, path)
        except (_ContentError, _NoImageError):
            raise
        except Exception as error:
            # A damaged file can fail anywhere inside astropy.io.fits.
            raise _broken(error) from None


def open_fits(file, *, known=False, **options):
    """
    Open a FITS file that may be damaged.

    The standard has up to 999 axes; astropy counts to any number that a header
    claims, for years.

    Parameters
    ----------
    file : binary file
    known : bool, optional
        Whether it was opened so before, and need not be looked through again.
    **options
        Of `astropy.io.fits.open`.

    Returns
    -------
    `~astropy.io.fits.HDUList`

    Raises
    ------
    OSError
        If a header claims to have more axes, and all that astropy raises.
    """
    found = None if known else _AXES.search(_content(file))
    if found:
        raise _NoImageError(f"is broken, it claims to have {found[1].decode()} axes")
    file.seek(0)
    return fits.open(file, **options)


def _content(file):
    """Where headers may be: all of a file, the beginning of a compressed one."""
    if file.read(2) == b"\x1f\x8b":
        file.seek(0)
        with gzip.open(file) as whole:
            return whole.read(2880)
    if file.seek(0, os.SEEK_END) == 0:
        return b""
    return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def _broken(error):
    # The first sentence of the reason; the rest is advice for callers of astropy.
    reason = re.split(r"[.,;:] |\n", str(error).strip())[0] or type(error).__name__
    return _NoImageError(f"cannot be read as FITS, it is broken or no FITS: {reason}")


def _image(hdus, which, path, window=None):
    hdu, header = _hdu_with_header(hdus, which, path)
    raw = hdu.data
    if raw is None or raw.dtype.kind not in "fiub":
        raise _NoImageError("holds no image of real numbers")
    raw = raw[_plane(header)]
    shape = raw.shape
    window = window or (slice(None), slice(None))
    # Only these pixels are read, where the file is mapped into memory.
    data = np.array(raw[window], dtype=np.float64)
    del raw
    where = "" if data.shape == shape else " in this part"
    bad = ~np.isfinite(data)
    if bad.all():
        raise _ContentError(f"no valid pixel{where}, all are NaN; leave this file out")
    for name, is_bad in (("WHT", np.logical_not), ("MASK", np.asarray)):
        values, _ = _beside(hdus, hdu, name, shape, window)
        if values is not None:
            bad |= is_bad(values).astype(bool)
        if bad.all():
            raise _ContentError(
                f"no valid pixel{where} by its extension {name}; leave this file out"
            )
    wcs = _celestial(header, hdus)

    notes = []
    text = get(header, "BUNIT", kind=str)
    unit = parse_unit(text)
    if unit is None:
        notes.append(
            f"its unit {text!r} is not known and taken as dimensionless; write one "
            "that FITS knows, such as JY/BEAM, to BUNIT"
        )
        unit = u.dimensionless_unscaled
    meta = _meta(header)
    beam = _beam(hdus, header, wcs, shape, notes)
    if beam is not None:
        meta["BMAJ"] = beam.major.to_value(u.deg)
        meta["BMIN"] = beam.minor.to_value(u.deg)
        meta["BPA"] = beam.pa.to_value(u.deg)
    mask = bad if bad.any() else None
    if data.shape != shape:
        wcs = cut_wcs(wcs, window, shape)
    errors, kind = _beside(hdus, hdu, "UNCERT", shape, window)
    if errors is not None:
        own = parse_unit(get(kind, "BUNIT", kind=str)) if "BUNIT" in kind else None
        kind = UNCERTAINTIES.get(get(kind, "UTYPE", kind=str), StdDevUncertainty)
        errors = kind(np.array(errors, dtype=float), unit=own, copy=False)
    image = CCDData(data, unit=unit, mask=mask, wcs=wcs, meta=meta, uncertainty=errors)
    return image, notes


def _hdu_with_header(hdus, which, path):
    """The extension of the image, and its header with what the first one adds."""
    if hdus[0].header.get("CREATOR") == CUBE_CREATOR:
        raise _ContentError("is a whole EpochCube; give it alone to EpochCube.read")
    hdu = _find(hdus, which)
    header = hdu.header.copy()
    if hdu is not hdus[0]:
        header.extend(hdus[0].header, unique=True, bottom=True)
    _check_complete(hdu, path)
    return hdu, header


def _grid(hdus, which, path):
    hdu, header = _hdu_with_header(hdus, which, path)
    index = _plane(header)
    shape = tuple(n for n, i in zip(hdu.shape, index, strict=True) if i == slice(None))
    return _celestial(header, hdus), shape, header


def _celestial(header, hdus):
    try:
        wcs = celestial_wcs(header, fobj=hdus)
    except ValueError as error:
        raise _ContentError(error) from None
    if wcs.has_distortion:
        raise _ContentError("its coordinates are distorted (SIP); resample it first")
    return wcs


def _beside(hdus, image, name, shape, window):
    """
    Values and header of an extension that belongs to the image, or None.

    Drizzled images of HST have weights, ``WHT``; astropy writes the mask and the
    uncertainty of CCDData as ``MASK`` and ``UNCERT``.
    """
    for hdu in hdus:
        if hdu is not image and hdu.name == name and hdu.is_image:
            if hdu.shape == shape:
                return hdu.data[window], hdu.header
            if name != "WHT":
                raise _ContentError(
                    f"its extension {name} has shape {hdu.shape}, its image {shape}; "
                    "correct or remove the extension"
                )
    return None, None


def _find(hdus, which):
    if which is not None:
        try:
            return hdus[which]
        except (KeyError, IndexError, TypeError):
            raise _NoImageError(f"has no extension {which!r}") from None
    for hdu in hdus:
        if hdu.is_image and len(hdu.shape) >= 2 and 0 not in hdu.shape:
            return hdu
    raise _NoImageError("holds no image")


def _check_complete(hdu, path):
    """Before memory is set aside for pixels that the file does not have."""
    info = hdu.fileinfo()
    compressed = path.suffix.lower() in (".gz", ".bz2", ".xz", ".z", ".zip")
    if info is None or compressed:
        return
    missing = info["datLoc"] + hdu.size - path.stat().st_size
    if missing > 0:
        raise _NoImageError(f"is truncated, {missing} bytes of its image are missing")


def _plane(header):
    """Index of the image plane; numpy's axes run against those of FITS."""
    naxis = header["NAXIS"]
    types = [str(header.get(f"CTYPE{k + 1}", "")).upper().strip() for k in range(naxis)]
    celestial = [k for k, t in enumerate(types) if axis_kind(t)]
    if len(celestial) != 2:
        # celestial_wcs refuses these with the better reason.
        celestial = [0, 1]
    index = []
    for k in range(naxis):
        length = header[f"NAXIS{k + 1}"]
        if k in celestial:
            index.append(slice(None))
        elif length == 1:
            index.append(0)
        elif types[k].startswith("STOKES"):
            index.append(_stokes_i(header, k + 1, length))
        else:
            name = types[k] or f"{k + 1} of the file"
            raise _ContentError(
                f"has {length} planes on axis {name}; write the one to use, or "
                "their mean, to a file of its own"
            )
    return tuple(reversed(index))


def _stokes_i(header, axis, length):
    start = get(header, f"CRVAL{axis}", kind=float)
    step = get(header, f"CDELT{axis}", kind=float) or 1.0
    pixel = get(header, f"CRPIX{axis}", kind=float)
    pixel = 1.0 if pixel is None else pixel
    if start is not None:
        position = (1 - start) / step + pixel - 1
        if abs(position - round(position)) < 1e-6 and 0 <= round(position) < length:
            return round(position)
    raise _ContentError(
        f"has {length} planes on axis STOKES and none of them is I; write the one "
        "to use to a file of its own"
    )


def _beam(hdus, header, wcs, shape, notes):
    try:
        tables = (h for h in hdus if isinstance(h, fits.BinTableHDU))
        beam = header_beam(header, tables)
    except (ValueError, KeyError, TypeError) as error:
        notes.append(f"its beam is taken as unknown: {error}; {CORRECT_BEAM}")
        return None
    if beam is None:
        return None
    extent = max(
        np.hypot(*column) * n
        for column, n in zip(wcs.pixel_scale_matrix.T, shape[::-1], strict=True)
    )
    if beam.major.to_value(u.deg) > extent:
        notes.append(
            f"its beam is taken as unknown: {beam} is larger than the image; "
            f"{CORRECT_BEAM}"
        )
        return None
    return beam


def _meta(header):
    """The header without what describes the array, with the band as values."""
    meta = fits.Header([card for card in header.cards if _belongs_to_meta(card)])
    facts = header_facts(header)
    for fact, keyword in (("frequency", "FREQ"), ("stokes", "STOKES")):
        if fact in facts:
            meta[keyword] = facts[fact]
    return meta


def _belongs_to_meta(card):
    try:
        # Cards are parsed at first use, where broken ones raise.
        readable = (card.value, card.comment)
        return bool(readable) and not _STRUCTURE.match(card.keyword)
    except (fits.VerifyError, ValueError):
        return False


registry.register_reader("vlbi-fits", CCDData, read_vlbi_fits, force=True)
