# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A small measurement to draw, on axes along the jet, on the sky and radial."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import JetSimulation, Stream

OPTIONS = {"scales": [1, 2, 3], "max_speed": 30 * u.mas / u.yr}


@pytest.fixture(scope="session")
def cube():
    """A core and features that move 0.6 beam an epoch to the west."""
    flow = Stream("flow", dx=6.0, sigma=3.0, density=0.6, jitter=0.5)
    jet = JetSimulation(
        [flow], n_epochs=8, core=1.0, shape=(96, 180), extent=(20.0, 140.0), axis=48.0
    )
    return jet.run(rng=2).cube


@pytest.fixture(scope="session")
def matched(cube):
    return StackedCrossCorrelation(**OPTIONS).match(cube)


@pytest.fixture(scope="session")
def results(matched):
    """Results of the same matches by the kind of their axes."""
    angles = {"jet": 270 * u.deg, "sky": None, "radial": "radial"}
    return {
        name: StackedCrossCorrelation(**OPTIONS, position_angle=angle).stack(
            matched, n_trials=40, rng=1
        )
        for name, angle in angles.items()
    }


@pytest.fixture(scope="session")
def result(results):
    return results["jet"]


@pytest.fixture(scope="session")
def empty(result):
    """A result without components."""
    return replace(result, maxima=(), velocities=(), jitters=())


@pytest.fixture(scope="session")
def bare(matched):
    """A result without SSPs, matches and components, of images of no beam."""
    scc = StackedCrossCorrelation(
        scales=[1, 2], max_speed=20 * u.mas / u.yr, detection=99, segmentation=98
    )
    rng = np.random.default_rng(1)
    data = 1e-3 * rng.standard_normal((len(matched.cube), 48, 64))
    dull = replace(matched.cube, data=data, mask=None, beams=None)
    return scc(dull, n_trials=20, rng=1)
