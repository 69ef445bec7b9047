# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.kinematics import intrinsic_table, two_sided_jet


def test_errors_are_those_of_small_changes():
    table = intrinsic_table([5.0], [0.01], viewing_angle=8 * u.deg, rng=1)
    step = intrinsic_table([5.01], [0.0], viewing_angle=8 * u.deg)
    for name in ("gamma_min", "gamma", "doppler", "angle_max"):
        half = 0.5 * np.abs(table[f"{name}_high"] - table[f"{name}_low"])
        change = np.abs(step[name] - table[name])
        np.testing.assert_allclose(half.value, change.value, rtol=0.05)
    # In the limit of no error there is none.
    assert step["gamma_low"] == step["gamma_high"] == step["gamma"]


def test_the_angle_has_an_error_too():
    sure = intrinsic_table([5.0], [0.1], viewing_angle=15 * u.deg, rng=1)
    unsure = intrinsic_table(
        [5.0], [0.1], viewing_angle=15 * u.deg, angle_error=2 * u.deg, rng=1
    )
    assert unsure["gamma_high"][0] > sure["gamma_high"][0]
    assert unsure["possible"][0] < sure["possible"][0] == 1


def test_impossible_flows_are_infinite():
    table = intrinsic_table([20.0], [0.1], viewing_angle=15 * u.deg, rng=1)
    assert np.isinf(table["gamma"][0])
    assert table["doppler"][0] == 0
    assert table["possible"][0] == 0
    assert "gamma" not in intrinsic_table([20.0], [0.1]).colnames


@pytest.mark.parametrize(
    ("beta", "error"), [([-1.0], [0.1]), ([np.nan], [0.1]), ([1.0], [-0.1])]
)
def test_speeds_that_cannot_be(beta, error):
    with pytest.raises(ValueError, match="finite and not negative"):
        intrinsic_table(beta, error)


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


def test_two_sided_errors_and_refusals():
    day = u.mas / u.day
    found = two_sided_jet(
        17.6 * day, 9.0 * day, 12.5 * u.kpc, errors=(0.4 * day, 0.1 * day), rng=1
    )
    assert found["angle"][1].value == pytest.approx(2, abs=1.5)
    assert 0 < found["beta"][1] < 0.05
    assert "beta" not in two_sided_jet(2 * day, 1 * day)
    with pytest.raises(u.UnitConversionError, match="errors = 0.4 must be an angle p"):
        two_sided_jet(17.6 * day, 9.0 * day, errors=(0.4, 0.1))
    with pytest.raises(u.UnitConversionError, match="receding = 9.0 must be an angle"):
        two_sided_jet(17.6 * day, 9.0)
    with pytest.raises(ValueError, match="distance = -1.0 kpc must be finite and abov"):
        two_sided_jet(17.6 * day, 9.0 * day, -1 * u.kpc)
    for receding in (0.0, 18.0):
        with pytest.raises(ValueError, match="receding motion must be positive"):
            two_sided_jet(17.6 * day, receding * day)
