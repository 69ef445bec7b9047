# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Components of simulated jets, restrictions, and what few epochs cannot tell."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astro_scc.streams.chains import Feature
from astro_scc.streams.dispersion import Population, velocity_of
from astro_scc.streams.search import Stream

from astro_scc import StackedCrossCorrelation
from astro_scc.exceptions import MeasurementWarning
from astro_scc.simulation import simulate_static

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
    # Without a baseline the map has intervals in which it moves 0.2 to 1 beam, here
    # one interval: 0.6 beam.  But the diagram holds all of them.
    moved = sky_result.pairs.interval * moving["pm"].value
    assert 0.2 <= moved.min() <= moved.max() <= 1
    assert len(sky_result.pairs) == 7
    assert sky_result.search.diagram.n_pairs.sum() == 28


# What few epochs, trials or SSPs cannot tell ---------------------------------------


def test_few_epochs_are_warned_of():
    still = scc().match(simulate_static(n_epochs=4, rng=1).cube)
    with pytest.warns(
        MeasurementWarning,
        match=r"^4 epochs allow no p_global below 0\.083 \(2/N!\), so nothing that "
        "moves can reach level 0.05: measure more epochs$",
    ):
        found = scc().stack(still, n_trials=100, rng=1)
    table, parts = found.components, found.sensitivity
    assert list(table["kind"]) == ["not significant", "stationary"]
    assert table["caution"][0] == "too few epochs or trials: no p_global below 0.083"
    np.testing.assert_allclose(table["p_smallest"], 2 / 24)
    # All orders were tried.
    assert np.all(table["p_global_err"] == 0)
    assert table["pm"][1] < 0.5 * PM
    # What does not move is not measured again from parts of the data.
    assert len(parts) == 0
    assert parts.meta["note"] == "nothing moves significantly"
    assert parts["pm"].unit == PM


def test_few_trials_are_warned_of(matched):
    with pytest.warns(
        MeasurementWarning,
        match=r"^10 trials allow no p_global below 0\.091, so nothing that moves can "
        "reach level 0.05: give n_trials of 20 or more$",
    ):
        found = scc().stack(matched, n_trials=10, rng=1)
    assert np.all(found.components["p_smallest"] > 0.05)
    assert "moving" not in list(found.components["kind"])


@pytest.mark.parametrize("n", [0, 2])
def test_few_ssps_have_a_finite_error_or_none_and_a_word(matched, n):
    """None, or two an epoch."""
    select = np.zeros(len(matched.ssps), dtype=bool)
    for epoch in range(len(matched.cube)):
        select[np.flatnonzero(matched.ssps.epoch == epoch)[[0, 5][:n]]] = True
    few = replace(matched, select=select)
    with np.errstate(over="raise", divide="raise", invalid="raise"):
        table = scc(scales=[1, 2]).stack(few, n_trials=20, rng=1).components
    assert (len(table) > 0) == (n > 0)
    for name in table.colnames:
        if "_err" in name:
            assert not np.isinf(np.asarray(table[name], dtype=float)).any()
    assert np.isfinite(table["pm"]).all()
    # No error without features that were followed.
    np.testing.assert_array_equal(np.isfinite(table["pm_err"]), table["n_features"] > 0)
    for row in table:
        assert row["caution"] != "-" or not row["kind"].startswith("not")


def feature(ssp, speed, error):
    """SSPs of the three epochs on a line."""
    return Feature(
        ssp=np.array(ssp), epoch=np.arange(3), speed=speed, error=error, across=0.0,
        across_error=error, middle=np.zeros(2), date=2000.0, motion=2 * speed,
        response=np.array([-0.5, 0.0, 0.5]),
    )  # fmt: skip


def stream_of(*features, angle=np.pi / 6, dispersion=0.0):
    return Stream(
        kind="moving", reason="", angle=angle,
        along=Population(2.0, 0.1, dispersion, 0.04),
        across=Population(0.5, 0.2, 0.0, 0.0), features=features,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("angle", "major", "minor"), [(0.4, 0.5, 2.0), (-1.3, 3.0, 0.1)]
)
def test_its_covariance_turns_with_it(angle, major, minor):
    stream = stream_of(angle=angle)
    found = velocity_of(stream, [major, minor], np.zeros((3, 2)))
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-np.sin(angle), np.cos(angle)])
    assert along @ found.features @ along == pytest.approx((0.1 * major) ** 2)
    assert across @ found.features @ across == pytest.approx((0.2 * minor) ** 2)
    assert along @ found.features @ across == pytest.approx(0, abs=1e-9)
    assert along @ found.value == pytest.approx(2.0 * major)
    assert across @ found.value == pytest.approx(0.5 * minor)


def test_epochs_that_are_misaligned_move_all_features_together():
    """A slope over 0, 1 and 2 yr is half the last position less the first."""
    misaligned = np.array([[0.1, 0.2], [5.0, 5.0], [0.3, 0.2]])
    expected = np.diag([0.25 * (0.1**2 + 0.3**2), 0.25 * (0.2**2 + 0.2**2)])
    one = stream_of(feature([0, 1, 2], 2.0, 0.1))
    two = stream_of(feature([0, 1, 2], 2.0, 0.1), feature([3, 4, 5], 2.1, 0.4))
    for stream in (one, two):
        found = velocity_of(stream, [0.5, 0.25], misaligned)
        # Averages over features do not make it smaller.
        np.testing.assert_allclose(found.alignment, expected)
        np.testing.assert_allclose(found.covariance, found.features + expected)


def test_a_stream_without_features_has_a_speed_and_no_error():
    unknown = Population(0.0, *[np.nan] * 3)
    stream = Stream("not significant", "", 0.0, Population(1.0, *[np.nan] * 3), unknown)
    found = velocity_of(stream, [0.5, 0.5], np.ones((3, 2)))
    np.testing.assert_array_equal(found.value, [0.5, 0.0])
    assert np.isnan(found.covariance).all()
    assert np.isnan(found.dispersion)
