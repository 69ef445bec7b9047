# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Intrinsic speeds and two-sided jets, and their errors against small differences."""

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.kinematics import (
    beta_intrinsic,
    intrinsic_table,
    lorentz_factor,
    two_sided_jet,
)

DAY = u.mas / u.day


def test_errors_of_a_two_sided_jet_are_those_of_small_changes():
    a, r, distance = 17.6, 9.0, 12.5 * u.kpc
    errors = 0.04, 0.03
    found = two_sided_jet(
        a * DAY, r * DAY, distance, errors=[e * DAY for e in errors], rng=1
    )
    for name in ("beta_cos", "angle", "beta"):
        changes = []
        for step in ((errors[0], 0), (0, errors[1])):
            up, down = (
                two_sided_jet(
                    (a + sign * step[0]) * DAY, (r + sign * step[1]) * DAY, distance
                )[name]
                for sign in (1, -1)
            )
            changes.append(0.5 * (u.Quantity(up[0]) - u.Quantity(down[0])).value)
            # Without errors of the motions there are none.
            assert u.Quantity(up[1]).value == pytest.approx(0, abs=1e-9)
        error = u.Quantity(found[name][1]).value
        assert error == pytest.approx(np.hypot(*changes), rel=0.03)
    assert found["angle"][1].unit == u.deg


def test_numbers_of_a_two_sided_jet():
    found = two_sided_jet(3 * DAY, 1 * DAY, 10 * u.kpc)
    assert found["beta_cos"][0] == pytest.approx(0.5)
    # beta sin = 2 D mu_a mu_r / (c (mu_a + mu_r)).
    sin = 1.5 * (DAY * 10 * u.kpc).to_value(u.rad * u.m / u.s) / 299792458
    assert found["beta"][0] == pytest.approx(np.hypot(0.5, sin))
    assert found["angle"][0].value == pytest.approx(np.degrees(np.arctan2(sin, 0.5)))
    at = two_sided_jet(3 * DAY, 1 * DAY, found["beta_max_distance"])
    assert at["beta"][0] == pytest.approx(1)
    same = two_sided_jet(2 * DAY, 2 * DAY)
    assert same["beta_cos"][0] == 0


def test_limits_are_the_central_68_per_cent():
    table = intrinsic_table([5.0, 9.0], [0.1, 0.3], n_trials=40000, rng=3)
    for row, (beta, error) in zip(table, [(5.0, 0.1), (9.0, 0.3)], strict=True):
        low, high = beta + np.array([-1, 1]) * 0.99446 * error
        assert row["gamma_min_low"].value == pytest.approx(np.hypot(1, low), rel=2e-3)
        assert row["gamma_min_high"].value == pytest.approx(np.hypot(1, high), rel=2e-3)
        assert row["angle_max_low"].to_value(u.deg) == pytest.approx(
            np.degrees(2 * np.arctan(1 / high)), rel=3e-3
        )
    assert table["beta_app_err"][1] == 0.3


def test_limits_with_an_angle_that_is_unsure():
    options = {"viewing_angle": 5 * u.deg, "angle_error": 0.2 * u.deg}
    table = intrinsic_table([5.0], [0.0], **options, rng=3)
    for name in ("gamma", "doppler"):
        ends = [
            intrinsic_table([5.0], [0.0], viewing_angle=angle * u.deg)[name][0].value
            for angle in (5 - 0.99446 * 0.2, 5 + 0.99446 * 0.2)
        ]
        assert table[f"{name}_low"][0].value == pytest.approx(min(ends), rel=5e-3)
        assert table[f"{name}_high"][0].value == pytest.approx(max(ends), rel=5e-3)
    assert {name: table.meta[name] for name in options} == options


def test_slow_flows_and_none():
    table = intrinsic_table([0.0, 0.4], [0.0, 0.0], viewing_angle=20 * u.deg)
    assert table["gamma"][0] == table["gamma_min"][0] == 1
    expected = lorentz_factor(beta_intrinsic(0.4, 20 * u.deg))
    assert table["gamma"][1].value == pytest.approx(expected.value)
    assert (table["possible"] == 1).all()


def test_impossible_flows_are_infinite():
    table = intrinsic_table([20.0], [0.1], viewing_angle=15 * u.deg, rng=1)
    assert np.isinf(table["gamma"][0])
    assert table["doppler"][0] == 0
    assert table["possible"][0] == 0
    assert "gamma" not in intrinsic_table([20.0], [0.1]).colnames


def test_speeds_are_in_units_of_c():
    table = intrinsic_table([400, 600] * u.percent, 10 * u.percent, rng=1)
    np.testing.assert_allclose(table["gamma_min"].value, np.sqrt([17, 37]))
    np.testing.assert_allclose(table["beta_app_err"].value, 0.1)
    with pytest.raises(u.UnitConversionError, match="units of c, got km / s: divide t"):
        intrinsic_table([1e6] * u.km / u.s, [0.1])


@given(beta=st.floats(0.1, 0.999), theta=st.floats(1, 89))
def test_two_sided_jet_there_and_back(beta, theta):
    t, d = np.radians(theta), 10 * u.kpc
    cos = beta * np.cos(t)
    rate = (beta * np.sin(t) / d.to_value(u.m) * 299792458) * u.rad / u.s
    found = two_sided_jet(rate / (1 - cos), rate / (1 + cos), d)
    assert found["beta"][0] == pytest.approx(beta, rel=1e-9)
    assert found["angle"][0].value == pytest.approx(theta, rel=1e-9)
    assert found["beta_cos"][0] == pytest.approx(cos, rel=1e-9)
    assert found["beta_max_distance"] > d


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"errors": (0.4, 0.1)}, u.UnitConversionError, "errors = 0.4 must be an"),
        ({"receding": 9.0}, u.UnitConversionError, "receding = 9.0 must be an"),
        ({"distance": -1 * u.kpc}, ValueError, "distance = -1.0 kpc must be finite"),
        ({"receding": 0 * DAY}, ValueError, "receding motion must be positive"),
        ({"receding": 18 * DAY}, ValueError, "receding motion must be positive"),
    ],
)  # fmt: skip
def test_two_sided_jets_that_are_refused(changes, error, message):
    motions = {"approaching": 17.6 * DAY, "receding": 9.0 * DAY, **changes}
    with pytest.raises(error, match=message):
        two_sided_jet(**motions)


@pytest.mark.parametrize(
    ("beta", "error"),
    [
        ([-1.0], [0.1]), ([np.nan], [0.1]), ([1.0], [-0.1]), ([1.0, 2.0], [0.1, -0.1]),
        ([1.0, -0.5], [0.1, 0.1]), ([1.0, 2.0], [0.1, np.nan]),
        ([1.0, np.inf], [0.1, 0.1]),
    ],
)  # fmt: skip
def test_one_speed_that_cannot_be_among_others(beta, error):
    with pytest.raises(ValueError, match="finite and not negative"):
        intrinsic_table(beta, error)


def test_nothing_over_nothing_is_no_speed():
    assert np.isnan(beta_intrinsic(0, 0 * u.deg))
    assert np.isnan(beta_intrinsic([-0.1, -0.5, -3.0], 15 * u.deg)).all()
    assert np.isnan(lorentz_factor([1.0, -1.0, 2.0])).all()
