# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.components.restoring import correlated_noise
from astro_scc.epochs import Beam

#: Uneven, 20 to 45 days apart.
DATES = [
    f"2000-{day}" for day in ("01-01", "02-01", "02-21", "04-05", "05-03", "06-01")
]
PIXEL = 0.1 * u.mas


@pytest.fixture(scope="session")
def sky():
    """Six epochs of nothing but noise."""
    beam, rng = Beam(1 * u.mas, 1 * u.mas), np.random.default_rng(1)
    images = [
        correlated_noise((48, 96), rms=0.01, beam=beam, pixel_scale=PIXEL, rng=rng)
        for _ in DATES
    ]
    return EpochCube.from_arrays(
        np.array(images), DATES, pixel_scale=PIXEL, unit=u.Jy / u.beam, beams=beam
    )


@pytest.fixture(scope="session")
def settings():
    """One scale, along the jet to the west."""
    return StackedCrossCorrelation(
        scales=[2], max_speed=24 * u.mas / u.yr, position_angle=270 * u.deg
    )
