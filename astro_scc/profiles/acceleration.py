# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Acceleration of the flow that a measurement found, in angles and years."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np

from astro_scc.measurement.axes import AxisProjection
from astro_scc.stacking.streams import fit_acceleration

__all__ = ["FlowAcceleration", "measure_acceleration"]


@dataclass(frozen=True)
class FlowAcceleration:
    """
    Acceleration of a flow, from the speeds and the bends of its features.

    Attributes
    ----------
    speed : `~astropy.units.Quantity`
        Mean speed of its features, in mas/yr.
    centre : `~astropy.units.Quantity`
        Their mean distance along the flow, in mas.
    gradient, gradient_err : `~astropy.units.Quantity`
        Change of the speed with distance, in 1/yr.
    acceleration, acceleration_err : `~astropy.units.Quantity`
        Of the matter, the gradient times the speed, in mas/yr^2.
    p_value : float
        Of an acceleration as large, of either sign, if there is none.
    n_features : int
        Features beyond two beams from the origin; below two of them, or four
        with speeds only, nothing is known, and the numbers are NaN.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.profiles import FlowAcceleration
    >>> found = FlowAcceleration(
    ...     speed=2 * u.mas / u.yr, centre=5 * u.mas, gradient=0.1 / u.yr,
    ...     gradient_err=0.02 / u.yr, acceleration=0.2 * u.mas / u.yr**2,
    ...     acceleration_err=0.04 * u.mas / u.yr**2, p_value=0.001, n_features=9)
    >>> print(found)
    acceleration: 0.2 +- 0.04 mas/yr^2 at 5 mas, p 0.001, 9 features
    """

    speed: u.Quantity
    centre: u.Quantity
    gradient: u.Quantity
    gradient_err: u.Quantity
    acceleration: u.Quantity
    acceleration_err: u.Quantity
    p_value: float
    n_features: int

    def __str__(self):
        if np.isnan(self.p_value):
            return (
                f"acceleration: unknown, {self.n_features} features are seen beyond "
                "two beams, of which four are needed, or two over five epochs"
            )
        return (
            f"acceleration: {self.acceleration.value:.3g} +- "
            f"{self.acceleration_err.value:.2g} mas/yr^2 at {self.centre.value:.3g} "
            f"mas, p {self.p_value:.2g}, {self.n_features} features"
        )


def measure_acceleration(result, row=0):
    """
    Measure the acceleration of a flow.

    The slope of the speeds of its features against their distances and their
    own accelerations are combined, see `~astro_scc.stacking.streams.fit_acceleration`.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    row : int, optional
        Of its components.

    Returns
    -------
    `FlowAcceleration`

    Raises
    ------
    ValueError
        If there is no such row.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.profiles import measure_acceleration
    >>> from astro_scc.simulation import simulate_jet
    >>> jet = simulate_jet(n_epochs=20, acceleration=3.0, dispersion=0.05, rng=1)
    >>> scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    >>> found = measure_acceleration(scc(jet.cube, n_trials=99, rng=1))
    >>> bool(found.acceleration > 0 * u.mas / u.yr**2), found.p_value < 0.05
    (True, True)
    """
    streams = result.search.streams
    if not 0 <= row < len(streams):
        raise ValueError(f"row must be from 0 to {len(streams) - 1}, got {row}")
    stream = streams[row]
    found = fit_acceleration(stream.features)
    matched = result.matched
    project = AxisProjection(
        result.displacements, matched.ssps, matched.cube, result.frame
    )
    beam = float(project.beam(stream.angle)[0]) * u.mas
    speed = abs(found.speed) * beam / u.yr
    gradient, error = (
        u.Quantity(x / beam * speed, "1/yr") for x in (found.gradient, found.error)
    )
    return FlowAcceleration(
        speed=speed.to(u.mas / u.yr),
        centre=abs(found.centre) * beam,
        gradient=gradient,
        gradient_err=error,
        acceleration=(gradient * speed).to(u.mas / u.yr**2),
        acceleration_err=(error * speed).to(u.mas / u.yr**2),
        p_value=found.p_value,
        n_features=found.n_features,
    )
