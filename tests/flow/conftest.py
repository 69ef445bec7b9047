# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import JetSimulation, Stream


@pytest.fixture(scope="package")
def scc():
    return StackedCrossCorrelation(
        scales=[1, 2], max_speed=30 * u.mas / u.yr, position_angle=270 * u.deg
    )


@pytest.fixture(scope="package")
def matched(scc):
    """A jet of one stream that moves by 8 pixels an epoch, 9.74 mas/yr."""
    flow = Stream("flow", dx=8.0, sigma=3.0, density=0.6, jitter=0.5)
    return scc.match(JetSimulation([flow], n_epochs=8, core=1.0).run(rng=2).cube)
