# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import pytest

from astro_scc import StackedCrossCorrelation


@pytest.fixture(scope="package")
def scc():
    return StackedCrossCorrelation(
        scales=[1, 2, 3], max_speed=30 * u.mas / u.yr, position_angle=270 * u.deg
    )


@pytest.fixture(scope="package")
def matched(jet_matched):
    """A jet of one stream that moves by 6 pixels an epoch, 7.3 mas/yr."""
    return jet_matched
