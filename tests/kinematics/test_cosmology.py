# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest
from astropy import constants
from astropy.cosmology import FlatLambdaCDM, LambdaCDM
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.kinematics import (
    apparent_speed,
    beta_intrinsic,
    doppler_factor,
    lorentz_factor,
    maximum_viewing_angle,
    minimum_lorentz_factor,
    paper_cosmology,
    viewing_angle,
)

MU = 1 * u.mas / u.yr


@pytest.mark.parametrize(
    ("redshift", "speed"),
    [(0.158, 10.20), (0.033, 2.188)],
    ids=["3C 273", "3C 120"],
)
def test_numbers_of_the_paper(redshift, speed):
    beta = apparent_speed(MU, redshift=redshift, cosmology=paper_cosmology())
    assert beta.unit == u.dimensionless_unscaled
    assert beta.value == pytest.approx(speed, rel=5e-4)


def test_m87_by_its_distance():
    beta = apparent_speed(MU, distance=16.7 * u.Mpc)
    assert beta.value == pytest.approx(0.264, abs=5e-4)


def test_equals_angular_diameter_distance_times_one_plus_z():
    cosmology = LambdaCDM(H0=65, Om0=0.3, Ode0=0.5)
    beta = apparent_speed(3 * MU, redshift=1.3, cosmology=cosmology)
    metres = cosmology.angular_diameter_distance(1.3).to_value(u.m)
    motion = 3 * u.mas.to(u.rad) / u.yr.to(u.s)
    expected = motion * metres * 2.3 / constants.c.to_value(u.m / u.s)
    assert beta.value == pytest.approx(expected)


def test_arrays_and_other_units():
    motions = [[1, 2], [3, 4]] * u.uas / u.day
    beta = apparent_speed(motions, distance=[10, 20] * u.kpc)
    assert beta.shape == (2, 2)
    expected = (motions.to_value(u.rad / u.s) / u.s * ([10, 20] * u.kpc)).to(
        u.m / u.s
    ) / constants.c
    np.testing.assert_allclose(beta.value, expected.to_value(u.one))
    signed = apparent_speed(-MU, distance=1 * u.Mpc)
    assert signed < 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "either a redshift with a cosmology, or a distance"),
        ({"redshift": 0.1, "distance": 1 * u.Mpc}, "either a redshift"),
        ({"redshift": 0.1}, "a redshift needs a cosmology"),
        (
            {"redshift": -0.1, "cosmology": paper_cosmology()},
            "the redshift must be positive",
        ),
        (
            {"redshift": 0.0, "cosmology": paper_cosmology()},
            "the redshift must be positive",
        ),
        (
            {"redshift": np.nan, "cosmology": paper_cosmology()},
            "the redshift must be positive",
        ),
        ({"distance": 0 * u.Mpc}, "distance must be positive"),
        ({"distance": np.nan * u.Mpc}, "distance must be positive"),
        (
            {"distance": 1 * u.Mpc, "cosmology": paper_cosmology()},
            "a distance needs no cosmology",
        ),
    ],
)
def test_what_is_missing_or_too_much(options, message):
    with pytest.raises(ValueError, match=message):
        apparent_speed(MU, **options)


def test_wrong_units():
    with pytest.raises(u.UnitConversionError):
        apparent_speed(1 * u.km / u.s, distance=1 * u.Mpc)
    with pytest.raises(u.UnitConversionError):
        apparent_speed(MU, distance=1 * u.s)


def test_paper_cosmology():
    assert paper_cosmology() == FlatLambdaCDM(H0=71, Om0=0.27)


def test_numbers_at_15_degrees():
    gamma = lorentz_factor(beta_intrinsic([4, 6], 15 * u.deg))
    np.testing.assert_allclose(gamma.value, [4.13, 7.48], atol=5e-3)
    # The acceleration between 1 and 7 mas that the paper calls 0.3.
    k = np.log((gamma[1] / gamma[0]).value) / np.log(7)
    assert k == pytest.approx(0.305, abs=5e-4)


def test_largest_apparent_speed_of_a_lorentz_factor():
    beta = np.sqrt(1 - 1 / 6**2)
    angles = np.linspace(0.1, 90, 2000) * u.deg
    seen = beta * np.sin(angles) / (1 - beta * np.cos(angles))
    assert seen.max().value == pytest.approx(5.92, abs=5e-3)
    assert minimum_lorentz_factor(np.sqrt(35)).value == pytest.approx(6)


@given(beta=st.floats(0.01, 0.9999), angle=st.floats(0.1, 179))
def test_everything_comes_back(beta, angle):
    angle = angle * u.deg
    sin, cos = np.sin(angle).value, np.cos(angle).value
    seen = beta * sin / (1 - beta * cos)
    assert beta_intrinsic(seen, angle).value == pytest.approx(beta, rel=1e-9)
    gamma = lorentz_factor(beta)
    assert gamma.value == pytest.approx((1 - beta**2) ** -0.5)
    assert minimum_lorentz_factor(seen) <= gamma * (1 + 1e-9)
    assert angle <= maximum_viewing_angle(seen) + 1e-6 * u.deg
    delta = doppler_factor(beta, angle)
    assert delta.value == pytest.approx(1 / gamma.value / (1 - beta * cos))
    back = viewing_angle(seen, delta)
    assert back.to_value(u.deg) == pytest.approx(angle.value, rel=1e-5)


def test_impossible_speeds_are_nan():
    assert np.isnan(beta_intrinsic(10, 15 * u.deg))
    assert np.isnan(beta_intrinsic(-1, 15 * u.deg))
    assert np.isnan(lorentz_factor(1.0))
    assert np.isnan(doppler_factor(1.2, 10 * u.deg))


def test_no_motion():
    assert beta_intrinsic(0, 15 * u.deg) == 0
    assert maximum_viewing_angle(0) == 180 * u.deg
    assert lorentz_factor(0) == 1
