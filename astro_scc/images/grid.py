# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""One beam and one pixel grid for several images: convolution and resampling."""

from __future__ import annotations

import astropy.units as u
import numpy as np
from astropy.io.fits import Header
from astropy.wcs import WCS
from astropy.wcs.utils import pixel_to_pixel, wcs_to_celestial_frame
from scipy import ndimage

from astro_scc.exceptions import warn
from astro_scc.images.beam import (
    CONTAINS,
    EQUAL,
    Beam,
    as_beam,
    beam_excess,
    gaussian_smooth,
    is_per,
    smallest_common_beam,
)
from astro_scc.images.headers import celestial_wcs
from astro_scc.images.positions import readable_angle
from astro_scc.images.series import ImageSeries, Series
from astro_scc.images.validation import as_celestial, naming
from astro_scc.quantities import check_choice, named

# Pixels are copied if a shift is this near to whole pixels; sky coordinates in
# degrees resolve pixels of microarcseconds to about 1e-4.
WHOLE_PIXEL = 1e-4
# Steps that differ by less, in pixels, count as one shift of the whole image.
ONE_SHIFT = 0.01
# A resampled pixel is bad if bad pixels contribute more than this weight to it.
BAD_WEIGHT = 0.01
ORDERS = ("nearest-neighbor", "bilinear", "biquadratic", "bicubic")
METHODS = ("interp", "exact", "adaptive")
# Pixels per full width at half maximum with which a beam is sampled.
SAMPLED = 2.0


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
    nearest = ndimage.distance_transform_edt(
        mask, return_distances=False, return_indices=True
    )
    filled = np.asarray(image, dtype=float)[tuple(nearest)]
    neighbours = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]]) / 4
    for _ in range(n_iterations):
        filled[mask] = ndimage.convolve(filled, neighbours, mode="nearest")[mask]
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
    moved = ndimage.shift(
        fill_masked(image, mask), step, order=3, mode="constant", cval=np.nan
    )
    weight = ndimage.shift(mask.astype(float), step, order=1, cval=1.0)
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
    pixels = _probe_pixels(shape)
    step = np.array(pixel_to_pixel(wcs, target, *pixels)) - pixels
    return step[:, 0], bool(np.all(np.abs(step - step[:, :1]) < ONE_SHIFT))


def is_same(wcs, other):
    """Return whether two celestial WCS without distortion are equal."""
    return wcs is other or (
        wcs.wcs.compare(other.wcs) and not (wcs.has_distortion or other.has_distortion)
    )


def _probe_pixels(shape):
    """Return (x, y) of the centre and the corners of an image, shape (2, 5)."""
    corners = [[0.5, 0, 1, 0, 1], [0.5, 0, 0, 1, 1]]
    return np.array(corners) * [[shape[1] - 1], [shape[0] - 1]]


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


def resample(data, bad, wcs, new_wcs, *, shape, method="bicubic"):
    """
    Return images (n, ny, nx) and their bad pixels on another grid, NaN where bad.

    The method is "exact", "adaptive", or an order of `reproject.reproject_interp`.
    """
    import reproject

    filled = np.stack([fill_masked(d, b) for d, b in zip(data, bad, strict=True)])
    options = {"shape_out": shape, "return_footprint": False}
    if method in ("exact", "adaptive"):
        lay, order, linear = getattr(reproject, f"reproject_{method}"), {}, {}
    else:
        lay, order = reproject.reproject_interp, {"order": method}
        linear = {"order": "bilinear"}
    # reproject maps the pixels once for all images.
    moved = lay((filled, wcs), new_wcs, **order, **options)
    weight = lay((bad.astype(float), wcs), new_wcs, **linear, **options)
    mask = ~(weight <= BAD_WEIGHT) | ~np.isfinite(moved)
    return np.where(mask, np.nan, moved), mask


def regrid(data, bad, wcs, grid, *, shape, unit, method="bicubic", near=WHOLE_PIXEL):
    """
    Return images and bad pixels on another grid, and whether pixels were copied.

    They are copied if the grids differ by whole pixels to within ``near``.  Otherwise
    they are resampled, see `resample`, and intensities per pixel are scaled to the
    area of the new pixels.
    """
    step, pure = grid_step(wcs, grid, data.shape[-2:])
    whole = np.rint(step)
    if pure and np.all(np.abs(step - whole) < near):
        if not whole.any() and shape == data.shape[-2:]:
            return data.copy(), bad.copy(), True
        return *_copy(data, bad, whole[::-1].astype(int), shape), True
    data, bad = resample(data, bad, wcs, grid, shape=shape, method=method)
    area = pixel_area(grid) / pixel_area(wcs)
    if is_per(unit, "pix", "pixel") and not np.isclose(area, 1, rtol=1e-6):
        data *= area
    return data, bad, False


def reproject_cube(
    cube: Series, wcs: WCS | Header | ImageSeries,
    shape: tuple[int, int] | None = None, order: str | None = None, *,
    method: str = "interp",
) -> Series:  # fmt: skip
    """
    Return all epochs of a cube resampled to another pixel grid.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    wcs : `~astropy.wcs.WCS`, `~astropy.io.Header` or `EpochCube`
        The new grid, with celestial axes.
    shape : (int, int), optional
        Shape (ny, nx) of the new grid, by default that of the header, the
        cube, or the ``array_shape`` of the WCS.
    order : {"bicubic", "biquadratic", "bilinear", "nearest-neighbor"}, optional
        Order of the interpolation, as in `reproject.reproject_interp`.
    method : {"interp", "exact", "adaptive"}, optional
        Interpolation, or for larger pixels an average over each of them:
        `reproject.reproject_exact` weights by the area that pixels share,
        `reproject.reproject_adaptive` by a Gaussian filter.

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
        If ``order`` or ``method`` is unknown, ``wcs`` is not celestial,
        ``shape`` is missing or not two positive integers, or the epochs have
        beams and ``wcs`` has another celestial frame (position angles would
        refer to another north).
    TypeError
        If ``wcs`` has the wrong type.

    Warns
    -----
    EpochWarning
        If interpolation undersamples: the new pixels are larger than the old
        ones and than half the beam.

    Notes
    -----
    Intensities per beam or per solid angle are interpolated as they are;
    intensities per pixel are multiplied by the ratio of the pixel areas.
    Interpolation does not average: white noise of rms 1 has an rms of 0.5 to 1
    on pixels four times as large, but 0.22 to 0.25 with ``method="exact"``.

    ``epoch_wcs`` is transferred to the new grid if it differs from ``cube.wcs``
    by shifts only, and dropped otherwise (align with it first).

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
    if method != "interp" and order is not None:
        raise ValueError(f"method={method!r} has no order; leave it out")
    order = order or "bicubic"
    named("method", check_choice, method, *METHODS)
    named("order", check_choice, order, *ORDERS)
    wcs, shape = _grid_of(wcs, shape)
    frames = [wcs_to_celestial_frame(grid) for grid in (wcs, cube.wcs)]
    if cube.beams is not None and not frames[0].is_equivalent_frame(frames[1]):
        raise ValueError(
            "the new wcs has another celestial frame, in which the position angles "
            "of the beams do not hold; use a wcs in the frame of the epochs"
        )
    how = order if method == "interp" else method
    grids = {"wcs": cube.wcs, "grid": wcs, "shape": shape, "unit": cube.unit}
    data, mask, copied = regrid(cube.data, cube.mask, method=how, **grids)
    if method == "interp" and not copied:
        _warn_of_undersampling(cube, wcs)
    side = (np.sqrt(pixel_area(wcs)) * u.deg).to_value(u.mas)
    return cube.with_step(
        f"reprojected onto {shape[1]} x {shape[0]} pixels of {side:.4g} mas "
        f"({'whole pixels copied' if copied else how})",
        data=data,
        mask=mask,
        wcs=wcs.deepcopy(),
        noise=cube.noise if copied else None,
        epoch_wcs=_new_epoch_wcs(cube, wcs, shape),
    )


def _grid_of(target, shape=None):
    """Return the WCS and shape of a grid, from a header, a cube or a WCS."""
    if isinstance(target, Header):
        own = target.get("NAXIS2"), target.get("NAXIS1")
        own = own if all(own) else None
        with naming("the header of the new grid"):
            wcs = as_celestial(celestial_wcs(target))
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
    """Warn if interpolation skips pixels."""
    side, own = (np.sqrt(pixel_area(grid)) * u.deg for grid in (wcs, cube.wcs))
    beams = [beam.minor / SAMPLED for beam in cube.beams or ()]
    if side > 1.01 * max(own, min(beams, default=own)):
        warn(
            f"pixels of {readable_angle(own)} are interpolated at steps of "
            f"{readable_angle(side)}, which leaves out those between; use "
            "method='exact' or 'adaptive' to average them, or smooth them first"
        )


def _new_epoch_wcs(cube, wcs, shape):
    """Return the absolute coordinates on the new grid, None if not all are shifts."""
    if cube.epoch_wcs is None:
        return None
    pixels = _probe_pixels(shape)
    old = pixel_to_pixel(wcs, cube.wcs, *pixels)
    steps = [pixels - pixel_to_pixel(own, wcs, *old) for own in cube.epoch_wcs]
    if not np.all(np.abs(np.subtract(steps, np.array(steps)[..., :1])) < ONE_SHIFT):
        return None
    return tuple(moved_wcs(wcs, step[:, 0]) for step in steps)


def pixel_area(wcs):
    """Return the solid angle of a pixel in square degrees."""
    return abs(np.linalg.det(wcs.pixel_scale_matrix))


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
    areas = np.array([pixel_area(wcs) for _, wcs in grids])
    finest = grids[int(np.argmax(areas <= areas.min() * (1 + 1e-6)))][1]
    edge = np.linspace(0, 1, 33)
    sides = (edge, 0), (edge, 1), (0, edge), (1, edge)
    outline = np.concatenate([np.broadcast_arrays(*side) for side in sides], axis=1)
    corners = []
    for (ny, nx), wcs in grids:
        x, y = outline * [[nx - 1], [ny - 1]]
        same = is_same(wcs, finest)
        corners.append([x, y] if same else pixel_to_pixel(wcs, finest, x, y))
    corners = np.concatenate(corners, axis=1)
    # Rounding errors must not add a row.
    first = np.floor(corners.min(axis=1) + 0.01)
    size = np.ceil(corners.max(axis=1) - 0.01) - first + 1
    covered = np.sum(areas * [ny * nx for (ny, nx), _ in grids])
    # It is NaN if a grid lies beyond the horizon of the projection.
    if not np.prod(size) * areas.min() <= 100 * covered:
        raise ValueError(
            "the grids lie too far apart on the sky to share one; "
            "check that all epochs show one object"
        )
    shared = moved_wcs(finest, -first)
    shared.array_shape = shape = tuple(size[::-1].astype(int).tolist())
    return shared, shape


def common_beam(cube: Series, beam: Beam | None = None) -> Series:
    """
    Return the cube with all epochs convolved to the same beam.

    An epoch with beam covariance ``C_i`` is convolved with a Gaussian of
    covariance ``C - C_i``; intensities per beam are multiplied by the ratio
    of the beam areas, so that flux densities are conserved.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
        With ``beams``.
    beam : beam, optional
        `~astro_scc.epochs.Beam`, or anything with the attributes ``major``,
        ``minor`` and ``pa``.  By default the smallest beam that contains the
        beams of all epochs.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`
        Epochs that already have the beam are identical to the bit.  Bad
        pixels stay bad and do not contribute; good pixels beside them and at
        the edges keep their level.  ``noise`` is None, and is then measured
        again, unless no epoch needed convolution.

    Raises
    ------
    ValueError
        If the epochs have no beams, or one of them does not fit into
        ``beam``.
    TypeError
        If ``beam`` is not a beam.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc.epochs import Beam, EpochCube
    >>> cube = EpochCube.from_arrays(
    ...     np.ones((2, 32, 32)),
    ...     ["2000-01-01", "2001-01-01"],
    ...     pixel_scale=0.1 * u.mas,
    ...     unit=u.Jy / u.beam,
    ...     beams=[Beam(s * u.mas, s * u.mas) for s in (0.5, 1)],
    ... )
    >>> smooth = common_beam(cube)
    >>> print(smooth.beams[0])
    1 x 1 mas at 0.0 deg
    >>> smooth.data[:, 16, 16].round(6)
    array([4., 1.])
    """
    if cube.beams is None:
        raise ValueError(
            "the epochs have no beams, so there is no common one; give them to "
            "EpochCube as beams=[...], or leave this step out"
        )
    target = smallest_common_beam(cube.beams) if beam is None else as_beam(beam)
    goal = target.covariance.value
    to_pixels = np.linalg.inv(cube.pixel_matrix.to_value(u.mas))
    data = cube.data.copy()
    changed = []
    for i, own in enumerate(cube.beams):
        covariance = own.covariance.value
        excess = beam_excess(goal, covariance)
        if excess > 1 + CONTAINS:
            raise ValueError(
                f"{cube.labels[i]}: its beam {own} does not fit into {target}; "
                "choose a larger one, or none for the smallest common beam"
            )
        if max(excess, beam_excess(covariance, goal)) <= 1 + EQUAL:
            continue
        variances, axes = np.linalg.eigh(to_pixels @ (goal - covariance) @ to_pixels.T)
        # Rounding errors must not leave a negative variance.
        difference = (axes * np.maximum(variances, 0)) @ axes.T
        data[i] = gaussian_smooth(data[i], difference, cube.mask[i])
        if is_per(cube.unit, "beam"):
            data[i] *= float(target.area / own.area)
        changed.append(i)
    return cube.with_step(
        f"common beam {target} ({len(changed)} of {len(cube)} epochs convolved)",
        data=data,
        beams=(target,) * len(cube),
        noise=None if changed else cube.noise,
    )
