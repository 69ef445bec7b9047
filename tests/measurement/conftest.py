# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import simulate_two_fluid


@pytest.fixture(scope="package")
def matched():
    """Six epochs of the paper's jet, correlated on two scales."""
    cube = simulate_two_fluid(n_epochs=6, rng=3).cube
    return StackedCrossCorrelation(scales=[1, 2], max_speed=30 * u.mas / u.yr).match(
        cube
    )


@pytest.fixture(scope="package")
def stacked(matched):
    """Measure the same matches with other settings."""

    def run(position_angle=None, **settings):
        scc = StackedCrossCorrelation(
            scales=[1, 2],
            max_speed=30 * u.mas / u.yr,
            position_angle=position_angle,
            **settings,
        )
        return scc.stack(matched, n_trials=30, rng=1)

    return run


@pytest.fixture(scope="package")
def sky_result(stacked):
    """Stacked along east and north."""
    return stacked()
