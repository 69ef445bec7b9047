# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Regions and rings as masks of pixels, and images that are cropped to them."""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path
from typing import Any

import astropy.units as u
import numpy as np

from astro_scc.exceptions import naming_all, warn
from astro_scc.images import grid, positions, series
from astro_scc.images.positions import readable_angle

#: Where pixels are not those of the files, by the beginning of a line of history.
CROPPED = "cropped to pixels"
OTHER_PIXELS = {
    CROPPED: "a part of the images (crop)",
    grid.SHARED: "images of several grids",
    grid.RESAMPLED: "resampled images",
    grid.REPROJECTED: "resampled images",
}


def region_mask(cube: series.ImageSeries, region: Any = None) -> np.ndarray:
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

    Pixels of a file are those of the images that were read, and are refused where
    those of the cube are others; pixels of a `regions.Region` are those of the cube.

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
    from regions import PixelRegion, Region

    shape, name, places = cube.shape[1:], "region", ()
    if region is None:
        return np.ones(shape, dtype=bool)
    if isinstance(region, str | os.PathLike):
        refuse_pixels(region, False, cube)
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
        drawn = name == "region" and any(isinstance(i, PixelRegion) for i in items)
        if drawn and _other_pixels(cube) == OTHER_PIXELS[grid.SHARED]:
            warn(
                "region: is in pixels, which are those of cube.wcs, not those of a "
                "file: the images were of several grids; give a SkyRegion if it was "
                "drawn on one of them"
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
            # A size that overflows is none.
            with np.errstate(over="raise"):
                # Images are small enough for spherical regions to be flat in them.
                pixel = item
                if not isinstance(item, PixelRegion):
                    pixel = positions.region_in_frame(item, cube.wcs).to_pixel(cube.wcs)
                target = pixel.bounding_box.get_overlap_slices(shape)[0]
                if target is None:
                    continue
                if not (isinstance(pixel, CompoundPixelRegion) or pixel.area > 0):
                    raise ValueError("it is a point, a line or text")
                # A mask of the region may be far larger than the image.
                y, x = np.mgrid[target]
                # Some versions of regions turn excluded ones over, others do not.
                within = pixel.copy(meta={}).contains(PixCoord(x, y))
        except (NotImplementedError, ArithmeticError, ValueError):
            raise ValueError(
                f"{name}: the {type(item).__name__} has no inside on the image; use "
                "circles, ellipses, rectangles or polygons, on the part of the sky "
                "that the images show"
            ) from None
        if places and isinstance(item, SkyRegion):
            _refuse_rounded(item, min(pixel.bounding_box.shape), cube.wcs, places, name)
        inside[include][target] |= within
    return inside[True] & ~inside[False]


def _refuse_rounded(item, size, wcs, places, name, moved=0.02, decimals=5):
    """
    Refuse a region that its file gives with too few digits.

    Writers round coordinates, CRTF by default to 1e-6 deg, the size of a whole jet.
    This may move a region by the part ``moved`` of its size.  Coordinates in degrees
    with fewer ``decimals`` were written by hand.
    """
    side = np.sqrt(abs(np.linalg.det(wcs.pixel_scale_matrix)))
    where = getattr(item, "vertices", getattr(item, "center", None)).spherical
    lon, lat = np.atleast_1d(where.lon.deg), np.atleast_1d(where.lat.deg)
    names = ("radius", "width", "height", "outer_radius", "outer_width", "outer_height")
    sizes = [getattr(item, n).to_value(u.deg) for n in names if hasattr(item, n)]
    # Numbers that are not round in degrees may be so in hours, minutes and seconds.
    step = _step([*lon, *lat], places, decimals) or max(
        _step(lon * 240, places, decimals - 2) / 240,
        _step(lat * 3600, places, decimals - 2) / 3600,
    )
    step = max(step, _step(sizes, places, decimals))
    if step / 2 > max(side, moved * size * side):
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
    with (
        warnings.catch_warnings(record=True, action="always") as caught,
        naming_all(f"{path}: cannot be read as a {kind} region file"),
    ):
        found = Regions.parse(text, format=kind)
    if len(found) == 0:
        why = [str(item.message).removesuffix(", skipping.") for item in caught]
        why = f": {'; '.join(why)}; save it as fk5 or image" if why else ""
        raise ValueError(f"{path}: holds no region that can be used{why}")
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


def crop(cube: series.Series, region: Any, pad: int = 0) -> series.Series:
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
    every = cube.epoch_wcs and [grid.cut_wcs(wcs, window) for wcs in cube.epoch_wcs]
    wcs = grid.cut_wcs(cube.wcs, window)
    return cube.with_step(crop_line(window), wcs=wcs, epoch_wcs=every, **cut)


def crop_line(window):
    """Return the line about slices (y, x) that `crop` adds to the history."""
    y, x = (f"{part.start} to {part.stop - 1}" for part in window)
    return f"{CROPPED} x {x}, y {y}"


def refuse_pixels(path, cropped, cube=None):
    """
    Refuse a region file in pixels if these are not those of the files.

    Pixels are others if only a part of the images is read (``cropped``), or if the
    images of the cube have been cropped, enlarged or resampled.
    """
    from regions import PixelRegion

    where = OTHER_PIXELS[CROPPED] if cropped else _other_pixels(cube)
    if where and any(isinstance(item, PixelRegion) for item in _read(path)[0]):
        raise ValueError(
            f"{path}: is in pixels, which are others in {where}; write it in celestial "
            "coordinates (DS9 saves it as fk5)"
        )


def _other_pixels(cube):
    """Return where pixels of a cube are not those of its files, '' if they are."""
    lines = getattr(cube, "meta", {}).get("history", ())
    starts = (s for s in OTHER_PIXELS if any(line.startswith(s) for line in lines))
    return OTHER_PIXELS.get(next(starts, ""), "")


def distance_mask(
    cube: series.ImageSeries, r_min: u.Quantity, r_max: u.Quantity
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
