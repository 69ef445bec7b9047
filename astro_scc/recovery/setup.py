# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What is put into which epochs, and whether it can be found at all."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np

from astro_scc.kinematics import PositionAngleFrame
from astro_scc.measurement.plan import mean_fwhm
from astro_scc.recovery.checks import PM_UNIT, check_trials, in_unit, positive
from astro_scc.recovery.rates import epochs_needed, smallest_p

__all__ = ["InjectionSetup", "peaks_of"]

#: A component is that of the features within this part of the beam over the
#: median interval.
TOLERANCE = 0.2


@dataclass(frozen=True, eq=False)
class InjectionSetup:
    """What follows from a cube and the settings of its measurement."""

    region: np.ndarray | None
    position_angle: u.Quantity | str
    fwhm: float
    tolerance: float
    limit: float
    #: Of a speed, along the axis that is searched.
    largest_part: float

    @classmethod
    def of(cls, cube, scc, position_angle, region, n_trials, fwhm, tolerance):
        """Check the arguments of `completeness`, and fill in what is not given."""
        pairs = scc.date_pairs(cube)
        _check_possible(len(cube), n_trials, scc.level)
        axis = _axis(scc.position_angle)
        position_angle = _direction(position_angle, axis)
        if fwhm is not None:
            fwhm = positive("fwhm", fwhm, u.mas)
        elif cube.beams is None:
            raise ValueError(
                "the cube has no beams: give fwhm, the full width of features, as an "
                "angle"
            )
        else:
            fwhm = mean_fwhm(cube, max(scc.scale_numbers(cube)))
        if tolerance is None:
            tolerance = TOLERANCE * fwhm / np.median(pairs.interval)
        else:
            tolerance = positive("tolerance", tolerance, PM_UNIT)
        region = None if region is None else cube.region_mask(region)
        limit = scc.speed_limit(cube).to_value(PM_UNIT)
        largest_part = 1.0
        if isinstance(axis, u.Quantity):
            largest_part = float(abs(np.cos(position_angle - axis)))
        return cls(region, position_angle, fwhm, tolerance, limit, largest_part)

    def speeds(self, speeds):
        """Speeds as numbers in mas/yr."""
        values = np.atleast_1d(in_unit("speeds", speeds, PM_UNIT).value)
        if (
            values.ndim != 1
            or values.size == 0
            or not np.all((values > 0) & np.isfinite(values))
        ):
            raise ValueError(
                f"speeds must be one or more positive speeds, got {speeds}"
            )
        if np.any(values * self.largest_part > self.limit):
            raise ValueError(
                f"speed {values.max():.4g} mas/yr is beyond the largest that is "
                f"searched, {self.limit:.4g} mas/yr: give StackedCrossCorrelation a "
                "larger max_speed"
            )
        return [float(value) for value in values]


def _axis(position_angle):
    """Direction of the velocity axes of a measurement."""
    if isinstance(position_angle, PositionAngleFrame):
        return position_angle.pa
    if position_angle is None or isinstance(position_angle, u.Quantity):
        return position_angle
    if isinstance(position_angle, str) and position_angle == "radial":
        return position_angle
    raise ValueError(
        "features move on straight lines, so the measurement needs velocity axes of "
        f"one direction, or 'radial', not {position_angle}: give "
        "StackedCrossCorrelation an angle as position_angle"
    )


def _direction(position_angle, axis):
    """Direction in which features move."""
    if position_angle is None:
        position_angle = axis
    if position_angle is None:
        raise ValueError(
            "position_angle is missing: give the direction in which features move, an "
            "angle or 'radial'"
        )
    radial = isinstance(position_angle, str)
    if radial != isinstance(axis, str) or (radial and position_angle != "radial"):
        raise ValueError(
            f"position_angle {position_angle} does not go with that of the "
            f"measurement, {axis}: either both are 'radial', or none"
        )
    return (
        position_angle if radial else in_unit("position_angle", position_angle, u.deg)
    )


def _check_possible(n_epochs, n_trials, level):
    if smallest_p(n_epochs) > level:
        raise ValueError(
            f"{n_epochs} epochs allow no p_global below {smallest_p(n_epochs):.2g} "
            f"(2/N!), so nothing that moves can be found at level {level:g}: "
            f"{epochs_needed(level)} epochs or more are needed"
        )
    check_trials(n_trials, level)


def peaks_of(fluxes, unit, noise):
    """
    Peaks of features as numbers in the unit of a cube.

    Parameters
    ----------
    fluxes : `~astropy.units.Quantity` or float
        In that unit, as flux densities, or in multiples of the noise.
    unit : `~astropy.units.Unit`
    noise : float
        In that unit.

    Returns
    -------
    list of float

    Raises
    ------
    ValueError
        If one is negative or not finite, or the noise is 0 where it is needed.
    `~astropy.units.UnitConversionError`
        If the unit does not fit.
    """
    if isinstance(fluxes, u.Quantity):
        # What is as small as the beam has as much in it as at its peak.
        if not fluxes.unit.is_equivalent(unit):
            per_beam = fluxes / u.beam
            fluxes = per_beam if per_beam.unit.is_equivalent(unit) else fluxes
        values = in_unit("fluxes", fluxes, unit).value
    else:
        values = np.asarray(fluxes, dtype=float) * noise
        if noise == 0:
            raise ValueError(
                "fluxes in multiples of the noise need epochs with noise, theirs is 0: "
                "give fluxes in the unit of the cube"
            )
    values = np.atleast_1d(values)
    if (
        values.ndim != 1
        or values.size == 0
        or not np.all((values >= 0) & np.isfinite(values))
    ):
        raise ValueError(f"fluxes must be one or more numbers from 0, got {fluxes}")
    return [float(value) for value in values]
