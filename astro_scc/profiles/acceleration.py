# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Acceleration of what a measurement matched, in angles and years."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc.kinematics import RadialFrame, RidgeLine
from astro_scc.measurement import select_ssps
from astro_scc.stacking import (
    Acceleration,
    Sightings,
    fit_acceleration,
    flow_speed,
    lag_test,
)

__all__ = ["StackAcceleration", "check_lags", "measure_acceleration"]


@dataclass(frozen=True, eq=False)
class StackAcceleration:
    """
    Speed and acceleration of a flow, from the stack of all its distances.

    Attributes
    ----------
    speed, speed_err : `~astropy.units.Quantity`
        At the distance ``centre``, in mas/yr.
    acceleration, acceleration_err : `~astropy.units.Quantity`
        Of the matter, in mas/yr^2; the gradient of the speed times the speed.
    centre : `~astropy.units.Quantity`
    p_value : float
        Of an acceleration as large on either side, if there is none.
    n_blocks : int
        Lengths of the flow that the errors rest on.
    n_sightings : int
    stacked : `~astro_scc.stacking.Acceleration`

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.profiles import measure_acceleration
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> matched = scc.match(cube)
    >>> found = measure_acceleration(scc, matched)
    >>> found.speed.unit, found.acceleration.unit
    (Unit("mas / yr"), Unit("mas / yr2"))
    """

    speed: u.Quantity
    speed_err: u.Quantity
    acceleration: u.Quantity
    acceleration_err: u.Quantity
    centre: u.Quantity
    p_value: float
    n_blocks: int
    n_sightings: int
    stacked: Acceleration

    def at(self, distance):
        """
        Speed of the flow at distances, with its error.

        Parameters
        ----------
        distance : `~astropy.units.Quantity`

        Returns
        -------
        speed, error : `~astropy.units.Quantity`
        """
        x = u.Quantity(distance).to_value(u.mas)
        v0, a, x0 = self.stacked.speed, self.stacked.acceleration, self.stacked.centre
        v = flow_speed(x, v0, a, x0)
        slow = np.maximum(v, 1e-3 * max(v0, 1e-9))
        slope = np.stack(np.broadcast_arrays(v0 / slow, (x - x0) / slow), axis=-1)
        with np.errstate(invalid="ignore"):
            variance = np.einsum(
                "...i,ij,...j->...", slope, self.stacked.covariance, slope
            )
        # Errors that are not known are not zero.
        variance = np.where(np.isfinite(variance), np.maximum(variance, 0), np.inf)
        return v * u.mas / u.yr, np.sqrt(variance) * u.mas / u.yr


def measure_acceleration(
    scc, matched, *, r_min=None, r_max=None, max_acceleration=None
):
    """
    Stack the matches of a stretch of jet in speed and acceleration.

    The matches are those of the pairs of epochs of ``scc``, at their own
    intervals: ``baseline`` may hold several lengths.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        With a ``position_angle``, "radial", "fit" or "ridge".
    matched : `~astro_scc.measurement.MatchedEpochs`
    r_min, r_max : `~astropy.units.Quantity`, optional
        Limits of the stretch; of SSPs, from the reference pixel.
    max_acceleration : `~astropy.units.Quantity`, optional
        Of the grid.

    Returns
    -------
    `StackAcceleration`

    Raises
    ------
    ValueError
        If the velocity axes are east and north, or there are too few
        matches.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.profiles import measure_acceleration
    >>> from astro_scc.simulation import JetSimulation, Stream
    >>> flow = Stream("flow", dx=10.0, sigma=3.0, density=0.5)
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=24 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> matched = scc.match(JetSimulation([flow], n_epochs=8).run(rng=1).cube)
    >>> found = measure_acceleration(scc, matched)
    >>> bool(abs(found.speed - 12.2 * u.mas / u.yr) < 1 * u.mas / u.yr)
    True
    """
    part = select_ssps(matched, r_min=r_min, r_max=r_max)
    seen, distance, limit = _sightings(scc, part)
    a_max = None
    if max_acceleration is not None:
        a_max = u.Quantity(max_acceleration).to_value(u.mas / u.yr**2)
    found = fit_acceleration(seen, distance, limit, a_max=a_max)
    errors = np.sqrt(np.diag(found.covariance))
    rate = u.mas / u.yr
    return StackAcceleration(
        speed=found.speed * rate,
        speed_err=errors[0] * rate,
        acceleration=found.acceleration * rate / u.yr,
        acceleration_err=errors[1] * rate / u.yr,
        centre=found.centre * u.mas,
        p_value=found.p_value,
        n_blocks=found.n_blocks,
        n_sightings=len(seen),
        stacked=found,
    )


def check_lags(scc, matched, velocity, *, n_groups=5, r_min=None, r_max=None):
    """
    Whether the displacement of a velocity grows in proportion to the lag.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        Its pairs of epochs, of several lengths, are what is compared.
    matched : `~astro_scc.measurement.MatchedEpochs`
    velocity : `~astropy.units.Quantity`, shape (2,)
        Along the two velocity axes.
    n_groups : int, optional
        Groups of lags.
    r_min, r_max : `~astropy.units.Quantity`, optional
        Of the SSPs.

    Returns
    -------
    `~astropy.table.QTable`
        Columns ``lag``, ``displacement``, its ``displacement_err``,
        ``coefficient`` and ``n_sightings``, only groups in which the
        velocity is seen.  Its meta has the ``speed`` and the ``offset`` at
        no lag with their errors, and ``p_offset``, the probability of so
        large an offset for what moves; None if it cannot be said.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.profiles import check_lags
    >>> from astro_scc.simulation import JetSimulation, Stream
    >>> flow = Stream("flow", dx=5.0, sigma=3.0, density=0.5)
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=10 * u.mas / u.yr,
    ...     position_angle=270 * u.deg, baseline=[0.05, 0.3] * u.yr)
    >>> matched = scc.match(JetSimulation([flow], n_epochs=6).run(rng=1).cube)
    >>> table = check_lags(scc, matched, [6, 0] * u.mas / u.yr, n_groups=3)
    >>> bool(abs(table["displacement"][-1] / table["lag"][-1] - 6.1 * u.mas / u.yr)
    ...      < 1 * u.mas / u.yr)
    True
    """
    part = select_ssps(matched, r_min=r_min, r_max=r_max)
    seen, distance, _ = _sightings(scc, part, need_flow=False)
    v = u.Quantity(velocity).to_value(u.mas / u.yr)
    test = lag_test(seen, *map(float, v), distance=distance, n_groups=n_groups)
    use = np.isfinite(test.displacement) & np.isfinite(test.error)
    table = QTable(
        {
            "lag": test.lag[use] * u.yr,
            "displacement": test.displacement[use] * u.mas,
            "displacement_err": test.error[use] * u.mas,
            "coefficient": test.coefficient[use],
            "n_sightings": test.n_sightings[use],
        }
    )
    known = np.isfinite(test.offset) and np.isfinite(test.p_offset)
    table.meta.update(
        {
            "velocity": v * u.mas / u.yr,
            "speed": test.speed * u.mas / u.yr if known else None,
            "speed_err": test.speed_err * u.mas / u.yr if known else None,
            "offset": test.offset * u.mas if known else None,
            "offset_err": test.offset_err * u.mas if known else None,
            "p_offset": test.p_offset if known else None,
            "n_blocks": test.n_blocks,
        }
    )
    return table


def _sightings(scc, part, *, need_flow=True):
    """Sightings, their distance along the flow, and the largest speed."""
    displacements, frame = scc.displacements(part)
    if need_flow and tuple(frame.axis_names) == ("east", "north"):
        raise ValueError(
            "an acceleration needs the direction of the flow: give position_angle as "
            "an angle, 'fit', 'radial' or 'ridge'"
        )
    limit = scc.speed_limit(part.cube).to_value(u.mas / u.yr)
    seen = Sightings.of(
        displacements,
        scc.date_pairs(part.cube),
        part.cube.years.to_value(u.yr),
        (2 * limit, 2 * limit),
    )
    if isinstance(frame, RidgeLine):
        distance, _ = frame.coordinates(*(seen.middle.T * u.mas))
        return seen, distance.to_value(u.mas), limit
    if isinstance(frame, RadialFrame):
        return seen, np.hypot(*(seen.middle - frame.origin.value).T), limit
    if tuple(frame.axis_names) == ("east", "north"):
        return seen, None, limit
    return seen, seen.middle @ frame.matrix()[0], limit
