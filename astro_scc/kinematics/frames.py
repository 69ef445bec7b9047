# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Axes along which displacements are measured."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np

from astro_scc.quantities import named, one_quantity, to_quantity

__all__ = ["PositionAngleFrame", "RadialFrame", "SkyFrame", "frame_displacements"]


def frame_displacements(frame, position, motion):
    """
    Displacements along the axes of a frame.

    Parameters
    ----------
    frame : frame of `astro_scc.kinematics`
        One with a method ``displacement`` is asked; of others the axes are
        those at the position.
    position, motion : `numpy.ndarray`, shape (n, 2)
        East and north in mas.

    Returns
    -------
    `numpy.ndarray`, shape (n, 2)

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.kinematics import RadialFrame, frame_displacements
    >>> position, motion = np.array([[0.0, 2.0]]), np.array([[0.1, 1.0]])
    >>> frame_displacements(RadialFrame(), position, motion)
    array([[1. , 0.1]])
    """
    own = getattr(frame, "displacement", None)
    if own is not None:
        return own(position, motion)
    axes = frame.matrix(position[:, 0], position[:, 1])
    return np.einsum("nai,ni->na", axes, motion)


@dataclass(frozen=True)
class SkyFrame:
    """
    East and north.

    Examples
    --------
    >>> from astro_scc.kinematics import SkyFrame
    >>> SkyFrame().axis_names
    ('east', 'north')
    """

    #: The axes are the same everywhere.
    uniform = True

    @property
    def axis_names(self):
        """Names of the two axes."""
        return "east", "north"

    def matrix(self, east=0.0, north=0.0):
        """
        Matrices that turn (east, north) into the axes of the frame.

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

    def to_sky(self, v1, v2):
        """
        Turn components along the axes back into (east, north).

        Parameters
        ----------
        v1, v2 : array_like or `~astropy.units.Quantity`

        Returns
        -------
        east, north
            Of the kind of the arguments.
        """
        return v1, v2


@dataclass(frozen=True)
class PositionAngleFrame:
    """
    Along a position angle and across it.

    With the position angle ``p``, north through east, the parallel axis is
    ``(sin p, cos p)`` over (east, north) and the transverse axis ``(cos p,
    -sin p)``, positive towards larger position angles.

    Parameters
    ----------
    pa : `~astropy.units.Quantity`
        Scalar angle.

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

    #: The axes are the same everywhere.
    uniform = True

    def __post_init__(self):
        pa = named("pa", one_quantity, self.pa, "an angle", "65 deg", False)
        object.__setattr__(self, "pa", pa.to(u.deg))

    @property
    def axis_names(self):
        """Names of the two axes."""
        return "parallel", "transverse"

    def matrix(self, east=0.0, north=0.0):
        """
        Matrices that turn (east, north) into the axes of the frame.

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
        sin, cos = np.sin(angle), np.cos(angle)
        return _everywhere(np.array([[sin, cos], [cos, -sin]]), east, north)

    def to_sky(self, v1, v2):
        """
        Turn components along the axes back into (east, north).

        Parameters
        ----------
        v1, v2 : array_like or `~astropy.units.Quantity`

        Returns
        -------
        east, north
            Of the kind of the arguments.
        """
        # The matrix is symmetric and so its own inverse.
        (a, b), (c, d) = self.matrix()
        return a * v1 + b * v2, c * v1 + d * v2


@dataclass(frozen=True)
class RadialFrame:
    """
    Away from a point and around it.

    At each position, radial points away from the origin and transverse
    towards larger position angles about it, north through east.  At the
    origin itself, where neither is defined, the matrix is NaN.

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

    #: The axes are not the same everywhere.
    uniform = False

    def __post_init__(self):
        wanted = "must be (east, north), two finite angles with a unit"
        origin = named("origin", to_quantity, self.origin, u.mas, wanted).to(u.mas)
        if origin.shape != (2,) or not np.all(np.isfinite(origin)):
            raise ValueError(f"origin = {origin} {wanted}")
        object.__setattr__(self, "origin", origin)

    def __eq__(self, other):
        if not isinstance(other, RadialFrame):
            return NotImplemented
        return bool(np.all(self.origin == other.origin))

    __hash__ = None

    @property
    def axis_names(self):
        """Names of the two axes."""
        return "radial", "transverse"

    def matrix(self, east, north):
        """
        Matrices that turn (east, north) into the axes of the frame.

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
        x, y = np.broadcast_arrays(
            np.asarray(east, dtype=float) - x0, np.asarray(north, dtype=float) - y0
        )
        distance = np.hypot(x, y)
        with np.errstate(divide="ignore", invalid="ignore"):
            sin, cos = x / distance, y / distance
        return np.stack(
            [np.stack([sin, cos], axis=-1), np.stack([cos, -sin], axis=-1)], axis=-2
        )


def _everywhere(matrix, east, north):
    shape = np.broadcast_shapes(np.shape(east), np.shape(north))
    return np.broadcast_to(matrix, (*shape, 2, 2))
