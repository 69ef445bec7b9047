# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.epochs import Beam
from astro_scc.epochs.restoring import correlated_noise

#: Uneven, 20 to 45 days apart.
DATES = [
    f"2000-{day}" for day in ("01-01", "02-01", "02-21", "04-05", "05-03", "06-01")
]
PIXEL = 0.1 * u.mas


def _noise_cube(*, shape=(48, 96), beams=None, dates=DATES, **options):
    """Epochs of nothing but noise."""
    beam = Beam(1 * u.mas, 1 * u.mas)
    rng = np.random.default_rng(1)
    images = [
        correlated_noise(shape, rms=0.01, beam=beam, pixel_scale=PIXEL, rng=rng)
        for _ in dates
    ]
    return EpochCube.from_arrays(
        np.array(images),
        dates,
        pixel_scale=PIXEL,
        unit=u.Jy / u.beam,
        beams=beam if beams is None else beams or None,
        **options,
    )


@pytest.fixture(scope="session")
def noise_cube():
    """Make epochs of nothing but noise."""
    return _noise_cube


@pytest.fixture(scope="session")
def sky():
    """Six epochs of noise."""
    return _noise_cube()


@pytest.fixture(scope="session")
def settings():
    """One scale, along the jet to the west."""
    return StackedCrossCorrelation(
        scales=[2], max_speed=24 * u.mas / u.yr, position_angle=270 * u.deg
    )
