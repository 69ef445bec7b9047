# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams of simulated jets: both of two, one of one, none that do not move."""

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import simulate_jet, simulate_resolved_jet, simulate_two_fluid
from astro_scc.streams.finder import verdict


def measured(cube, **settings):
    return StackedCrossCorrelation(**settings)(cube, n_trials=119, rng=1)


@pytest.fixture(name="two", scope="module")
def fixture_two():
    return measured(simulate_two_fluid(rng=3).cube, position_angle=270 * u.deg)


def test_both_streams_of_the_paper_are_found(two):
    streams = two.streams[two.streams["kind"] == "moving"]
    assert streams["pm"].value == pytest.approx([6.09, 24.35], rel=0.12)
    assert np.all(
        np.abs(streams["pm"].value - [6.09, 24.35]) < 2.5 * streams["pm_err"].value
    )
    assert np.all(streams["p_distinct"] <= 0.01)
    assert streams["share"].sum() == pytest.approx(1.0)
    assert streams["pm_pa"].value == pytest.approx([270, 270], abs=8)
    assert streams["stream"].tolist() == [1, 2]


@pytest.mark.slow
def test_a_direction_that_is_not_known_is_found(two):
    found = measured(two.cube)
    moving = found.streams["kind"] == "moving"
    assert found.streams["pm"][moving].value == pytest.approx([6.09, 24.35], rel=0.12)
    assert found.streams["pm_pa"][moving].value == pytest.approx([270, 270], abs=10)


@pytest.mark.parametrize("seed", [5, pytest.param(6, marks=pytest.mark.slow)])
def test_a_static_jet_does_not_move(seed):
    cube = simulate_jet(n_features=0, standing=8, memory=5.0, rng=seed).cube
    found = measured(cube, position_angle=270 * u.deg)
    kinds = found.streams["kind"].tolist()
    assert "moving" not in kinds
    assert kinds[0] == "not significant"
    assert "were searched" in found.streams["caution"][0]
    assert not len(found.sensitivity)


def test_one_stream_is_that_of_its_features():
    jet = simulate_jet(dispersion=0.1, rng=7)
    found = measured(jet.cube, position_angle=270 * u.deg)
    row = found.streams[0]
    assert row["kind"] == "moving"
    assert row["pm_from"] == "features"
    assert row["pm_min"] <= row["pm"] <= row["pm_max"]
    assert np.sum(found.streams["kind"] == "moving") == 1
    assert len(found.sensitivity) > 4


def test_speed_towards_the_core_has_its_sign():
    cube = simulate_two_fluid(rng=3).cube
    found = measured(cube, position_angle=90 * u.deg)
    row = found.streams[found.streams["kind"] == "moving"][0]
    assert row["pm_parallel"] < 0
    assert "towards the core" in row["caution"]
    assert row["pm_pa"].value == pytest.approx(270, abs=10)


@pytest.mark.slow
def test_layers_that_overlap_have_their_own_speeds():
    jet = simulate_resolved_jet(n_epochs=24, interval=8 * u.day, rng=5001)
    found = measured(jet.cube, position_angle=288 * u.deg)
    speeds = found.streams["pm"][found.streams["kind"] == "moving"]
    assert speeds.to_value("mas/yr") == pytest.approx([1.14, 8.5], rel=0.15)


def test_few_epochs_cannot_show_motion():
    cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    with pytest.warns(UserWarning, match="6 epochs or more"):
        found = measured(cube, position_angle=270 * u.deg)
    assert found.streams["kind"][0] == "not significant"
    with pytest.raises(ValueError, match="three epochs or more"):
        measured(cube[:2], position_angle=270 * u.deg)


@pytest.mark.parametrize("doubtful", [False, True])
@pytest.mark.parametrize("unlike", [False, True])
@pytest.mark.parametrize("ratio", [0.5, 1.5, 3.0, np.nan])
def test_what_is_said_of_a_speed_that_the_test_finds(ratio, doubtful, unlike):
    kind, reason = verdict(ratio, 1.0, doubtful=doubtful, unlike=unlike)
    known = ratio > (2 if doubtful else 1)
    assert kind == ("moving" if known and not unlike else "not confirmed")
    assert ("of rest" in reason) == (not known)
    assert ("little in common" in reason) == (known and unlike)
    assert verdict(1e6 * ratio, 1e6, doubtful=doubtful, unlike=unlike) == (kind, reason)


def test_a_largest_speed_holds_along_every_direction():
    cube = simulate_two_fluid(rng=1).cube
    scc = StackedCrossCorrelation(max_speed=200 * u.mas / u.yr, position_angle="any")
    flow = scc.flow(scc.decompose(cube))
    turned = flow.along(np.radians(270))
    assert turned.max_speed == flow.max_speed == scc.max_speed
    assert turned.planes[0].reach == pytest.approx(flow.planes[0].reach)
    assert turned.planes[0].reach > 4
