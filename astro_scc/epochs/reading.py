# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Assembly of single images, from files or memory, into the fields of a cube."""

import os
import sys
import warnings
from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace

import astropy.units as u
import numpy as np
from astropy.nddata import NDData
from astropy.time import Time
from astropy.wcs.utils import pixel_to_pixel

from astro_scc.correlation.parallel import machine_memory
from astro_scc.epochs import inspection, validation
from astro_scc.epochs.cutout import box, crop_line
from astro_scc.epochs.fits import (
    CORRECT_BEAM,
    Plane,
    beam_note,
    looks_like_mask,
    plane_of_hdu,
    read_plane,
)
from astro_scc.epochs.grid import ONE_SHIFT, pixel_area, regrid, shared_grid
from astro_scc.epochs.headers import get, read_header, some
from astro_scc.epochs.positions import readable_angle
from astro_scc.exceptions import EpochWarning

FRAMES = ("offset", "absolute")
# Reference pixels further apart than this fraction of the image exceed the
# scatter of VLBI positions.
FAR = 0.05
#: Bytes of a pixel of a cube, with its mask.
BYTES = 9
# Pixel sides in one series differ from the usual side by at most this factor.
LARGEST_RATIO = 10.0
#: Pixels read around a part that is interpolated: the reach of the splines.
MARGIN = 4


def read_files(files, *, frame, times, beams, hdu, check, region=None, pad=0):
    """Return the fields of the cube in some files; see `EpochCube.read`."""
    times, beams = _given(times, beams, len(files), frame)
    names = [path.name for path in files]
    if len(set(names)) < len(names):
        names = [str(path) for path in files]

    windows = [None] * len(files)
    if region is not None:
        planes = [read_plane(path, hdu=hdu, pixels=False) for path in files]
        dates = validation.as_times(list(map(_observed, planes, times)), len(files))
        first = planes[int(np.argmin((dates - dates[0]).jd))]
        part, windows = windows_of(planes, first, frame, region, pad)
    remarks, epochs = {}, []
    for path, name, time, beam, window in zip(
        files, names, times, beams, windows, strict=True
    ):
        plane = read_plane(path, hdu=hdu, window=window)
        for note in plane.notes:
            if beam is None or not note.startswith("its beam"):
                remarks.setdefault(note, []).append(name)
        if check and looks_like_mask(plane.data):
            where = "" if window is None else " in this region"
            raise ValueError(
                f"{path}: has no more than two different values{where}, it seems to be "
                "a mask; leave it out (in Python, check=False reads it)"
            )
        epochs.append(_epoch(plane, time, beam, name))
        if len(epochs) == 1:
            _refuse_too_many(plane.data.shape, len(files))
    for note, where in remarks.items():
        _warn(f"{some(where)}: {note}")
    fields = _assemble(epochs, frame, check, f"{len(files)} FITS images")
    if region is not None:
        fields["meta"]["history"].append(crop_line(part))
    return fields


def _refuse_too_many(shape, n):
    """Refuse more images than the memory holds, before the machine is blocked."""
    need = n * np.prod(shape, dtype=float) * BYTES
    have = machine_memory()
    if need > have:
        ny, nx = shape
        raise MemoryError(
            f"{n} images of {nx} x {ny} pixels are {need / 1e9:.3g} GB, this machine "
            f"has {have / 1e9:.3g}; read a region of them (region=, --crop)"
        )


def read_images(images, *, times, beams, frame, check):
    """Return the fields of a cube of images; see `EpochCube.from_ccddata`."""
    images = [images] if isinstance(images, NDData) else list(images)
    times, beams = _given(times, beams, len(images), frame)
    epochs = []
    for i, (image, time, beam) in enumerate(zip(images, times, beams, strict=True)):
        name = f"image {i}"
        if hasattr(image, "extra_coords"):
            # Imported by name: a subpackage above this one.
            room = import_module("astro_scc.interchange")
            cube = room.from_ndcube(image, times=time, beams=beam)
            if len(cube) > 1:
                raise ValueError(
                    f"{name}: is an NDCube of {len(cube)} epochs; give it alone to "
                    "EpochCube.from_ndcube"
                )
            image = cube[0]
        if isinstance(image, NDData):
            plane = _plane_of_nddata(image, name)
        elif getattr(getattr(image, "hdu", None), "is_image", False):
            plane = plane_of_hdu(image.hdu, name)
        else:
            raise TypeError(
                f"{name}: is a {type(image).__name__}; give NDData, such as CCDData, "
                "or images of spectral-cube"
            )
        if beam is None and plane.record.beam_problem:
            _warn(f"{name}: {plane.notes[-1]}")
        epochs.append(_epoch(plane, time, beam, get(image.meta, "LABEL", kind=str)))
        if plane.record.beam is None and getattr(image, "psf", None) is not None:
            _warn(f"{name}: its psf is an image, of which no beam is made; give beams=")
    return _assemble(epochs, frame, check, f"{len(images)} images")


def _plane_of_nddata(image, name):
    data = np.ma.getdata(image.data)
    mask = ~np.isfinite(data)
    if image.mask is not None:
        mask |= np.asarray(image.mask, dtype=bool)
    if data.ndim < 2 or np.prod(data.shape[:-2]) != 1:
        raise ValueError(f"{name}: has shape {data.shape}, an image has two axes")
    if mask.all():
        raise ValueError(f"{name}: no valid pixel; leave it out")
    if image.wcs is None:
        raise ValueError(f"{name}: it has no WCS; use EpochCube.from_arrays")
    try:
        wcs = validation.as_celestial(image.wcs)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: {error}") from None
    shape, record = data.shape[-2:], read_header(image.meta)
    plane = Plane(name, wcs, shape, record, image.meta)
    plane.data, plane.mask = data.reshape(shape), mask.reshape(shape)
    plane.unit = image.unit or u.dimensionless_unscaled
    plane.uncertainty = image.uncertainty
    if record.beam_problem:
        plane.notes.append(beam_note(record.beam_problem))
    return plane


def _given(times, beams, n, frame):
    """Return the dates and beams that the user gives, None where there is none."""
    if frame not in FRAMES:
        raise ValueError(f"frame must be 'offset' or 'absolute', got {frame!r}")
    if n == 0:
        raise ValueError("a cube needs at least one image")
    if times is None:
        times = [None] * n
    elif isinstance(times, str) or (isinstance(times, Time) and times.isscalar):
        times = [times]
    times = [t if t is None else validation.as_times(t, 1)[0] for t in times]
    if len(times) != n:
        raise ValueError(f"{n} images need {n} times, got {len(times)}")
    return times, validation.as_beams(beams, n) or [None] * n


def _observed(plane, time):
    """Return the given date, or that of the header."""
    if time is not None or plane.record.time is not None:
        return plane.record.time if time is None else time
    problem = plane.record.date_problem or (
        "no date of observation (DATE-OBS, MJD-OBS); write DATE-OBS to its header, or "
        "give times= in Python"
    )
    raise ValueError(f"{plane.name}: {problem}")


def _epoch(plane, time, beam, label):
    """Return a plane with given values; pixels without finite uncertainty are bad."""
    record = replace(plane.record, time=_observed(plane, time))
    plane.record = record if beam is None else replace(record, beam=beam)
    plane.label = label
    if plane.uncertainty is not None:
        try:
            plane.noise, bad, plane.even = validation.uncertainty_noise(
                plane.uncertainty, plane.unit, plane.mask
            )
        except ValueError as error:
            raise ValueError(f"{plane.name}: {error}") from None
        plane.mask |= bad
        plane.uncertainty = None
    return plane


def _assemble(planes, frame, check, source):
    """Return the fields of a cube from images on their own grids."""
    times = validation.as_times([plane.record.time for plane in planes], len(planes))
    order = np.argsort((times - times[0]).jd, kind="stable")
    planes, times = [planes[i] for i in order], times[order]
    for i, k in inspection.find_same_dates(times):
        _warn(
            f"{planes[i].name} and {planes[k].name} are both of {times[i].isot[:10]}; "
            "leave one out if it is a stack or another image of the same data"
        )
    for i, what, fatal in inspection.find_odd(planes) if check else ():
        what = f"{planes[i].name}: {what}; leave it out"
        if fatal:
            raise ValueError(f"{what} (in Python, check=False reads it)")
        _warn(f"{what} if it is another object")
    _convert(planes)
    if frame == "offset":
        _warn_of_distances(planes)
    fields, resampled = lay_on_one_grid(planes, frame)
    if resampled:
        ny, nx = fields["data"].shape[1:]
        given = any(plane.noise is not None for plane in planes)
        anew = ", and the noise of all is measured anew" if given else ""
        _warn(
            f"{some(resampled)}: on another grid than the finest and therefore "
            f"resampled to it; all are {nx} x {ny} pixels, masked outside each image"
            f"{anew}; leave it out if you do not want that"
        )
    facts = [plane.record.facts for plane in planes]
    labels = [plane.label for plane in planes]
    names = {fact.get("object") for fact in facts} - {None}
    laid = "reference pixels" if frame == "offset" else "absolute coordinates"
    meta = {"object": names.pop()} if len(names) == 1 else {}
    otherwise = f"the cube has none; {CORRECT_BEAM}, or give beams= in Python"
    beams = [plane.record.beam for plane in planes]
    return {
        **fields,
        "times": times,
        "unit": planes[0].unit,
        "beams": _all_or_none(planes, "beam", beams, otherwise),
        "noise": None if resampled else _all_noise(planes),
        "labels": labels if all(labels) else (),
        "epoch_meta": facts,
        "meta": {**meta, "history": [f"{source}, aligned on their {laid}"]},
    }


def _convert(planes):
    """Convert all images to the unit of the first one."""
    first = planes[0]
    for plane in planes:
        if not plane.unit.is_equivalent(first.unit):
            own, other = (p.unit.to_string() or "none" for p in (plane, first))
            raise ValueError(
                f"{plane.name}: its unit is {own}, that of {first.name} is {other}; "
                "leave one out"
            )
        factor = plane.unit.to(first.unit)
        if factor != 1:
            plane.data, plane.unit = plane.data * factor, first.unit
            plane.noise = None if plane.noise is None else plane.noise.to(first.unit)


def _warn_of_distances(planes):
    first = planes[0]
    distance = [inspection.separation(plane.wcs, first.wcs) for plane in planes]
    k = int(np.argmax(distance))
    if distance[k] > FAR * max(first.extent, planes[k].extent):
        _warn(
            f"{first.name} and {planes[k].name}: their reference pixels are "
            f"{distance[k] * 3600:.4g} arcsec apart on the sky and are taken for one "
            "place; use frame='absolute' (--align wcs) where the coordinates are "
            "to be trusted"
        )


def _all_or_none(planes, what, values, otherwise):
    """Return the values of all images, or None, with a warning if some have one."""
    missing = [p.name for p, v in zip(planes, values, strict=True) if v is None]
    if not missing:
        return values
    if len(missing) < len(planes):
        other = f"no {what} where other epochs have one"
        _warn(f"{some(missing)}: {other}, so {otherwise}")
    return None


def _all_noise(planes):
    """Return the noise of all images from their uncertainties, if all have them."""
    otherwise = "that of all is measured; give every image an uncertainty"
    noise = [plane.noise for plane in planes]
    noise = _all_or_none(planes, "noise", noise, otherwise)
    uneven = [plane.name for plane in planes if not plane.even]
    if uneven and noise:
        _warn(f"{some(uneven)}: {validation.UNEVEN}")
    return None if noise is None else u.Quantity(noise)


def _warn(message):
    """Warn the first caller outside this subpackage."""
    here = os.path.dirname(__file__) + os.sep
    level, frame = 1, sys._getframe(0)
    while frame and frame.f_code.co_filename.startswith(here):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, EpochWarning, stacklevel=level)


def windows_of(planes, first, frame, region, pad=0):
    """
    Return rows and columns of a region in the image ``first``, and in every image.

    ``region`` and ``pad``, as in `~astro_scc.epochs.EpochCube.crop`, refer to the image
    ``first``.  The windows of the other images hold the same part of the sky, or of the
    offsets, and slightly more if images are not whole pixels apart.  An image without
    a pixel in the region raises a ValueError.
    """
    cube = SimpleNamespace(shape=(1, *first.shape), wcs=first.wcs)
    window = box(cube, region, pad)
    steps = []
    for plane in planes:
        corners, moved = _corners(window, first, plane, frame)
        whole = np.rint((moved - corners)[:, :1])
        # NaN, from beyond the horizon of a projection, is not whole either.
        is_whole = np.all(np.abs(moved - corners - whole) < ONE_SHIFT)
        steps.append(whole if is_whole else None)
    if any(step is None for step in steps):
        # Interpolation is worst at the edges.
        window = box(cube, region, pad + MARGIN)
    windows = []
    for plane, step in zip(planes, steps, strict=True):
        corners, moved = _corners(window, first, plane, frame)
        moved = moved if step is None else corners + step
        low, high = np.floor(moved.min(axis=1)), np.ceil(moved.max(axis=1))
        size = np.array(plane.shape[::-1])
        if not (np.all(low < size) and np.all(high >= 0)):
            raise ValueError(
                f"{plane.name}: nothing of the region lies in it; leave it out, or "
                "read all of the images"
            )
        start = np.maximum(low, 0).astype(int)
        stop = np.minimum(high, size - 1).astype(int) + 1
        windows.append(tuple(map(slice, start[::-1].tolist(), stop[::-1].tolist())))
    return window, windows


def _corners(window, first, other, frame):
    """Return the corners (x, y) of a window, in its own image and in another one."""
    (y0, y1), (x0, x1) = ((part.start, part.stop - 1) for part in window)
    corners = np.array([[x0, x1, x0, x1], [y0, y0, y1, y1]], dtype=float)
    frames = (_in_frame(plane.wcs, frame) for plane in (first, other))
    return corners, np.array(pixel_to_pixel(*frames, *corners))


def lay_on_one_grid(planes, frame):
    """
    Place images on the finest of their grids, enlarged to hold all of them.

    Images on the same grid are stacked as they are; images whole pixels apart are
    shifted without interpolation; others are interpolated.  Pixels outside an image
    are masked.  A ValueError names an image whose pixels or position differ too much.

    Parameters
    ----------
    planes : sequence of `Plane`
    frame : {"offset", "absolute"}
        Align the images by their reference pixels or their celestial coordinates.

    Returns
    -------
    fields : dict
        ``data``, ``mask``, ``wcs`` and ``epoch_wcs`` of an EpochCube.
    resampled : list of str
        Names of the images that were interpolated.
    """
    first = planes[0]
    if all(_same_grid(first, plane, frame) for plane in planes):
        data, mask = _stacked(planes, "data"), _stacked(planes, "mask")
        own = [plane.wcs for plane in planes]
        return {"data": data, "mask": mask, "wcs": first.wcs, "epoch_wcs": own}, []
    _check_pixels(planes)
    frames = [_in_frame(plane.wcs, frame) for plane in planes]
    grid, shape = _shared_grid(planes, frames)
    data = np.empty((len(planes), *shape))
    mask = np.empty(data.shape, dtype=bool)
    resampled = []
    for i, (plane, wcs) in enumerate(zip(planes, frames, strict=True)):
        grids = {"wcs": wcs, "grid": grid, "shape": shape, "near": ONE_SHIFT}
        data[i : i + 1], mask[i : i + 1], copied = regrid(
            plane.data[None], plane.mask[None], unit=plane.unit, **grids
        )
        if not copied:
            resampled.append(plane.name)
    own = [grid] * len(planes)
    if frame == "offset":
        names = ("crval", "radesys", "equinox", "lonpole", "latpole")
        inner = [plane.wcs.wcs for plane in planes]
        own = [_with(grid, w.ctype, **{n: getattr(w, n) for n in names}) for w in inner]
    return {"data": data, "mask": mask, "wcs": own[0], "epoch_wcs": own}, resampled


def _stacked(planes, name):
    """Return the arrays of all images as one; each is freed once it is copied."""
    arrays = [getattr(plane, name) for plane in planes]
    every = np.empty((len(planes), *arrays[0].shape), dtype=np.result_type(*arrays))
    del arrays
    for i, plane in enumerate(planes):
        every[i] = getattr(plane, name)
        setattr(plane, name, every[i])
    return every


def _shared_grid(planes, frames):
    grids = [(p.data.shape, wcs) for p, wcs in zip(planes, frames, strict=True)]
    try:
        return shared_grid(grids)
    except ValueError:
        for plane, grid in zip(planes, grids, strict=True):
            try:
                shared_grid([grids[0], grid])
            except ValueError:
                raise ValueError(
                    f"{plane.name}: lies too far from {planes[0].name} to share a "
                    "grid with it, by its coordinates; leave one of them out"
                ) from None
        raise


def _check_pixels(planes):
    """Refuse pixel sizes so different that the finest grid would be huge."""
    sizes = [pixel_area(plane.wcs) ** 0.5 for plane in planes]
    usual = np.sort(sizes)[(len(sizes) - 1) // 2]
    for plane, size in zip(planes, sizes, strict=True):
        if not usual / LARGEST_RATIO <= size <= usual * LARGEST_RATIO:
            raise ValueError(
                f"{plane.name}: its pixels are {readable_angle(size * u.deg)} where "
                f"others are {readable_angle(usual * u.deg)}; leave it out"
            )


def _same_grid(one, other, frame):
    """Return whether shape, projection, pixels and reference pixel are the same."""
    a, b = one.wcs.wcs, other.wcs.wcs
    ny, nx = one.data.shape
    if other.data.shape != (ny, nx) or [*a.ctype] != [*b.ctype]:
        return False
    own = one.wcs.pixel_scale_matrix
    step = np.linalg.solve(own, other.wcs.pixel_scale_matrix - own)
    # The largest possible difference at the far corner of the image.
    largest = np.abs(step) @ [nx, ny] + np.abs(a.crpix - b.crpix)
    if np.any(largest > ONE_SHIFT):
        return False
    return frame == "offset" or (
        np.array_equal(a.crval, b.crval)
        and a.radesys == b.radesys
        and np.array_equal(a.equinox, b.equinox, equal_nan=True)
    )


def _in_frame(wcs, frame):
    """Return a WCS; for offsets, one with its reference pixel at (0, 0)."""
    if frame == "absolute":
        return wcs
    axes = "RA---", "DEC--"
    return _with(wcs, axes, crval=(0, 0), radesys="ICRS", equinox=np.nan)


def _with(wcs, axes, **values):
    """Return a copy of a WCS with other axis names and frame values."""
    changed = wcs.deepcopy()
    codes = zip(axes, wcs.wcs.ctype, strict=True)
    changed.wcs.ctype = [name[:5] + code[5:] for name, code in codes]
    for name, value in values.items():
        setattr(changed.wcs, name, value)
    changed.wcs.set()
    return changed
