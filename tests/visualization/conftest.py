# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A small measurement to draw, on axes along the jet, on the sky and radial."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation


@pytest.fixture(scope="session")
def cube(jet_cube):
    return jet_cube


@pytest.fixture(scope="session")
def result(jet_results):
    return jet_results["jet"]


@pytest.fixture(scope="session")
def empty(result):
    """A result without components."""
    return replace(result, maxima=(), velocities=(), jitters=())


@pytest.fixture(scope="session")
def bare(cube):
    """A result without SSPs, matches and components, of images of no beam."""
    scc = StackedCrossCorrelation(
        scales=[1, 2], max_speed=20 * u.mas / u.yr, detection=99, segmentation=98
    )
    rng = np.random.default_rng(1)
    data = 1e-3 * rng.standard_normal((len(cube), 48, 64))
    dull = replace(cube, data=data, mask=None, beams=None)
    with pytest.MonkeyPatch.context() as patch:
        # Refused where it is measured; files of matches may be of nothing.
        patch.setattr("astro_scc.scc.require_ssps", lambda *args, **kwargs: None)
        return scc(dull, n_trials=20, rng=1)
