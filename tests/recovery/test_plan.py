# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The estimate against its definition, and the simulation where it is easy."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

from astro_scc.epochs import Beam
from astro_scc.recovery import plan, smallest_plan
from astro_scc.stacking import Rays, SearchSettings

PM = u.mas / u.yr
# The slowest speed that is searched in 2.5 yr, for a beam of 1 mas.
SLOW = SearchSettings().slowest / 2.5
SPEEDS = [SLOW, 2 * SLOW] * PM
BASE = {"speeds": SPEEDS, "beam": 1 * u.mas, "n_epochs": [4, 6, 9],
        "intervals": [0.25, 0.5] * u.yr}  # fmt: skip


def estimate(**changes):
    return plan(**{**BASE, "n_jets": 0, **changes})


def test_rows_are_what_was_asked_for():
    table = estimate(intervals=[0.25 * u.yr, 182.625 * u.day])
    assert table["n_epochs"].tolist() == [4, 4, 6, 6, 9, 9]
    assert u.allclose(table["interval"], [0.25, 0.5] * 3 * u.yr)
    assert u.allclose(table["total_time"], [0.75, 1.5, 1.25, 2.5, 2, 4] * u.yr)
    np.testing.assert_allclose(table["motion_slow"], SLOW * np.array([0.25, 0.5] * 3))
    np.testing.assert_allclose(table["motion_fast"], SLOW * np.array([0.5, 1] * 3))
    np.testing.assert_allclose(table["p_smallest"][::2], [1 / 12, 1 / 360, 2 / 362880])
    # In 2.5 yr or more the slower stream moves far enough.
    assert table["limit"].tolist() == ["epochs", "epochs", "rest", "", "rest", ""]
    assert not table["n_jets"].any()
    for name in ("slow", "fast", "both"):
        for suffix in ("", "_low", "_high"):
            assert table[f"fraction_{name}{suffix}"].mask.all()
    assert table.meta["epochs_needed"] == 5
    assert all(table[name].info.description for name in table.colnames)


@pytest.mark.parametrize(
    ("changes", "limit"),
    [
        ({}, ""),
        ({"n_epochs": 4}, "epochs"),
        ({"n_epochs": 4, "alpha": 0.1}, "rest"),
        ({"n_epochs": 4, "alpha": 0.1, "intervals": 1 * u.yr}, ""),
        ({"speeds": [0.99 * SLOW, 2 * SLOW] * PM}, "rest"),
        ({"speeds": [SLOW, SLOW + 0.19] * PM}, "difference"),
        ({"speeds": [SLOW, SLOW + 0.2] * PM}, ""),
        ({"speeds": [1.6, 20.1] * PM}, "field"),
        ({"speeds": [1.6, 20] * PM}, ""),
        ({"speeds": [1.6, 5.1] * PM, "field": 5 * u.mas}, "field"),
        ({"speeds": [1.6, 5] * PM, "field": 5 * u.mas}, ""),
    ],
)
def test_what_cannot_be_told_apart(changes, limit):
    table = estimate(**{"n_epochs": 6, "intervals": 0.5 * u.yr, **changes})
    assert table["limit"].tolist() == [limit]


def test_what_moves_too_little_is_what_the_search_leaves_out():
    rays = Rays.of(0.5 * np.arange(6), SearchSettings().radius, SearchSettings())
    slowest = rays.speed[rays.speed > 0].min()
    for factor, limit in ((0.999, "rest"), (1.001, "")):
        speeds = [factor * slowest, 3 * slowest] * PM
        table = estimate(speeds=speeds, n_epochs=6, intervals=0.5 * u.yr)
        assert table["limit"].tolist() == [limit]


def test_the_beam_lies_as_it_does_to_the_jet():
    beam = Beam(2 * u.mas, 0.5 * u.mas, 30 * u.deg)
    for angle, width in ((30, 2.0), (120, 0.5), (210, 2.0)):
        table = estimate(beam=beam, position_angle=angle * u.deg)
        assert u.isclose(table.meta["beam_along"], width * u.mas)
    assert u.isclose(estimate(beam=beam).meta["beam_along"], 1 * u.mas)


def test_the_smallest_row_has_the_fewest_epochs_then_the_shortest_time():
    table = estimate()
    row = smallest_plan(table)
    assert (row["n_epochs"], row["interval"]) == (6, 0.5 * u.yr)
    assert table.meta["smallest"]["n_epochs"] == 6
    assert table.meta["smallest"]["fraction_both"] is None
    assert smallest_plan(estimate(n_epochs=[3, 4])) is None
    assert estimate(n_epochs=[3, 4]).meta["smallest"] is None


def test_the_smallest_row_reaches_the_share():
    table = estimate()
    table["n_jets"] = [0, 0, 10, 10, 10, 10]
    table["fraction_both"] = np.ma.MaskedArray(
        [0, 0, 0.2, 0.8, 0.9, 0.95], [1, 1] + [0] * 4
    )
    assert smallest_plan(table, 0.8)["interval"] == 0.5 * u.yr
    assert smallest_plan(table, 0.9)["n_epochs"] == 9
    assert smallest_plan(table, 0.96) is None


@pytest.fixture(scope="module")
def simulated():
    """One number of epochs that cannot do, and one that does."""
    return {
        "speeds": [0.5, 1.5] * u.mas / u.yr,
        "beam": 1 * u.mas,
        "n_epochs": [4, 6],
        "intervals": 1 * u.yr,
        "field": 12 * u.mas,
        "n_jets": 1,
        "n_trials": 20,
        "wanted": 0.5,
        "jitter": 0.5,
        "shape": (64, 180),
        "axis": 32.0,
    }


@pytest.mark.slow
def test_streams_are_found_in_simulated_jets(simulated, tmp_path):
    one = plan(**simulated, rng=3)
    two = plan(**simulated, rng=3, n_workers=2)
    assert one["n_jets"].tolist() == [0, 1]
    assert one["fraction_both"].mask.tolist() == [True, False]
    assert one["fraction_slow"][1] > 0
    assert one["fraction_both"][1] <= min(
        one["fraction_slow"][1], one["fraction_fast"][1]
    )
    assert one["fraction_slow_low"][1] < one["fraction_slow"][1]
    for name in one.colnames:
        np.testing.assert_array_equal(
            np.ma.filled(one[name], -1), np.ma.filled(two[name], -1)
        )
    one.write(tmp_path / "plan.ecsv")
    read = QTable.read(tmp_path / "plan.ecsv")
    assert read.colnames == one.colnames
    assert read["fraction_both"].mask.tolist() == [True, False]
    assert read.meta["seed"] == 3
    assert u.allclose(read.meta["speeds"], one.meta["speeds"])


def test_a_seed_is_drawn_and_kept():
    assert estimate()["n_jets"].sum() == 0
    assert estimate().meta["seed"] is not None
    assert estimate(rng=5).meta["seed"] == 5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"speeds": 1 * PM}, "speeds must be two different ones"),
        ({"speeds": [1, 0] * PM}, "speeds = .* must be positive and finite"),
        ({"speeds": [1, 1] * PM}, "speeds must be two different ones"),
        ({"beam": 0 * u.mas}, "beam = 0.0 mas must be finite and above 0"),
        ({"field": -1 * u.mas}, "field = -1.0 mas must be finite and above 0"),
        ({"n_epochs": 1}, "n_epochs must be one or more numbers from 2, got 1"),
        ({"n_epochs": []}, "n_epochs must be one or more numbers from 2"),
        ({"n_epochs": 5.5}, "n_epochs must be one or more numbers from 2, got 5.5"),
        ({"intervals": 0 * u.yr}, "intervals = 0.0 yr must be positive and finite"),
        ({"intervals": [] * u.yr}, "intervals = .* must be positive and finite"),
        ({"n_jets": -1}, "n_jets must be zero or positive, got -1"),
        ({"n_jets": 1, "n_trials": 5}, "5 trials allow no p_global below 0.17"),
        ({"alpha": 1}, "alpha must be between 0 and 1, got 1"),
        ({"wanted": 0}, "wanted must be between 0 and 1, got 0"),
    ],
)
def test_says_what_is_wrong(changes, message):
    with pytest.raises(ValueError, match=message):
        estimate(**changes)


@pytest.mark.parametrize(
    "changes",
    [
        {"speeds": [1, 2] * u.mas},
        {"beam": 1 * u.s},
        {"field": 1 * u.s},
        {"intervals": 1 * u.mas},
        {"position_angle": 1 * u.s},
    ],
)
def test_says_which_unit_does_not_fit(changes):
    (name,) = changes
    with pytest.raises(u.UnitConversionError, match=f"{name} = .* must be"):
        estimate(**changes)
