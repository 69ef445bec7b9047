# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speed against distance from the features of a measurement."""

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.flow import feature_profile
from astro_scc.simulation import simulate_jet, simulate_static
from astro_scc.stacking import random_effects
from astro_scc.stacking.dispersion import feature_speeds
from astro_scc.visualization import plot_feature_distances, plot_feature_speeds


@pytest.fixture(scope="module")
def result():
    cube = simulate_jet(n_epochs=16, n_features=8, rng=2).cube
    scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    return scc(cube, n_trials=99, rng=1)


def test_bins_hold_all_features_in_order(result):
    profile = feature_profile(result)
    moving = result.features[result.features["component"] == 1]
    assert profile["n_features"].sum() == len(moving)
    assert np.all(profile["n_features"] >= 5)
    assert np.all(profile["r_min"] <= profile["r_mid"])
    assert np.all(profile["r_mid"] <= profile["r_max"])
    assert np.all(profile["r_max"][:-1] <= profile["r_min"][1:])


def test_speeds_are_those_of_random_effects(result):
    profile = feature_profile(result)
    order = np.argsort(np.abs(result.features["distance"]))
    order = order[result.features["component"][order] == 1]
    stream = result.search.streams[0]
    features = [stream.features[k] for k in order[: profile["n_features"][0]]]
    mean = random_effects(*feature_speeds(features))
    beam = result.features["pm"][0] / stream.features[0].speed
    assert profile["pm_parallel"][0].value == pytest.approx(mean.mean * beam.value)
    assert profile["dispersion"][0].value == pytest.approx(mean.dispersion * beam.value)


@pytest.mark.slow
def test_without_motion_it_is_empty():
    scc = StackedCrossCorrelation(scales=[1, 2])
    result = scc(simulate_static(n_epochs=5, rng=1).cube, n_trials=20, rng=1)
    profile = feature_profile(result)
    assert len(profile) == 0
    assert profile["pm_parallel"].unit == u.mas / u.yr


def test_positions_are_those_of_the_ssps(result):
    table = result.feature_positions
    assert len(table) == result.features["n_epochs"].sum()
    for number, row in enumerate(result.features):
        own = table[table["feature"] == number]
        assert own["date"][0] == row["first"]
        assert own["date"][-1] == row["last"]
        assert np.all(own["component"] == row["component"])
    # The jet points west, and distances are from the reference pixel.
    ssps = result.ssps[table["ssp"]]
    assert np.allclose(ssps["east"].to_value(u.mas), -table["distance"].to_value(u.mas))


def test_the_figures_have_a_line_for_each_feature(result):
    ax = plot_feature_distances(result).axes[0]
    assert len(ax.lines) == 2 * len(result.features)
    ax = plot_feature_speeds(result, profile=feature_profile(result)).axes[0]
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels[0] == "1: moving"
    assert labels[-1] == "mean of bin"


def test_outward_is_positive_whatever_the_axis(result):
    """East and north as axes, and a jet to the west."""
    scc = StackedCrossCorrelation(scales=[1, 2])
    found = scc.stack(result.matched, n_trials=99, rng=1)
    assert found.search.streams[0].along.mean < 0
    moving = found.features["component"] == 1
    assert np.all(found.features["pm"][moving] > 0)
    assert np.all(found.features["distance"][moving] > 0)
    assert np.all(found.features["feature"] == np.arange(len(found.features)))
    own = found.feature_positions
    assert np.all(own["distance"][own["component"] == 1] > -1 * u.mas)
