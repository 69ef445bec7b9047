# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The functions of ``examples/relativity.py``: errors of flows and two-sided jets."""

import doctest
import importlib.util
import sys
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

PATH = Path(__file__).parents[1] / "examples" / "relativity.py"
spec = importlib.util.spec_from_file_location("relativity", PATH)
relativity = importlib.util.module_from_spec(spec)
spec.loader.exec_module(relativity)
intrinsic_table, two_sided_jet = relativity.intrinsic_table, relativity.two_sided_jet

DAY = u.mas / u.day


def test_its_examples(monkeypatch):
    monkeypatch.setitem(sys.modules, "relativity", relativity)
    assert doctest.testmod(relativity).failed == 0


def test_limits_are_the_central_68_per_cent():
    beta, error = np.array([5.0, 9.0]), np.array([0.1, 0.3])
    table = intrinsic_table(beta, error, n_trials=40000, rng=3)
    for name, sign in (("low", -1), ("high", 1)):
        end = beta + sign * 0.99446 * error
        gamma = table[f"gamma_min_{name}"].value
        np.testing.assert_allclose(gamma, np.hypot(1, end), rtol=2e-3)
    angles = {"viewing_angle": 5 * u.deg, "angle_error": 0.2 * u.deg}
    table = intrinsic_table([5.0], [0.0], **angles, rng=3)
    for name in ("gamma", "doppler"):
        ends = [
            intrinsic_table([5.0], [0.0], viewing_angle=angle * u.deg)[name][0].value
            for angle in (5 - 0.99446 * 0.2, 5 + 0.99446 * 0.2)
        ]
        found = [table[f"{name}_{end}"][0].value for end in ("low", "high")]
        assert found == pytest.approx(sorted(ends), rel=5e-3)


def test_impossible_flows():
    table = intrinsic_table([20.0], 0.1, viewing_angle=15 * u.deg, rng=1)
    assert np.isinf(table["gamma"][0])
    assert (table["doppler"][0], table["possible"][0]) == (0, 0)
    assert "gamma" not in intrinsic_table([20.0], [0.1]).colnames


@settings(max_examples=20)
@given(beta=st.floats(0.1, 0.999), theta=st.floats(1, 89))
def test_two_sided_jet_there_and_back(beta, theta):
    t, d = np.radians(theta), 10 * u.kpc
    cos = beta * np.cos(t)
    rate = (beta * np.sin(t) / d.to_value(u.m) * 299792458) * u.rad / u.s
    motions = rate / (1 - cos), rate / (1 + cos)
    found = two_sided_jet(*motions, d, n_trials=2)
    assert found["beta"][0] == pytest.approx(beta, rel=1e-9)
    assert found["angle"][0].to_value(u.deg) == pytest.approx(theta, rel=1e-9)
    assert found["beta_cos"][0] == pytest.approx(cos, rel=1e-9)
    at = two_sided_jet(*motions, found["beta_max_distance"], n_trials=2)
    assert at["beta"][0] == pytest.approx(1)


def test_errors_of_a_two_sided_jet_are_those_of_small_changes():
    motions, errors, distance = np.array([17.6, 9.0]), [0.04, 0.03], 12.5 * u.kpc

    def measure(a, r, **options):
        found = two_sided_jet(a * DAY, r * DAY, distance, **options)
        names = ("beta_cos", "angle", "beta")
        return np.array([[u.Quantity(v).value for v in found[n]] for n in names])

    changes = [
        0.5 * (measure(*(motions + step)) - measure(*(motions - step)))[:, 0]
        for step in np.diag(errors)
    ]
    found = measure(*motions, errors=errors * DAY, rng=1)
    np.testing.assert_allclose(found[:, 1], np.hypot(*changes), rtol=0.03)


@pytest.mark.parametrize("speed", [-1.0, np.nan])
def test_speeds_and_motions_that_are_refused(speed):
    with pytest.raises(ValueError, match="finite and not negative"):
        intrinsic_table([speed], [0.1])
    with pytest.raises(ValueError, match="receding motion must be positive"):
        two_sided_jet(17.6 * DAY, 18 * speed * DAY, 1 * u.kpc)
