# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Assembly of single images, from files or memory, into the fields of a cube."""

from pathlib import Path
from types import SimpleNamespace

import astropy.units as u
import numpy as np
from astropy.io.fits import HDUList
from astropy.nddata import NDData
from astropy.wcs.utils import pixel_to_pixel

from astro_scc.components.tables import LISTS, NO_IMAGE
from astro_scc.epochs.inspection import UNCHECKED, problems, separation
from astro_scc.epochs.serialize import planes_of
from astro_scc.exceptions import warn
from astro_scc.images import fits, grid, series
from astro_scc.images.beam import different_beam
from astro_scc.images.headers import as_celestial, get, read_header, some
from astro_scc.images.positions import readable_angle
from astro_scc.parallel import machine_memory
from astro_scc.quantities import check_choice, named

# Reference pixels further apart than this fraction of the image exceed the
# scatter of VLBI positions.
FAR = 0.05
#: Bytes of a pixel of a cube, with its mask.
BYTES = 9
# Pixel sides in one series differ from the usual side by at most this factor.
LARGEST_RATIO = 10.0
#: Pixels read around a part that is interpolated: the reach of the splines.
MARGIN = 4


def read_files(files, times, beams, frame, *, check, hdu, region, pad):
    """Return the fields of the cube in some files; see `EpochCube.read`."""
    given = _given(times, beams, len(files), frame)
    for path in files:
        if path.suffix.lower() in LISTS:
            raise ValueError(f"{path}: {NO_IMAGE}")
    names = [path.name for path in files]
    if len(set(names)) < len(names):
        names = [str(path) for path in files]
    windows = [None] * len(files)
    if region is not None:
        planes = [fits.read_plane(path, hdu=hdu, pixels=False) for path in files]
        dates = series.as_times(list(map(_observed, planes, given[0])), len(files))
        first = planes[int(np.argmin((dates - dates[0]).jd))]
        part, windows = windows_of(planes, first, frame, region, pad)

    def read():
        for path, name, window in zip(files, names, windows, strict=True):
            plane = fits.read_plane(path, hdu=hdu, window=window)
            plane.label, (ny, nx) = name, plane.data.shape
            if check and fits.looks_like_mask(plane.data):
                where = "" if window is None else " in this region"
                raise ValueError(
                    f"{path}: has no more than two different values{where}, it seems "
                    f"to be a mask; {UNCHECKED}"
                )
            # Before the machine is blocked by more than its memory holds.
            need = len(files) * ny * nx * BYTES
            if need > (have := machine_memory()):
                raise MemoryError(
                    f"{len(files)} images of {nx} x {ny} pixels are {need / 1e9:.3g} "
                    f"GB, this machine has {have / 1e9:.3g}; read a region of them "
                    "(region=, --crop)"
                )
            yield plane

    fields = _assemble(read(), *given, frame, check, f"{len(files)} FITS images")
    if region is not None:
        fields["meta"]["history"].append(grid.crop_line(part))
    return fields


def read_images(images, times, beams, frame, *, check):
    """Return the fields of a cube of images; see `EpochCube.from_ccddata`."""
    given = _given(times, beams, len(images), frame)
    planes = map(_plane_of, range(len(images)), images, *given)
    return _assemble(planes, *given, frame, check, f"{len(images)} images")


def _plane_of(i, image, time, beam):
    """Return an image in memory as `Plane`."""
    if isinstance(image, fits.Plane):
        return image
    name = f"image {i}"
    with series.naming(name):
        if hasattr(image, "extra_coords"):
            (plane, *others), _ = planes_of(image, time, beam)
            if others:
                raise ValueError(
                    f"is an NDCube of {1 + len(others)} epochs; give it to from_ndcube"
                )
            plane.name = name
        elif isinstance(image, NDData):
            plane = _plane_of_nddata(image, name)
        elif getattr(getattr(image, "hdu", None), "is_image", False):
            plane = fits.plane_of(HDUList([image.hdu]), None, Path(name))
        else:
            plane = None
    if plane is None:
        kind = type(image).__name__
        raise TypeError(f"{name}: is a {kind}; give NDData, such as CCDData")
    if plane.beam is beam is None and getattr(image, "psf", None) is not None:
        warn(f"{name}: its psf is an image, of which no beam is made; give beams=")
    plane.label = plane.label or get(image.meta, "LABEL", kind=str)
    return plane


def _plane_of_nddata(image, name):
    data = series.as_numbers(np.ma.getdata(image.data))
    mask = ~np.isfinite(data)
    if image.mask is not None:
        mask |= np.asarray(image.mask, dtype=bool)
    if data.ndim < 2 or np.prod(data.shape[:-2]) != 1:
        raise ValueError(f"has shape {data.shape}, an image has two axes")
    if mask.all():
        raise ValueError("no valid pixel; leave it out")
    if image.wcs is None:
        raise ValueError("it has no WCS; use EpochCube.from_arrays")
    own, shape = read_header(image.meta), data.shape[-2:]
    own |= {"data": data.reshape(shape), "mask": mask.reshape(shape), "shape": shape}
    own |= {"unit": image.unit or u.one, "uncertainty": image.uncertainty}
    return fits.Plane(name=name, wcs=as_celestial(image.wcs), **own)


def _given(times, beams, n, frame):
    """Return the dates and beams that the user gives, None where there is none."""
    named("frame", check_choice, frame, "offset", "absolute")
    if n == 0:
        raise ValueError("a cube needs at least one image")
    if isinstance(times, str) or not np.iterable(times):
        times = [None] * n if times is None else [times]
    times = [t if t is None else series.as_times(t, 1)[0] for t in times]
    if len(times) != n:
        raise ValueError(f"{n} images need {n} times, got {len(times)}")
    return times, series.as_beams(beams, n) or [None] * n


def _observed(plane, time):
    """Return the given date, or that of the header."""
    if time is None and plane.time is None:
        problem = plane.date_problem or (
            "no date of observation (DATE-OBS, MJD-OBS); write DATE-OBS to its header, "
            "or give times= in Python"
        )
        raise ValueError(f"{plane.name}: {problem}")
    return plane.time if time is None else time


def _completed(planes, times, beams):
    """Return images by date, and their dates, with what is given and their noise."""
    every, remarks = [], {}
    for plane, time, beam in zip(planes, times, beams, strict=True):
        plane.time = _observed(plane, time)
        own, notes = plane.beam, []
        if beam is not None:
            if beam.major.to_value(u.deg) > plane.extent:
                raise ValueError(
                    f"{plane.name}: the beam that is given, {beam}, is larger than the "
                    "image; give another"
                )
            plane.beam, plane.beam_problem = beam, ""
            if own is not None and different_beam((beam, own)):
                notes = [f"the beam that is given, {beam}, replaces that of the header"]
        for note in plane.notes + notes:
            remarks.setdefault(note, []).append(plane.label or plane.name)
        if plane.uncertainty is not None:
            with series.naming(plane.name):
                plane.noise, bad, plane.even = fits.uncertainty_noise(
                    plane.uncertainty, plane.unit, plane.mask
                )
            plane.mask |= bad
            plane.uncertainty = None
        every.append(plane)
    for note, names in remarks.items():
        warn(f"{some(names)}: {note}")
    times = series.as_times([plane.time for plane in every], len(every))
    order = series.order_of(times)
    return [every[i] for i in order], times[order]


def _refuse_strangers(planes, frame, check):
    """Refuse images that do not belong together, or warn of them."""
    first, peaks = planes[0], np.zeros(len(planes))
    for i, plane in enumerate(planes):
        if plane.unit.is_equivalent(first.unit):
            peak = np.max(plane.data, where=~plane.mask, initial=-np.inf)
            peaks[i] = peak * plane.unit.to(first.unit)
    for i, what, advice, refused in problems(planes, peaks, check):
        text = f"{planes[i].name}: {what}; {advice}"
        if refused:
            raise ValueError(text)
        warn(text)
    distance = [separation(plane.wcs, first.wcs) for plane in planes]
    k = int(np.argmax(distance))
    if frame == "offset" and distance[k] > FAR * max(first.extent, planes[k].extent):
        warn(
            f"{first.name} and {planes[k].name}: their reference pixels are "
            f"{distance[k] * 3600:.4g} arcsec apart on the sky and are taken for one "
            "place; use frame='absolute' (--align wcs) where the coordinates are "
            "to be trusted"
        )


def _assemble(planes, times, beams, frame, check, source):
    """Return the fields of a cube from images on their own grids."""
    planes, times = _completed(planes, times, beams)
    _refuse_strangers(planes, frame, check)
    unit = planes[0].unit
    for plane in planes:
        if (factor := plane.unit.to(unit)) != 1:
            plane.data = plane.data * factor
            plane.noise = None if plane.noise is None else plane.noise.to(unit)
    fields, resampled = lay_on_one_grid(planes, frame, unit)
    if resampled:
        ny, nx = fields["data"].shape[1:]
        given = any(plane.noise is not None for plane in planes)
        anew = ", and the noise of all is measured anew" if given else ""
        warn(
            f"{some(resampled)}: on another grid than the finest and therefore "
            f"resampled to it; all are {nx} x {ny} pixels, masked outside each image"
            f"{anew}; leave it out if you do not want that"
        )
    advice = (
        f"{fits.CORRECT_BEAM}, give one of all (--beam, in Python beams=), or leave it "
        "out (check=False reads all without beams)"
    )
    beams = _all_or_none(planes, "beam", advice, refused=check)
    advice = "that of all is measured; give every image an uncertainty"
    noise = None if resampled else _all_or_none(planes, "noise", advice)
    uneven = [plane.name for plane in planes if not plane.even]
    if uneven and noise:
        warn(
            f"{some(uneven)}: its uncertainty differs from pixel to pixel, and the "
            "median is taken for the noise; leave it out to have the noise measured"
        )
    labels = tuple(plane.label for plane in planes)
    labels = labels if all(labels) else series.date_labels(times)
    names = {plane.facts.get("object") for plane in planes} - {None}
    meta = {"object": names.pop()} if len(names) == 1 else {}
    laid = "reference pixels" if frame == "offset" else "absolute coordinates"
    meta["history"] = [f"{source}, aligned on their {laid}"]
    fields |= {"times": times, "unit": unit, "labels": labels, "meta": meta}
    fields |= {"beams": beams and tuple(beams), "noise": noise and u.Quantity(noise)}
    return fields | {"epoch_meta": tuple(plane.facts for plane in planes)}


def _all_or_none(planes, what, advice, refused=False):
    """Return the beams or noise of all images, or None; it is odd if some have one."""
    values = [getattr(plane, what) for plane in planes]
    missing = [p.name for p, v in zip(planes, values, strict=True) if v is None]
    if not missing:
        return values
    if len(missing) < len(planes):
        text = f"{some(missing)}: no {what} where other epochs have one; {advice}"
        if refused:
            raise ValueError(text)
        warn(text)
    return None


def windows_of(planes, first, frame, region, pad=0):
    """
    Return rows and columns of a region in the image ``first``, and in every image.

    ``region`` and ``pad``, as in `~astro_scc.epochs.EpochCube.crop`, refer to the image
    ``first``.  The windows of the other images hold the same part of the sky, or of the
    offsets, and slightly more if images are not whole pixels apart.  An image without
    a pixel in the region raises a ValueError.
    """
    own, *frames = [_in_frame(plane.wcs, frame) for plane in (first, *planes)]
    shifts, windows = [], []
    for step, pure in (grid.grid_step(own, wcs, first.shape) for wcs in frames):
        whole = pure and np.all(np.abs(step - np.rint(step)) < grid.ONE_SHIFT)
        shifts.append(np.rint(step) if whole else None)
    cube = SimpleNamespace(shape=(1, *first.shape), wcs=first.wcs)
    window = grid.box(cube, region, pad)
    if any(shift is None for shift in shifts):
        # Interpolation is worst at the edges.
        window = grid.box(cube, region, pad + MARGIN)
    (y0, y1), (x0, x1) = ((part.start, part.stop - 1) for part in window)
    corners = np.array([[x0, x1, x0, x1], [y0, y0, y1, y1]], dtype=float)
    for plane, wcs, shift in zip(planes, frames, shifts, strict=True):
        if shift is None:
            there = np.array(pixel_to_pixel(own, wcs, *corners))
        else:
            there = corners + shift[:, None]
        low, high = np.floor(there.min(axis=1)), np.ceil(there.max(axis=1))
        size = np.array(plane.shape[::-1])
        if not (np.all(low < size) and np.all(high >= 0)):
            raise ValueError(
                f"{plane.name}: nothing of the region lies in it; leave it out"
            )
        start = np.maximum(low, 0).astype(int)
        stop = np.minimum(high, size - 1).astype(int) + 1
        windows.append(tuple(map(slice, start[::-1].tolist(), stop[::-1].tolist())))
    return window, windows


def lay_on_one_grid(planes, frame, unit):
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
    unit : `~astropy.units.Unit`
        Unit of all of them.

    Returns
    -------
    fields : dict
        ``data``, ``mask``, ``wcs`` and ``epoch_wcs`` of an EpochCube.
    resampled : list of str
        Names of the images that were interpolated.
    """
    frames, resampled = [_in_frame(plane.wcs, frame) for plane in planes], []
    sizes = [grid.pixel_area(plane.wcs) ** 0.5 for plane in planes]
    usual = np.sort(sizes)[(len(sizes) - 1) // 2]
    grids = [(p.data.shape, wcs) for p, wcs in zip(planes, frames, strict=True)]
    for plane, size, one in zip(planes, sizes, grids, strict=True):
        # The finest grid would be huge otherwise.
        if not usual / LARGEST_RATIO <= size <= usual * LARGEST_RATIO:
            raise ValueError(
                f"{plane.name}: its pixels are {readable_angle(size * u.deg)} where "
                f"others are {readable_angle(usual * u.deg)}; leave it out"
            )
        try:
            grid.shared_grid([grids[0], one])
        except ValueError:
            raise ValueError(
                f"{plane.name}: lies too far from {planes[0].name} to share a grid "
                "with it, by its coordinates; leave one of them out"
            ) from None
    new, shape = grid.shared_grid(grids)
    own = [new] * len(planes)
    if frame == "offset":
        names = ("crval", "radesys", "equinox", "lonpole", "latpole")
        inner = [plane.wcs.wcs for plane in planes]
        own = [_with(new, w.ctype, **{n: getattr(w, n) for n in names}) for w in inner]
    data = np.empty((len(planes), *shape))
    mask = np.empty(data.shape, dtype=bool)
    for i, (plane, wcs) in enumerate(zip(planes, frames, strict=True)):
        one = slice(i, i + 1)
        options = {"shape": shape, "unit": unit, "near": grid.ONE_SHIFT}
        data[one], mask[one], copied = grid.regrid(
            plane.data[None], plane.mask[None], wcs, new, **options
        )
        resampled += [] if copied else [plane.name]
        plane.data = plane.mask = None
    fields = {"data": data, "mask": mask, "wcs": own[0], "epoch_wcs": tuple(own)}
    return fields, resampled


def _in_frame(wcs, frame):
    """Return a WCS; for offsets, one with its reference pixel at (0, 0)."""
    if frame == "absolute":
        return wcs
    return _with(wcs, ("RA---", "DEC--"), crval=(0, 0), radesys="ICRS", equinox=np.nan)


def _with(wcs, axes, **values):
    """Return a copy of a WCS with other axis names and frame values."""
    changed = wcs.deepcopy()
    codes = zip(axes, wcs.wcs.ctype, strict=True)
    values["ctype"] = [name[:5] + code[5:] for name, code in codes]
    for name, value in values.items():
        setattr(changed.wcs, name, value)
    changed.wcs.set()
    return changed
