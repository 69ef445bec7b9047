# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Axes of displacements: straight, radial, of an expansion, along ridge lines."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.table import QTable
from numpy.typing import ArrayLike

from astro_scc.quantities import named, one_quantity, to_quantity

#: Positions nearer to the centre than this fraction of the radius do not constrain
#: the expansion.
INNERMOST = 0.2


class StraightAxes:
    """What frames have in common whose axes are straight lines."""

    def displacement(self, position: ArrayLike, motion: ArrayLike) -> np.ndarray:
        """
        Return displacements along the axes at their beginning.

        Parameters
        ----------
        position, motion : array_like, shape (n, 2)
            East and north in mas.

        Returns
        -------
        `numpy.ndarray`, shape (n, 2)
        """
        return np.einsum("nai,ni->na", self.matrix(*np.transpose(position)), motion)


def axes_along(sin, cos):
    """Return the matrices of axes along and across directions (sin, cos)."""
    return np.stack([np.stack([sin, cos], -1), np.stack([cos, -sin], -1)], -2)


@dataclass(frozen=True)
class SkyFrame(StraightAxes):
    """
    Axes to the east and to the north.

    Examples
    --------
    >>> from astro_scc.kinematics import SkyFrame
    >>> SkyFrame().axis_names
    ('east', 'north')
    """

    axis_names = ("east", "north")
    #: Whether the axes are the same everywhere.
    uniform = True

    def matrix(self, east: ArrayLike = 0.0, north: ArrayLike = 0.0) -> np.ndarray:
        """
        Return matrices that turn (east, north) into the axes of the frame.

        Parameters
        ----------
        east, north : array_like, shape (...,), optional
            Positions, offsets from the origin in mas.

        Returns
        -------
        `numpy.ndarray`, shape (..., 2, 2)
            ``(v1, v2) = matrix @ (d_east, d_north)``, orthogonal.
        """
        return _everywhere(np.eye(2), east, north)


@dataclass(eq=False)
class PositionAngleFrame(StraightAxes):
    """
    Axes along a position angle and across it.

    With the position angle ``p``, north through east, the parallel axis is
    ``(sin p, cos p)`` over (east, north) and the transverse axis ``(cos p,
    -sin p)``, positive towards larger position angles.

    Parameters
    ----------
    pa : `~astropy.units.Quantity`
        Scalar angle, of which the attribute is between 0 and 360 deg.

    Raises
    ------
    ValueError
        If ``pa`` is not one finite angle.
    `~astropy.units.UnitConversionError`
        If ``pa`` is not an angle.

    Examples
    --------
    A jet to the west: parallel is west, transverse is north.

    >>> import astropy.units as u
    >>> from astro_scc.kinematics import PositionAngleFrame
    >>> PositionAngleFrame(-90 * u.deg).matrix().round(3) + 0
    array([[-1.,  0.],
           [ 0.,  1.]])
    """

    pa: u.Quantity

    axis_names = ("parallel", "transverse")
    #: Whether the axes are the same everywhere.
    uniform = True

    def __post_init__(self):
        pa = named("pa", one_quantity, self.pa, "an angle", "65 deg", False)
        self.pa = pa.to(u.deg) % (360 * u.deg)

    def matrix(self, east: ArrayLike = 0.0, north: ArrayLike = 0.0) -> np.ndarray:
        """
        Return matrices that turn (east, north) into the axes of the frame.

        Parameters
        ----------
        east, north : array_like, shape (...,), optional
            Positions, offsets from the origin in mas.

        Returns
        -------
        `numpy.ndarray`, shape (..., 2, 2)
            ``(v1, v2) = matrix @ (d_east, d_north)``, orthogonal.
        """
        angle = self.pa.to_value(u.rad)
        return _everywhere(axes_along(np.sin(angle), np.cos(angle)), east, north)


@dataclass(eq=False)
class RadialFrame(StraightAxes):
    """
    Axes away from a point and around it.

    At each position, the radial axis points away from the origin and the
    transverse axis towards larger position angles about it, north through
    east.  At the origin itself neither is defined, and the matrix is NaN.

    Parameters
    ----------
    origin : `~astropy.units.Quantity`, shape (2,), optional
        (east, north) of the point, by default the reference pixel.

    Raises
    ------
    ValueError
        If ``origin`` is not two finite angles.
    `~astropy.units.UnitConversionError`
        If ``origin`` is not an angle.

    Examples
    --------
    >>> from astro_scc.kinematics import RadialFrame
    >>> RadialFrame().matrix(3.0, 4.0) @ [3.0, 4.0]
    array([5., 0.])
    """

    origin: u.Quantity = (0.0, 0.0) * u.mas

    axis_names = ("radial", "transverse")
    #: Whether the axes are the same everywhere.
    uniform = False

    def __post_init__(self):
        wanted = "must be (east, north), two finite angles with a unit"
        origin = named("origin", to_quantity, self.origin, u.mas, wanted).to(u.mas)
        if origin.shape != (2,) or not np.all(np.isfinite(origin)):
            raise ValueError(f"origin = {origin} {wanted}")
        self.origin = origin

    def matrix(self, east: ArrayLike, north: ArrayLike) -> np.ndarray:
        """
        Return matrices that turn (east, north) into the axes of the frame.

        Parameters
        ----------
        east, north : array_like, shape (...,)
            Positions, offsets from the reference pixel in mas.

        Returns
        -------
        `numpy.ndarray`, shape (..., 2, 2)
            ``(v1, v2) = matrix @ (d_east, d_north)``, orthogonal.
        """
        x0, y0 = self.origin.to_value(u.mas)
        x, y = np.broadcast_arrays(np.subtract(east, x0), np.subtract(north, y0))
        distance = np.hypot(x, y)
        with np.errstate(divide="ignore", invalid="ignore"):
            sin, cos = x / distance, y / distance
        return axes_along(sin, cos)


@dataclass(eq=False)
class ExpansionFrame:
    """
    Expansion and rotation about a centre, as speeds at one radius.

    In homologous expansion all speeds are proportional to the distance r from
    the centre.  The axes are those of `RadialFrame`, scaled by ``radius / r``,
    so a rate of expansion is the same velocity at all positions.

    Parameters
    ----------
    centre : `~astropy.units.Quantity`, shape (2,)
        (east, north) of the centre from the reference pixel.
    radius : `~astropy.units.Quantity`
        Radius at which velocities are given.

    Raises
    ------
    ValueError
        If the centre is not two finite angles, or the radius is not positive.
    `~astropy.units.UnitConversionError`
        If either is not an angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc.kinematics import ExpansionFrame
    >>> frame = ExpansionFrame([0, 0] * u.arcsec, 100 * u.arcsec)
    >>> position = np.array([[30e3, 40e3], [-120e3, 0.0]])
    >>> frame.displacement(position, 0.001 * position).round()
    array([[100., 0.],
           [100., 0.]])
    >>> frame.rate(100 * u.mas / u.yr)
    <Quantity 0.1 % / yr>
    """

    centre: u.Quantity
    radius: u.Quantity

    axis_names = ("expansion", "rotation")
    #: Whether the axes are the same everywhere.
    uniform = False

    def __post_init__(self):
        radius = named("radius", one_quantity, self.radius, "an angle", "100 arcsec")
        self.centre, self.radius = RadialFrame(self.centre).origin, radius.to(u.mas)

    @property
    def origin(self) -> u.Quantity:
        """The centre, from which distances are counted."""
        return self.centre

    def matrix(self, east: ArrayLike, north: ArrayLike) -> np.ndarray:
        """
        Return matrices that turn (east, north) into the axes of the frame.

        Parameters
        ----------
        east, north : array_like, shape (...,)
            Positions, offsets from the reference pixel in mas.

        Returns
        -------
        `numpy.ndarray`, shape (..., 2, 2)
            Orthogonal except for the factor ``radius / r``; NaN within a
            fifth of the radius, where an expansion is hardly a motion.
        """
        return self._scaled(east, north, np.nan)

    def _scaled(self, east, north, least):
        """Return axes times ``radius / r``, with another r in the innermost part."""
        x0, y0 = self.centre.value
        r = np.hypot(np.subtract(east, x0), np.subtract(north, y0))
        r = np.where(r >= INNERMOST * self.radius.value, r, least)
        axes = RadialFrame(self.centre).matrix(east, north)
        return axes * (self.radius.value / r)[..., None, None]

    def displacement(self, position: ArrayLike, motion: ArrayLike) -> np.ndarray:
        """
        Return displacements scaled to the radius, along the axes at their middle.

        Parameters
        ----------
        position, motion : array_like, shape (n, 2)
            East and north in mas.

        Returns
        -------
        `numpy.ndarray`, shape (n, 2)
        """
        motion = np.asarray(motion, dtype=float)
        middle = np.asarray(position, dtype=float) + 0.5 * motion
        # A chance match may cross the centre.
        axes = self._scaled(*middle.T, INNERMOST * self.radius.value)
        return np.einsum("nai,ni->na", axes, motion)

    def rate(self, speed: u.Quantity) -> u.Quantity:
        """
        Return the rate of expansion of a speed at the radius.

        Parameters
        ----------
        speed : `~astropy.units.Quantity`

        Returns
        -------
        `~astropy.units.Quantity`
            In per cent per year.
        """
        return (u.Quantity(speed) / self.radius).to(u.percent / u.yr)


def _everywhere(matrix, east, north):
    shape = np.broadcast_shapes(np.shape(east), np.shape(north))
    return np.broadcast_to(matrix, (*shape, 2, 2))


# -- ridge lines -------------------------------------------------------------------

if TYPE_CHECKING:
    from astro_scc.epochs import EpochCube

#: Steps of the curve between two points of the line.
FINE = 8
#: Step of the search, in beams.
STEP = 0.25


@dataclass(eq=False, repr=False)
class RidgeLine:
    """
    The line along which a jet flows, and the frame along and across it.

    The distance s is measured along the line from its first point, which is
    the core.  The offset n is positive towards larger position angles of the
    local direction, like the transverse axis of `PositionAngleFrame`.  Beyond
    its ends the line continues straight.

    Parameters
    ----------
    east, north : `~astropy.units.Quantity`, shape (n,)
        Points in the order of the flow, offsets from the reference pixel.
    error : `~astropy.units.Quantity`, shape (n,), optional
        Standard errors of the points across the line.
    meta : dict, optional
        Facts for the meta of a table.

    Raises
    ------
    ValueError
        If there are fewer than two points, or two neighbours coincide.
    `~astropy.units.UnitConversionError`
        If the points are not angles.

    Examples
    --------
    A quarter of a circle with a radius of 10 mas that begins to the west and
    ends to the north:

    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc.kinematics import RidgeLine
    >>> angle = np.linspace(0, np.pi / 2, 50)
    >>> line = RidgeLine(-10 * np.sin(angle) * u.mas, 10 * (1 - np.cos(angle)) * u.mas)
    >>> line.length.round(2), line.position_angle([0, 15] * u.mas).round()
    (<Quantity 15.71 mas>, <Quantity [270., 356.] deg>)
    >>> s, n = line.coordinates(-11 * u.mas, 10 * u.mas)
    >>> s.round(2), n.round(2)
    (<Quantity 15.71 mas>, <Quantity -1. mas>)
    """

    east: u.Quantity
    north: u.Quantity
    error: u.Quantity | None = None
    meta: dict = field(default_factory=dict)

    axis_names = ("parallel", "transverse")
    #: Whether the axes are the same everywhere.
    uniform = False

    def __post_init__(self):
        given = self.east, self.north
        east, north = (np.atleast_1d(u.Quantity(v)).to(u.mas) for v in given)
        if east.shape != north.shape or east.ndim != 1 or len(east) < 2:
            raise ValueError(
                "a ridge line needs two points or more, east and north of each, got "
                f"shapes {east.shape} and {north.shape}"
            )
        step = np.hypot(np.diff(east), np.diff(north)).value
        if not np.all(step > 0):
            raise ValueError("the points of a ridge line must be finite and differ")
        error = 0 * u.mas if self.error is None else u.Quantity(self.error).to(u.mas)
        self.error = np.broadcast_to(error, east.shape, subok=True)
        self.east, self.north = east, north

    def __repr__(self):
        ends = (self.position_angle(s) for s in (0 * u.mas, self.length))
        angles = " to ".join(f"{angle:.0f}" for angle in ends)
        size = f"{len(self.east)} points, {self.length:.3g} long"
        return f"<RidgeLine: {size}, PA {angles}>"

    @cached_property
    def _curve(self):
        """Return fine points (m, 2), their distances s (m,), in mas."""
        points = np.stack([self.east.value, self.north.value], axis=-1)
        s = lengths_of(points)
        if len(points) > 3:
            from scipy.interpolate import CubicSpline

            number = np.arange(len(s))
            fine = np.interp(np.arange(FINE * number[-1] + 1) / FINE, number, s)
            points = CubicSpline(s, points)(fine)
            s = lengths_of(points)
        return points, s

    @property
    def distances(self) -> u.Quantity:
        """Distance along the line of each of its points, from 0."""
        points, s = self._curve
        return s[:: FINE if len(self.east) > 3 else 1] * u.mas

    @property
    def length(self) -> u.Quantity:
        """Length of the line."""
        return self._curve[1][-1] * u.mas

    def at(self, distance: u.Quantity) -> tuple[u.Quantity, u.Quantity]:
        """
        Return the points of the line at some distances along it.

        Parameters
        ----------
        distance : `~astropy.units.Quantity`

        Returns
        -------
        east, north : `~astropy.units.Quantity`
        """
        points, s = self._curve
        wanted = u.Quantity(distance).to_value(u.mas)
        inside = np.clip(wanted, 0, s[-1])
        place = np.stack([np.interp(inside, s, c) for c in points.T], axis=-1)
        place += (wanted - inside)[..., None] * self._direction(inside)
        return place[..., 0] * u.mas, place[..., 1] * u.mas

    def position_angle(self, distance: u.Quantity) -> u.Quantity:
        """
        Return the direction of the line, north through east.

        Parameters
        ----------
        distance : `~astropy.units.Quantity`

        Returns
        -------
        `~astropy.units.Quantity`
            0 to 360 deg.
        """
        direction = self._direction(u.Quantity(distance).to_value(u.mas))
        angle = np.degrees(np.arctan2(direction[..., 0], direction[..., 1]))
        return angle % 360 * u.deg

    def coordinates(
        self, east: u.Quantity, north: u.Quantity
    ) -> tuple[u.Quantity, u.Quantity]:
        """
        Return the distance along the line and the offset from it.

        Parameters
        ----------
        east, north : `~astropy.units.Quantity`
            Offsets from the reference pixel.

        Returns
        -------
        s, n : `~astropy.units.Quantity`
            Distance of the nearest point of the line, and offset from it, in mas.
        """
        x, y = (u.Quantity(v).to_value(u.mas) for v in (east, north))
        s, n = self._project(np.stack(np.broadcast_arrays(x, y), axis=-1))
        return s * u.mas, n * u.mas

    def matrix(self, east: ArrayLike, north: ArrayLike) -> np.ndarray:
        """
        Return matrices that turn (east, north) into the axes of the frame.

        Parameters
        ----------
        east, north : array_like, shape (...,)
            Positions, offsets from the reference pixel in mas.

        Returns
        -------
        `numpy.ndarray`, shape (..., 2, 2)
            ``(v1, v2) = matrix @ (d_east, d_north)``, orthogonal.
        """
        s, _ = self._project(np.stack(np.broadcast_arrays(east, north), axis=-1))
        sin, cos = np.moveaxis(self._direction(s), -1, 0)
        return axes_along(sin, cos)

    def displacement(self, position: ArrayLike, motion: ArrayLike) -> np.ndarray:
        """
        Return displacements as changes of s and n.

        Along a bend this is the length along the line, which is longer than
        the straight distance between the two positions.

        Parameters
        ----------
        position, motion : array_like, shape (n, 2)
            East and north in mas.

        Returns
        -------
        `numpy.ndarray`, shape (n, 2)
        """
        start = np.stack(self._project(np.asarray(position, float)), axis=-1)
        end = np.stack(self._project(np.add(position, motion)), axis=-1)
        return end - start

    def _direction(self, s):
        """Return unit vectors along the line, shape (..., 2)."""
        points, distances = self._curve
        middle = 0.5 * (distances[1:] + distances[:-1])
        step = np.diff(points, axis=0)
        unit = step / np.hypot(*step.T)[:, None]
        found = np.stack([np.interp(s, middle, c) for c in unit.T], axis=-1)
        return found / np.hypot(found[..., 0], found[..., 1])[..., None]

    def _project(self, places):
        from scipy.spatial import cKDTree

        points, distances = self._curve
        flat = places.reshape(-1, 2)
        nearest = cKDTree(points).query(flat)[1]
        last = len(points) - 2
        # The segments before and after the nearest point.
        segment = np.stack([np.maximum(nearest - 1, 0), np.minimum(nearest, last)])
        step, away = points[segment + 1] - points[segment], flat - points[segment]
        length = np.hypot(step[..., 0], step[..., 1])
        unit = step / length[..., None]
        # The first and the last segment continue beyond the line.
        low = np.where(segment == 0, -np.inf, 0.0)
        high = np.where(segment == last, np.inf, length)
        along = np.clip((away * unit).sum(axis=-1), low, high)
        square = ((away - along[..., None] * unit) ** 2).sum(axis=-1)
        side = away[..., 0] * unit[..., 1] - away[..., 1] * unit[..., 0]
        found = np.stack([distances[segment] + along, np.copysign(square**0.5, side)])
        nearer = square.argmin(axis=0), np.arange(len(flat))
        return found[:, *nearer].reshape(2, *places.shape[:-1])

    def to_table(self) -> QTable:
        """
        Return the points of the line as a table.

        ``RidgeLine(table["east"], table["north"], table["error"])`` is the line again.

        Returns
        -------
        `~astropy.table.QTable`
            Columns ``s``, ``east``, ``north``, ``error``, ``pa``.
        """
        s = self.distances
        names = ("s", "east", "north", "error", "pa")
        values = [s, self.east, self.north, self.error, self.position_angle(s)]
        return QTable(values, names=names, meta=dict(self.meta))


def lengths_of(points):
    """Return the length of the path to each of the points, shape (n, 2)."""
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])


def fit_position_angle(
    cube: EpochCube, *, threshold: float = 5.0
) -> tuple[u.Quantity, u.Quantity]:
    r"""
    Return the position angle of a jet, from the mean of its images.

    It is the direction of the mean offset, weighted by brightness, of the
    pixels above a threshold that lie more than a beam from the reference pixel,

    .. math:: \tan p = \sum I\, \Delta_\mathrm{east} / \sum I\,
              \Delta_\mathrm{north}.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    threshold : float, optional
        Faintest pixel, in standard deviations of the mean image's noise.

    Returns
    -------
    angle, error : `~astropy.units.Quantity`
        North through east, 0 to 360 deg; the error is from a jackknife over the
        epochs, and infinite for one epoch.

    Raises
    ------
    ValueError
        If no pixel is bright enough.

    Examples
    --------
    >>> from astro_scc.kinematics import fit_position_angle
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> angle, error = fit_position_angle(simulate_two_fluid(rng=1).cube)
    >>> bool(abs(angle.value - 270) < 3)
    True
    """
    image, noise, sky = _mean(cube)
    x, y = (offset.value for offset in cube.offsets())
    beyond = np.hypot(x, y) > cube.resolution.to_value(u.mas)
    use = (image > threshold * noise) & beyond
    if not use.any():
        raise ValueError(
            f"no pixel of the mean image is above {threshold:g} times its noise, a "
            "beam or more from the core: give a position angle"
        )
    each = np.where(cube.mask[:, use], 0.0, cube.data[:, use] - sky)
    sums = np.stack([each @ x[use], each @ y[use]], axis=-1)
    total = sums.sum(axis=0)
    angle = np.arctan2(*total)
    # The jackknife: how far the direction turns without one of the epochs.
    turn = np.arctan2(*(total - sums).T) - angle
    turn = (turn + np.pi) % (2 * np.pi) - np.pi
    error = np.sqrt((len(cube) - 1) * turn.var()) if len(cube) > 1 else np.inf
    return np.degrees(angle) % 360 * u.deg, np.degrees(error) * u.deg


def find_ridge_line(
    cube: EpochCube, *, position_angle: u.Quantity | None = None,
    half_width: u.Quantity | None = None, smoothing: u.Quantity | None = None,
    threshold: float = 5.0,
) -> RidgeLine:  # fmt: skip
    """
    Follow the brightest line of a jet in the mean of its images.

    The line starts at the reference pixel and advances by a quarter of a beam.  At each
    step, its point is the mean position of the part of a slice across the jet
    that is brighter than half of the slice's maximum.  The next slice is
    perpendicular to the direction of the last points.  The points are then
    smoothed by local parabolas.  The line ends where the slice is no longer
    above the noise, at the edge of the image, or where it would turn back.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    position_angle : `~astropy.units.Quantity`, optional
        Direction at the core, by default from `fit_position_angle`.
    half_width : `~astropy.units.Quantity`, optional
        Half length of the slices, by default 1.5 beams.
    smoothing : `~astropy.units.Quantity`, optional
        Standard deviation of the weights of the parabolas, by default two
        beams.
    threshold : float, optional
        The line ends where the slice's maximum is below this many standard
        deviations of the mean image's noise.

    Returns
    -------
    `RidgeLine`
        The error of a slice is due to noise, ``b / (sqrt(2) SNR)`` (Fomalont
        1999), or the scatter about the smooth line where that is larger; the
        errors of the points are propagated through the smoothing.

    Raises
    ------
    ValueError
        If the jet cannot be followed over three beams.

    Examples
    --------
    >>> from astro_scc.kinematics import find_ridge_line
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> line = find_ridge_line(simulate_two_fluid(rng=1).cube)
    >>> s, n = line.coordinates(*line.at(line.length / 2))
    >>> bool(abs(line.at(line.length / 2)[1].value) < 0.5)
    True
    """
    image, noise, _ = _mean(cube)
    width = cube.resolution.to_value(u.mas)
    step = STEP * width
    half = 1.5 * width if half_width is None else _length("half_width", half_width)
    smooth = 2 * width if smoothing is None else _length("smoothing", smoothing)
    if position_angle is None:
        position_angle, _ = fit_position_angle(cube, threshold=threshold)
    angle = PositionAngleFrame(position_angle).pa.to_value(u.rad)
    direction = np.array([np.sin(angle), np.cos(angle)])
    points, tops = _follow(cube, image, direction, half, threshold * noise)
    length = (len(points) - 1) * step
    if length < 3 * width:
        raise ValueError(
            f"the jet can be followed over {length:.2g} mas only, less than three "
            "beams: give a position angle instead"
        )
    snr = tops / noise
    snr[0] = np.nanmax(snr)
    error = width / (np.sqrt(2) * snr)
    # A small error keeps the beginning of the line at the core.
    error[0] = 1e-2 * error.min()
    points, error = _smoothed(points, error, smooth)
    meta = {"width": width * u.mas, "smoothing": smooth * u.mas}
    return RidgeLine(*(points.T * u.mas), error * u.mas, meta=meta)


def _follow(cube, image, direction, half, faintest):
    """Return the points of slices from the core onwards, and the slices' maxima."""
    width = cube.resolution.to_value(u.mas)
    step = STEP * width
    points, tops = [np.zeros(2)], [np.nan]
    # It ends: a line that does not come near itself cannot be longer than the image has
    # room for.
    while True:
        guess = points[-1] + step * direction
        found = _slice_point(cube, image, guess, direction, half)
        if found is None or found[1] < faintest:
            break
        point, top = found
        met = _met_again(points, point, width)
        if met is not None:
            # The line went round the end of the jet, so half of the detour is cut off.
            end = (met + len(points)) // 2
            del points[end:], tops[end:]
            break
        points.append(point)
        tops.append(top)
        # A direction over the last 1.5 beams keeps the slices from tumbling.
        back = points[max(0, len(points) - 1 - round(1.5 / STEP))]
        direction = (point - back) / np.hypot(*(point - back))
    return np.array(points), np.array(tops)


def _met_again(points, point, width):
    """Return the index of a point three beams earlier within a beam of one, or None."""
    earlier = np.array(points[: -round(3 / STEP)])
    if len(earlier) == 0:
        return None
    away = np.hypot(*(earlier - point).T)
    return int(away.argmin()) if away.min() < width else None


def _slice_point(cube, image, guess, direction, half):
    """Return the mean position and the maximum of the bright part of a slice."""
    from scipy.ndimage import label, map_coordinates

    normal = np.array([direction[1], -direction[0]])
    n = np.linspace(-half, half, 61)
    x, y = cube.offset_to_pixel(*((guess + n[:, None] * normal).T * u.mas))
    values = np.nan_to_num(map_coordinates(image, [y, x], order=1, cval=np.nan))
    top = int(values.argmax())
    if values[top] <= 0:
        return None
    # Only the part connected with the maximum, as another ridge is not part of it.
    parts, _ = label(values >= 0.5 * values[top])
    part = parts == parts[top]
    middle = np.average(n[part], weights=values[part])
    return guess + middle * normal, float(values[top])


def _smoothed(points, error, width):
    """Return points smoothed by local parabolas over distance, and their errors."""
    s = lengths_of(points)
    distance = (s - s[:, None]) / width
    windows = np.exp(-0.5 * distance**2)
    smooth, gains = np.empty_like(points), np.empty_like(windows)
    for k, x in enumerate(distance):
        weight = windows[k] / (error / error.max()) ** 2
        design = np.stack([np.ones_like(x), x, x * x], axis=1)
        normal = design.T @ (weight[:, None] * design)
        gains[k] = np.linalg.solve(normal, design.T * weight)[0]
        smooth[k] = gains[k] @ points
    # Half of the square in two dimensions is across the line.
    square = 0.5 * ((points - smooth) ** 2).sum(axis=1)
    scatter = windows @ square / windows.sum(axis=1)
    variance = np.maximum(error**2, scatter)
    # Points within a beam share their noise.
    return smooth, np.sqrt(gains**2 @ variance / STEP)


def _mean(cube):
    """Return the mean image above its sky, NaN where masked, its noise, and the sky."""
    image = np.asarray(cube.mean_image().data, dtype=float)
    sky, noise = np.nanmedian(image), cube.noise_rms().value
    return image - sky, float(np.sqrt(np.mean(noise**2) / len(cube))), sky


def _length(name, value):
    return named(name, one_quantity, value, "an angle", "2 mas").to_value(u.mas)
