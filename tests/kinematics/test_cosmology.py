# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest
from astropy import constants
from astropy.cosmology import FlatLambdaCDM, LambdaCDM, Planck18, default_cosmology
from astropy.cosmology import units as cu
from astropy.table import Column, MaskedColumn, QTable
from astropy.utils.masked import Masked
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.kinematics import (
    apparent_speed,
    beta_intrinsic,
    doppler_factor,
    lorentz_factor,
    paper_cosmology,
    viewing_angle,
)
from astro_scc.kinematics.cosmology import (
    cosmology_text,
    maximum_viewing_angle,
    minimum_lorentz_factor,
    table_in_c,
    to_cosmology,
)

MU = 1 * u.mas / u.yr


@pytest.mark.parametrize(
    ("redshift", "speed"), [(0.158, 10.20), (0.033, 2.188)], ids=["3C 273", "3C 120"]
)
def test_numbers_of_the_paper(redshift, speed):
    beta = apparent_speed(MU, redshift=redshift, cosmology=paper_cosmology())
    assert beta.unit == u.dimensionless_unscaled
    assert beta.value == pytest.approx(speed, rel=5e-4)


def test_equals_angular_diameter_distance_times_one_plus_z():
    cosmology = LambdaCDM(H0=65, Om0=0.3, Ode0=0.5)
    beta = apparent_speed(3 * MU, redshift=1.3, cosmology=cosmology)
    metres = cosmology.angular_diameter_distance(1.3).to_value(u.m)
    motion = 3 * u.mas.to(u.rad) / u.yr.to(u.s)
    expected = motion * metres * 2.3 / constants.c.to_value(u.m / u.s)
    assert beta.value == pytest.approx(expected)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "either a redshift, of which the cosmology may be given, or a distance"),
        ({"redshift": 0.1, "distance": 1 * u.Mpc}, "either a redshift"),
        ({"cosmology": "Planck18"}, "either a redshift"),
        ({"redshift": -0.1}, "redshift = -0.1 must be above 0; give the distance"),
        ({"redshift": np.nan}, "redshift = nan must be above 0"),
        ({"redshift": 47367}, "redshift = 47367 must be below 1090; of a velocity"),
        ({"redshift": "high"}, "redshift = 'high' must be a redshift, a number such"),
        ({"redshift": "0.1 0.2"}, "must be a redshift, a number such as 0.158"),
        ({"redshift": MaskedColumn([0.1], mask=[True])}, "must be a redshift"),
        ({"redshift": 1 * u.yr}, "redshift = 1.0 yr must be a redshift"),
        (
            {"redshift": 47367 * u.km / u.s},
            "redshift = 47367.0 km / s is a velocity, which may be defined in three "
            "ways; give the redshift, 0.158 if it is c z",
        ),
        ({"redshift": 600 * u.Mpc}, "redshift = 600.0 Mpc is a length; give it as the"),
        ({"redshift": 0.1, "cosmology": "Planck"}, "cosmology = 'Planck' is no"),
        ({"redshift": 0.1, "cosmology": 0.27}, "cosmology = 0.27 is no cosmology;"),
        ({"redshift": 0.1, "cosmology": {"H0": 71}}, "is no cosmology; give H0=71"),
        ({"distance": 0 * u.Mpc}, "distance = 0.0 Mpc must be finite and above 0"),
        ({"distance": np.nan * u.Mpc}, "distance = nan Mpc must be finite and above"),
        ({"distance": 16.7}, "distance = 16.7 must be a length with a unit, as"),
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
    with pytest.raises(u.UnitConversionError, match="proper_motion = 1.0 km / s must"):
        apparent_speed(1 * u.km / u.s, distance=1 * u.Mpc)
    with pytest.raises(
        u.UnitConversionError, match="distance = 1.0 s must be a length"
    ):
        apparent_speed(MU, distance=1 * u.s)
    for speed in (lorentz_factor, minimum_lorentz_factor, maximum_viewing_angle):
        with pytest.raises(u.UnitConversionError, match="divide them by astropy.const"):
            speed(100 * u.km / u.s)
    assert lorentz_factor(60 * u.percent).value == pytest.approx(1.25)


@pytest.mark.parametrize(
    "redshift",
    ["0.158", "15.8 %", 15.8 * u.percent, 0.158 * cu.redshift, 0.158 * u.one,
     np.float32(0.158), Column([0.158])[0]],
)  # fmt: skip
def test_redshifts_as_people_give_them(redshift):
    assert apparent_speed(MU, redshift=redshift).value == pytest.approx(10.20, rel=5e-4)


def test_distances_as_text():
    expected = apparent_speed(MU, distance=16.7 * u.Mpc)
    assert apparent_speed("1 mas/yr", distance="16.7 Mpc") == expected
    # astropy reads 16 x 7 Mpc.
    assert u.Quantity("16 7 Mpc").to_value(u.Mpc) == pytest.approx(112)
    table = QTable({"pm": [1] * MU, "pm_err": [1] * MU})
    with pytest.raises(ValueError, match="distance must be one value, that of the sou"):
        table_in_c(table, distance="16 7 Mpc")


def test_what_is_masked_stays_masked():
    for motion in (
        MaskedColumn([1.0, 2.0], mask=[True, False], unit="mas/yr"),
        Masked([1, 2] * MU, mask=[True, False]),
    ):
        speed = apparent_speed(motion, redshift=0.158)
        assert speed.mask.tolist() == [True, False]
        assert speed.unmasked[1].value == pytest.approx(20.40, rel=5e-4)


def test_one_cosmology_without_another():
    """Whatever the default of astropy is."""
    paper = FlatLambdaCDM(H0=71, Om0=0.27)
    expected = apparent_speed(MU, redshift=0.158, cosmology=paper)
    with default_cosmology.set(Planck18):
        assert apparent_speed(MU, redshift=0.158) == expected
        own = default_cosmology.get()
    planck = apparent_speed(MU, redshift=0.158, cosmology=own)
    assert planck.value == pytest.approx(10.65, abs=0.01)
    for name in ("Planck18", "H0=67.66, Om0=0.30966"):
        speed = apparent_speed(MU, redshift=0.158, cosmology=name)
        assert speed.value == pytest.approx(planck.value, rel=5e-4)


@pytest.mark.parametrize("cosmology", [None, Planck18, "H0=65,Om0=0.3,Ode0=0.5"])
def test_tables_say_what_they_were_made_with(cosmology, tmp_path):
    table = QTable({"pm": [1, 2] * MU, "pm_err": [0.1, np.inf] * MU}, meta={"seed": 1})
    found = table_in_c(table, redshift="15.8 %", cosmology=cosmology)
    expected = apparent_speed(table["pm"], redshift=0.158, cosmology=cosmology)
    assert np.all(found["beta_app"] == expected)
    assert found["beta_app_err"][1] == np.inf
    assert found["beta_app"].unit == found["beta_app_err"].unit == u.one
    assert "units of c" in found["beta_app"].info.description
    assert found.meta["redshift"] == 0.158
    assert found.meta["seed"] == 1
    assert table.colnames == ["pm", "pm_err"]
    for path in (tmp_path / "a.ecsv", tmp_path / "a.fits"):
        if path.suffix == ".fits":
            found.meta = {}
        found.write(path)
        read = QTable.read(path)
        assert isinstance(read["beta_app"], u.Quantity)
        assert np.all(read["beta_app"] == expected)
        if path.suffix == ".ecsv":
            own = read.meta["cosmology"]
            again = table_in_c(table, redshift=read.meta["redshift"], cosmology=own)
            assert np.all(again["beta_app"] == expected)
            assert cosmology_text(own) == cosmology_text(cosmology)


def test_numbers_at_15_degrees():
    gamma = lorentz_factor(beta_intrinsic([4, 6], 15 * u.deg))
    np.testing.assert_allclose(gamma.value, [4.13, 7.48], atol=5e-3)
    # The acceleration between 1 and 7 mas that the paper calls 0.3.
    k = np.log((gamma[1] / gamma[0]).value) / np.log(7)
    assert k == pytest.approx(0.305, abs=5e-4)


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


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Planck18", Planck18),
        ("H0=71,Om0=0.27", FlatLambdaCDM(H0=71, Om0=0.27)),
        (" H0 = 70 , Om0 = .3 ", FlatLambdaCDM(H0=70, Om0=0.3)),
        ("H0=70,Om0=0.3,Ode0=0.6", LambdaCDM(H0=70, Om0=0.3, Ode0=0.6)),
    ],
)
def test_cosmologies(text, expected):
    assert to_cosmology(text) == expected


@pytest.mark.parametrize(
    "text",
    [
        "Planck",
        "H0=71",
        "H0=71,Om0",
        "H0=71,Om0=0.3,w=1",
        "H0=0,Om0=0.3",
        "",
        "H0=1e999,Om0=0.3",
    ],
)
def test_cosmologies_that_are_none(text):
    with pytest.raises(ValueError, match=r"is no cosmology; give H0=71,Om0=0.27.*Pla"):
        to_cosmology(text)
