# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Epochs laid onto another grid, and the grid that several can share."""

import warnings

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.wcs.utils import pixel_to_pixel, wcs_to_celestial_frame

from astro_scc.epochs.grids.resampling import (
    WHOLE_PIXEL,
    grid_step,
    moved_wcs,
    probe_pixels,
    resample,
)
from astro_scc.epochs.positions import readable_angle
from astro_scc.epochs.validation import as_celestial
from astro_scc.exceptions import EpochWarning

__all__ = ["reproject_cube", "shared_grid"]

ORDERS = ("nearest-neighbor", "bilinear", "biquadratic", "bicubic")
METHODS = ("interp", "exact", "adaptive")
#: Pixels in the full width of a beam that sample it.
SAMPLED = 2.0


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


def _grid_of(target, shape):
    """WCS and shape of the grid that something describes."""
    if isinstance(target, fits.Header):
        from astro_scc.epochs.headers import celestial_wcs

        axes = target.get("NAXIS2"), target.get("NAXIS1")
        try:
            wcs, own = as_celestial(celestial_wcs(target)), axes if all(axes) else None
        except ValueError as error:
            raise ValueError(f"the header of the new grid: {error}") from None
    elif hasattr(target, "shape") and hasattr(target, "wcs"):
        wcs, own = as_celestial(target.wcs), target.shape[-2:]
    else:
        wcs = as_celestial(target)
        own = wcs.array_shape
    if shape is None and own is None:
        raise ValueError("the grid has no shape of its own; give shape=(ny, nx)")
    shape = tuple(own if shape is None else shape)
    if len(shape) != 2 or any(n != int(n) or n < 1 for n in shape):
        raise ValueError(f"shape={shape} must be two positive integers (ny, nx)")
    return wcs, tuple(int(n) for n in shape)


def _warn_of_undersampling(cube, wcs):
    """Interpolation takes pixels one by one, and leaves out those between them."""
    side, own = (np.sqrt(_pixel_area(grid)) * u.deg for grid in (wcs, cube.wcs))
    beams = [beam.minor / SAMPLED for beam in cube.beams or ()]
    if side > 1.01 * max(own, min(beams, default=own)):
        warnings.warn(
            f"pixels of {readable_angle(own)} are interpolated at steps of "
            f"{readable_angle(side)}, which leaves out those between; use "
            "method='exact' or 'adaptive' to average them, or smooth them first",
            EpochWarning,
            stacklevel=4,
        )


def reproject_cube(cube, wcs, shape=None, order=None, *, method="interp"):
    """
    Lay all epochs of a cube onto another pixel grid.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    wcs : `~astropy.wcs.WCS`, `~astropy.io.fits.Header` or `EpochCube`
        The new grid, celestial.
    shape : (int, int), optional
        Shape (ny, nx) of the new grid, by default that of the header, the
        cube, or the ``array_shape`` of the WCS.
    order : {"bicubic", "biquadratic", "bilinear", "nearest-neighbor"}, optional
        Of the interpolation, as in `reproject.reproject_interp`.
    method : {"interp", "exact", "adaptive"}, optional
        Interpolation; or, for larger pixels, averages over them:
        `reproject.reproject_exact` by the areas that pixels share,
        `reproject.reproject_adaptive` with a Gaussian filter.

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
        If ``order`` or ``method`` is unknown, ``wcs`` is not celestial,
        ``shape`` is missing or not two positive integers, or the epochs have
        beams and ``wcs`` has another celestial frame (position angles would
        lose their north).
    TypeError
        If ``wcs`` is of another kind.

    Warns
    -----
    EpochWarning
        If interpolation undersamples: the new pixels are larger than the old
        ones and than half the beam.

    Notes
    -----
    Intensities per beam or per solid angle are interpolated as they are,
    intensities per pixel are multiplied by the ratio of the pixel areas.
    Interpolation does not average: white noise of 1 has an rms of 0.5 to 1 on
    pixels four times as large, and of 0.22 to 0.25 by ``method="exact"``.

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
    if method not in METHODS:
        raise ValueError(f"method={method!r} is not one of {', '.join(METHODS)}")
    if method != "interp" and order is not None:
        raise ValueError(f"method={method!r} has no order; leave it out")
    order = order or "bicubic"
    if order not in ORDERS:
        raise ValueError(f"order={order!r} is not one of {', '.join(ORDERS)}")
    wcs, shape = _grid_of(wcs, shape)
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
        noise, how = None, order if method == "interp" else method
        if method == "interp":
            _warn_of_undersampling(cube, wcs)
        data, mask = resample(
            cube.data, cube.mask, cube.wcs, wcs, shape=shape, method=how
        )
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
        _grid_of(g, None) if hasattr(g, "wcs") else _grid_of(g[1], g[0]) for g in grids
    ]
    grids = [(shape, wcs) for wcs, shape in grids]
    if not grids:
        raise ValueError("shared_grid needs at least one grid")
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
