# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import pytest

from astro_scc import StackedCrossCorrelation

OPTIONS = {"scales": [1, 2], "max_speed": 30 * u.mas / u.yr}


@pytest.fixture(scope="session")
def matched(jet_cube):
    """The small jet on two scales."""
    return StackedCrossCorrelation(**OPTIONS).match(jet_cube)


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
