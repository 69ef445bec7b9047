# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images on another pixel grid, and with another beam."""

from __future__ import annotations

import astropy.units as u
import numpy as np
import scipy
from astropy.io.fits import Header
from astropy.wcs import WCS
from astropy.wcs.utils import pixel_to_pixel, wcs_to_celestial_frame

from astro_scc.exceptions import naming, warn
from astro_scc.images import headers, positions, series
from astro_scc.images.beam import Beam, as_beam, contains, is_per, smallest_common_beam
from astro_scc.images.series import ImageSeries, Series

# Steps that differ by less, in pixels, count as one shift of the whole image.
ONE_SHIFT = 0.01
# A resampled pixel is bad if bad pixels contribute more than this weight to it.
BAD_WEIGHT = 0.01
#: Beginnings of lines of history after which pixels are not those of the files: of
#: images that were not flat, on grids that differ, and on a grid that was asked for.
RESAMPLED, SHARED = "resampled onto a tangent plane", "laid on a shared grid"
REPROJECTED = "reprojected onto"


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
    filled = np.pad(np.asarray(image, dtype=float)[tuple(nearest)], 1, mode="edge")
    for _ in range(n_iterations):
        mean = filled[:-2, 1:-1] + filled[2:, 1:-1]
        mean += filled[1:-1, :-2] + filled[1:-1, 2:]
        np.copyto(filled[1:-1, 1:-1], mean / 4, where=mask)
        filled[[0, -1]] = filled[[1, -2]]
        filled[:, [0, -1]] = filled[:, [1, -2]]
    return filled[1:-1, 1:-1].copy()


def whole_pixels(step, near=1e-4):
    """
    Return the whole pixels of a step in pixels, None if they are not that ``near``.

    Sky coordinates in degrees resolve pixels of microarcseconds to about 1e-4.
    """
    whole = np.rint(step)
    return whole.astype(int) if np.all(np.abs(step - whole) < near) else None


def shift_image(image, mask, shift):
    """
    Return an image whose sources are moved by ``shift`` (dx, dy) pixels, and its mask.

    Shifts by whole pixels copy the pixels; others interpolate with cubic splines, which
    damp the smallest structures, but not those of beams of five pixels or more.  Pixels
    that come from outside the image, or to which bad pixels contribute, are masked and
    NaN.
    """
    step = np.asarray(shift, dtype=float)[::-1]
    if (whole := whole_pixels(step)) is not None:
        return _copy(image, mask, whole, image.shape)
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


def whole_step(wcs, target, shape, near=ONE_SHIFT):
    """Return the whole pixels by which grids differ, None if not, see `grid_step`."""
    step, pure = grid_step(wcs, target, shape)
    return whole_pixels(step, near) if pure else None


def is_same(wcs, other):
    """Return whether two celestial WCS without distortion are equal."""
    return wcs is other or wcs.wcs.compare(other.wcs)


def moved_wcs(wcs, shift):
    """Return the WCS of a grid whose content has moved by (dx, dy) pixels."""
    return positions.changed_wcs(wcs, crpix=wcs.wcs.crpix + np.asarray(shift, float))


def cut_wcs(wcs, window):
    """Return the WCS of a window of a grid, slices (y, x) with a start and a stop."""
    y, x = window
    part = moved_wcs(wcs, (-x.start, -y.start))
    part.array_shape = y.stop - y.start, x.stop - x.start
    return part


def regrid(data, bad, wcs, grid, *, unit, averaged=False, near=1e-4):
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
        return *_copy(data, bad, whole[::-1], shape), True
    # Slow to import, and not needed for most series.
    from reproject import reproject_exact, reproject_interp

    filled = np.stack([fill_masked(d, b) for d, b in zip(data, bad, strict=True)])
    lay = reproject_exact if averaged else reproject_interp
    options, weighed = {"shape_out": shape, "return_footprint": False}, {}
    if not averaged:
        options, weighed = options | {"order": "bicubic"}, {"order": "bilinear"}
    # reproject maps the pixels once for all images.
    moved = lay((filled, wcs), grid, **options)
    weight = lay((bad.astype(float), wcs), grid, **options | weighed)
    mask = ~(weight <= BAD_WEIGHT) | ~np.isfinite(moved)
    if is_per(unit, "pix", "pixel"):
        moved *= area_ratio(wcs, grid, shape)
    return np.where(mask, np.nan, moved), mask, False


def area_ratio(wcs, grid, shape):
    """Return the areas of the pixels (ny, nx) of a grid over those of a WCS there."""

    def ratio(x, y):
        there = pixel_to_pixel(grid, wcs, x, y)
        return positions.local_area(grid, x, y) / positions.local_area(wcs, *there)

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
            wcs = headers.celestial_wcs(wcs)
    wcs = headers.as_celestial(wcs)
    shape = wcs.array_shape if shape is None else shape
    if shape is None:
        raise ValueError("the grid has no shape of its own; give shape=(ny, nx)")
    shape = series.as_shape(shape)
    frames = [wcs_to_celestial_frame(grid) for grid in (wcs, cube.wcs)]
    if cube.beams is not None and not frames[0].is_equivalent_frame(frames[1]):
        raise ValueError(
            "the new wcs has another celestial frame, in which the position angles "
            "of the beams do not hold; use a wcs in the frame of the epochs"
        )
    side = np.sqrt(positions.middle_area(wcs, shape)) * u.deg
    # Two pixels a beam sample it.
    sampled = [beam.minor / 2 for beam in cube.beams or ()]
    present = cube.pixel_scale
    coarse = side > 1.01 * max(present, min(sampled, default=present))
    wcs = wcs.deepcopy()
    wcs.array_shape = shape
    data, mask, copied = regrid(
        cube.data, cube.mask, cube.wcs, wcs, unit=cube.unit, averaged=coarse
    )
    if not positions.is_flat(wcs, shape):
        wcs = series.flat_wcs(wcs, data, mask)
    how = "averaged" if coarse else "interpolated"
    how = "whole pixels copied" if copied else how
    return cube.with_step(
        f"{REPROJECTED} {shape[1]} x {shape[0]} pixels of "
        f"{side.to_value(u.mas):.4g} mas ({how})",
        data=data, mask=mask, wcs=wcs, epoch_wcs=None,
        noise=cube.noise if copied else None,
    )  # fmt: skip


def finest(grids):
    """Return the index of the first (shape, wcs) among those with smallest pixels."""
    areas = np.array([positions.middle_area(wcs, shape) for shape, wcs in grids])
    return int(np.argmax(areas <= areas.min() * (1 + 1e-6)))


def shared_grid(grids):
    """
    Return the smallest grid, and its shape, that holds grids at the finest of their
    pixels.

    Its projection, orientation and reference point are those of the grid with the
    smallest pixels (the first one if there are several), so that epochs on that grid
    need no interpolation.  If offsets from the reference pixel can be trusted and
    absolute coordinates cannot, as in VLBI, give all of them the same ``crval`` first.

    Parameters
    ----------
    grids : sequence of (shape, wcs)

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
    areas = np.array([positions.middle_area(wcs, shape) for shape, wcs in grids])
    fine = grids[finest(grids)][1]
    corners = []
    for shape, wcs in grids:
        edge = positions.outline(positions.whole(shape))
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
    far = positions.is_far(wcs, whole)
    if not far and positions.is_flat(wcs, data.shape[1:]):
        return ""
    mean = series.mean_of(data, mask)
    flat, turn = positions.flat_wcs(wcs, mean, moved=far)
    if flat is wcs:
        return ""
    if flat is not None:
        x, y = flat.wcs.crpix - 1
        every = [positions.tangent_wcs(one, (x, y)) for one in fields["epoch_wcs"]]
        line = f"offsets are from pixel ({x:.4g}, {y:.4g}), not the far reference pixel"
    else:
        with naming(f"{name} and the other images"):
            flat, turn = positions.tangent_grid(wcs, mean)
        shape, code = flat.array_shape, str(wcs.wcs.ctype[0])[5:]
        data, mask, _ = regrid(data, mask, wcs, flat, unit=unit)
        every = [flat] * len(data)
        line = f"{RESAMPLED} of {shape[1]} x {shape[0]} pixels at the structure"
        warn(
            f"all images are {line}: their projection ({code}) changes the scale over "
            "it; reproject them yourself if you want another grid"
        )
        fields |= {"data": data, "mask": mask}
    if turn > positions.EVEN:
        warn(
            f"north turns by {np.degrees(turn):.2g} deg from the middle of the "
            "structure to its edges; directions refer to north in the middle"
        )
    fields |= {"wcs": flat, "epoch_wcs": tuple(every)}
    return line


def gaussian_smooth(image, covariance, mask=False):
    """
    Return an image convolved with an elliptical Gaussian of unit sum.

    The image is multiplied in Fourier space by ``exp(-2 pi^2 k^T C k)``, with the
    ``covariance`` C over (x, y) in square pixels, which may be singular.  A normalised
    convolution (Knutsson & Westin 1993) leaves out bad pixels and everything beyond the
    edges: ``(g * (m I)) / (g * m)``, where m is 1 for good pixels and 0 for others.
    Pixels that are masked or not finite are bad, and stay NaN.
    """
    variances = np.linalg.eigvalsh(covariance)
    bad = ~np.isfinite(image) | mask
    pad = int(np.ceil(6 * np.sqrt(variances[1]))) + 2
    shape = [scipy.fft.next_fast_len(n + pad, real=True) for n in image.shape]
    transfer = gaussian_transfer(covariance, shape)

    def convolve(values):
        smooth = scipy.fft.irfft2(scipy.fft.rfft2(values, s=shape) * transfer, s=shape)
        return smooth[: image.shape[0], : image.shape[1]]

    weight = convolve((~bad).astype(float))
    smooth = convolve(np.where(bad, 0.0, image))
    # Good pixels contribute to their own weight, so it is never zero there.
    return np.divide(smooth, weight, out=np.full(image.shape, np.nan), where=~bad)


def gaussian_transfer(covariance, shape):
    """
    Return the transform of a Gaussian of unit sum in the layout of `scipy.fft.rfft2`.

    The ``covariance`` over (x, y), in square pixels, may be singular; ``shape`` is
    that of the image, (ny, nx).
    """
    ky = scipy.fft.fftfreq(shape[0])[:, None]
    kx = scipy.fft.rfftfreq(shape[1])[None, :]
    (xx, xy), (_, yy) = covariance
    form = xx * kx**2 + 2 * xy * kx * ky + yy * ky**2
    return np.exp(-2 * np.pi**2 * form)


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
            "the epochs have no beams; give them, beams=[...], or leave this step out"
        )
    target = smallest_common_beam(cube.beams) if beam is None else as_beam(beam)
    goal = target.covariance.value
    to_pixels = np.linalg.inv(cube.pixel_matrix.to_value(u.mas))
    data = cube.data.copy()
    changed = []
    for i, beam_now in enumerate(cube.beams):
        covariance = beam_now.covariance.value
        # Headers round to single precision.
        if not contains(goal, covariance, within=1e-4):
            raise ValueError(
                f"{cube.labels[i]}: its beam {beam_now} does not fit into {target}; "
                "choose a larger one, or none for the smallest common beam"
            )
        if contains(goal, covariance) and contains(covariance, goal):
            continue
        variances, axes = np.linalg.eigh(to_pixels @ (goal - covariance) @ to_pixels.T)
        # Rounding errors must not leave a negative variance.
        difference = (axes * np.maximum(variances, 0)) @ axes.T
        data[i] = gaussian_smooth(data[i], difference, cube.mask[i])
        if is_per(cube.unit, "beam"):
            data[i] *= float(target.area / beam_now.area)
        changed.append(i)
    line = f"common beam {target} ({len(changed)} of {len(cube)} epochs convolved)"
    noise = None if changed else cube.noise
    return cube.with_step(line, data=data, beams=(target,) * len(cube), noise=noise)
