# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Assembly of single images, from files or memory, into the fields of a cube."""

from pathlib import Path
from types import SimpleNamespace

import astropy.units as u
import numpy as np
from astropy.io.fits import HDUList
from astropy.nddata import NDData
from astropy.time import Time
from astropy.wcs.utils import pixel_to_pixel

from astro_scc.epochs.inspection import NO_BEAM, UNCHECKED, far_away, problems
from astro_scc.epochs.serialize import AXIS, KEPT
from astro_scc.epochs.tables import LISTS, NO_IMAGE, first_names
from astro_scc.exceptions import naming, refusing, warn
from astro_scc.images import dates, fits, grid, positions, regions, series
from astro_scc.images.beam import Beam, different_beam
from astro_scc.images.headers import as_celestial, fits_wcs, get, logarithm, some
from astro_scc.images.pixels import missing
from astro_scc.images.positions import readable_angle
from astro_scc.parallel import machine_memory
from astro_scc.quantities import check_choice, named


def read_files(files, times, beams, frame, *, check, region, pad):
    """Return the fields of the cube in some files; see `EpochCube.read`."""
    for path in files:
        if path.suffix.lower() in LISTS:
            raise ValueError(f"{path}: {NO_IMAGE}")
    images = [(path, k) for path in files for k in fits.frames_of(path)]
    given = _given(times, beams, len(images), frame)
    names = [fits.labelled(path.name, k) for path, k in images]
    if len(set(names)) < len(names):
        names = [fits.labelled(path, k) for path, k in images]
    windows = [None] * len(images)
    if region is not None:
        planes = [fits.read_plane(path, load=False, frame=k) for path, k in images]
        days = dates.as_times(map(_observed, planes, given[0]), len(images))
        first = planes[days.argmin()]
        part, windows = windows_of(planes, first, frame, region, pad)

    def read():
        have = machine_memory()
        for (path, k), name, window in zip(images, names, windows, strict=True):
            plane = fits.read_plane(path, window=window, frame=k, known=True)
            plane.label = name
            if check and fits.looks_like_mask(plane.data):
                where = "" if window is None else " in this region"
                raise ValueError(
                    f"{path}: has no more than two different values{where}, it seems "
                    f"to be a mask; {UNCHECKED}"
                )
            _refuse_too_large(len(images), *plane.data.shape, have)
            yield plane

    fields = _assemble(read(), *given, frame, check, f"{len(images)} FITS images")
    if region is not None:
        fields["meta"]["history"].append(regions.crop_line(part))
    return fields


def _refuse_too_large(n, ny, nx, have):
    """Refuse images before the machine is blocked by more than its memory holds."""
    # Of float64, with masks.
    need = n * ny * nx * (8 + 1)
    if need > have:
        raise MemoryError(
            f"{n} images of {nx} x {ny} pixels are {need / 1e9:.3g} GB, this machine "
            f"has {have / 1e9:.3g}; read a region of them (region=, --crop)"
        )


def read_images(images, times, beams, frame, *, check):
    """Return the fields of a cube of images; see `EpochCube.from_ccddata`."""
    given = _given(times, beams, len(images), frame)
    planes = map(_plane_of, range(len(images)), images)
    return _assemble(planes, *given, frame, check, f"{len(images)} images")


def _plane_of(i, image):
    """Return an image in memory as `Plane`."""
    name, kind, hdu = f"image {i}", type(image).__name__, getattr(image, "hdu", None)
    if not (isinstance(image, NDData) or getattr(hdu, "is_image", False)):
        raise TypeError(f"{name}: is a {kind}; give NDData, such as CCDData")
    with naming(name):
        if isinstance(image, NDData):
            plane = _plane_of_nddata(image, name)
        else:
            plane = fits.plane_of(HDUList([hdu]), Path(name))
    plane.label = plane.label or get(image.meta, "LABEL", kind=str)
    return plane


def _plane_of_nddata(image, name):
    data = series.as_numbers(np.ma.getdata(image.data))
    if data.ndim < 2 or np.prod(data.shape[:-2]) != 1:
        raise ValueError(f"has shape {data.shape}, an image has two axes")
    shape = data.shape[-2:]
    mask = False if image.mask is None else np.asarray(image.mask, dtype=bool)
    mask = np.broadcast_to(mask, data.shape).reshape(shape)
    data = data.reshape(shape)
    mask, remark = missing(data, mask)
    if image.unit is not None and (problem := logarithm(image.unit)):
        raise ValueError(problem)
    if mask.all():
        raise ValueError("no valid pixel; leave it out")
    if image.wcs is None:
        raise ValueError("it has no WCS; use EpochCube.from_arrays")
    record = fits.read_header(image.meta)
    record["remarks"].append(remark)
    if hasattr(image, "global_coords"):
        record |= _of_ndcube(image)
    if record["beam"] is None and getattr(image, "psf", None) is not None:
        record.setdefault(
            "beam_problem", "its psf is an image, of which no beam is made"
        )
    wcs = positions.unwrapped(as_celestial(image.wcs), shape)
    return fits.Plane(
        name=name, wcs=wcs, shape=shape, data=data, mask=mask,
        unit=image.unit or u.one, uncertainty=image.uncertainty, **record,
    )  # fmt: skip


def epochs_of(ndcube, times=None):
    """
    Return the epochs of an NDCube, each as an NDCube of two axes.

    It has two celestial axes, and one of the epochs if there are several; its WCS is a
    FITS WCS, possibly sliced or resampled.
    """
    try:
        wcs, size, kept = fits_wcs(ndcube.wcs)
        celestial = {wcs.wcs.lng, wcs.wcs.lat}
        others = [int(axis) for axis in np.flatnonzero(kept) if axis not in celestial]
        known = wcs.has_celestial and kept[[*celestial]].all() and len(others) < 2
    except TypeError:
        known = False
    if not known:
        raise ValueError(
            "an NDCube must have two celestial axes, one of the epochs, and a FITS "
            "WCS; EpochCube.from_arrays takes what has none"
        )
    if not others:
        return [ndcube]
    dated = times is None and any(ndcube.extra_coords.keys())
    if size[others[0]] != 1 and (dated or AXIS in wcs.wcs.ctype):
        raise ValueError(
            "epochs of the NDCube were averaged, of which ndcube keeps the first date "
            "only; rebin its celestial axes alone"
        )
    beside = ndcube.mask, getattr(ndcube.uncertainty, "array", None)
    if any(k is not None and np.shape(k) != ndcube.data.shape for k in beside):
        raise ValueError("mask and uncertainty of an NDCube must have its data's shape")
    # Array axes are in the reverse order of WCS axes.
    before = (slice(None),) * (int(np.sum(kept[others[0] :])) - 1)
    return [ndcube[(*before, i)] for i in range(ndcube.data.shape[len(before)])]


def _of_ndcube(image):
    """Return the date of an epoch of an NDCube, and what `to_ndcube` keeps of it."""
    times = [v for v in image.global_coords.values() if isinstance(v, Time)]
    found = {"time": times[0].reshape(-1)[0]} if times else {}
    wcs, _, _ = fits_wcs(image.wcs)
    header = wcs.to_header()
    header["NAXIS"] = wcs.naxis
    if times and (axis := dates.time_axis(header)):
        # WCS takes times in any unit for seconds.
        header[f"NAXIS{axis}"] = 1
        if not header[f"CTYPE{axis}"].endswith("-TAB"):
            found["time"] = dates.axis_times(header, axis)[0]
    if AXIS in wcs.wcs.ctype and set(KEPT) <= image.meta.keys():
        i = round(1 - wcs.wcs.crpix[list(wcs.wcs.ctype).index(AXIS)])
        values = [image.meta[name] and image.meta[name][i] for name in KEPT]
        found |= dict(zip(("label", "beam", "facts"), values, strict=True))
    return found


def _given(times, beams, n, frame):
    """Return the dates and beams that the user gives, None where there is none."""
    named("frame", check_choice, frame, "offset", "absolute")
    if n == 0:
        raise ValueError("a cube needs at least one image")
    return dates.given_times(times, n), series.as_beams(beams, n) or [None] * n


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
    planes, remarks = list(planes), {}
    if all(plane.beam_is_small for plane in planes):
        for plane in planes:
            plane.beam_problem = f"{plane.beam} is smaller than a pixel"
            plane.beam = None
    for plane, time, beam in zip(planes, times, beams, strict=True):
        plane.time = _observed(plane, time)
        written = plane.beam
        if beam is not None:
            plane.beam, plane.beam_problem, plane.beam_choice = beam, "", ""
            large = beam.major.to_value(u.deg) > plane.extent
            if large or plane.beam_is_small:
                size = "larger than the image" if large else "smaller than a pixel"
                what = f"the beam that is given, {beam}, is {size}; give another"
                raise ValueError(f"{plane.name}: {what}")
            if written is not None and different_beam((beam, written)) is not None:
                line = f"the beam that is given, {beam}, replaces that of the header"
                plane.remarks.append(line)
        if plane.beam_choice:
            raise ValueError(f"{plane.name}: {plane.beam_choice}")
        with naming(plane.name):
            plane.take_uncertainty()
    notes = dates.without_order([plane.notes for plane in planes])
    for plane, found in zip(planes, notes, strict=True):
        for note in found:
            remarks.setdefault(note, []).append(plane.label or plane.name)
    for note, names in remarks.items():
        warn(f"{some(names)}: {note}")
    times = dates.as_times([plane.time for plane in planes], len(planes))
    order = times.argsort()
    return [planes[i] for i in order], times[order]


def _refuse_strangers(planes):
    """Refuse images that do not belong together, or warn of them."""
    unit, peaks = planes[0].unit, np.full(len(planes), np.nan)
    for i, plane in enumerate(planes):
        if plane.unit.is_equivalent(unit):
            peak = np.max(plane.data, where=~plane.mask, initial=-np.inf)
            peaks[i] = peak * plane.unit.to(unit)
    lines = _lines(planes, problems(planes, peaks))
    for names, text, is_refused in lines:
        if is_refused:
            others = (more for more, _, also in lines if also and more != names)
            others = [name for more in others for name in more]
            more = f"; others are refused, too: {some(others)}" if others else ""
            raise ValueError(text + more)
        warn(text)


def _lines(planes, found):
    """
    Return what is odd about images, see `problems`, once for all of the same fault.

    These are the names of the images, a line, and whether they are refused.
    """
    names = {}
    for i, *words in found:
        names.setdefault(tuple(words), []).append(planes[i].name)
    return [
        (each, f"{some(each)}: {what}; {advice}", refused)
        for (what, advice, refused), each in names.items()
    ]


def _assemble(planes, times, beams, frame, check, source):
    """Return the fields of a cube from images on their own grids."""
    planes, times = _completed(planes, times, beams)
    if check:
        _refuse_strangers(planes)
    else:
        dates.warn_of_equal_dates(times)
    frame = _trusted(planes, frame)
    for _, text, _ in _lines(planes, far_away(planes) if frame == "offset" else ()):
        warn(text)
    unit = _in_one_unit(planes)
    fields, resampled, line = lay_on_one_grid(planes, frame, unit)
    if resampled:
        ny, nx = fields["data"].shape[1:]
        warn(
            f"{some(resampled)}: on another grid than the finest (or turned, as those "
            "of B1950 to those of J2000) and therefore resampled to it; all are "
            f"{nx} x {ny} pixels, masked outside each image, "
            "and the noise of all is measured; leave it out if you do not want that"
        )
    whole = np.max([plane.shape for plane in planes], axis=0)
    flattened = grid.flatten(fields, planes[0].name, whole, unit)
    resampled = resampled or flattened.startswith(grid.RESAMPLED)
    beams = _all_or_none(planes, "beam", NO_BEAM)
    advice = "that of all is measured; give every image an uncertainty"
    noise = _all_or_none(planes, "noise", advice)
    noise = None if resampled or noise is None else u.Quantity(noise)
    labels = tuple(plane.label for plane in planes)
    labels = labels if all(labels) else dates.date_labels(times)
    names = [*filter(None, (plane.facts.get("object") for plane in planes))]
    meta = {"object": names[0]} if len({*first_names(names).values()}) == 1 else {}
    laid = "reference pixels" if frame == "offset" else "absolute coordinates"
    steps = f"{source}, aligned on their {laid}", line, flattened
    meta["history"] = [step for step in steps if step]
    facts = tuple(plane.facts for plane in planes)
    fields |= {"times": times, "unit": unit, "beams": beams, "noise": noise}
    return fields | {"labels": labels, "epoch_meta": facts, "meta": meta}


def _in_one_unit(planes):
    """Convert images to the unit of the first one, which is returned."""
    unit = planes[0].unit
    for plane in planes:
        with naming(plane.name):
            factor = plane.unit.to(unit)
        if factor != 1:
            plane.data = plane.data * factor
            plane.noise = None if plane.noise is None else plane.noise.to(unit)
    return unit


def _trusted(planes, frame):
    """Return "absolute" where reference pixels are not places in the images."""
    for plane in planes if frame == "offset" else ():
        y, x = (np.array(plane.data.shape) - 1) / 2
        usual = plane.wcs.pixel_scale_matrix
        if max(positions.differences(plane.wcs, (x, x, y, y), usual)) > positions.EVEN:
            return "absolute"
    return frame


def _all_or_none(planes, what, advice):
    """Return the beams or the noise of all images, None if some have none."""
    values = tuple(getattr(plane, what) for plane in planes)
    missing = [p.name for p, v in zip(planes, values, strict=True) if v is None]
    if 0 < len(missing) < len(planes):
        warn(f"{some(missing)}: no {what} where other epochs have one; {advice}")
    return None if missing else values


def windows_of(planes, first, frame, region, pad=0, margin=4):
    """
    Return rows and columns of a region in the image ``first``, and in every image.

    ``region`` and ``pad``, as in `~astro_scc.epochs.EpochCube.crop`, refer to the image
    ``first``.  The windows of the other images hold the same part of the sky, or of the
    offsets, and a ``margin`` of pixels, the reach of splines, if images are not whole
    pixels apart.  An image without a pixel in the region raises a ValueError.
    """
    every = [plane.wcs for plane in (first, *planes)]
    here, *frames = positions.on_one_sky(every, first.wcs, frame)
    copied = (grid.whole_step(here, wcs, first.shape) is not None for wcs in frames)
    if not all(copied):
        # Interpolation is worst at the edges.
        pad += margin
    window = regions.box(
        SimpleNamespace(shape=(1, *first.shape), wcs=first.wcs), region, pad
    )
    (y0, y1), (x0, x1) = ((part.start, part.stop - 1) for part in window)
    corners = np.array([[x0, x1, x0, x1], [y0, y0, y1, y1]], dtype=float)
    windows = []
    for plane, wcs in zip(planes, frames, strict=True):
        there = np.array(pixel_to_pixel(here, wcs, *corners))
        # Rounding errors must not add a row.
        low = np.floor(there.min(axis=1) + grid.ONE_SHIFT)
        high = np.ceil(there.max(axis=1) - grid.ONE_SHIFT)
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
    line : str
        About the grid, for the history, or ''.
    """
    frames = positions.on_one_sky([plane.wcs for plane in planes], planes[0].wcs, frame)
    grids = [(p.data.shape, wcs) for p, wcs in zip(planes, frames, strict=True)]
    _refuse_misfits(planes, grids)
    new, shape = grid.shared_grid(grids)
    known = planes[0].wcs if frame == "offset" else new
    data = np.empty((len(planes), *shape))
    mask = np.empty(data.shape, dtype=bool)
    every, resampled = [new] * len(planes), []
    for i, (plane, wcs) in enumerate(zip(planes, frames, strict=True)):
        north = positions.north_in(plane.wcs, known)
        if frame == "offset":
            every[i] = positions.placed_as(positions.turned(new, -north), plane.wcs)
        if plane.beam is not None and north != 0:
            pa = plane.beam.pa + north * u.rad
            plane.beam = Beam(plane.beam.major, plane.beam.minor, pa)
        one = slice(i, i + 1)
        data[one], mask[one], copied = grid.regrid(
            plane.data[None], plane.mask[None], wcs, new, unit=unit, near=grid.ONE_SHIFT
        )
        resampled += [] if copied else [plane.name]
        plane.data = plane.mask = None
    fields = {"data": data, "mask": mask, "wcs": every[0], "epoch_wcs": tuple(every)}
    line, steps = "", [grid.whole_step(wcs, new, size) for size, wcs in grids]
    alike = all(size == shape for size, _ in grids)
    if not alike or any(step is None or step.any() for step in steps):
        n, side = len(resampled), np.sqrt(positions.middle_area(new, shape)) * u.deg
        line = (
            f"{grid.SHARED} of {shape[1]} x {shape[0]} pixels of {readable_angle(side)}"
            f", masked outside each image ({n} of {len(planes)} images interpolated)"
        )
    return fields, resampled, line


def _refuse_misfits(planes, grids, ratio=10):
    """
    Refuse an image whose pixels or position differ too much from the others'.

    Sides of pixels differ from the usual one by no more than a ``ratio``.
    """
    sizes = [positions.middle_area(p.wcs, p.data.shape) ** 0.5 for p in planes]
    usual = np.sort(sizes)[(len(sizes) - 1) // 2]
    for plane, size, one in zip(planes, sizes, grids, strict=True):
        # The finest grid would be huge otherwise.
        if not usual / ratio <= size <= usual * ratio:
            raise ValueError(
                f"{plane.name}: its pixels are {readable_angle(size * u.deg)} where "
                f"others are {readable_angle(usual * u.deg)}; leave it out"
            )
        too_far = (
            f"{plane.name}: lies too far from {planes[0].name} to share a grid with "
            "it, by its coordinates; leave one of them out"
        )
        if one[0] == grids[0][0] and grid.is_same(one[1], grids[0][1]):
            continue
        with refusing(too_far, ValueError):
            grid.shared_grid([grids[0], one])
