# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images on different grids brought to a common one, in whole or in part."""

from types import SimpleNamespace

import astropy.units as u
import numpy as np
from astropy.wcs.utils import pixel_to_pixel

from astro_scc.epochs.cutout import box
from astro_scc.epochs.grid import ONE_SHIFT, pixel_area, regrid, shared_grid
from astro_scc.epochs.positions import readable_angle

# Pixel sides in one series differ from the usual side by at most this factor.
LARGEST_RATIO = 10.0
#: Pixels read around a part that is interpolated: the reach of the splines.
MARGIN = 4


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
