# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Parts of the data that are searched again."""

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.measurement.sensitivity import (
    largest_difference,
    sensitivity_line,
    sensitivity_table,
    with_choices,
)
from astro_scc.simulation import simulate_jet
from astro_scc.streams.errors import StreamVelocity

SCC = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)


@pytest.fixture(scope="module")
def result():
    jet = simulate_jet(n_epochs=12, dispersion=0.05, rng=1)
    return SCC(jet.cube, n_trials=99, rng=1)


NOTHING = np.nan, np.nan


def row(choice, pm, err, significant):
    numbers = dict.fromkeys(("change", "change_err", "change_sigma"), 0.0)
    numbers |= {"pm": pm, "pm_err": err, "p_value": 1.0, "n_features": 3}
    return {"choice": choice, "significant": significant, **numbers}


def test_every_part_of_a_steady_flow_has_its_speed(result):
    table = result.sensitivity
    assert list(table["choice"][:1]) == ["as measured"]
    assert len(table) == 9
    words = "intervals up", "intervals from", "epochs before", "epochs from", "inner"
    for choice, word in zip(table["choice"][1:], words, strict=False):
        assert choice.startswith(word)
    known = np.isfinite(table["pm"])
    assert known.sum() >= 6
    off = (table["pm"] - table["pm"][0])[known] / table["pm_err"][known]
    assert np.all(np.abs(off) < 3)
    assert not table["significant"].any()
    assert result.sensitivity_line == ""
    assert table["pm"][0] == result.components["pm"][0]


def test_both_parts_may_differ_from_the_whole():
    whole = row("as measured", 1.05, 0.1, False)
    fine, coarse = row("fine", 0.75, 0.07, False), row("coarse", 0.81, 0.1, False)
    off = largest_difference([fine, coarse, whole])
    assert off == pytest.approx(0.3 / np.hypot(0.07, 0.1))
    nothing = row("coarse", np.nan, np.nan, False)
    assert largest_difference([fine, nothing, whole]) == pytest.approx(off)
    assert np.isnan(largest_difference([nothing, nothing, whole]))


def test_parts_without_the_speed_are_said():
    rows = [row("as measured", 0.9, 0.1, False)]
    rows += [row("inner half", 0.1, 0.04, True), row("outer half", *NOTHING, True)]
    own = StreamVelocity(np.array([0.9, 0.0]), *np.zeros((2, 2, 2)), 0.0, 0.0)
    assert np.sqrt(with_choices(own, rows).covariance[0, 0]) == pytest.approx(0.4)
    assert sensitivity_line(sensitivity_table(rows)) == (
        "differs with the data: 0.100 +- 0.040 mas / yr (inner half)"
    )
    rows += [row("fine scales", *NOTHING, False), row("coarse scales", *NOTHING, False)]
    line = sensitivity_line(sensitivity_table(rows))
    assert line.endswith("(inner half); not found in 3 of 4 parts of the data")


def test_halves_that_differ_are_said_and_are_in_the_error():
    """The first half of the dates has slow features, and the second has fast ones."""
    rows = [
        row("as measured", 0.3, 0.02, False),
        row("epochs before 2001-06-10", 0.29, 0.05, True),
        row("epochs from 2001-06-10 on", 0.06, 0.01, True),
        row("fine scales (1)", 0.3, 0.02, False),
        row("coarse scales (2)", 0.3, 0.02, False),
    ]
    line = sensitivity_line(sensitivity_table(rows))
    assert line.startswith("differs with the data: 0.290 +- 0.050 mas / yr (epochs")
    assert "0.060 +- 0.010 mas / yr (epochs from 2001-06-10 on)" in line
    assert "scales" not in line
    zero = np.zeros((2, 2))
    angle = np.radians(30)
    axis = np.array([np.cos(angle), np.sin(angle)])
    own = StreamVelocity(0.3 * axis, zero, zero, 0.0, 0.0)
    wider = with_choices(own, rows)
    assert np.sqrt(axis @ wider.covariance @ axis) == pytest.approx(0.12)
    assert [-axis[1], axis[0]] @ wider.covariance @ axis == pytest.approx(0)
    assert with_choices(own, rows[:1]) is own
