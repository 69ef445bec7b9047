# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Components of simulated jets, and what few epochs or trials cannot tell."""

import re
import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc import StackedCrossCorrelation
from astro_scc.exceptions import MeasurementWarning
from astro_scc.measurement.stacking import _warn_of_limits
from astro_scc.simulation import simulate_static, simulate_unrelated


def scc(**settings):
    options = {"scales": [2], "max_speed": 30 * u.mas / u.yr, **settings}
    return StackedCrossCorrelation(**options)


@pytest.fixture(scope="module")
def still():
    """Four epochs of a jet that stands still."""
    return scc().match(simulate_static(n_epochs=4, rng=1).cube)


def test_few_epochs_are_warned_of(still):
    with pytest.warns(
        MeasurementWarning,
        match=r"^4 epochs allow no p_global below 0\.083 \(2/N!\), so nothing that "
        "moves can reach level 0.05: measure 5 epochs or more$",
    ):
        found = scc().stack(still, n_trials=100, rng=1)
    table = found.components
    # What stands still needs no order of the epochs.
    assert table["kind"][0] == "stationary"
    assert table["p_smallest"][0] == table["p_global"][0] == pytest.approx(1 / 101)
    assert np.hypot(table["pm"][0], 0).value < 0.5
    others = table[table["kind"] != "stationary"]
    assert np.all(others["kind"] == "uncertain")
    assert np.all(others["p_smallest"] == pytest.approx(2 / 24))


def test_orders_of_another_null_hypothesis_are_warned_of(matched):
    with pytest.warns(
        MeasurementWarning,
        match=r"^6 epochs allow no p_global below 0\.17 \(the orders of 'blocks' are "
        r"so few\), so nothing .* can reach level 0.05: measure 7 epochs or more$",
    ):
        scc(nulls=["scramble", "blocks"]).stack(matched, n_trials=100, rng=1)


def test_few_trials_are_warned_of(matched):
    with pytest.warns(
        MeasurementWarning,
        match=r"^10 trials allow no p_global below 0\.091, so no component can reach "
        "level 0.05: give n_trials of 19 or more$",
    ):
        found = scc().stack(matched, n_trials=10, rng=1)
    assert np.all(found.components["p_smallest"] > 0.05)
    assert set(found.components["kind"]) == {"uncertain"}


def test_a_level_that_can_be_reached_is_not_warned_of(still, matched):
    # Warnings are errors.
    found = scc().stack(matched, n_trials=19, rng=1)
    assert np.all(found.components["p_smallest"] <= 0.05)
    scc(level=0.09).stack(still, n_trials=20, rng=1)


@given(st.integers(2, 200), st.integers(2, 10**6), st.floats(1e-6, 0.99))
def test_the_advice_is_enough_and_not_too_much(n_epochs, n_trials, level):
    def said(n_epochs, n_trials):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            _warn_of_limits(n_epochs, n_trials, level, ["scramble", "shuffle"])
        return " ".join(str(w.message) for w in caught)

    text = said(n_epochs, n_trials)
    assert bool(text) == (
        1 / (n_trials + 1) > level
        or (n_epochs < 20 and 2 / np.prod(np.arange(2.0, n_epochs + 1)) > level)
    )
    if "epochs allow" in text:
        enough = int(re.search(r"measure (\d+) epochs", text).group(1))
        assert enough > n_epochs
        assert "epochs allow" in said(enough - 1, n_trials)
        assert "epochs allow" not in said(enough, n_trials)
    elif text:
        enough = int(re.search(r"n_trials of (\d+)", text).group(1))
        assert enough > n_trials
        assert said(n_epochs, enough) == ""
        assert enough < 3 or said(n_epochs, enough - 2)


@pytest.mark.parametrize("seed", [1, 2])
def test_jets_without_common_speeds_have_no_component(seed):
    cube = simulate_unrelated(n_epochs=6, rng=seed).cube
    found = scc()(cube, n_trials=50, rng=1)
    assert set(found.components["kind"]) <= {"uncertain"}


def chosen(ssps, which):
    """One or two SSPs, of all epochs or of each."""
    select = np.zeros(len(ssps), dtype=bool)
    epochs = [np.flatnonzero(ssps.epoch == k) for k in np.unique(ssps.epoch)]
    places = {
        "one": [epochs[0][3]],
        "one that only earlier epochs know": [epochs[-1][9]],
        "two that only earlier epochs know": epochs[-1][[9, 16]],
        "one an epoch": [own[0] for own in epochs],
        "two an epoch": [k for own in epochs for k in own[[0, 9]]],
    }
    select[places[which]] = True
    return select


@pytest.mark.parametrize(
    ("which", "known"),
    [
        ("one", True),
        ("one that only earlier epochs know", False),
        ("two that only earlier epochs know", False),
        ("one an epoch", True),
        ("two an epoch", True),
    ],
)
@pytest.mark.parametrize("nulls", [("scramble", "shuffle"), ("shuffle",)])
def test_one_or_two_ssps_have_a_finite_error_or_none_and_a_word(
    matched, which, known, nulls
):
    few = replace(matched, select=chosen(matched.ssps, which))
    measure = scc(scales=[1, 2], nulls=nulls)
    with np.errstate(over="raise", divide="raise", invalid="raise"):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            found = measure.stack(few, n_trials=20, rng=1)
    said = [text for one in said if "too few matches" in (text := str(one.message))]
    table = found.components
    assert len(table) >= 1
    for name in table.colnames:
        if "_err" in name:
            assert not np.isinf(np.asarray(table[name], dtype=float)).any()
    assert np.isfinite(table["pm"]).all()
    assert np.isfinite(table["pm_err"]).all() == known
    assert said == (
        []
        if known
        else [
            "component 1: too few matches for an error of the velocity, pm_err is NaN; "
            "measure more scales, a larger region, more epochs or a wider baseline"
        ]
    )


def test_two_epochs_have_no_error_by_leaving_out_epochs(matched):
    cube = matched.cube[:2]
    with pytest.warns(MeasurementWarning, match="2 epochs allow no p_global"):
        table = scc()(cube, n_trials=20, rng=1).components
    assert np.isnan(table["pm_err_epochs"]).all()
    assert np.isfinite(table["pm_err"]).all()
