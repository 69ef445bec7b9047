# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The frame of a shell that expands about a centre."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np

from astro_scc.kinematics.frames import RadialFrame
from astro_scc.quantities import named, one_quantity

__all__ = ["ExpansionFrame"]

#: Nearer to the centre than this part of the radius nothing is said of expansion.
INNERMOST = 0.2


@dataclass(frozen=True, eq=False)
class ExpansionFrame:
    """
    Expansion and rotation about a centre, as speeds at one radius.

    In homologous expansion everything moves at a speed in proportion to its
    distance r from the centre.  Axes are those of `RadialFrame`, scaled by
    ``radius / r``: one rate of expansion is one velocity, wherever it is
    seen.

    Parameters
    ----------
    centre : `~astropy.units.Quantity`, shape (2,)
        (east, north) of the centre from the reference pixel.
    radius : `~astropy.units.Quantity`
        At which velocities are given.

    Raises
    ------
    ValueError
        If the centre is not two finite angles, or the radius is not positive.
    `~astropy.units.UnitConversionError`
        If either is no angle.

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

    #: The axes are not the same everywhere.
    uniform = False

    def __post_init__(self):
        object.__setattr__(self, "centre", RadialFrame(self.centre).origin)
        radius = named("radius", one_quantity, self.radius, "an angle", "100 arcsec")
        object.__setattr__(self, "radius", radius.to(u.mas))

    @property
    def axis_names(self):
        """Names of the two axes."""
        return "expansion", "rotation"

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
            Orthogonal but for the factor ``radius / r``; NaN within a fifth
            of the radius, where an expansion is hardly a motion.
        """
        r = self._distance(east, north)
        r = np.where(r >= INNERMOST * self.radius.value, r, np.nan)
        return self._scaled(east, north, r)

    def _distance(self, east, north):
        x0, y0 = self.centre.value
        return np.hypot(np.subtract(east, x0), np.subtract(north, y0))

    def _scaled(self, east, north, r):
        rotation = RadialFrame(self.centre).matrix(east, north)
        return rotation * (self.radius.value / r)[..., None, None]

    def displacement(self, position, motion):
        """
        Displacements at the radius, with the axes of the place midway.

        Parameters
        ----------
        position, motion : array_like, shape (n, 2)
            East and north in mas.

        Returns
        -------
        `numpy.ndarray`, shape (n, 2)
        """
        motion = np.asarray(motion, dtype=float)
        east, north = (np.asarray(position, dtype=float) + 0.5 * motion).T
        # A chance match may lead across the centre.
        r = np.maximum(self._distance(east, north), INNERMOST * self.radius.value)
        axes = self._scaled(east, north, r)
        return np.einsum("nai,ni->na", axes, motion)

    def rate(self, speed):
        """
        The rate of expansion of a speed at the radius.

        Parameters
        ----------
        speed : `~astropy.units.Quantity`

        Returns
        -------
        `~astropy.units.Quantity`
            In per cent a year.
        """
        return (u.Quantity(speed) / self.radius).to(u.percent / u.yr)
