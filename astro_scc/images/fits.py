# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""One FITS image of VLBI, CASA, HST and others."""

import glob
import gzip
import mmap
import os
import re
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.nddata import (
    InverseVariance,
    NDUncertainty,
    StdDevUncertainty,
    VarianceUncertainty,
)
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.images import headers
from astro_scc.images.beam import Beam
from astro_scc.images.grid import cut_wcs

# Value of CREATOR that marks the files of EpochCube.write.
CUBE_CREATOR = "astro_scc EpochCube"
#: Advice for a beam that cannot be right.
CORRECT_BEAM = "write BMAJ, BMIN and BPA in degrees to its header"
#: Uncertainties by the names that astropy writes.
UNCERTAINTIES = {
    kind.__name__: kind
    for kind in (StdDevUncertainty, VarianceUncertainty, InverseVariance)
}
#: Bytes of a block of a FITS file.
BLOCK = 2880
#: Factor by which uncertainties of pixels may differ from the image's median.
EVEN = 1.5
_AXES = re.compile(rb"NAXIS   = *(\d{4,})")


@dataclass(kw_only=True)
class Plane:
    """
    One image on its own grid, with the facts in its header, see `headers.read_header`.

    ``shape`` is that of the whole image, of which ``data`` and ``mask`` may be a
    part; they are None if only the header was read.
    """

    name: str
    wcs: WCS
    shape: tuple[int, int]
    time: Time | None = None
    beam: Beam | None = None
    facts: dict = field(default_factory=dict)
    date_problem: str = ""
    beam_problem: str = ""
    data: np.ndarray | None = None
    mask: np.ndarray | None = None
    unit: u.UnitBase = u.dimensionless_unscaled
    uncertainty: NDUncertainty | None = None
    noise: u.Quantity | None = None
    label: str | None = None
    unit_problem: str = ""
    noise_problem: str = ""

    @property
    def extent(self):
        """Size of the whole image in degrees."""
        sides = np.hypot(*self.wcs.pixel_scale_matrix) * self.shape[::-1]
        return float(np.max(sides))

    @property
    def notes(self):
        """Advice on what in the header is not understood."""
        beam = f"its beam is taken as unknown: {self.beam_problem}; {CORRECT_BEAM}"
        notes = self.unit_problem, self.beam_problem and beam, self.noise_problem
        return [note for note in notes if note]

    def take_uncertainty(self):
        """Make the uncertainty the noise, and mask the pixels without one."""
        if self.uncertainty is not None:
            self.noise, bad, even = uncertainty_noise(
                self.uncertainty, self.unit, self.mask
            )
            self.mask |= bad
            self.uncertainty = None
            if not even:
                self.noise_problem = (
                    "its uncertainty differs from pixel to pixel, and the median is "
                    "taken for the noise; leave it out to have the noise measured"
                )


class _NoImageError(OSError):
    """The file is not FITS, is broken, or holds no image."""


def find_files(paths, *, missing_ok=False):
    """
    Return the files that paths and patterns stand for, each once, as a list of Path.

    They are in the order given; those of a pattern are in alphabetical order.  Files
    that do not exist raise a FileNotFoundError, or are kept if ``missing_ok`` is True.
    """
    if isinstance(paths, str | os.PathLike):
        paths = [paths]
    try:
        names = [os.path.expanduser(os.fspath(path)) for path in paths]
    except TypeError:
        raise TypeError(f"paths must be names or a pattern, got {paths!r}") from None
    found = []
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"paths must be text, got {name!r}")
        if os.path.exists(name) or (missing_ok and not glob.has_magic(name)):
            found.append(name)
        elif matches := sorted(glob.glob(name, recursive=True)):
            found += [match for match in matches if not os.path.isdir(match)]
        else:
            what = "file matches this pattern" if glob.has_magic(name) else "such file"
            raise FileNotFoundError(f"{name}: no {what}")
    if not found:
        raise FileNotFoundError("no files were given")
    files = [Path(name) for name in dict.fromkeys(found)]
    for path in files:
        if path.exists() and not (path.is_file() or path.is_dir()):
            # Pipes, sockets and devices may have no end.
            raise OSError(f"{path}: is no ordinary file; give the name of one")
    return files


def read_plane(path, *, window=None, pixels=True):
    """
    Return the `Plane` of a FITS file of AIPS, difmap, CASA, HST or others.

    The first image is read.  Axes of length one are dropped, and Stokes I is taken from
    several Stokes parameters.  ``window`` selects the rows and columns to load from a
    file that was read before; without ``pixels`` only the header is read.  A file that
    is missing, broken or holds no image raises an OSError; an image of more than two
    axes, without celestial coordinates or without a valid pixel a ValueError.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if path.is_dir():
        raise IsADirectoryError(
            f"{path}: is a directory; give {path}/*.fits, or export a CASA image by "
            "exportfits"
        )
    # AIPS and difmap files break minor rules of the standard throughout.
    with warnings.catch_warnings(action="ignore"):
        try:
            # astropy.io.fits does not close files that it fails to open.
            with path.open("rb") as file, open_fits(file, known=bool(window)) as hdus:
                return plane_of(hdus, path, window=window, pixels=pixels)
        except (headers.ContentError, _NoImageError) as error:
            raise type(error).__base__(f"{path}: {error}") from None
        except Exception as error:
            # A damaged file can fail anywhere inside astropy.io.fits.  The first
            # sentence gives the reason; the rest is advice for callers of astropy.
            reason = re.split(r"[.,;:] ", headers.first_line(error))[0]
            raise OSError(
                f"{path}: cannot be read as FITS, it is broken or no FITS: {reason}"
            ) from None


def open_fits(file, *, known=False, **options):
    """
    Open a binary file with `astropy.io.fits.open`, even if its header is damaged.

    The standard allows 999 axes, but astropy loops over any number that a header
    claims, so a larger number raises an OSError.  A ``known`` file has been checked.
    """
    if not known:
        packed = file.read(2) == b"\x1f\x8b"
        file.seek(0)
        if packed:
            content = gzip.open(file).read(BLOCK)
        else:
            content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        if found := _AXES.search(content):
            raise _NoImageError(f"is broken, it claims {found[1].decode()} axes")
        file.seek(0)
    return fits.open(file, **options)


def plane_of(hdus, path, *, window=None, pixels=True):
    """Return the `Plane` of an open file, see `read_plane`."""
    if "SCCVERS" in hdus[0].header:
        what = hdus[0].header["CREATOR"].removeprefix("astro_scc ")
        reader = what if what == "EpochCube" else "SCCResult"
        raise headers.ContentError(f"is a whole {what}; give it alone to {reader}.read")
    hdu = _find(hdus)
    header = hdu.header.copy()
    if hdu is not hdus[0]:
        header.extend(hdus[0].header, unique=True, bottom=True)
    _check_complete(hdu, path)
    wcs = headers.celestial_wcs(header, fobj=hdus)
    index = _plane_index(header)
    shape = tuple(n for n, i in zip(hdu.shape, index, strict=True) if i == slice(None))
    tables = (table for table in hdus if isinstance(table, fits.BinTableHDU))
    record = headers.read_header(header, tables)
    text = headers.get(header, "BUNIT", kind=str)
    plane = Plane(name=str(path), wcs=wcs, shape=shape, **record)
    if (unit := headers.parse_unit(text)) is not None:
        plane.unit = unit
    else:
        plane.unit_problem = (
            f"its unit {text!r} is not known and taken as dimensionless; write one "
            "that FITS knows, such as JY/BEAM, to BUNIT"
        )
    if plane.beam is not None and plane.beam.major.to_value(u.deg) > plane.extent:
        plane.beam_problem = f"{plane.beam} is larger than the image"
        plane.beam = None
    if pixels:
        _load(plane, hdus, hdu, index, window or (slice(None), slice(None)))
    return plane


def _load(plane, hdus, hdu, index, window):
    """Add the pixels of a window, with mask and uncertainty, to the plane."""
    # Only these pixels are read if the file is mapped into memory.
    plane.data = np.array(hdu.data[index][window], dtype=np.float64)
    where = "" if plane.data.shape == plane.shape else " in this part"
    plane.mask, why = ~np.isfinite(plane.data), ", all are NaN"
    for name, is_bad in (("WHT", np.logical_not), ("MASK", np.asarray)):
        beside = _beside(hdus, hdu, name, plane.shape)
        if beside is not None and not plane.mask.all():
            plane.mask |= is_bad(beside.data[window]).astype(bool)
            why = f" by its extension {name}"
    if plane.mask.all():
        raise headers.ContentError(f"no valid pixel{where}{why}; leave this file out")
    if (beside := _beside(hdus, hdu, "UNCERT", plane.shape)) is not None:
        name, unit = (beside.header.get(key) for key in ("UTYPE", "BUNIT"))
        kind = UNCERTAINTIES.get(name, StdDevUncertainty)
        unit = None if unit is None else headers.parse_unit(unit)
        values = np.array(beside.data[window], dtype=float)
        plane.uncertainty = kind(values, unit=unit, copy=False)
    if where:
        plane.wcs = cut_wcs(plane.wcs, window)


def _beside(hdus, image, name, shape):
    """
    Return an extension of the image with its shape, or None.

    Drizzled HST images have weights, ``WHT``; astropy writes the mask and the
    uncertainty of a CCDData as ``MASK`` and ``UNCERT``.
    """
    for hdu in hdus:
        if hdu is not image and hdu.name == name and hdu.is_image:
            if hdu.shape == shape:
                return hdu
            if name != "WHT":
                raise headers.ContentError(
                    f"its extension {name} has shape {hdu.shape}, it {shape}; remove it"
                )
    return None


def _find(hdus):
    """Return the first image."""
    for hdu in hdus:
        if hdu.is_image and len(hdu.shape) >= 2 and 0 not in hdu.shape:
            return hdu
    if is_visibilities(hdus):
        raise _NoImageError(
            "holds visibilities and no image; make an image of them (difmap, CASA "
            "or AIPS), or give the models that were fitted to them (.mod)"
        )
    raise _NoImageError("holds no image")


def is_visibilities(hdus):
    """Return whether an open file is UVFITS or FITS-IDI."""
    return any(isinstance(h, fits.GroupsHDU) or h.name == "UV_DATA" for h in hdus)


def _check_complete(hdu, path):
    """Refuse a truncated file before memory is reserved for its missing pixels."""
    info = hdu.fileinfo()
    if info is None or info["file"].compression:
        return
    # A file may lack the zeros that fill its last block.  What a tile-compressed image
    # takes in the file is known with them only.
    packed = isinstance(hdu, fits.CompImageHDU)
    size = info["datSpan"] - BLOCK + 1 if packed else hdu.size
    missing = info["datLoc"] + size - path.stat().st_size
    if missing > 0:
        least = "at least " if packed else ""
        raise _NoImageError(
            f"is truncated, {least}{missing} bytes of its image are missing; "
            "copy the file again"
        )


def _plane_index(header):
    """Return the index of the image plane, in numpy's order of axes."""
    index = []
    for axis in range(header["NAXIS"], 0, -1):
        name = str(header.get(f"CTYPE{axis}", "")).upper().strip()
        length = header[f"NAXIS{axis}"]
        if headers.axis_kind(name):
            index.append(slice(None))
        elif length == 1:
            index.append(0)
        elif name.startswith("STOKES"):
            index.append(_stokes_i(header, axis, length))
        else:
            raise headers.ContentError(
                f"has {length} planes on axis {name or f'{axis} of the file'}; write "
                "the one to use, or their mean, to a file of its own"
            )
    return tuple(index)


def _stokes_i(header, axis, length):
    start, pixel, step = headers.axis_numbers(header, axis)
    if start is not None:
        position = (1 - start) / (step or 1) + pixel - 1
        if abs(position - round(position)) < 1e-6 and 0 <= round(position) < length:
            return round(position)
    raise headers.ContentError(
        f"has {length} planes on axis STOKES and none of them is I; write one to a file"
    )


def looks_like_mask(image):
    """Return whether an image has no more than two values that are finite."""
    values = np.asarray(image, dtype=float)
    # A few pixels usually show that there are more values.
    few = values.flat[:1000]
    if len(np.unique(few[np.isfinite(few)])) > 2:
        return False
    values = values[np.isfinite(values)]
    return values.size > 0 and np.isin(values, (values.min(), values.max())).all()


def uncertainty_noise(uncertainty, unit, mask):
    """
    Return the noise of an image whose pixels have uncertainties.

    The noise is the median standard deviation of the valid pixels, in the ``unit`` of
    the image, which is also assumed for an NDUncertainty without a unit.  The function
    also returns a mask of the pixels without a finite standard deviation, and whether
    the pixels differ little.  An uncertainty that cannot be used raises a ValueError.
    """
    kind, sigma = type(uncertainty).__name__, uncertainty
    if uncertainty.array is None:
        raise ValueError("its uncertainty has no values; remove it")
    try:
        with np.errstate(divide="ignore", invalid="ignore"):
            if not isinstance(uncertainty, StdDevUncertainty):
                sigma = uncertainty.represent_as(StdDevUncertainty)
        factor = 1.0 if sigma.unit is None else sigma.unit.to(unit)
    except TypeError:
        names = ", ".join(UNCERTAINTIES)
        raise ValueError(
            f"its uncertainty is of type {kind}; give it as {names}"
        ) from None
    except u.UnitConversionError:
        raise ValueError(
            f"its {kind} is in {uncertainty.unit}, which does not fit "
            f"images in {unit.to_string() or 'no unit'}; correct or remove it"
        ) from None
    if np.any(np.asarray(uncertainty.array) < 0):
        raise ValueError("its uncertainty has negative values; correct or remove it")
    sigma = np.broadcast_to(np.asarray(sigma.array) * factor, mask.shape)
    bad = ~np.isfinite(sigma)
    valid = sigma[~(mask | bad)]
    if valid.size == 0:
        raise ValueError("its uncertainty is finite at no valid pixel; remove it")
    noise = np.median(valid)
    even = valid.max() <= EVEN * noise and noise <= EVEN * valid.min()
    return noise * unit, bad, even
