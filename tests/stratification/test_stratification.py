# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Scale groups and limbs of simulated jets, and what must be refused."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.kinematics import RidgeLine
from astro_scc.simulation import JetSimulation, Stream
from astro_scc.stratification import (
    compare_positions,
    compare_speeds,
    limb_groups,
    scale_groups,
)

PM = u.mas / u.yr
PER_PIXEL = 0.1 / 30 * 365.25


@pytest.fixture(scope="module")
def scc():
    return StackedCrossCorrelation(
        scales=[1, 2], max_speed=20 * PM, position_angle=270 * u.deg
    )


@pytest.fixture(scope="module")
def matched(scc):
    """A jet that is faster on its northern side, by 4 pixels an epoch."""
    flow = Stream(
        "flow",
        dx=lambda x, y: np.where(y > 64, 8.0, 4.0),
        half_width=25.0,
        density=1.5,
    )
    jet = JetSimulation([flow], n_epochs=10, extent=(20.0, 240.0))
    return scc.match(jet.run(rng=2).cube)


@pytest.fixture(scope="module")
def limbs(matched):
    line = RidgeLine([0, -25] * u.mas, [0, 0] * u.mas)
    return limb_groups(matched, line, 0.5 * u.mas)


def test_limbs_have_their_speeds(scc, matched, limbs):
    two = {name: limbs[name] for name in ("south", "north")}
    table = compare_speeds(scc, matched, two, n_trials=199, rng=1)
    row = table[0]
    assert row["p_value"] < 0.05
    error = row["difference_err"].value
    assert abs(row["difference"].value - 4 * PER_PIXEL) < 4 * error + 0.5
    assert abs(row["first_speed"].value - 4 * PER_PIXEL) < 1
    assert abs(row["second_speed"].value - 8 * PER_PIXEL) < 1
    assert row["first_n_ssp"] == two["south"].sum()


def test_scales_of_one_flow_have_one_direction(scc, matched):
    groups = scale_groups(matched, {"fine": [1], "coarse": [2]})
    table = compare_positions(scc, matched, groups, speed=7 * PM, n_trials=99, rng=1)
    assert table["quantity"].tolist() == ["position angle", "offset", "from the middle"]
    assert table["p_paired"][0] > 0.01


def test_limbs_differ_in_place(scc, matched, limbs):
    two = {name: limbs[name] for name in ("south", "north")}
    table = compare_positions(scc, matched, two, n_trials=99, rng=1)
    offset = table[table["quantity"] == "offset"][0]
    assert offset["p_paired"] <= 0.02
    assert offset["p_ksamp"] <= 0.001
    assert offset["first_median"] < 0 < offset["second_median"]
    for axes in ("radial", RidgeLine([0, -25] * u.mas, [0, 0] * u.mas), None):
        other = compare_positions(
            replace(scc, position_angle=axes), matched, two, n_trials=9, rng=1
        )
        row = other[other["quantity"] == "offset"][0]
        assert row["first_median"] * row["second_median"] < 0


def test_three_groups_are_three_comparisons(scc, matched, limbs):
    table = compare_speeds(scc, matched, limbs, n_trials=9, rng=1)
    assert len(table) == 3


def test_same_seed_same_table(scc, matched, limbs):
    first, second = (
        compare_speeds(scc, matched, limbs, n_trials=19, rng=3) for _ in range(2)
    )
    assert first["p_value"].tolist() == second["p_value"].tolist()


def test_refused(scc, matched, limbs):
    everything = {"a": matched.select, "b": matched.select}
    with pytest.raises(ValueError, match="'a' and 'b' share SSPs"):
        compare_speeds(scc, matched, everything)
    with pytest.raises(ValueError, match="two groups or more, got 1"):
        scale_groups(matched, {"a": [1]})
    with pytest.raises(ValueError, match="share SSPs"):
        scale_groups(matched, {"a": [1, 2], "b": [2]})
    sky = replace(scc, position_angle=None)
    with pytest.raises(ValueError, match="direction of the flow is needed"):
        compare_speeds(sky, matched, limbs)
    none = {"north": limbs["north"], "nothing": np.zeros_like(limbs["north"])}
    with pytest.raises(ValueError, match="'nothing' has no match"):
        compare_speeds(scc, matched, none)
    with pytest.raises(ValueError, match="'nothing' has 0 SSPs"):
        compare_positions(scc, matched, none)


def test_other_axes(scc, matched, limbs):
    for axes in ("radial", RidgeLine([0, -25] * u.mas, [0, 0] * u.mas)):
        table = compare_speeds(
            replace(scc, position_angle=axes), matched, limbs, n_trials=9,
            r_min=5 * u.mas, rng=1,
        )  # fmt: skip
        assert np.all(np.isfinite(table["difference"]))
