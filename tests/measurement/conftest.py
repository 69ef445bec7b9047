# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import JetSimulation, Stream

OPTIONS = {"scales": [1, 2], "max_speed": 30 * u.mas / u.yr}


@pytest.fixture(scope="session")
def matched():
    """Eight epochs of a core and of features that move 0.6 beam an epoch west."""
    flow = Stream("flow", dx=6.0, sigma=3.0, density=0.6, jitter=0.5)
    jet = JetSimulation(
        [flow], n_epochs=8, core=1.0, shape=(48, 160), extent=(20.0, 140.0), axis=24.0
    )
    return StackedCrossCorrelation(**OPTIONS).match(jet.run(rng=2).cube)


@pytest.fixture(scope="session")
def stacked(matched):
    """Measure the same matches with other settings."""

    def run(position_angle=None, **settings):
        scc = StackedCrossCorrelation(
            **{**OPTIONS, "position_angle": position_angle, **settings}
        )
        return scc.stack(matched, n_trials=40, rng=1)

    return run


@pytest.fixture(scope="session")
def sky_result(stacked):
    """Stacked along east and north."""
    return stacked()
