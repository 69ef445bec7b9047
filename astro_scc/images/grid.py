# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Pixel grids: images on one of them, regions as masks, and images cropped to them."""

from __future__ import annotations

import os
import re
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import astropy.units as u
import numpy as np
import scipy
from astropy.io.fits import Header
from astropy.wcs import WCS
from astropy.wcs.utils import pixel_to_pixel, wcs_to_celestial_frame

from astro_scc.exceptions import warn
from astro_scc.images import local
from astro_scc.images.beam import is_per
from astro_scc.images.frames import region_in_frame
from astro_scc.images.headers import as_celestial, celestial_wcs, first_line
from astro_scc.images.positions import readable_angle
from astro_scc.images.series import (
    ImageSeries,
    Series,
    as_shape,
    flat_wcs,
    mean_of,
    naming,
)

# Pixels are copied if a shift is this near to whole pixels; sky coordinates in
# degrees resolve pixels of microarcseconds to about 1e-4.
WHOLE_PIXEL = 1e-4
# Steps that differ by less, in pixels, count as one shift of the whole image.
ONE_SHIFT = 0.01
# A resampled pixel is bad if bad pixels contribute more than this weight to it.
BAD_WEIGHT = 0.01
# Pixels per full width at half maximum with which a beam is sampled.
SAMPLED = 2.0
#: Beginning of the line of history about images that were not flat.
RESAMPLED = "resampled onto a tangent plane"
#: Coordinates in degrees with fewer decimal places were written by hand.
DECIMALS = 5
#: Rounding may move a region by this fraction of its size.
MOVED = 0.02


def fill_masked(image, mask, n_iterations=20):
    """
    Return an image with its masked pixels replaced by a smooth continuation.

    Interpolation with splines needs a value everywhere, and a jump at the
    edge of the mask would ring into the good pixels.  The nearest good
    values are relaxed towards a solution of Laplace's equation; holes wider
    than ``n_iterations`` pixels are smoothed at their edges only.  Without any
    good pixel the result is zero.
    """
    if not mask.any():
        return np.array(image, dtype=float)
    if mask.all():
        return np.zeros(image.shape)
    nearest = scipy.ndimage.distance_transform_edt(
        mask, return_distances=False, return_indices=True
    )
    filled = np.asarray(image, dtype=float)[tuple(nearest)]
    neighbours = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]]) / 4
    for _ in range(n_iterations):
        filled[mask] = scipy.ndimage.convolve(filled, neighbours, mode="nearest")[mask]
    return filled


def shift_image(image, mask, shift):
    """
    Return an image whose sources are moved by ``shift`` (dx, dy) pixels, and its mask.

    Shifts by whole pixels copy the pixels; others interpolate with cubic
    splines.  Pixels that come from outside the image, or to which bad pixels
    contribute, are masked and NaN.

    Cubic splines damp the smallest structures: a shift by half a pixel lowers
    the rms of white noise by up to 30%, but that of noise correlated over a
    beam of five pixels or more by nothing that can be measured.
    """
    step = np.asarray(shift, dtype=float)[::-1]
    whole = np.rint(step)
    if np.all(np.abs(step - whole) < WHOLE_PIXEL):
        return _copy(image, mask, whole.astype(int), image.shape)
    moved = scipy.ndimage.shift(
        fill_masked(image, mask), step, order=3, mode="constant", cval=np.nan
    )
    weight = scipy.ndimage.shift(mask.astype(float), step, order=1, cval=1.0)
    bad = (weight > BAD_WEIGHT) | ~np.isfinite(moved)
    return np.where(bad, np.nan, moved), bad


def _copy(data, mask, step, shape):
    """Return images copied to another grid, ``step`` whole pixels (y, x) away."""
    moved = np.full((*data.shape[:-2], *shape), np.nan)
    bad = np.ones(moved.shape, dtype=bool)
    target, source = [...], [...]
    for s, n, n_new in zip(step, data.shape[-2:], shape, strict=True):
        target.append(slice(max(s, 0), max(min(n + s, n_new), 0)))
        source.append(slice(max(-s, 0), max(min(n, n_new - s), 0)))
    moved[*target] = np.where(mask[*source], np.nan, data[*source])
    bad[*target] = mask[*source]
    return moved, bad


def grid_step(wcs, target, shape):
    """
    Return the shift (dx, dy) between two grids, and whether they differ by it only.

    The shift is measured from the centre of an image of ``shape`` (ny, nx) on ``wcs``
    to the pixel of ``target`` at the same place on the sky.  The grids differ by it
    only if the shifts of all corners agree with it to a hundredth of a pixel.
    """
    if is_same(wcs, target):
        return np.zeros(2), True
    pixels = _few(shape)
    step = np.array(pixel_to_pixel(wcs, target, *pixels)) - pixels
    return step[:, 0], bool(np.all(np.abs(step - step[:, :1]) < ONE_SHIFT))


def _few(shape):
    """Return the middle and the corners of an image as pixels x and y, shape (2, 5)."""
    places = np.array([[0.5, 0, 1, 0, 1], [0.5, 0, 0, 1, 1]])
    return places * [[shape[1] - 1], [shape[0] - 1]]


def whole_step(wcs, target, shape, near):
    """Return the whole pixels by which grids differ, None if not, see `grid_step`."""
    step, pure = grid_step(wcs, target, shape)
    whole = np.rint(step)
    return whole if pure and np.all(np.abs(step - whole) < near) else None


def is_same(wcs, other):
    """Return whether two celestial WCS without distortion are equal."""
    return wcs is other or wcs.wcs.compare(other.wcs)


def moved_wcs(wcs, shift):
    """Return the WCS of a grid whose content has moved by (dx, dy) pixels."""
    moved = wcs.deepcopy()
    moved.wcs.crpix = moved.wcs.crpix + np.asarray(shift, dtype=float)
    moved.wcs.set()
    return moved


def cut_wcs(wcs, window):
    """Return the WCS of a window of a grid, slices (y, x) with a start and a stop."""
    y, x = window
    part = moved_wcs(wcs, (-x.start, -y.start))
    part.array_shape = y.stop - y.start, x.stop - x.start
    return part


def regrid(data, bad, wcs, grid, *, unit, averaged=False, near=WHOLE_PIXEL):
    """
    Return images and bad pixels on another grid, and whether pixels were copied.

    The grid is a WCS with its ``array_shape``.  They are copied if the grids differ by
    whole pixels to within ``near``.  Otherwise they are interpolated, or averaged over
    the new pixels, NaN where bad, and intensities per pixel are scaled to the area of
    the new pixels.
    """
    shape = grid.array_shape
    whole = whole_step(wcs, grid, data.shape[-2:], near)
    if whole is not None:
        if not whole.any() and shape == data.shape[-2:]:
            return data.copy(), bad.copy(), True
        return *_copy(data, bad, whole[::-1].astype(int), shape), True
    # Slow to import, and not needed for most series.
    from reproject import reproject_exact, reproject_interp

    filled = np.stack([fill_masked(d, b) for d, b in zip(data, bad, strict=True)])
    lay = linear = reproject_exact
    if not averaged:
        lay = partial(reproject_interp, order="bicubic")
        linear = partial(reproject_interp, order="bilinear")
    options = {"shape_out": shape, "return_footprint": False}
    # reproject maps the pixels once for all images.
    moved = lay((filled, wcs), grid, **options)
    weight = linear((bad.astype(float), wcs), grid, **options)
    mask = ~(weight <= BAD_WEIGHT) | ~np.isfinite(moved)
    if is_per(unit, "pix", "pixel"):
        moved *= area_ratio(wcs, grid, shape)
    return np.where(mask, np.nan, moved), mask, False


def area_ratio(wcs, grid, shape):
    """Return the areas of the pixels (ny, nx) of a grid over those of a WCS there."""

    def ratio(x, y):
        there = pixel_to_pixel(grid, wcs, x, y)
        return local.local_area(grid, x, y) / local.local_area(wcs, *there)

    few = ratio(*_few(shape))
    if np.allclose(few, few[0], rtol=1e-6):
        return 1.0 if np.isclose(few[0], 1, rtol=1e-6) else few[0]
    return ratio(*np.indices(shape)[::-1])


def reproject_cube(
    cube: Series, wcs: WCS | Header | ImageSeries, shape: tuple[int, int] | None = None
) -> Series:
    """
    Return all epochs of a cube resampled to another pixel grid.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    wcs : `~astropy.wcs.WCS`, `~astropy.io.fits.Header` or `EpochCube`
        The new grid, with celestial axes.
    shape : (int, int), optional
        Shape (ny, nx) of the new grid, by default that of the header, the
        cube, or the ``array_shape`` of the WCS.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`
        On the new grid.  Pixels from outside the old grid, or to which bad
        pixels contribute, are masked.  ``noise`` is None, because
        resampling alters it, unless the grids differ by whole pixels and
        the pixels are copied.

    Raises
    ------
    ValueError
        If ``wcs`` is not celestial, ``shape`` is missing or not two positive
        integers, or the epochs have beams and ``wcs`` has another celestial
        frame (position angles would refer to another north).
    TypeError
        If ``wcs`` has the wrong type.

    Notes
    -----
    Images are interpolated by cubic splines.  Where that would leave pixels out,
    because the new ones are larger than the old ones and than half the beam, they
    are averaged over each new pixel (`reproject.reproject_exact`).

    Intensities per beam or per solid angle are resampled as they are; intensities
    per pixel are multiplied by the ratio of the pixel areas.

    The new cube has no ``epoch_wcs``; align with it first.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc.epochs import EpochCube
    >>> cube = EpochCube.from_arrays(
    ...     np.ones((2, 16, 16)),
    ...     ["2000-01-01", "2001-01-01"],
    ...     pixel_scale=0.1 * u.mas,
    ... )
    >>> finer = cube.wcs.deepcopy()
    >>> finer.wcs.cdelt = cube.wcs.wcs.cdelt / 2
    >>> reproject_cube(cube, finer, (8, 8)).shape
    (2, 8, 8)
    """
    if isinstance(wcs, ImageSeries):
        wcs, shape = wcs.wcs, wcs.shape[1:] if shape is None else shape
    elif isinstance(wcs, Header):
        with naming("the header of the new grid"):
            wcs = celestial_wcs(wcs)
    wcs = as_celestial(wcs)
    shape = wcs.array_shape if shape is None else shape
    if shape is None:
        raise ValueError("the grid has no shape of its own; give shape=(ny, nx)")
    shape = as_shape(shape)
    frames = [wcs_to_celestial_frame(grid) for grid in (wcs, cube.wcs)]
    if cube.beams is not None and not frames[0].is_equivalent_frame(frames[1]):
        raise ValueError(
            "the new wcs has another celestial frame, in which the position angles "
            "of the beams do not hold; use a wcs in the frame of the epochs"
        )
    side = np.sqrt(local.middle_area(wcs, shape)) * u.deg
    sampled = [beam.minor / SAMPLED for beam in cube.beams or ()]
    present = cube.pixel_scale
    coarse = side > 1.01 * max(present, min(sampled, default=present))
    wcs = wcs.deepcopy()
    wcs.array_shape = shape
    data, mask, copied = regrid(
        cube.data, cube.mask, cube.wcs, wcs, unit=cube.unit, averaged=coarse
    )
    if not local.is_flat(wcs, shape):
        wcs = flat_wcs(wcs, data, mask)
    how = "averaged" if coarse else "interpolated"
    how = "whole pixels copied" if copied else how
    return cube.with_step(
        f"reprojected onto {shape[1]} x {shape[0]} pixels of "
        f"{side.to_value(u.mas):.4g} mas ({how})",
        data=data, mask=mask, wcs=wcs, epoch_wcs=None,
        noise=cube.noise if copied else None,
    )  # fmt: skip


def finest(grids):
    """Return the index of the first (shape, wcs) among those with smallest pixels."""
    areas = np.array([local.middle_area(wcs, shape) for shape, wcs in grids])
    return int(np.argmax(areas <= areas.min() * (1 + 1e-6)))


def shared_grid(grids):
    """
    Return the smallest grid that holds several grids at the finest of their pixels.

    Its projection, orientation and reference point are those of the grid with
    the smallest pixels (the first one if there are several), so that epochs on
    that grid need no interpolation.

    Parameters
    ----------
    grids : sequence of (shape, wcs)
        Shapes are (ny, nx), and each WCS is celestial.  If offsets from the
        reference pixel can be trusted and absolute coordinates cannot, as in
        VLBI, give all of them the same ``crval`` first.

    Returns
    -------
    wcs : `~astropy.wcs.WCS`
    shape : (int, int)

    Raises
    ------
    ValueError
        If the grids are so far apart that the shared one would be mostly empty.

    Examples
    --------
    >>> from astropy.wcs import WCS
    >>> wcs = WCS(naxis=2)
    >>> wcs.wcs.ctype = ["RA---SIN", "DEC--SIN"]
    >>> wcs.wcs.cdelt = [-1e-4, 1e-4]
    >>> wcs.wcs.crpix = [8, 8]
    >>> other = wcs.deepcopy()
    >>> other.wcs.crpix = [12, 8]
    >>> grid, shape = shared_grid([((16, 16), wcs), ((16, 16), other)])
    >>> shape, grid.wcs.crpix.tolist()
    ((16, 20), [12.0, 8.0])
    """
    areas = np.array([local.middle_area(wcs, shape) for shape, wcs in grids])
    fine = grids[finest(grids)][1]
    corners = []
    for shape, wcs in grids:
        edge = local.outline(local.whole(shape))
        corners.append(edge if is_same(wcs, fine) else pixel_to_pixel(wcs, fine, *edge))
    corners = np.concatenate(corners, axis=1)
    # Rounding errors must not add a row.
    first = np.floor(corners.min(axis=1) + 0.01)
    size = np.ceil(corners.max(axis=1) - 0.01) - first + 1
    covered = np.sum(areas * [ny * nx for (ny, nx), _ in grids])
    # It is NaN if a grid lies beyond the horizon of the projection.
    if not np.prod(size) * areas.min() <= 100 * covered:
        raise ValueError("the grids lie too far apart on the sky to share one")
    shared = moved_wcs(fine, -first)
    shared.array_shape = shape = tuple(size[::-1].astype(int).tolist())
    return shared, shape


def flatten(fields, name, whole, unit):
    """
    Make one matrix hold where the structure of the images is, and return how.

    The coordinates are replaced in place, and the images if they must be resampled.
    ``name`` is that of an image, and ``whole`` the shape of files of which these may be
    parts.
    """
    data, mask, wcs = (fields[name] for name in ("data", "mask", "wcs"))
    far = local.is_far(wcs, whole)
    if not far and local.is_flat(wcs, data.shape[1:]):
        return ""
    mean = mean_of(data, mask)
    flat, turn = local.flat_wcs(wcs, mean, moved=far)
    if flat is wcs:
        return ""
    if flat is not None:
        place = flat.wcs.crpix - 1
        every = [local.tangent_wcs(one, place) for one in fields["epoch_wcs"]]
        line = "offsets are from pixel ({:.4g}, {:.4g}), not the far reference pixel"
        line = line.format(*place)
    else:
        with naming(f"{name} and the other images"):
            flat, turn = local.tangent_grid(wcs, mean)
        shape, code = flat.array_shape, str(wcs.wcs.ctype[0])[5:]
        data, mask, _ = regrid(data, mask, wcs, flat, unit=unit)
        every = [flat] * len(data)
        line = f"{RESAMPLED} of {shape[1]} x {shape[0]} pixels at the structure"
        warn(
            f"all images are {line}: their projection ({code}) changes the scale over "
            "it; reproject them yourself if you want another grid"
        )
        fields |= {"data": data, "mask": mask}
    if turn > local.EVEN:
        warn(
            f"north turns by {np.degrees(turn):.2g} deg from the middle of the "
            "structure to its edges; directions refer to north in the middle"
        )
    fields |= {"wcs": flat, "epoch_wcs": tuple(every)}
    return line


def region_mask(cube: ImageSeries, region: Any = None) -> np.ndarray:
    """
    Return the pixels whose centres lie inside a region.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
        Its ``wcs`` places regions of the sky.
    region : optional
        One of: None (everything), a `regions.Region` of pixels, of the sky or
        of the sphere, a sequence of them (a `regions.Regions`), the path of a
        DS9 or CRTF region file, or an array of bool of the images' shape.

    Returns
    -------
    `~numpy.ndarray` of bool, shape (ny, nx)
        True inside, the opposite of a mask of bad pixels.

    Raises
    ------
    ValueError
        If the region holds no pixel of the image, an array has another
        shape, a file holds no region, cannot be understood or was written
        with too few digits for the size of its regions, or a shape has no
        inside (points, lines, text).
    TypeError
        If ``region`` is none of the above.
    OSError
        If the file cannot be read.

    Notes
    -----
    The union of all regions is taken, then excluded ones (a leading ``-`` in
    DS9 and CRTF files, ``meta["include"]`` false) are removed from it.  If all
    regions are excluded, the rest of the image remains.

    Examples
    --------
    >>> import numpy as np
    >>> from types import SimpleNamespace
    >>> from regions import CirclePixelRegion, PixCoord
    >>> cube = SimpleNamespace(shape=(2, 5, 7), wcs=None)
    >>> region_mask(cube, CirclePixelRegion(PixCoord(3, 2), 1.5)).astype(int)
    array([[0, 0, 0, 0, 0, 0, 0],
           [0, 0, 1, 1, 1, 0, 0],
           [0, 0, 1, 1, 1, 0, 0],
           [0, 0, 1, 1, 1, 0, 0],
           [0, 0, 0, 0, 0, 0, 0]])
    """
    from regions import Region

    shape, name, places = cube.shape[1:], "region", ()
    if region is None:
        return np.ones(shape, dtype=bool)
    if isinstance(region, str | os.PathLike):
        name, (region, places) = str(region), _read(region)
    if isinstance(region, np.ndarray):
        if region.dtype != bool or region.shape != shape:
            raise ValueError(
                f"region is an array of {region.dtype} of shape {region.shape}; "
                f"give an array of bool of the images' shape {shape}"
            )
        inside = region.copy()
    else:
        items = [region] if isinstance(region, Region) else region
        items = list(items) if np.iterable(items) else []
        if not items or not all(isinstance(item, Region) for item in items):
            raise TypeError(
                "region must be a regions.Region, a non-empty list of them, the path "
                f"of a region file or an array of bool, got {region!r}"
            )
        inside = _combine(cube, items, name, places)
    if not inside.any():
        raise ValueError(
            f"{name}: holds no pixel of the {shape[1]} x {shape[0]} image; "
            "check its coordinates, frame and size"
        )
    return inside


def _combine(cube, items, name, places):
    """Return the pixels in any region that is included and in none excluded."""
    from regions import CompoundPixelRegion, PixCoord, PixelRegion, SkyRegion

    shape = cube.shape[1:]
    wanted = [bool(item.meta.get("include", True)) for item in items]
    inside = {True: np.full(shape, not any(wanted)), False: np.zeros(shape, dtype=bool)}
    for item, include in zip(items, wanted, strict=True):
        try:
            # Images are small enough for spherical regions to be flat in them.
            pixel = item
            if not isinstance(item, PixelRegion):
                pixel = region_in_frame(item, cube.wcs).to_pixel(cube.wcs)
            target = pixel.bounding_box.get_overlap_slices(shape)[0]
            if target is None:
                continue
            if not (isinstance(pixel, CompoundPixelRegion) or pixel.area > 0):
                raise ValueError("it is a point, a line or text")
            # A mask of the region may be far larger than the image.
            y, x = np.mgrid[target]
            # Some versions of regions turn excluded ones over, others do not.
            within = pixel.copy(meta={}).contains(PixCoord(x, y))
        except (NotImplementedError, OverflowError, ValueError):
            raise ValueError(
                f"{name}: a {type(item).__name__} has no inside on the image; use "
                "circles, ellipses, rectangles or polygons, on the part of the sky "
                "that the images show"
            ) from None
        if places and isinstance(item, SkyRegion):
            size = min(pixel.bounding_box.shape)
            _refuse_rounded(item, size, cube.wcs, places, name)
        inside[include][target] |= within
    return inside[True] & ~inside[False]


def _refuse_rounded(item, size, wcs, places, name):
    """
    Refuse a region that its file gives with too few digits.

    Writers round coordinates, CRTF by default to 1e-6 deg, the size of a whole jet.
    """
    side = np.sqrt(abs(np.linalg.det(wcs.pixel_scale_matrix)))
    where = getattr(item, "vertices", getattr(item, "center", None)).spherical
    lon, lat = np.atleast_1d(where.lon.deg), np.atleast_1d(where.lat.deg)
    names = ("radius", "width", "height", "outer_radius", "outer_width", "outer_height")
    sizes = [getattr(item, n).to_value(u.deg) for n in names if hasattr(item, n)]
    # Numbers that are not round in degrees may be so in hours, minutes and seconds.
    step = _step([*lon, *lat], places, DECIMALS) or max(
        _step(lon * 240, places, DECIMALS - 2) / 240,
        _step(lat * 3600, places, DECIMALS - 2) / 3600,
    )
    step = max(step, _step(sizes, places, DECIMALS))
    if step / 2 > max(side, MOVED * size * side):
        raise ValueError(
            f"{name}: a {type(item).__name__} of {readable_angle(size * side * u.deg)} "
            f"is written in steps of {readable_angle(step * u.deg)}, which moves it; "
            "write it with more digits (regions: precision=13)"
        )


def _step(values, places, fewest):
    """
    Return the step to which numbers with these decimal places were rounded.

    It is 0 for numbers with fewer than ``fewest`` places, which were written by
    hand, and for numbers that were not rounded.
    """
    for end in range(10):
        ratio = np.multiply(values, 10.0**end)
        if np.all(np.abs(ratio - np.rint(ratio)) <= 1e-3 * np.minimum(1, abs(ratio))):
            steps = (10.0**-place for place in places if place >= end >= fewest)
            return max(steps, default=0.0)
    return 0.0


def _read(path):
    """Return the regions of a file, and the decimal places of its numbers."""
    from regions import Regions

    path = Path(path)
    # Reading the text first distinguishes a missing file from one without regions.
    text = path.read_text(encoding="utf-8", errors="replace")
    if text.startswith("SIMPLE  =") or "\0" in text:
        raise ValueError(f"{path}: is not a text file; give a DS9 or CRTF region file")
    kind = "crtf" if text.startswith("#CRTF") else "ds9"
    with warnings.catch_warnings(record=True, action="always") as caught:
        try:
            found = Regions.parse(text, format=kind)
        except (ValueError, TypeError, KeyError, IndexError, AttributeError) as error:
            raise ValueError(
                f"{path}: cannot be read as a {kind} region file ({first_line(error)})"
            ) from error
    if len(found) == 0:
        raise ValueError(f"{path}: holds no region that can be used")
    for item in caught:
        warn(f"{path}: {item.message}; check that the rest is what you want")
    return found, {len(digits) for digits in re.findall(r"\.(\d+)", text)}


def box(cube, region, pad=0):
    """
    Return the bounding box of a region as slices of rows and columns, see `crop`.

    The cube may be anything with a ``shape`` and a ``wcs``.
    """
    if pad != int(pad) or pad < 0:
        raise ValueError(f"pad={pad} must be a whole number of at least 0")
    shape = cube.shape[1:]
    if isinstance(region, tuple) and all(isinstance(item, slice) for item in region):
        if len(region) != 2 or any(item.step not in (None, 1) for item in region):
            raise ValueError("slices must be two, (y, x), without a step")
        window, region = region, np.zeros(shape, dtype=bool)
        region[window] = True
    inside = region_mask(cube, region)
    hits = [np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0)]
    start, stop = np.transpose([(hit[0], hit[-1] + 1) for hit in hits])
    start, stop = np.maximum(start - int(pad), 0), np.minimum(stop + int(pad), shape)
    return tuple(map(slice, start.tolist(), stop.tolist()))


def crop(cube: Series, region: Any, pad: int = 0) -> Series:
    """
    Return all epochs cut down to the bounding box of a region.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    region : (slice, slice) or region
        Slices of pixels (y, x), or anything that `region_mask` takes.
    pad : int, optional
        Pixels to keep around the box, as far as the image reaches.  The
        largest wavelet scale needs some.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`
        Smaller images with the same values.  The origin of offsets stays
        where it is, even if it is no longer inside.

    Raises
    ------
    ValueError
        If no pixel would be left, a slice has a step, or ``pad`` is not a
        whole number of at least 0; and if `region_mask` raises one.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc.epochs import EpochCube
    >>> cube = EpochCube.from_arrays(
    ...     np.ones((1, 16, 16)),
    ...     ["2000-01-01"],
    ...     pixel_scale=0.1 * u.mas,
    ...     reference_pixel=(7, 7),
    ... )
    >>> part = crop(cube, (slice(2, 10), slice(4, 16)), pad=1)
    >>> part.shape, part.wcs.wcs.crpix.tolist()
    ((1, 10, 13), [5.0, 7.0])
    """
    window = box(cube, region, pad)
    cut = {name: getattr(cube, name)[:, *window].copy() for name in ("data", "mask")}
    every = cube.epoch_wcs and [cut_wcs(wcs, window) for wcs in cube.epoch_wcs]
    wcs = cut_wcs(cube.wcs, window)
    return cube.with_step(crop_line(window), wcs=wcs, epoch_wcs=every, **cut)


def crop_line(window):
    """Return the line about slices (y, x) that `crop` adds to the history."""
    y, x = (f"{part.start} to {part.stop - 1}" for part in window)
    return f"cropped to pixels x {x}, y {y}"


def refuse_pixels(path, cropped, cube=None):
    """
    Refuse a region file in pixels if these are not those of the files.

    Pixels are others if only a part of the images is read (``cropped``), or if the
    images of the cube have been resampled.
    """
    from regions import PixelRegion

    lines = () if cube is None else cube.meta.get("history", ())
    why = (
        "in a part of the images (crop)" if cropped else "in images that are resampled"
    )
    if not (cropped or any(line.startswith(RESAMPLED) for line in lines)):
        return
    if any(isinstance(item, PixelRegion) for item in _read(path)[0]):
        raise ValueError(
            f"{path}: is in pixels, which are others {why}; give it in celestial "
            "coordinates"
        )


def distance_mask(
    cube: ImageSeries, r_min: u.Quantity, r_max: u.Quantity
) -> np.ndarray:
    """
    Return the pixels whose centres lie in a ring around the reference pixel.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    r_min, r_max : `~astropy.units.Quantity`
        Angles; ``r_min <= r < r_max``, so that adjacent bins share no pixel.

    Returns
    -------
    `~numpy.ndarray` of bool, shape (ny, nx)
        True inside.

    Raises
    ------
    ValueError
        If not ``0 <= r_min < r_max``, or no pixel lies in the ring.
    `~astropy.units.UnitsError`
        If an argument is not an angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc.epochs import EpochCube
    >>> cube = EpochCube.from_arrays(
    ...     np.ones((1, 3, 5)), ["2000-01-01"], pixel_scale=1 * u.arcsec
    ... )
    >>> distance_mask(cube, 1 * u.arcsec, 1.9 * u.arcsec).astype(int)
    array([[0, 1, 1, 1, 0],
           [0, 1, 0, 1, 0],
           [0, 1, 1, 1, 0]])
    """
    low, high = (u.Quantity(r).to_value(u.mas) for r in (r_min, r_max))
    if not 0 <= low < high:
        raise ValueError(f"r_min={r_min} and r_max={r_max} must be 0 <= r_min < r_max")
    distance = np.hypot(*cube.offsets()).to_value(u.mas)
    # Pixels at r_min up to rounding errors belong to this ring, not to the inner one.
    slack = 1e-9 * high
    inside = (distance >= low - slack) & (distance < high - slack)
    if not inside.any():
        raise ValueError(f"no pixel is {r_min} to {r_max} from the reference pixel")
    return inside
