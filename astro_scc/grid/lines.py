# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Grids along and across a flow: straight, along a ridge line, radial, in ln r."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np

from astro_scc.kinematics import (
    ExpansionFrame,
    PositionAngleFrame,
    RadialFrame,
    RidgeLine,
    SkyFrame,
)
from astro_scc.kinematics.frames import axes_along

#: Part of the flow on the other side of the core that makes a counter-jet, and the gap
#: between both halves of the grid, in beams.
COUNTER, GAP = 0.02, 2.0
#: Margin around what is seen, in beams.
MARGIN = 0.5


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
    weight : `~numpy.ndarray`, shape (n_along, 1)
        Area that a point stands for.
    beam : float
        Length of the unit, in mas.
    angle : float
        Position angle of a straight grid, in radians, or NaN.
    outward : bool
        Whether positive speeds lead away from a core.
    """

    x: np.ndarray
    y: np.ndarray
    along: np.ndarray
    across: np.ndarray
    counter: np.ndarray
    weight: np.ndarray
    beam: float
    angle: float = np.nan
    outward: bool = False

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
    if isinstance(frame, SkyFrame):
        turns = np.arange(12) * np.pi / 12
        return [straight_grid(cube, t, east, north, step, beam) for t in turns]
    if isinstance(frame, PositionAngleFrame):
        angle = frame.pa.to_value(u.rad)
        return [straight_grid(cube, angle, east, north, step, beam, core=core)]
    if isinstance(frame, RidgeLine):
        return [ridge_grid(cube, frame, east, north, step, beam)]
    if isinstance(frame, RadialFrame | ExpansionFrame):
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
    return FlowGrid(x, y, along, across, sense < 0, weight, beam, angle, core)


def ridge_grid(cube, line, east, north, step, beam):
    """Return the grid along a ridge line; see `straight_grid`."""
    s, n = (v.to_value(u.mas) / beam for v in line.coordinates(*(_mas(east, north))))
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
    return FlowGrid(x, y, along, across, counter, weight, beam, outward=True)


def radial_grid(cube, frame, east, north, step, beam):
    """Return the grid in distance, or its logarithm, and angle; see `straight_grid`."""
    shell = isinstance(frame, ExpansionFrame)
    origin = (frame.centre if shell else frame.origin).to_value(u.mas)
    dx, dy = east - origin[0], north - origin[1]
    r = np.maximum(np.hypot(dx, dy), 1e-3 * beam)
    unit = frame.radius.to_value(u.mas) if shell else float(np.mean(r))
    angle = np.arctan2(dx, dy)
    # Angles are cut where nothing or least is seen.
    angle = np.mod(angle, 2 * np.pi)
    middle = np.sort(angle)
    gaps = np.diff(np.append(middle, middle[0] + 2 * np.pi))
    start = middle[(gaps.argmax() + 1) % len(middle)]
    turned = np.mod(angle - start, 2 * np.pi)
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
    east, north = (
        origin[k] + radius[:, None] * turn(theta)
        for k, turn in enumerate((np.sin, np.cos))
    )
    x, y = cube.offset_to_pixel(*_mas(east, north))
    counter = np.zeros(len(across), dtype=bool)
    return FlowGrid(x, y, along, across, counter, weight[:, None], beam, outward=True)


def _mas(*values):
    return tuple(value * u.mas for value in values)


def _least(values):
    return float(values.min()) - MARGIN


def _most(values):
    return float(values.max()) + MARGIN


def _covering(low, high, step):
    """Return evenly spaced points, one of them zero if it lies between the limits."""
    return np.arange(np.floor(low / step), np.ceil(high / step) + 1) * step
