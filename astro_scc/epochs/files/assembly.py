# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Single images, from files or in memory, put together to a cube."""

import glob
import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.nddata import NDData
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.epochs.beam import Beam
from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.cutout import crop_line
from astro_scc.epochs.files.consistency import (
    find_odd,
    find_same_dates,
    looks_like_mask,
)
from astro_scc.epochs.files.fits import (
    CORRECT_BEAM,
    as_image,
    check_ordinary,
    read_grid,
    read_image,
)
from astro_scc.epochs.files.gridding import FRAMES, lay_on_one_grid
from astro_scc.epochs.files.headers import header_beam, header_facts, observing_time
from astro_scc.epochs.files.windows import Grid, windows_of
from astro_scc.epochs.keywords import get
from astro_scc.epochs.validation import (
    UNEVEN,
    as_beams,
    as_celestial,
    as_times,
    uncertainty_noise,
)
from astro_scc.exceptions import EpochWarning

__all__ = ["cube_from_files", "cube_from_images", "find_files"]

# Reference pixels further apart than this part of the image are more than
# the scatter of VLBI positions.
FAR = 0.05
#: Of a pixel of a cube, with its mask.
BYTES = 9


@dataclass
class Plane:
    """One image on its own grid, with what its header says."""

    name: str
    data: np.ndarray
    mask: np.ndarray
    unit: u.UnitBase
    wcs: WCS
    time: Time
    beam: Beam | None
    facts: dict
    noise: u.Quantity | None = None
    even: bool = True
    label: str | None = None
    whole: tuple[int, int] | None = None

    @property
    def extent(self):
        """Size of the whole image, of which this may be a part, in degrees."""
        ny, nx = self.whole or self.data.shape
        return float(np.max(np.hypot(*self.wcs.pixel_scale_matrix) * [nx, ny]))


def find_files(paths, *, missing_ok=False):
    """
    Files that paths and patterns stand for, each once.

    Parameters
    ----------
    paths : str, path-like, or sequence of them
    missing_ok : bool
        Keep names of files that do not exist.

    Returns
    -------
    list of `~pathlib.Path`
        In the order given, those of a pattern in alphabetical order.

    Raises
    ------
    FileNotFoundError
        If a file does not exist or nothing matches a pattern.
    TypeError
        If something is not a path.
    """
    from astro_scc.epochs.interchange.casa import is_casa_image

    if isinstance(paths, str | os.PathLike):
        paths = [paths]
    try:
        names = [os.path.expanduser(os.fspath(path)) for path in paths]
    except TypeError:
        raise TypeError(
            f"paths must be file names or a pattern, got {paths!r}"
        ) from None
    found = []
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"paths must be text, got {name!r}")
        if os.path.exists(name):
            check_ordinary(name)
            found.append(name)
        elif glob.has_magic(name):
            matches = sorted(p for p in glob.glob(name, recursive=True))
            found += [m for m in matches if not os.path.isdir(m) or is_casa_image(m)]
            if not matches:
                raise FileNotFoundError(f"{name}: no file matches this pattern")
        elif missing_ok:
            found.append(name)
        else:
            raise FileNotFoundError(f"{name}: no such file")
    if not found:
        raise FileNotFoundError("no files were given")
    return [Path(name) for name in dict.fromkeys(found)]


def cube_from_files(paths, *, frame, times, beams, hdu, check, region=None, pad=0):
    """See `EpochCube.read`."""
    from astro_scc.epochs.files.serialize import is_cube_file, read_cube
    from astro_scc.epochs.interchange import is_hdf5, read_movie

    _check_frame(frame)
    files = find_files(paths)
    if len(files) == 1 and is_cube_file(files[0]):
        if times is not None or beams is not None or hdu is not None:
            raise ValueError(f"{files[0]}: an EpochCube; it has its dates and beams")
        return read_cube(files[0], region=region, pad=pad)
    if len(files) == 1 and is_hdf5(files[0]):
        if times is not None or hdu is not None:
            raise ValueError(f"{files[0]}: a movie; it has its dates, and no extension")
        movie = read_movie(files[0], beams=beams)
        return movie if region is None else movie.crop(region, pad=pad)
    times, beams = _given(times, beams, len(files))
    names = [path.name for path in files]
    if len(set(names)) < len(names):
        names = [str(path) for path in files]

    grids = windows = [None] * len(files)
    if region is not None:
        grids = [_grid(*item, hdu) for item in zip(files, times, strict=True)]
        first, windows = windows_of(grids, frame, region, pad)
    planes = []
    remarks = {}
    for path, name, time, beam, grid, window in zip(
        files, names, times, beams, grids, windows, strict=True
    ):
        image, notes = read_image(path, hdu=hdu, window=window)
        for note in notes:
            if not (beam is not None and note.startswith("its beam")):
                remarks.setdefault(note, []).append(name)
        if check and looks_like_mask(image.data):
            where = "" if window is None else " in this region"
            raise ValueError(
                f"{path}: has no more than two different values{where}, it seems to be "
                "a mask; leave it out (in Python, check=False reads it)"
            )
        planes.append(_plane(image, str(path), time, beam))
        planes[-1].label = name
        planes[-1].whole = grid and grid.shape
        if len(planes) == 1:
            _refuse_too_many(image.shape, len(files))
    for note, where in remarks.items():
        _warn(f"{_some(where)}: {note}")
    cube = _assemble(planes, frame, check, f"{len(files)} FITS images")
    return cube if region is None else cube.with_step(crop_line(first))


def _grid(path, time, hdu):
    """The pixels and the date of a file of which a part is wanted."""
    wcs, shape, header = read_grid(path, hdu=hdu)
    try:
        time = _observed(header) if time is None else time
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return Grid(str(path), wcs, shape, time)


def _refuse_too_many(shape, n):
    """Refuse what the machine cannot hold, before it comes to a standstill."""
    from astro_scc.correlation.workers import machine_memory

    need = n * np.prod(shape, dtype=float) * BYTES
    have = machine_memory()
    if need > have:
        ny, nx = shape
        raise MemoryError(
            f"{n} images of {nx} x {ny} pixels are {need / 1e9:.3g} GB, this machine "
            f"has {have / 1e9:.3g}; read a region of them (region=, --crop)"
        )


def cube_from_images(images, *, times, beams, frame, check):
    """See `EpochCube.from_ccddata`."""
    from astro_scc.epochs.interchange import from_ndcube

    _check_frame(frame)
    images = [images] if isinstance(images, NDData) else list(images)
    times, beams = _given(times, beams, len(images))
    planes = []
    for i, (image, time, beam) in enumerate(zip(images, times, beams, strict=True)):
        if hasattr(image, "extra_coords"):
            cube = from_ndcube(image, times=time, beams=beam)
            if len(cube) > 1:
                raise ValueError(
                    f"image {i}: is an NDCube of {len(cube)} epochs; give it alone to "
                    "EpochCube.from_ndcube"
                )
            image = cube[0]
        plane = _plane(as_image(image, f"image {i}"), f"image {i}", time, beam)
        plane.label = get(image.meta, "LABEL", kind=str)
        planes.append(plane)
    return _assemble(planes, frame, check, f"{len(images)} images")


def _check_frame(frame):
    if frame not in FRAMES:
        raise ValueError(f"frame must be 'offset' or 'absolute', got {frame!r}")


def _given(times, beams, n):
    """Dates and beams that the user gives, None where there is none."""
    if n == 0:
        raise ValueError("a cube needs at least one image")
    if times is None:
        times = [None] * n
    elif not isinstance(times, Time):
        times = [times] if isinstance(times, str) else list(times)
        times = [t if t is None else as_times([t], 1)[0] for t in times]
    elif times.isscalar:
        times = [times]
    if len(times) != n:
        raise ValueError(f"{n} images need {n} times, got {len(times)}")
    return times, as_beams(beams, n) or [None] * n


def _plane(image, name, time, beam):
    """An image with what its header says, errors and warnings with its name."""
    data = np.ma.getdata(image.data)
    mask = ~np.isfinite(data)
    if image.mask is not None:
        mask |= np.asarray(image.mask, dtype=bool)
    if data.ndim < 2 or np.prod(data.shape[:-2]) != 1:
        raise ValueError(f"{name}: has shape {data.shape}, an image has two axes")
    if mask.all():
        raise ValueError(f"{name}: no valid pixel; leave it out")
    try:
        if image.wcs is None:
            raise ValueError("it has no WCS; use EpochCube.from_arrays")
        wcs = as_celestial(image.wcs)
        time = _observed(image.meta) if time is None else time
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: {error}") from None
    if beam is None:
        try:
            beam = header_beam(image.meta)
        except ValueError as error:
            _warn(f"{name}: its beam is taken as unknown: {error}; {CORRECT_BEAM}")
    if beam is None and getattr(image, "psf", None) is not None:
        _warn(f"{name}: its psf is an image, of which no beam is made; give beams=")
    unit = image.unit or u.dimensionless_unscaled
    noise, even = None, True
    if image.uncertainty is not None:
        try:
            noise, bad, even = uncertainty_noise(image.uncertainty, unit, mask)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        mask |= bad
    return Plane(
        name=name,
        data=data.reshape(data.shape[-2:]),
        mask=mask.reshape(data.shape[-2:]),
        unit=unit,
        wcs=wcs,
        time=time,
        beam=beam,
        facts=header_facts(image.meta),
        noise=noise,
        even=even,
    )


def _observed(header):
    time = observing_time(header)
    if time is None:
        raise ValueError(
            "no date of observation (DATE-OBS, MJD-OBS); write DATE-OBS to its "
            "header, or give times= in Python"
        )
    return time


def _assemble(planes, frame, check, source):
    """A cube of images that are each on their own grid."""
    times = as_times([plane.time for plane in planes], len(planes))
    order = np.argsort((times - times[0]).jd, kind="stable")
    planes, times = [planes[i] for i in order], times[order]
    for i, k in find_same_dates(times):
        _warn(
            f"{planes[i].name} and {planes[k].name} are both of {times[i].isot[:10]}; "
            "leave one out if it is a stack or another image of the same data"
        )
    if check:
        _refuse_odd(planes)
    unit = planes[0].unit
    for plane in planes:
        try:
            factor = plane.unit.to(unit)
        except u.UnitConversionError:
            raise ValueError(
                f"{plane.name}: its unit is {plane.unit.to_string() or 'none'}, that "
                f"of {planes[0].name} is {unit.to_string() or 'none'}; leave one out"
            ) from None
        if factor != 1:
            plane.data = plane.data * factor
            plane.unit = unit
            plane.noise = None if plane.noise is None else plane.noise.to(unit)
    if frame == "offset":
        _warn_of_distances(planes)
    grid = lay_on_one_grid(planes, frame)
    if grid.resampled:
        ny, nx = grid.data.shape[1:]
        given = any(plane.noise is not None for plane in planes)
        anew = ", and the noise of all is measured anew" if given else ""
        _warn(
            f"{_some(grid.resampled)}: on another grid than the finest and therefore "
            f"resampled to it; all are {nx} x {ny} pixels, masked outside each image"
            f"{anew}; leave it out if you do not want that"
        )
    laid = "reference pixels" if frame == "offset" else "absolute coordinates"
    names = {plane.facts.get("object") for plane in planes} - {None}
    labelled = all(plane.label for plane in planes)
    return EpochCube(
        data=grid.data,
        times=times,
        wcs=grid.wcs,
        unit=unit,
        mask=grid.mask,
        beams=_all_or_none(
            planes,
            "beam",
            f"the cube has none; {CORRECT_BEAM}, or give beams= in Python",
        ),
        noise=None if grid.resampled else _all_noise(planes),
        labels=[plane.label for plane in planes] if labelled else (),
        epoch_wcs=grid.epoch_wcs,
        epoch_meta=[plane.facts for plane in planes],
        meta={
            **({"object": names.pop()} if len(names) == 1 else {}),
            "history": [f"{source}, laid on their {laid}"],
        },
    )


def _refuse_odd(planes):
    odd = find_odd(
        [plane.facts for plane in planes],
        [plane.wcs.wcs.crval for plane in planes],
        [plane.extent for plane in planes],
    )
    for i, what, fatal in odd:
        if fatal:
            raise ValueError(
                f"{planes[i].name}: {what}; leave it out (in Python, check=False "
                "reads it)"
            )
        _warn(f"{planes[i].name}: {what}; leave it out if it is another object")


def _warn_of_distances(planes):
    first = planes[0]
    lon, lat = np.array([plane.wcs.wcs.crval for plane in planes]).T
    east = (lon - lon[0] + 180) % 360 - 180
    distance = np.hypot(east * np.cos(np.radians(lat[0])), lat - lat[0])
    k = int(np.argmax(distance))
    if distance[k] > FAR * max(first.extent, planes[k].extent):
        _warn(
            f"{first.name} and {planes[k].name}: their reference pixels are "
            f"{distance[k] * 3600:.4g} arcsec apart on the sky and are laid on one "
            "another; use frame='absolute' (--align wcs) where the coordinates are "
            "to be trusted"
        )


def _all_or_none(planes, what, otherwise):
    """A value of every image, or else a warning that some have none."""
    values = [getattr(plane, what) for plane in planes]
    missing = [p.name for p, v in zip(planes, values, strict=True) if v is None]
    if missing and len(missing) < len(planes):
        _warn(
            f"{_some(missing)}: no {what} where other epochs have one, so {otherwise}"
        )
    return None if missing else values


def _all_noise(planes):
    """The noise of all images by their uncertainties, if they have them."""
    noise = _all_or_none(
        planes, "noise", "that of all is measured; give every image an uncertainty"
    )
    uneven = [plane.name for plane in planes if not plane.even]
    if uneven and noise:
        _warn(f"{_some(uneven)}: {UNEVEN}")
    return None if noise is None else u.Quantity(noise)


def _some(names):
    """The first names of a list that may be long."""
    names = [str(name) for name in names]
    if len(names) <= 3:
        return ", ".join(names)
    return f"{', '.join(names[:2])} and {len(names) - 2} more"


def _warn(message):
    warnings.warn(message, EpochWarning, stacklevel=_outside())


def _outside():
    """Stack level of the first caller outside the epochs."""
    import sys

    here = os.path.dirname(os.path.dirname(__file__)) + os.sep
    level = 1
    frame = sys._getframe(1)
    while frame and frame.f_code.co_filename.startswith(here):
        frame, level = frame.f_back, level + 1
    return level
