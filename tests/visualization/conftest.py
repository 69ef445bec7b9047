# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A small measurement to draw, on axes along the jet, on the sky and radial."""

from dataclasses import replace

import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import simulate_static


@pytest.fixture(scope="session")
def result(jet_results):
    return jet_results["jet"]


@pytest.fixture(scope="session")
def bare():
    """A result without features and patterns, of images of no beam."""
    cube = simulate_static(n_epochs=8, rng=1).cube.crop(np.s_[32:96, :128])
    noise = 0.3 * np.random.default_rng(1).standard_normal(cube.shape)
    scc = StackedCrossCorrelation(scales=[1, 2], detection=99, segmentation=98)
    dull = replace(cube, data=cube.data + cube.data.max() * noise, beams=None)
    return scc.measure(scc.decompose(dull), n_trials=99, rng=1)
