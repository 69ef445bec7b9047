# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The elliptical Gaussian beam (PSF) of an epoch."""

from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np

FWHM_TO_SIGMA = 1 / np.sqrt(8 * np.log(2))
#: Beams are the same if their widths differ by less in every direction: headers round
#: widths, and so small a difference affects no displacement.
SAME_WIDTH = 0.01


@dataclass(frozen=True)
class Beam:
    """
    An elliptical Gaussian restoring beam.

    Parameters
    ----------
    major, minor : `~astropy.units.Quantity`
        Full widths at half maximum, scalar angles, ``major >= minor > 0``.
    pa : `~astropy.units.Quantity`, optional
        Position angle of the major axis, north through east.  It is kept
        in the range [-90 deg, 90 deg).

    Raises
    ------
    ValueError
        If an axis is not finite or positive, or ``minor > major``.
    `~astropy.units.UnitConversionError`
        If an argument is not an angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.epochs import Beam
    >>> beam = Beam(1.0 * u.mas, 0.5 * u.mas, -7 * u.deg)
    >>> beam.area.to(u.mas**2).round(3)
    <Quantity 0.567 mas2>
    """

    major: u.Quantity
    minor: u.Quantity
    pa: u.Quantity = 0 * u.deg

    def __post_init__(self):
        major, minor = (u.Quantity(axis).to(u.mas) for axis in (self.major, self.minor))
        pa = u.Quantity(self.pa).to(u.deg)
        if not np.all(np.isfinite([major.value, minor.value, pa.value])):
            raise ValueError(f"a beam needs finite axes and position angle, got {self}")
        if minor <= 0:
            raise ValueError(f"the beam's axes must be positive, got {major} x {minor}")
        if minor > major * (1 + 1e-9):
            raise ValueError(
                f"the beam's minor axis {minor} is larger than its major axis {major}"
            )
        pa = (pa + 90 * u.deg) % (180 * u.deg) - 90 * u.deg
        for name, value in {"major": major, "minor": minor, "pa": pa}.items():
            object.__setattr__(self, name, value)

    def __str__(self):
        return (
            f"{self.major.value:.3g} x {self.minor.value:.3g} mas "
            f"at {self.pa.value:.1f} deg"
        )

    @property
    def area(self):
        """Solid angle, pi major minor / (4 ln 2)."""
        return np.pi * self.major * self.minor / (4 * np.log(2))

    @cached_property
    def covariance(self):
        """
        Covariance of the Gaussian over (east, north), shape (2, 2).

        ``C = s_major^2 p p^T + s_minor^2 q q^T``, where ``p = (sin pa, cos pa)``
        is along the major axis, ``q`` across it, and s are the standard
        deviations.
        """
        along = np.array([np.sin(self.pa), np.cos(self.pa)])
        across = np.array([np.cos(self.pa), -np.sin(self.pa)])
        return FWHM_TO_SIGMA**2 * (
            self.major**2 * np.outer(along, along)
            + self.minor**2 * np.outer(across, across)
        )

    def fwhm_along(self, position_angle):
        """
        Return the full width at half maximum of the profile along a direction.

        Parameters
        ----------
        position_angle : `~astropy.units.Quantity`
            Direction, north through east; scalar or array.

        Returns
        -------
        `~astropy.units.Quantity`
            ``sqrt(8 ln 2 d^T C d)``, where d is the unit vector, in mas.
        """
        direction = np.stack([np.sin(position_angle), np.cos(position_angle)])
        variance = np.einsum("i...,ij,j...->...", direction, self.covariance, direction)
        return np.sqrt(variance) / FWHM_TO_SIGMA

    def __eq__(self, other):
        if not isinstance(other, Beam):
            return NotImplemented
        return bool(np.all(np.isclose(self.covariance, other.covariance, rtol=1e-6)))

    __hash__ = None


def different_beam(cube):
    """
    Return the index of the first epoch whose beam differs from that of epoch 0.

    Return None if all widths agree within 1% in every direction, or there are no beams.
    """
    if cube.beams is None:
        return None
    inverse = np.linalg.inv(cube.beams[0].covariance.to_value(u.mas**2))
    for index, beam in enumerate(cube.beams):
        ratio = np.linalg.eigvals(inverse @ beam.covariance.to_value(u.mas**2))
        if np.any(np.abs(np.sqrt(ratio.real) - 1) > SAME_WIDTH):
            return index
    return None


def require_common_beam(cube):
    """Raise a ValueError if the beams of the epochs differ by more than 1%."""
    index = different_beam(cube)
    if index is not None:
        raise ValueError(
            f"the beams differ, {cube.beams[0]} in {cube.labels[0]} and "
            f"{cube.beams[index]} in {cube.labels[index]}: give cube.to_common_beam(), "
            "or state common_beam=False to measure them as they are"
        )
