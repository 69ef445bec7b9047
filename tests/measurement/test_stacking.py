# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Components of simulated jets, restrictions, and what few epochs cannot tell."""

import re
import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.exceptions import MeasurementWarning
from astro_scc.measurement.stacking import _warn_of_limits
from astro_scc.simulation import simulate_static, simulate_unrelated
from astro_scc.stacking.velocities import baseline_pairs, consecutive_pairs

PM = u.mas / u.yr
#: Speed of the features of the jet, 0.6 beam of 1 mas in 30 days.
SPEED = 0.6 * 365.25 / 30


def scc(**settings):
    options = {"scales": [2], "max_speed": 30 * u.mas / u.yr, **settings}
    return StackedCrossCorrelation(**options)


# What is found ---------------------------------------------------------------------


def test_a_stream_and_what_stands_still(sky_result):
    table = sky_result.components
    assert list(table["kind"]) == ["moving", "stationary"]
    moving, still = table
    for name, expected in (("pm_ra_cosdec", -SPEED), ("pm_dec", 0.0)):
        error = moving[f"{name}_err"].value
        assert 0 < error < 0.5
        assert abs(moving[name].value - expected) < 2.5 * error
    assert moving["n_features"] >= 4
    assert 0 < moving["dispersion"] < 1 * PM
    assert moving["p_global"] <= 0.05
    assert still["pm"] < 0.5 * PM
    assert (still["p_global"], still["p_distinct"]) == (1, 1)
    assert list(table["caution"]) == ["-", "-"]


def test_the_probability_is_that_of_the_velocity_that_is_quoted(stacked):
    found = stacked(270 * u.deg)
    (stream, _), row = found.search.streams, found.components[0]
    beam = 1.0
    assert row["pm_parallel"].value == pytest.approx(stream.along.mean * beam)
    permutations = found.search.permutations
    local, everywhere = permutations.p_values(0, stream.along.mean)
    assert (row["p_local"], row["p_global"]) == (local, everywhere)
    # By counting: the observed order is one of those that are as likely.
    z = np.interp(stream.along.mean, permutations.speed, permutations.z[0])
    largest = permutations.permuted.max(axis=(1, 2))
    assert everywhere == (np.sum(largest >= z) + 1) / (len(largest) + 1)
    assert row["p_distinct"] == everywhere


def test_another_alpha_is_another_kind_of_the_same_numbers(sky_result, stacked):
    smallest = sky_result.components["p_global"][0]
    with pytest.warns(MeasurementWarning, match="no stream can reach level 0.01"):
        strict = stacked(alpha=0.01).components
    one, other = strict[0], sky_result.components[0]
    assert one["kind"] == "not significant"
    least = one["p_smallest"]
    assert one["caution"] == f"too few epochs or trials: no p_global below {least:.2g}"
    assert one["p_global"] == smallest
    assert one["pm"] == other["pm"]


@pytest.mark.slow
def test_outward_only(stacked):
    """Towards the east everything moves inward."""
    found = stacked(90 * u.deg)
    assert found.components["kind"][0] == "moving"
    assert found.components["pm_parallel"][0] < 0 * PM
    outward = stacked(90 * u.deg, outward=True)
    assert "moving" not in list(outward.components["kind"])
    assert np.all(outward.search.permutations.speed > 0)
    assert stacked(270 * u.deg, outward=True).components["kind"][0] == "moving"
    # On the sky there is no outward.
    assert stacked(outward=True).search.permutations.speed.min() < 0


def test_no_speed_beyond_the_largest_is_searched(stacked):
    for limit in (30.0, 10.0, 5.0):
        found = stacked(270 * u.deg, max_speed=limit * PM)
        speeds = found.search.permutations.speed
        # The beam is 1 mas wide.
        assert speeds.max() == pytest.approx(limit)
        moving = limit > SPEED
        assert ("moving" in found.components["kind"]) == moving


def test_a_baseline_restricts_the_intervals(stacked, matched):
    found = stacked(270 * u.deg, baseline=[50, 100] * u.day)
    years = matched.cube.years.value
    pairs = baseline_pairs(years, 50 / 365.25, 100 / 365.25)
    np.testing.assert_array_equal(found.pairs.first, pairs.first)
    np.testing.assert_array_equal(found.pairs.second, pairs.second)
    interval = found.search.diagram.interval * 365.25
    assert 50 <= interval.min() < interval.max() <= 100


def test_without_a_baseline_the_map_has_intervals_that_suit_the_speed(stacked, matched):
    """Those in which it moves 0.2 to 1 beam, here one interval: 0.6 beam."""
    found = stacked(270 * u.deg)
    moved = found.pairs.interval * found.components["pm"][0].value
    assert 0.2 <= moved.min() <= moved.max() <= 1
    assert len(found.pairs) == 7
    # But the diagram holds all of them.
    assert found.search.diagram.n_pairs.sum() == 28


def test_where_nothing_moves_the_map_has_the_papers_pairs(still):
    with pytest.warns(MeasurementWarning, match="4 epochs allow no p_global"):
        found = scc().stack(still, n_trials=100, rng=1)
    expected = consecutive_pairs(still.cube.years.value)
    np.testing.assert_array_equal(found.pairs.second, expected.second)


def test_a_map_reaches_beyond_what_moves(stacked, sky_result):
    assert sky_result.grid.v_max == (30.0, 30.0)
    free = stacked(max_speed=None)
    for found in (sky_result, free):
        assert found.components["pm"][0].value == pytest.approx(SPEED, rel=0.1)
        assert 0 <= found.maxima[0].row < found.grid.shape[0]
    assert free.grid.v_max[0] == pytest.approx(3 * free.components["pm"][0].value)


# What few epochs, trials or SSPs cannot tell ---------------------------------------


@pytest.fixture(scope="module")
def still():
    """Four epochs of a jet that stands still."""
    return scc().match(simulate_static(n_epochs=4, rng=1).cube)


def test_few_epochs_are_warned_of(still):
    with pytest.warns(
        MeasurementWarning,
        match=r"^4 epochs allow no p_global below 0\.083 \(2/N!\), so nothing that "
        "moves can reach level 0.05: measure more epochs$",
    ):
        table = scc().stack(still, n_trials=100, rng=1).components
    assert list(table["kind"]) == ["not significant", "stationary"]
    assert table["caution"][0] == "too few epochs or trials: no p_global below 0.083"
    np.testing.assert_allclose(table["p_smallest"], 2 / 24)
    assert table["pm"][1] < 0.5 * PM


def test_few_trials_are_warned_of(matched):
    with pytest.warns(
        MeasurementWarning,
        match=r"^10 trials allow no p_global below 0\.091, so no stream can reach "
        "level 0.05: give n_trials of 20 or more$",
    ):
        found = scc().stack(matched, n_trials=10, rng=1)
    assert np.all(found.components["p_smallest"] > 0.05)
    assert "moving" not in list(found.components["kind"])


def test_a_level_that_can_be_reached_is_not_warned_of(still, matched):
    # Warnings are errors.
    found = scc().stack(matched, n_trials=19, rng=1)
    assert np.all(found.components["p_smallest"] <= 0.05)
    scc(alpha=0.09).stack(still, n_trials=20, rng=1)


@pytest.mark.parametrize("level", [0.05, 0.01, 0.07, 1 / 3, 1e-4, 1 / 49])
def test_the_advice_is_enough_and_not_too_much(level):
    def said(n_trials):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            _warn_of_limits(1 / (n_trials + 1), 99, n_trials, level)
        return " ".join(str(w.message) for w in caught)

    enough = int(re.search(r"n_trials of (\d+)", said(1)).group(1))
    assert said(enough) == ""
    assert enough < 4 or said(enough - 3)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.slow
def test_jets_without_common_speeds_do_not_move(seed):
    cube = simulate_unrelated(n_epochs=6, rng=seed).cube
    table = scc()(cube, n_trials=50, rng=1).components
    assert table["kind"][0] == "not significant"
    assert table["caution"][0].startswith("permuted epochs give as strong a peak")
    assert "moving" not in list(table["kind"])


def chosen(ssps, which):
    """No, one or two SSPs, of all epochs or of each."""
    select = np.zeros(len(ssps), dtype=bool)
    epochs = [np.flatnonzero(ssps.epoch == k) for k in np.unique(ssps.epoch)]
    places = {
        "none": [],
        "one": [epochs[0][3]],
        "one that only earlier epochs know": [epochs[-1][9]],
        "one an epoch": [own[0] for own in epochs],
        "two an epoch": [k for own in epochs for k in own[[0, 5]]],
    }
    select[places[which]] = True
    return select


@pytest.mark.parametrize(
    "which",
    ["one", "one that only earlier epochs know", "one an epoch", "two an epoch"],
)
def test_one_or_two_ssps_have_a_finite_error_or_none_and_a_word(matched, which):
    few = replace(matched, select=chosen(matched.ssps, which))
    with np.errstate(over="raise", divide="raise", invalid="raise"):
        table = scc(scales=[1, 2]).stack(few, n_trials=20, rng=1).components
    assert len(table) >= 1
    for name in table.colnames:
        if "_err" in name:
            assert not np.isinf(np.asarray(table[name], dtype=float)).any()
    assert np.isfinite(table["pm"]).all()
    # No error without features that were followed.
    np.testing.assert_array_equal(np.isfinite(table["pm_err"]), table["n_features"] > 0)
    for row in table:
        assert row["caution"] != "-" or not row["kind"].startswith("not")


def test_without_an_ssp_there_is_no_component(matched):
    few = replace(matched, select=chosen(matched.ssps, "none"))
    for angle in (None, 270 * u.deg, "radial"):
        found = scc(scales=[1, 2], position_angle=angle).stack(few, n_trials=20, rng=1)
        assert len(found.components) == 0
        assert found.search.streams == found.velocities == ()


def test_two_epochs_have_a_speed_without_an_error(matched):
    with pytest.warns(MeasurementWarning, match="2 epochs allow no p_global below 1"):
        table = scc()(matched.cube[:2], n_trials=20, rng=1).components
    assert list(table["kind"]) == ["not significant"]
    assert table["p_smallest"][0] == table["p_global"][0] == 1
    assert np.isfinite(table["pm"]).all()
    assert np.isnan(table["pm_err"]).all()
