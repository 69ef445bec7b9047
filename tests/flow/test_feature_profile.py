# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speed against distance from the features of a measurement."""

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.flow import feature_profile
from astro_scc.measurement.axes import projection_of
from astro_scc.simulation import simulate_jet, simulate_static
from astro_scc.stacking.dispersion import feature_speeds, random_effects


@pytest.fixture(scope="module")
def result():
    cube = simulate_jet(n_epochs=16, n_features=8, rng=2).cube
    scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    return scc(cube, n_trials=99, rng=1)


def test_bins_hold_all_features_in_order(result):
    profile = feature_profile(result)
    stream = result.search.streams[0]
    assert stream.kind == "moving"
    assert profile["n_features"].sum() == len(stream.features)
    assert np.all(profile["n_features"] >= 5)
    assert np.all(profile["r_min"] <= profile["r_mid"])
    assert np.all(profile["r_mid"] <= profile["r_max"])
    assert np.all(profile["r_max"][:-1] <= profile["r_min"][1:])


def test_speeds_are_those_of_random_effects(result):
    profile = feature_profile(result)
    stream = result.search.streams[0]
    features = sorted(stream.features, key=lambda feature: abs(feature.place))
    mean = random_effects(*feature_speeds(features[: profile["n_features"][0]]))
    beam = projection_of(result).beam(stream.angle)[0]
    assert profile["pm_parallel"][0].value == pytest.approx(mean.mean * beam)
    assert profile["dispersion"][0].value == pytest.approx(mean.dispersion * beam)


@pytest.mark.slow
def test_without_motion_it_is_empty():
    scc = StackedCrossCorrelation(scales=[1, 2])
    result = scc(simulate_static(n_epochs=5, rng=1).cube, n_trials=20, rng=1)
    profile = feature_profile(result)
    assert len(profile) == 0
    assert profile["pm_parallel"].unit == u.mas / u.yr
