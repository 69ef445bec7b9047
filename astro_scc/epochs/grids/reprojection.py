# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Epochs laid onto another grid, and the grid that several can share."""

import astropy.units as u
import numpy as np
from astropy.wcs.utils import pixel_to_pixel, wcs_to_celestial_frame

from astro_scc.epochs.grids.resampling import (
    WHOLE_PIXEL,
    grid_step,
    moved_wcs,
    probe_pixels,
    resample,
)

__all__ = ["reproject_cube", "shared_grid"]

ORDERS = ("nearest-neighbor", "bilinear", "biquadratic", "bicubic")


def _check_celestial(wcs):
    if not getattr(wcs, "is_celestial", False):
        raise ValueError(
            "the wcs of a grid must be celestial and two-dimensional; "
            "use wcs.celestial or WCS(header).celestial"
        )


def _is_per_pixel(unit):
    return any(
        power < 0 and base.name.lower() in ("pix", "pixel")
        for base, power in zip(unit.bases, unit.powers, strict=True)
    )


def _new_epoch_wcs(cube, wcs, shape):
    """Absolute coordinates of the new grid, where they differ by a shift only."""
    if cube.epoch_wcs is None:
        return None
    result = []
    for own in cube.epoch_wcs:
        pixels = probe_pixels(shape)
        old = pixel_to_pixel(wcs, cube.wcs, *pixels)
        step = pixels - np.array(pixel_to_pixel(own, wcs, *old))
        if not np.all(np.abs(step - step[:, :1]) < 0.01):
            return None
        result.append(moved_wcs(wcs, step[:, 0]))
    return tuple(result)


def reproject_cube(cube, wcs, shape, order="bicubic"):
    """
    Lay all epochs of a cube onto another pixel grid.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    wcs : `~astropy.wcs.WCS`
        Celestial WCS of the new grid.
    shape : (int, int)
        Shape (ny, nx) of the new grid.
    order : {"bicubic", "biquadratic", "bilinear", "nearest-neighbor"}, optional
        Interpolation, as in `reproject.reproject_interp`.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`
        On the new grid.  Pixels from outside the old grid, or to which bad
        pixels contribute, are masked.  ``noise`` is None, because
        resampling alters it, unless the grids differ by whole pixels:
        those are copied.

    Raises
    ------
    ValueError
        If ``order`` is unknown, ``wcs`` is not celestial, ``shape`` is not
        two positive integers, or the epochs have beams and ``wcs`` has
        another celestial frame (position angles would lose their north).

    Notes
    -----
    Intensities per beam or per solid angle are interpolated as they are,
    intensities per pixel are multiplied by the ratio of the pixel areas.
    Interpolation does not average: smooth before going to larger pixels
    (`~astro_scc.epochs.common_beam`).

    ``epoch_wcs`` is carried to the new grid if it differs from ``cube.wcs``
    by shifts only, and dropped otherwise (align on it first).

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
    if order not in ORDERS:
        raise ValueError(f"order={order!r} is not one of {', '.join(ORDERS)}")
    _check_celestial(wcs)
    shape = tuple(shape)
    if len(shape) != 2 or any(n != int(n) or n < 1 for n in shape):
        raise ValueError(f"shape={shape} must be two positive integers (ny, nx)")
    shape = tuple(int(n) for n in shape)
    same_frame = wcs_to_celestial_frame(wcs).is_equivalent_frame(
        wcs_to_celestial_frame(cube.wcs)
    )
    if cube.beams is not None and not same_frame:
        raise ValueError(
            "the new wcs has another celestial frame, in which the position angles "
            "of the beams do not hold; use a wcs in the frame of the epochs"
        )

    step, pure = grid_step(cube.wcs, wcs, cube.shape[1:])
    if pure and np.all(np.abs(step - np.rint(step)) < WHOLE_PIXEL):
        data, mask = _copy(cube.data, cube.mask, np.rint(step).astype(int), shape)
        noise, how = cube.noise, "whole pixels copied"
    else:
        data, mask = resample(
            cube.data, cube.mask, cube.wcs, wcs, shape=shape, order=order
        )
        noise, how = None, order
    area = _pixel_area(wcs) / _pixel_area(cube.wcs)
    if _is_per_pixel(cube.unit) and not np.isclose(area, 1, rtol=1e-6):
        data = data * area
    side = np.sqrt(_pixel_area(wcs)) * u.deg
    return cube.with_step(
        f"reprojected onto {shape[1]} x {shape[0]} pixels of "
        f"{side.to_value(u.mas):.4g} mas ({how})",
        data=data,
        mask=mask,
        wcs=wcs.deepcopy(),
        noise=noise,
        epoch_wcs=_new_epoch_wcs(cube, wcs, shape),
    )


def _copy(data, bad, step, shape):
    moved = np.full((len(data), *shape), np.nan)
    mask = np.ones(moved.shape, dtype=bool)
    pairs = [
        (
            slice(max(s, 0), max(min(n + s, n_new), 0)),
            slice(max(-s, 0), max(min(n, n_new - s), 0)),
        )
        for s, n, n_new in zip(step[::-1], data.shape[1:], shape, strict=True)
    ]
    target, source = ((slice(None), *(p[k] for p in pairs)) for k in (0, 1))
    moved[target] = np.where(bad[source], np.nan, data[source])
    mask[target] = bad[source]
    return moved, mask


def _pixel_area(wcs):
    """Solid angle of a pixel in square degrees."""
    return abs(np.linalg.det(wcs.pixel_scale_matrix))


def shared_grid(grids):
    """
    Smallest grid that holds several grids at the finest of their pixels.

    The grid with the smallest pixels gives its projection, orientation and
    reference point, the first of them if there are several, so that epochs
    on that grid need no interpolation.

    Parameters
    ----------
    grids : sequence of `~astro_scc.epochs.EpochCube` or of (shape, wcs)
        Shapes are (ny, nx) and WCS celestial.  Where offsets from the
        reference pixel are to be trusted and absolute coordinates are not,
        as in VLBI, give all of them the same ``crval`` first.

    Returns
    -------
    wcs : `~astropy.wcs.WCS`
    shape : (int, int)

    Raises
    ------
    ValueError
        If ``grids`` is empty, a WCS is not celestial, or the grids lie so
        far apart that the shared one would be empty for the most part.

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
    grids = [
        (g.shape[-2:], g.wcs) if hasattr(g, "wcs") else (tuple(g[0]), g[1])
        for g in grids
    ]
    if not grids:
        raise ValueError("shared_grid needs at least one grid")
    for _, wcs in grids:
        _check_celestial(wcs)
    areas = np.array([_pixel_area(wcs) for _, wcs in grids])
    finest = grids[int(np.argmax(areas <= areas.min() * (1 + 1e-6)))][1]

    corners = []
    for (ny, nx), wcs in grids:
        edge = np.linspace(0, 1, 33)
        low, high = np.zeros(33), np.ones(33)
        x = np.concatenate([edge, edge, low, high]) * (nx - 1)
        y = np.concatenate([low, high, edge, edge]) * (ny - 1)
        if wcs is not finest:
            x, y = pixel_to_pixel(wcs, finest, x, y)
        corners.append([x, y])
    corners = np.concatenate(corners, axis=1)
    covered = sum(
        ny * nx * area for ((ny, nx), _), area in zip(grids, areas, strict=True)
    )
    if np.all(np.isfinite(corners)):
        # Pixels that match but for rounding add no row.
        first = np.floor(corners.min(axis=1) + 0.01).astype(int)
        last = np.ceil(corners.max(axis=1) - 0.01).astype(int)
        nx, ny = (last - first + 1).tolist()
    if not np.all(np.isfinite(corners)) or nx * ny * areas.min() > 100 * covered:
        raise ValueError(
            "the grids lie too far apart on the sky to share one; "
            "check that all epochs show one object"
        )
    shared = moved_wcs(finest, -first)
    shared.array_shape = (ny, nx)
    return shared, (ny, nx)
