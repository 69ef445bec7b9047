# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Fits of profiles against numpy and against what was put in."""

import astropy.units as u
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from astro_scc.flow import fit_profile

R = np.linspace(0.5, 10, 12) * u.mas
PM = u.mas / u.yr


def test_straight_line_is_that_of_numpy():
    rng = np.random.default_rng(1)
    v, e = rng.normal(2, 0.3, 12), rng.uniform(0.1, 0.4, 12)
    fit = fit_profile(R, v * PM, e * PM)
    slope, offset = np.polyfit(R.value, v, 1, w=1 / e)
    assert fit.parameters["gradient"].value == pytest.approx(slope)
    np.testing.assert_allclose(fit(R).value, slope * R.value + offset)
    _, covariance = np.polyfit(R.value, v, 1, w=1 / e, cov="unscaled")
    assert fit.errors["gradient"].value == pytest.approx(np.sqrt(covariance[0, 0]))


@settings(max_examples=25)
@given(v0=st.floats(0.5, 5), k=st.floats(-0.8, 0.8))
@example(v0=2.5, k=1e-6)
def test_power_law_of_a_power_law(v0, k):
    v = v0 * R.value**k
    fit = fit_profile(R, v, 0.05 * v, model="power-law")
    assert fit.parameters["index"].value == pytest.approx(k, abs=1e-6)
    np.testing.assert_allclose(fit(R).value, v, rtol=1e-6)
    assert fit.chi2 < 1e-6
    # With equal relative errors it is a straight line of logarithms.
    x = np.log(R.value)
    _, covariance = np.polyfit(x, k * x, 1, w=np.full(12, 20.0), cov="unscaled")
    error = fit.errors["index"].value
    assert error == pytest.approx(np.sqrt(covariance[0, 0]), rel=1e-3)


def test_broken_line_finds_the_break():
    v = 2 + 0.3 * np.minimum(R.value - 6, 0) - 0.2 * np.maximum(R.value - 6, 0)
    fit = fit_profile(R, v, np.full(12, 0.02), model="broken")
    assert fit.parameters["r_break"].value == pytest.approx(6, abs=0.1)
    assert fit.parameters["outer_gradient"].value == pytest.approx(-0.2, abs=0.02)
    straight = fit_profile(R, v, np.full(12, 0.02))
    assert fit.aicc < straight.aicc
    assert fit.p_constant < 1e-10
    assert 0 < fit.errors["r_break"].value < 0.5


def test_constant_has_uniform_probabilities():
    rng = np.random.default_rng(4)
    p = [
        fit_profile(R, rng.normal(2, 0.1, 12), np.full(12, 0.1)).p_constant
        for _ in range(300)
    ]
    assert np.mean(np.array(p) < 0.05) < 0.09
    assert fit_profile(R, np.ones(12), np.ones(12), model="constant").p_constant == 1


@pytest.mark.parametrize(
    ("r", "v", "model", "words"),
    [
        (R, np.ones(12), "cubic", "unknown model 'cubic'"),
        (R[:2], np.ones(2), "broken", "at 4 distances or more, got 2"),
        (R, -np.ones(12), "power-law", "above 0"),
    ],
)
def test_fits_that_cannot_be(r, v, model, words):
    with pytest.raises(ValueError, match=words):
        fit_profile(r, v, np.ones(len(v)), model=model)
