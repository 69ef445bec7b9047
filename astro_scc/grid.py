# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Coordinates along and across the flow: the one home of its direction.

Grids are straight, along a ridge line, radial or in ln r; where the flow is seen, the
wavelet planes of all epochs are sampled on them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import astropy.units as u
import numpy as np
import scipy

from astro_scc import kinematics
from astro_scc.decomposition import wavelet
from astro_scc.images.beam import FWHM_TO_SIGMA
from astro_scc.images.grid import gaussian_smooth
from astro_scc.kinematics.frames import axes_along
from astro_scc.spectrum.diagram import REACH, SampledPlanes

#: Part of the flow on the other side of the core that makes a counter-jet, and the gap
#: between both halves of the grid, in beams.
COUNTER, GAP = 0.02, 2.0
#: With less of the flow on its side of the core, a position angle is of the other one;
#: the light of the core takes 0.02 to 0.05.
AHEAD = 0.1
#: Smallest radius of an expansion, relative to the distance of what is seen.
SMALLEST = 0.1
#: Margin around what is seen, in beams.
MARGIN = 0.5
#: Margin around the grid, in sizes of the largest scale.
BORDER = 10
#: Least share of known points along the flow, as far as a wavelet reaches: more than
#: beside an edge, less than around single bad pixels.
KNOWN = 7 / 8
#: Lines that diverge do so from so many beams behind the core.
BEHIND = 1.0


@dataclass(frozen=True, eq=False, repr=False)
class FlowGrid:
    """
    Points along and across a flow.

    Attributes
    ----------
    x, y : `~numpy.ndarray`, shape (n_along, n_across)
        Pixels, counted from 0.
    along, across : `~numpy.ndarray`, shapes (n_along,) and (n_across,)
        Coordinates in beams.  If both sides of a core are seen, ``along`` is the
        distance from it on either side, so that outward is positive, and ``across`` has
        first the points of the jet, then those of the counter-jet.
    counter : `~numpy.ndarray` of bool, shape (n_across,)
        Which are those of the counter-jet.
    distance : `~numpy.ndarray`, shape (n_along,)
        From the origin of the flow, in beams: ``along`` of a shell is its logarithm.
    weight : `~numpy.ndarray`, shape (n_along, 1)
        Area that a point stands for.
    beam : float
        Length of the unit, in mas.
    angle : float
        Position angle of a straight grid, in radians, or NaN.
    outward : bool
        Whether positive speeds lead away from a core.
    lines : `~numpy.ndarray`, shape (2, n_along, n_across), optional
        Rows and columns of the straight grid through which its lines lead.
    """

    x: np.ndarray
    y: np.ndarray
    along: np.ndarray
    across: np.ndarray
    counter: np.ndarray
    distance: np.ndarray
    weight: np.ndarray
    beam: float
    angle: float = np.nan
    outward: bool = False
    lines: np.ndarray | None = None

    @property
    def bends(self) -> bool:
        """Whether its lines bend, so that speeds along them are lengths."""
        return self.lines is not None and bool((self.lines[0] % 1).any())

    @property
    def distances(self) -> np.ndarray:
        """Distance of each point from the origin of the flow, in beams."""
        return np.broadcast_to(self.distance[:, None], self.x.shape)

    @property
    def kind_of_lines(self) -> str:
        """Whether its lines are straight, diverging or bent."""
        if self.lines is None:
            return "straight"
        return "bent" if self.bends else "diverging"

    @property
    def axes(self) -> np.ndarray:
        """Unit vectors (east, north) along and across a straight grid."""
        return axes_along(np.sin(self.angle), np.cos(self.angle))


def flow_grids(cube, frame, seen, beam, *, core, points=8.0):
    """
    Return the grids on which the flow is looked at.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    frame : frame of `astro_scc.kinematics`
        Axes of the velocities; with axes to the east and north no direction is known,
        and there are twelve grids.
    seen : `~numpy.ndarray` of bool, shape (ny, nx)
        Pixels in which the flow is seen.
    beam : float
        In mas.
    core : bool
        Whether there is a core at the reference pixel, from which both sides flow.
    points : float, optional
        Points of a grid in a beam, at most.

    Returns
    -------
    list of `FlowGrid`
    """
    y, x = np.nonzero(seen)
    east, north = (offset.to_value(u.mas) for offset in cube.pixel_to_offset(x, y))
    step = max(cube.pixel_scale.to_value(u.mas) / beam, 1 / points)
    if isinstance(frame, kinematics.SkyFrame):
        turns = np.arange(12) * np.pi / 12
        return [straight_grid(cube, t, east, north, step, beam) for t in turns]
    if isinstance(frame, kinematics.PositionAngleFrame):
        angle = frame.pa.to_value(u.rad)
        return [straight_grid(cube, angle, east, north, step, beam, core=core)]
    if isinstance(frame, kinematics.RidgeLine):
        return [ridge_grid(cube, frame, east, north, step, beam)]
    if isinstance(frame, kinematics.RadialFrame | kinematics.ExpansionFrame):
        return [radial_grid(cube, frame, east, north, step, beam)]
    raise TypeError(f"no grid is known for the frame {type(frame).__name__}")


def straight_grid(cube, angle, east, north, step, beam, *, core=False):
    """
    Return the grid along a position angle.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    angle : float
        In radians.
    east, north : `~numpy.ndarray`, shape (n,)
        Where the flow is seen, in mas from the reference pixel.
    step : float
        Distance of two points in beams.
    beam : float
        In mas.
    core : bool, optional
        Whether both sides flow away from the reference pixel.

    Returns
    -------
    `FlowGrid`
    """
    axes = axes_along(np.sin(angle), np.cos(angle))
    if core and np.mean(axes[0] @ np.stack([east, north]) > 0) < AHEAD:
        angle, axes = angle + np.pi, -axes
    s, n = axes @ np.stack([east, north]) / beam
    side = np.ones(len(s))
    if core:
        side[s < 0] = -1
        few = (side < 0).mean() < COUNTER
        s, n, side = (a[side > 0] for a in (s, n, side)) if few else (s, n, side)
        s = np.abs(s)
    along = _covering(0.0 if core else _least(s), _most(s), step)
    parts = [(1, _covering(_least(n[side > 0]), _most(n[side > 0]), step))]
    if (side < 0).any():
        parts.append((0, _covering(-GAP / 2, GAP / 2, step)))
        parts.append((-1, _covering(_least(n[side < 0]), _most(n[side < 0]), step)))
    across = np.concatenate([points for _, points in parts])
    sense = np.concatenate([np.full(len(points), way) for way, points in parts])
    place = along[:, None, None] * sense[:, None] * axes[0]
    place = (place + across[:, None] * axes[1]) * beam
    x, y = cube.offset_to_pixel(*(np.moveaxis(place, -1, 0) * u.mas))
    # Nothing is seen in the gap between both halves.
    x, y = (np.where(sense == 0, -1e9, pixel) for pixel in (x, y))
    weight = np.ones((len(along), 1))
    return FlowGrid(
        x, y, along, across, sense < 0, np.abs(along), weight, beam, angle, core
    )


def ridge_grid(cube, line, east, north, step, beam):
    """Return the grid along a ridge line; see `straight_grid`."""
    s, n = (v.value / beam for v in line.coordinates(east * u.mas, north * u.mas))
    use = s >= 0
    if not use.any():
        use = np.ones(len(s), dtype=bool)
    along = _covering(0.0, _most(s[use]), step)
    across = _covering(_least(n[use]), _most(n[use]), step)
    start = np.stack([v.to_value(u.mas) for v in line.at(along * beam * u.mas)], -1)
    angle = line.position_angle(along * beam * u.mas).to_value(u.rad)
    normal = np.stack([np.cos(angle), -np.sin(angle)], axis=-1)
    place = start[:, None] + across[:, None] * beam * normal[:, None]
    x, y = cube.offset_to_pixel(*(np.moveaxis(place, -1, 0) * u.mas))
    counter = np.zeros(len(across), dtype=bool)
    weight = np.ones((len(along), 1))
    return FlowGrid(x, y, along, across, counter, along, weight, beam, outward=True)


def radial_grid(cube, frame, east, north, step, beam):
    """Return the grid in distance, or its logarithm, and angle; see `straight_grid`."""
    shell = isinstance(frame, kinematics.ExpansionFrame)
    origin = frame.origin.to_value(u.mas)
    dx, dy = east - origin[0], north - origin[1]
    r = np.maximum(np.hypot(dx, dy), 1e-3 * beam)
    unit = frame.radius.to_value(u.mas) if shell else float(np.mean(r))
    angle = np.arctan2(dx, dy)
    # Angles are cut where the flow is not seen far out; near the origin it may be seen
    # all around, for the sake of the core's sidelobes.
    far = np.sort(angle[r >= np.median(r)])
    gaps = np.diff(np.append(far, far[0] + 2 * np.pi))
    cut = far[gaps.argmax()] + gaps.max() / 2
    turned = np.mod(angle - cut, 2 * np.pi)
    start, turned = cut + turned.min(), turned - turned.min()
    if shell and not unit > SMALLEST * np.median(r):
        raise ValueError(
            f"the radius of the ExpansionFrame, {unit:.4g} mas, is far below the "
            f"distance of what is seen, {np.median(r):.4g} mas: give that of the shell"
        )
    across = _covering(0.0, turned.max() * unit / beam, step)
    theta = start + across * beam / unit
    if shell:
        use = r >= 0.2 * unit
        s = unit / beam * np.log(r[use] / unit)
        along = _covering(s.min(), s.max(), step)
        radius = unit * np.exp(along * beam / unit)
        weight = (radius / radius.max()) ** 2
    else:
        along = _covering(0.0, _most(r / beam), step)
        radius = along * beam
        weight = radius / radius.max()
    east = origin[0] + radius[:, None] * np.sin(theta)
    north = origin[1] + radius[:, None] * np.cos(theta)
    x, y = cube.offset_to_pixel(east * u.mas, north * u.mas)
    counter = np.zeros(len(across), dtype=bool)
    distance, weight = radius / beam, weight[:, None]
    return FlowGrid(x, y, along, across, counter, distance, weight, beam, outward=True)


def _least(values):
    return float(values.min()) - MARGIN


def _most(values):
    return float(values.max()) + MARGIN


def _covering(low, high, step):
    """Return evenly spaced points, one of them zero if it lies between the limits."""
    return np.arange(np.floor(low / step), np.ceil(high / step) + 1) * step


# -- wavelet planes on a grid --------------------------------------------------------


def default_scales(beam_px, largest=0.55, number=3):
    """Return a number of scales up to a part of the beam, whose size is in pixels."""
    last = max(0, int(np.floor(np.log2(largest * beam_px) + 1e-9)))
    return tuple(range(max(0, last - number + 1), last + 1))


def seen_flow(cube, beam, *, core, threshold=5.0, least=1.2):
    """
    Return the pixels in which the flow is seen, if need be without a sky.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    beam : float
        In mas.
    core : bool
        Whether the core at the reference pixel is left out.
    threshold : float, optional
        Faintest mean of the brightest quarter of epochs, in noises of an epoch.
    least : float, optional
        Distance from the core from which the flow is looked at, in beams.

    Returns
    -------
    `~numpy.ndarray` of bool, shape (ny, nx)
    """
    place = np.ones(cube.shape[1:], dtype=bool)
    if core:
        east, north = (offset.to_value(u.mas) for offset in cube.offsets())
        place = np.hypot(east, north) > least * beam
    seen = place & _bright(cube.data, cube.mask, cube.noise_rms().value, threshold)
    if not seen.any():
        # The noise of images whose sky is not even is that of the sky.
        data, rms = _evened(cube, beam)
        seen = place & _bright(data, cube.mask, rms, threshold)
    return seen


def _bright(data, mask, rms, threshold):
    """Return the pixels whose brightest quarter of epochs has a mean above noises."""
    n = len(data)
    few = max(2, n // 4)
    images = np.where(mask, -np.inf, data)
    top = np.partition(images, n - few, axis=0)[n - few :].mean(axis=0)
    return top > threshold * float(np.median(rms))


def _evened(cube, beam, *, smooth=4.0):
    """Return images without their sky, smooth on this many beams, and their noise."""
    width = FWHM_TO_SIGMA * smooth * beam / cube.pixel_scale.to_value(u.mas)
    even = np.where(cube.mask, np.nan, cube.data)
    for epoch, image in enumerate(even):
        for place, axis in zip(np.indices(image.shape), (0, 1), strict=True):
            # Smoothing has one side alone at the edges of a slope.
            image -= np.nanmedian(np.diff(image, axis=axis)) * place
        even[epoch] -= gaussian_smooth(image, width**2 * np.eye(2))
    return even, [*map(wavelet.measure_noise, even, cube.mask)]


def has_core(cube, beam):
    """Return whether the brightest point of the mean image is the reference pixel."""
    if cube.beams is None:
        return False
    image = np.nan_to_num(np.asarray(cube.mean_image().data, dtype=float), nan=-np.inf)
    y, x = np.unravel_index(image.argmax(), image.shape)
    place = [v.to_value(u.mas) for v in cube.pixel_to_offset(x, y)]
    return bool(np.hypot(*place) < beam)


def sample_lines(grid, sampled, lines):
    """
    Return a straight grid and the planes on it along lines through its points.

    Parameters
    ----------
    grid : `FlowGrid`
    sampled : ``SampledPlanes``
    lines : `~numpy.ndarray`, shape (2, n_points, n_across)
        Rows and columns, see `flow_lines`.

    Returns
    -------
    grid : `FlowGrid`
    sampled : ``SampledPlanes``
    """
    row, column = (
        np.clip(np.rint(at).astype(int), 0, n - 1)
        for at, n in zip(lines, grid.x.shape, strict=True)
    )
    # No line leads from one half of the grid to the other.
    known = np.abs(lines - [row, column]).max(axis=0) <= 0.5
    known &= grid.counter[column] == grid.counter
    at_lines = scipy.ndimage.map_coordinates
    planes = [[at_lines(one, lines, order=3) for one in k] for k in sampled.planes]
    pixels = grid.x, grid.y
    x, y = (at_lines(p, lines, order=1, mode="nearest") for p in pixels)
    weight = lines[1, :, 1:2] - lines[1, :, :1]
    weight = weight / weight.max()
    step = grid.along[1] - grid.along[0]
    along = grid.along[0] + step * np.arange(len(weight))
    return (
        replace(
            grid, x=x, y=y, along=along, distance=np.abs(along), weight=weight,
            lines=lines,
        ),
        replace(
            sampled, planes=np.array(planes), along=along, weight=weight,
            valid=sampled.valid[:, row, column] & known,
            mask=sampled.mask[row, column] & known,
        ),
    )  # fmt: skip


def flow_lines(grid, values):
    """
    Return lines of a straight grid along which the flow may move.

    Parameters
    ----------
    grid : ``FlowGrid``
    values : `~numpy.ndarray`, shape (n_scales, n_epochs, n_along, n_across)
        The planes along it, zero where nothing is seen.

    Returns
    -------
    list of `~numpy.ndarray`, shape (2, n_points, n_across)
        Rows and columns of lines that diverge from a beam behind the core, unchanged at
        the mean distance; and of those that bend with the middle of what changes, a
        parabola, at even steps of the way.
    """
    step, columns = grid.along[1] - grid.along[0], np.arange(len(grid.across))
    rows = np.arange(float(len(grid.along)))[:, None]
    power = (values**2).sum(axis=(0, 1)) * ~grid.counter
    weight = power.sum(axis=1)
    seen = weight > 0
    if seen.sum() < 3:
        return []
    width = np.abs(grid.along) + BEHIND
    width = (width / (weight @ width / weight.sum()))[:, None]
    middle = power[seen] @ grid.across / weight[seen]
    curve = np.polynomial.Polynomial.fit(
        grid.along[seen], middle, 2, w=np.sqrt(weight[seen])
    )
    way = np.cumsum(np.hypot(1, curve.deriv()(grid.along)))
    at = np.interp(np.arange(way[0], way[-1]), way, rows[:, 0])[:, None]
    bent = columns + ~grid.counter * curve(grid.along[0] + step * at) / step
    diverging = np.broadcast_arrays(rows, columns + grid.across * (width - 1) / step)
    return [np.stack(diverging), np.stack(np.broadcast_arrays(at, bent))]


def sample_planes(cube, grid, scales, seen, *, kernel="b1", order=3, reach=REACH):
    """
    Decompose all epochs on a grid along the flow.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    grid : ``FlowGrid``
    scales : sequence of float
        Numbers of the wavelet scales.
    seen : `~numpy.ndarray` of bool, shape (ny, nx)
    kernel : str, optional
        Of the wavelets.
    order : int, optional
        Of the splines between pixels.
    reach : float, optional
        Largest displacement of the diagrams, in beams.

    Returns
    -------
    ``SampledPlanes``
    """
    ny, nx = cube.shape[1:]
    inside = (grid.x > -0.5) & (grid.y > -0.5)
    inside &= (grid.x < nx - 0.5) & (grid.y < ny - 0.5)
    margin = int(BORDER * max(wavelet.scale_size(scale) for scale in scales)) + 2
    box = tuple(
        slice(max(0, int(v[inside].min()) - margin), int(v[inside].max()) + margin + 1)
        for v in (grid.y, grid.x)
    )
    sampled = scipy.ndimage.map_coordinates
    where = np.array([grid.y - box[0].start, grid.x - box[1].start])
    where = np.where(inside, where, -1e6)
    n = len(cube)
    planes = np.empty((len(scales), n, *grid.x.shape), np.float32)
    valid = np.empty((n, *grid.x.shape), dtype=bool)
    sky, noise = ~seen[box], np.empty((n, len(scales)))
    for k in range(n):
        missing = cube.mask[k][box]
        masked = missing if missing.any() else None
        image = np.where(missing, 0.0, cube.data[k][box])
        found = wavelet.wavelet_planes(image, scales, kernel=kernel, mask=masked)
        empty, pairs = sky & ~missing, zip(found, scales, strict=True)
        noise[k] = [_noise(plane, scale, empty, masked) for plane, scale in pairs]
        for j, plane in enumerate(found):
            planes[j, k] = sampled(plane, where, order=order)
        valid[k] = inside
        if masked is not None:
            valid[k] &= sampled(missing.astype(float), where, order=1, cval=1.0) < 0.5
    mask = sampled(seen[box].astype(float), where, order=1) > 0.5
    side = cube.pixel_scale.to_value(u.mas) / (grid.along[1] - grid.along[0])
    # In the mirror image beyond an edge across the flow all moves backward.
    far = max(wavelet.scale_reach(scale, kernel) for scale in scales)
    around = 1, 1 + 2 * int(np.ceil(side / grid.beam * far - 1e-6)), 3
    share = scipy.ndimage.uniform_filter(np.float32(valid), around, mode="nearest")
    valid &= share > KNOWN
    return SampledPlanes(
        planes, valid, mask, np.sqrt((noise**2).mean(axis=0)), grid.along, grid.across,
        grid.weight, cube.years.to_value(u.yr), tuple(scales),
        tuple(side / grid.beam * wavelet.scale_size(scale) for scale in scales), reach,
    )  # fmt: skip


def region_weight(region, grid):
    """Return the weight of the points of a grid inside a region, None without one."""
    if region is None:
        return None
    where = np.array([grid.y, grid.x])
    weight = scipy.ndimage.map_coordinates(np.asarray(region, float), where, order=1)
    return weight.astype(np.float32)


def _noise(plane, scale, sky, mask):
    """Return the noise of a plane where no flow is seen, or as it is found in it."""
    if sky.mean() < 0.1:
        return wavelet.plane_noise(plane, scale, mask=mask)
    return wavelet.MAD_TO_SIGMA * wavelet.median(np.abs(plane[sky]))
