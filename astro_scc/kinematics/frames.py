# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Axes along which displacements are measured: straight, radial, of an expansion."""

from __future__ import annotations

from dataclasses import dataclass

import astropy.units as u
import numpy as np
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
