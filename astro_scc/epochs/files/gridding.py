# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images that come on grids of their own, laid on one."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.time import Time
from astropy.wcs import WCS

from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.description import readable_angle
from astro_scc.epochs.grid import grid_step, moved_wcs, reproject_cube, shared_grid

__all__ = ["FRAMES", "Grid", "lay_on_one_grid", "offset_frame"]

FRAMES = ("offset", "absolute")
# Grids that agree to this part of a pixel all over the image are one grid.
TOLERANCE = 0.01
# Sides of pixels of images that can be one series.
LARGEST_RATIO = 10.0


@dataclass(frozen=True)
class Grid:
    """
    Images on one grid.

    Attributes
    ----------
    data : `~numpy.ndarray`, shape (n, ny, nx)
    mask : `~numpy.ndarray` of bool, shape (n, ny, nx)
    wcs : `~astropy.wcs.WCS`
    epoch_wcs : tuple of `~astropy.wcs.WCS`
        Absolute coordinates of this grid by each image's own header.
    resampled : tuple of str
        Names of the images that were interpolated.
    """

    data: np.ndarray
    mask: np.ndarray
    wcs: WCS
    epoch_wcs: tuple[WCS, ...]
    resampled: tuple[str, ...]


def lay_on_one_grid(planes, frame):
    """
    Lay images on the finest of their grids, as large as all of them.

    Parameters
    ----------
    planes : sequence
        With ``name``, ``data``, ``mask``, ``unit`` and ``wcs``.
    frame : {"offset", "absolute"}
        Whether reference pixels or celestial coordinates are laid on one
        another.

    Returns
    -------
    `Grid`
        Images on the very same grid are stacked as they are; those that lie
        whole pixels aside are moved without interpolation; others are
        interpolated.  Pixels outside an image are masked.

    Raises
    ------
    ValueError
        If pixels or positions are too different to be of one series.
    """
    first = planes[0]
    shape = first.data.shape
    if all(_same_grid(first, plane, frame) for plane in planes):
        return Grid(
            data=_stacked(planes, "data"),
            mask=_stacked(planes, "mask"),
            wcs=first.wcs,
            epoch_wcs=tuple(plane.wcs for plane in planes),
            resampled=(),
        )
    offset = frame == "offset"
    frames = [offset_frame(p.wcs) if offset else p.wcs for p in planes]
    _check_pixels(planes)
    grid, shape = _shared_grid(planes, frames)
    data = np.empty((len(planes), *shape))
    mask = np.empty(data.shape, dtype=bool)
    resampled = []
    for i, (plane, wcs) in enumerate(zip(planes, frames, strict=True)):
        data[i], mask[i], exact = _place(plane, wcs, grid, shape)
        if not exact:
            resampled.append(plane.name)
    return Grid(
        data=data,
        mask=mask,
        wcs=_own_frame(grid, first.wcs) if offset else grid,
        epoch_wcs=tuple(_own_frame(grid, p.wcs) if offset else grid for p in planes),
        resampled=tuple(resampled),
    )


def _stacked(planes, name):
    """The arrays of all images as one; each goes as soon as it is in it."""
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
    """Refuse pixels so different that the finest would make huge images."""
    sizes = [abs(np.linalg.det(p.wcs.pixel_scale_matrix)) ** 0.5 for p in planes]
    usual = np.sort(sizes)[(len(sizes) - 1) // 2]
    for plane, size in zip(planes, sizes, strict=True):
        if not usual / LARGEST_RATIO <= size <= usual * LARGEST_RATIO:
            raise ValueError(
                f"{plane.name}: its pixels are {readable_angle(size * u.deg)} where "
                f"others are {readable_angle(usual * u.deg)}; leave it out"
            )


def _same_grid(one, other, frame):
    """Equal shape, projection, pixels and reference pixel."""
    a, b = one.wcs.wcs, other.wcs.wcs
    ny, nx = one.data.shape
    if other.data.shape != (ny, nx) or [*a.ctype] != [*b.ctype]:
        return False
    step = np.linalg.solve(
        one.wcs.pixel_scale_matrix,
        other.wcs.pixel_scale_matrix - one.wcs.pixel_scale_matrix,
    )
    # The largest possible difference at the far corner of the image.
    largest = np.abs(step) @ [nx, ny] + np.abs(a.crpix - b.crpix)
    if np.any(largest > TOLERANCE):
        return False
    if frame == "offset":
        return True
    return (
        np.array_equal(a.crval, b.crval)
        and a.radesys == b.radesys
        and np.array_equal(a.equinox, b.equinox, equal_nan=True)
    )


def offset_frame(wcs):
    """
    The WCS with its reference pixel at (0, 0) of a frame of offsets.

    Parameters
    ----------
    wcs : `~astropy.wcs.WCS`

    Returns
    -------
    `~astropy.wcs.WCS`
    """
    local = wcs.deepcopy()
    local.wcs.ctype = [
        name + code[5:]
        for name, code in zip(("RA---", "DEC--"), wcs.wcs.ctype, strict=True)
    ]
    local.wcs.crval = 0, 0
    local.wcs.radesys = "ICRS"
    local.wcs.equinox = np.nan
    local.wcs.set()
    return local


def _own_frame(grid, own):
    """The grid with the celestial frame and reference point of an image."""
    wcs = grid.deepcopy()
    wcs.wcs.ctype = [
        name[:5] + code[5:]
        for name, code in zip(own.wcs.ctype, grid.wcs.ctype, strict=True)
    ]
    wcs.wcs.crval = own.wcs.crval
    wcs.wcs.radesys = own.wcs.radesys
    wcs.wcs.equinox = own.wcs.equinox
    wcs.wcs.lonpole = own.wcs.lonpole
    wcs.wcs.latpole = own.wcs.latpole
    wcs.wcs.set()
    return wcs


def _place(plane, wcs, grid, shape):
    """Data and mask on the grid, and whether no interpolation was needed."""
    step, pure = grid_step(wcs, grid, plane.data.shape, tolerance=TOLERANCE)
    exact = pure and bool(np.all(np.abs(step - np.rint(step)) < TOLERANCE))
    if exact:
        wcs = moved_wcs(grid, -np.rint(step))
    one = EpochCube(
        data=plane.data[None],
        times=Time([2000.0], format="jyear"),
        wcs=wcs,
        unit=plane.unit,
        mask=plane.mask[None],
    )
    placed = reproject_cube(one, grid, shape)
    return placed.data[0], placed.mask[0], exact
