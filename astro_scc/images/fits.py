# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""One FITS image of VLBI, CASA, HST and others."""

import glob
import gzip
import mmap
import os
import re
import warnings
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.nddata import NDUncertainty
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.exceptions import first_line
from astro_scc.images import grid, headers, pixels, positions
from astro_scc.images.beam import Beam, SeveralBeamsError, header_beam
from astro_scc.images.dates import axis_times, observing_time, time_axis

# Value of CREATOR that marks the files of EpochCube.write.
CUBE_CREATOR = "astro_scc EpochCube"
#: Advice for a beam that cannot be right.
CORRECT_BEAM = "write BMAJ, BMIN and BPA in degrees to its header"
#: Suffixes of text that is no list of components by its name.
TEXT = ".csv", ".tsv", ".asc", ".tab", ".tbl", ".xls", ".xlsx", ".vot", ".xml", ".tex"
#: What to do with a list in a form of its own, such as spots of masers.
AS_TABLE = (
    "a list of spots or components is read as .ecsv: with astropy, table = "
    "QTable.read(FILE, ...) with the columns epoch, flux, x and y, their units "
    "(table['x'].unit = 'mas'), and table.write('spots.ecsv')"
)
#: Of what Pan-STARRS stretches.
STRETCHED = (
    "its brightness is stretched by asinh (BSOFTEN, BOFFSET of Pan-STARRS); make it "
    "linear, BOFFSET + 2 BSOFTEN sinh(pixel / 1.0857362), and remove these keywords"
)
#: Longest side of an image in degrees: maps of the whole sky may have margins.
WHOLE_SKY = 600.0
#: Bytes of a block of a FITS file.
BLOCK = 2880
#: Cards that are of one image alone.
_OF_ONE = re.compile(r"(CTYPE|CRVAL|CRPIX|CDELT|CUNIT|CROTA|PC|CD)\d|B(UNIT|TYPE)$")
_AXES = re.compile(rb"NAXIS   = *(\d{4,})")


@dataclass(kw_only=True)
class Plane:
    """
    One image on its own grid, with the facts in its header, see `read_header`.

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
    beam_choice: str = ""
    bandwidth: float | None = None
    data: np.ndarray | None = None
    mask: np.ndarray | None = None
    unit: u.UnitBase = u.dimensionless_unscaled
    uncertainty: NDUncertainty | None = None
    noise: u.Quantity | None = None
    label: str | None = None
    remarks: list[str] = field(default_factory=list)

    @property
    def extent(self):
        """Size of the whole image in degrees."""
        sides = np.hypot(*self.wcs.pixel_scale_matrix) * self.shape[::-1]
        return float(np.max(sides))

    @property
    def beam_is_small(self):
        """Whether the beam is smaller than a pixel, but for rounding."""
        pixel = self.extent / max(self.shape)
        return self.beam is not None and self.beam.major.to_value(u.deg) < 0.99 * pixel

    @property
    def notes(self):
        """Advice on what in the header is not understood."""
        beam = f"its beam is taken as unknown: {self.beam_problem}; {CORRECT_BEAM}"
        notes = *self.remarks, self.beam_problem and beam, self.beam_choice
        return [note for note in notes if note]

    def take_uncertainty(self):
        """Make the uncertainty the noise, and mask the pixels without one."""
        if self.uncertainty is not None:
            found = pixels.uncertainty_noise(
                self.uncertainty, self.unit, self.data, self.mask
            )
            self.noise, bad, remark = found
            self.mask |= bad
            self.uncertainty = None
            self.remarks.append(remark)


def read_header(header, hdus=()):
    """
    Return what a FITS header or a dict tells about an image, by the fields of `Plane`.

    ``time`` (UTC) and ``beam`` are None if the header has none, or if they cannot be
    read; then ``date_problem`` and ``beam_problem`` say why.  ``facts`` are those of
    `headers.header_facts`.

    For the date see `observing_time`, of whose doubts ``remarks`` tell.  The beam is
    taken from ``BMAJ``, ``BMIN`` and ``BPA`` (degrees), else from an ``AIPS CG`` or
    ``BEAMS`` table among ``hdus``, else from the last ``CLEAN BMAJ=`` in the
    history; ``beam_choice`` says that a table has several and none is the image's.
    """
    found = {"time": None, "beam": None, "remarks": []}
    found["facts"] = headers.header_facts(header)
    try:
        found["time"], remark = observing_time(header)
        found["remarks"].append(remark)
    except ValueError as error:
        found["date_problem"] = str(error)
    try:
        tables = [hdu for hdu in hdus if isinstance(hdu, fits.BinTableHDU)]
        found["beam"] = header_beam(header, tables)
    except SeveralBeamsError as error:
        found["beam_choice"] = str(error)
    except (KeyError, TypeError, ValueError) as error:
        found["beam_problem"] = str(error)
    return found


def find_files(paths, *, missing_ok=False):
    """
    Return the files that paths and patterns stand for, each once, as a list of Path.

    They are in the order given; those of a pattern are in alphabetical order.  An
    image of a file may be chosen behind its name, ``file.fits[SCI,2]``.  Files that do
    not exist raise a FileNotFoundError, or are kept if ``missing_ok`` is True.
    """
    single = isinstance(paths, str | os.PathLike) or not np.iterable(paths)
    paths = [paths] if single else list(paths)
    if not all(isinstance(path, str | os.PathLike) for path in paths):
        raise TypeError(f"paths must be names or a pattern, got {paths!r}")
    found = []
    for name in (os.path.expanduser(os.fspath(path)) for path in paths):
        # Brackets are of a name, of a pattern or of a choice.
        for file, choice in ((name, None), pixels.split_choice(name)):
            if os.path.exists(file) or (missing_ok and not glob.has_magic(file)):
                matches = [file]
            else:
                matches = sorted(glob.glob(file, recursive=True))
                matches = [match for match in matches if not os.path.isdir(match)]
            if matches:
                behind = f"[{choice}]" if choice else ""
                found += [f"{match}{behind}" for match in matches]
                break
        else:
            what = "file matches this pattern" if glob.has_magic(name) else "such file"
            raise FileNotFoundError(f"{name}: no {what}")
    if not found:
        raise FileNotFoundError("no files were given")
    once = {}
    for name in found:
        path = once.setdefault(os.path.abspath(name), Path(name))
        if path.exists() and not (path.is_file() or path.is_dir()):
            # Pipes, sockets and devices may have no end.
            raise OSError(f"{path}: is no ordinary file; give the name of one")
    return list(once.values())


def file_of(path):
    """Return the file of a path, and the image that is chosen behind it, or None."""
    file, choice = (path, None) if path.exists() else pixels.split_choice(path)
    return Path(file), choice


def read_plane(path, *, window=None, load=True, frame=None, known=False):
    """
    Return the `Plane` of a FITS file of AIPS, difmap, CASA, HST or others.

    For the image that is read see `find_image`.  Axes of length one are dropped, and
    Stokes I is taken from several Stokes parameters, ``frame`` from an axis of time.
    ``window`` selects the rows and columns to load; without ``load`` only the header is
    read.  A ``known`` file was opened before.  A file that is missing, broken or holds
    no image raises an OSError; an image of more than two axes, without celestial
    coordinates or without a valid pixel a ValueError.
    """
    with opened(path, known=known) as hdus:
        return plane_of(hdus, path, window=window, load=load, frame=frame)


def frames_of(path):
    """Return the numbers of the images on an axis of time of a file, else [None]."""
    with opened(path) as hdus:
        header = pixels.find_image(hdus, path, file_of(Path(path))[1]).header
        axis = time_axis(header)
        n = header[f"NAXIS{axis}"] if axis else 1
        return [None] if n == 1 else range(n)


@contextmanager
def opened(path, *, known=False):
    """Open a FITS file; what is wrong with it, then or later, names it in one line."""
    path, _ = file_of(Path(path))
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if path.is_dir():
        raise IsADirectoryError(
            f"{path}: is a directory; give {path}/*.fits, or export a CASA image by "
            "exportfits"
        )
    if path.suffix.lower() in TEXT:
        raise pixels.NoImageError(f"{path}: is a table and no image; {AS_TABLE}")
    # AIPS and difmap files break minor rules of the standard throughout.
    with warnings.catch_warnings(action="ignore"):
        try:
            # astropy.io.fits does not close files that it fails to open.
            with path.open("rb") as file, open_fits(file, known=known) as hdus:
                yield hdus
        except (headers.ContentError, pixels.NoImageError) as error:
            raise type(error).__base__(f"{path}: {error}") from None
        except Exception as error:
            # A damaged file can fail anywhere inside astropy.io.fits.  The first
            # sentence gives the reason; the rest is advice for callers of astropy.
            reason = re.split(r"[.,;:] ", first_line(error))[0]
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
            raise pixels.NoImageError(f"is broken, it claims {found[1].decode()} axes")
        file.seek(0)
    return fits.open(file, **options)


def plane_of(hdus, path, *, window=None, load=True, frame=None):
    """Return the `Plane` of an open file, see `read_plane`."""
    _refuse_whole(hdus[0].header)
    file, choice = file_of(Path(path))
    hdu = pixels.find_image(hdus, path, choice)
    header = hdu.header.copy()
    if hdu is not hdus[0]:
        header.extend(_inherited(hdus[0], hdu), unique=True, bottom=True)
    _check_complete(hdu, file)
    unit, remark = _unit_of(header)
    wcs = headers.celestial_wcs(header, fobj=hdus)
    index = pixels.plane_index(header, frame)
    shape = tuple(n for n, i in zip(hdu.shape, index, strict=True) if i == slice(None))
    record = read_header(header, hdus)
    record["remarks"] += [remark, headers.contradicting_matrices(header)]
    plane = Plane(name=labelled(path, frame), wcs=wcs, shape=shape, unit=unit, **record)
    if plane.extent > WHOLE_SKY:
        raise headers.ContentError(
            f"its sides are {plane.extent:.3g} deg by CDELT or CD; correct these, or "
            "write their unit, such as arcsec, to CUNIT1 and CUNIT2"
        )
    plane.bandwidth = headers.bandwidth(header)
    if (axis := time_axis(header)) is not None:
        try:
            plane.time = axis_times(header, axis, hdus)[frame or 0]
        except ValueError as error:
            if frame is not None:
                raise headers.ContentError(str(error)) from None

    if plane.beam is not None and plane.beam.major.to_value(u.deg) > plane.extent:
        plane.beam_problem = f"{plane.beam} is larger than the image"
        plane.beam = None
    if load:
        _load(plane, hdus, hdu, index, window or (slice(None), slice(None)))
        shape = plane.data.shape
    plane.wcs = positions.unwrapped(plane.wcs, shape)
    return plane


def _unit_of(header):
    """Return the unit of brightness, and a remark if it is not known; no logarithm."""
    text = headers.get(header, "BUNIT", kind=str)
    stretched = STRETCHED if {"BOFFSET", "BSOFTEN"} & {*header} else ""
    if problem := headers.logarithm(text) or stretched:
        raise headers.ContentError(problem)
    if (unit := headers.parse_unit(text)) is not None:
        return unit, ""
    return u.dimensionless_unscaled, (
        f"its unit {text!r} is not known and taken as dimensionless; write one that "
        "FITS knows, such as JY/BEAM, to BUNIT"
    )


def _refuse_whole(header):
    """Refuse what this package wrote that is more than an image."""
    if "SCCVERS" in header:
        what = header["CREATOR"].removeprefix("astro_scc ")
        reader = what if what == "EpochCube" else "SCCResult"
        raise headers.ContentError(f"is a whole {what}; give it alone to {reader}.read")


def labelled(name, frame):
    """Return the name of an image, with its number on an axis of time if any."""
    return str(name) if frame is None else f"{name}, image {frame + 1}"


def _inherited(primary, hdu):
    """Return the cards of the first header that may be those of a later image."""
    if not (headers.celestial_axes(hdu.header) and "NAXIS1" in primary.header):
        return primary.header
    # Coordinates and units of another image are not those of this one.
    cards = primary.header.cards
    return fits.Header([card for card in cards if not _OF_ONE.match(card.keyword)])


def _load(plane, hdus, hdu, index, window):
    """Add the pixels of a window, with mask and uncertainty, to the plane."""
    # Only these pixels are read if the file is mapped into memory.
    plane.data = np.array(hdu.data[index][window], dtype=np.float64)
    where = "" if plane.data.shape == plane.shape else " in this part"
    plane.mask, why = ~np.isfinite(plane.data), ", all are NaN"

    dates, telescope = time_axis(hdu.header), plane.facts.get("telescope", "").upper()
    # Extensions tell of one plane, or of those of all dates.
    shape = plane.shape if dates is None else hdu.shape

    def part(other):
        values = other.data.reshape(shape)
        return (values if dates is None else values[index])[window]

    remarks = []
    weights = pixels.beside(hdus, hdu, "weights", shape)
    for other in (*weights, *pixels.beside(hdus, hdu, "flags", shape)):
        if plane.mask.all():
            break
        bad, remark = ~(part(other) > 0), ""
        if other not in weights:
            bad, remark = pixels.flagged(part(other), plane.data, other.name, telescope)
        plane.mask |= bad
        remarks.append(remark)
        why = f" by its extension {other.name}"
    # What extensions mark needs no remark.
    plane.mask, remark = pixels.missing(plane.data, plane.mask)
    plane.remarks += [*remarks, remark]
    if plane.mask.all():
        raise headers.ContentError(f"no valid pixel{where}{why}; leave this file out")
    for other in pixels.beside(hdus, hdu, "uncertain", shape)[:1]:
        values = part(other)
        plane.uncertainty = pixels.uncertainty_of(other, values, plane.unit, plane.mask)
    if where:
        plane.wcs = grid.cut_wcs(plane.wcs, window)


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
        raise pixels.NoImageError(
            f"is truncated, {least}{missing} bytes of its image are missing; "
            "copy the file again"
        )


def looks_like_mask(image):
    """Return whether an image has no more than two values that are finite."""
    values = image[np.isfinite(image)]
    return values.size > 0 and np.isin(values, (values.min(), values.max())).all()
