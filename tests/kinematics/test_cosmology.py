# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Apparent speeds, and the flows behind them."""

import astropy.units as u
import numpy as np
import pytest
from astropy.cosmology import LambdaCDM, Planck18, default_cosmology
from astropy.cosmology import units as cu
from astropy.table import Column, MaskedColumn, QTable
from astropy.tests.helper import assert_quantity_allclose
from astropy.utils.masked import Masked
from hypothesis import given, settings
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
from astro_scc.kinematics.cosmology import cosmology_text, table_in_c, to_cosmology

MU, MPC = 1 * u.mas / u.yr, u.Mpc


def test_numbers_of_the_paper_in_all_forms():
    for redshift, speed in ((0.158, 10.20), (0.033, 2.188)):  # 3C 273, 3C 120
        beta = apparent_speed(MU, redshift=redshift, cosmology=paper_cosmology())
        assert beta.value == pytest.approx(speed, rel=5e-4)
    # As people give them, whatever the default of astropy is.
    for own in ("0.158", "15.8 %", 0.158 * cu.redshift, Column([0.158])[0]):
        with default_cosmology.set(Planck18):
            beta = apparent_speed(MU, redshift=own)
        assert beta.value == pytest.approx(10.20, rel=5e-4)
    for cosmology in (Planck18, "Planck18", "H0=67.66, Om0=0.30966"):
        beta = apparent_speed(MU, redshift=0.158, cosmology=cosmology)
        assert beta.value == pytest.approx(10.65, abs=0.01)
    assert to_cosmology("H0=70,Om0=0.3,Ode0=0.6") == LambdaCDM(70, 0.3, 0.6)
    text = apparent_speed("1 mas/yr", distance="16.7 Mpc")
    assert apparent_speed(MU, distance=16.7 * MPC) == text
    motion = Masked([1, 2] * MU, mask=[True, False])
    column = MaskedColumn([1.0, 2.0], mask=[True, False], unit="mas/yr")
    for speed in (apparent_speed(m, redshift=0.158) for m in (motion, column)):
        assert speed.mask.tolist() == [True, False]
        assert speed.unmasked[1].value == pytest.approx(20.40, rel=5e-4)


def test_what_is_missing_or_too_much():
    for options, message in [
        ({}, "either a redshift, of which the cosmology may be given, or a distance"),
        ({"redshift": -0.1}, "redshift = -0.1 must be above 0; give the distance"),
        ({"redshift": 47367}, "redshift = 47367 must be below 30; of a velocity"),
        ({"redshift": MaskedColumn([0.1], mask=[True])}, "must be a redshift"),
        ({"redshift": 1 * u.yr}, "redshift = 1.0 yr must be a redshift"),
        ({"redshift": "high"}, "redshift = 'high' must be a redshift, a number such"),
        ({"redshift": 47367 * u.km / u.s},
         "redshift = 47367.0 km / s is a velocity, which may be defined in three "
         "ways; give the redshift, 0.158 if it is c z"),
        ({"redshift": 600 * MPC}, "redshift = 600.0 Mpc is a length; give it as the"),
        ({"redshift": 0.1, "cosmology": 0.27}, "cosmology = 0.27 is no cosmology;"),
        *(({"redshift": 0.1, "cosmology": text}, "is no cosmology; give H0=71,.*Pla")
          for text in ("Planck", "H0=71", "H0=71,Om0", "H0=0,Om0=1", "H0=1e999,Om0=1")),
        ({"distance": 0 * MPC}, "distance = 0.0 Mpc must be finite and above 0"),
        ({"distance": 1 * MPC, "cosmology": "Planck18"}, "needs no cosmology"),
        ({"proper_motion": 1 * u.km / u.s, "distance": 1 * MPC},
         "proper_motion = 1.0 km / s must"),
    ]:  # fmt: skip
        with pytest.raises(ValueError, match=message):
            apparent_speed(**{"proper_motion": MU, **options})


@pytest.mark.parametrize("cosmology", [Planck18, "H0=65,Om0=0.3,Ode0=0.5"])
def test_tables_say_what_they_were_made_with(cosmology, tmp_path):
    table = QTable({"pm": [1, 2] * MU, "pm_err": [0.1, np.inf] * MU}, meta={"seed": 1})
    found = table_in_c(table, redshift="15.8 %", cosmology=cosmology)
    expected = apparent_speed(table["pm"], redshift=0.158, cosmology=cosmology)
    assert np.all(found["beta_app"] == expected)
    assert found["beta_app_err"][1] == np.inf
    assert (found.meta["redshift"], found.meta["seed"]) == (0.158, 1)
    found.write(tmp_path / "a.ecsv")
    read = QTable.read(tmp_path / "a.ecsv")
    assert np.all(read["beta_app"] == expected)
    own = read.meta["cosmology"]
    again = table_in_c(table, redshift=read.meta["redshift"], cosmology=own)
    assert np.all(again["beta_app"] == expected)
    assert cosmology_text(own) == cosmology_text(cosmology)
    near = table_in_c(table, distance=400 * u.pc)
    # 4.74 km/s for an arcsecond a year at a parsec.
    kms = u.km / u.s
    assert_quantity_allclose(near["v_app"], [1.8962, 3.7924] * kms, rtol=1e-4)
    assert_quantity_allclose(near["v_app_err"][0], 0.18962 * kms, rtol=1e-4)
    assert "v_app" not in table_in_c(table, distance=2 * u.Mpc).colnames
    table["kind"] = "moving"
    with pytest.warns(UserWarning, match="c, and no jet is known to exceed 50 c"):
        table_in_c(table, distance=20 * u.Gpc)
    # astropy reads 16 x 7 Mpc.
    with pytest.raises(ValueError, match="distance must be one value, that of the sou"):
        table_in_c(table, distance="16 7 Mpc")


def test_speeds_that_are_none():
    assert lorentz_factor(60 * u.percent).value == pytest.approx(1.25)
    assert np.isnan(beta_intrinsic(0, 0 * u.deg))
    assert np.isnan(beta_intrinsic([-0.1, -0.5, -3.0], 15 * u.deg)).all()
    assert np.isnan(lorentz_factor([1.0, -1.0, 2.0])).all()


@settings(max_examples=25)
@given(beta=st.floats(0.01, 0.9999), angle=st.floats(0.1, 179))
def test_everything_comes_back(beta, angle):
    cos, angle = np.cos(np.radians(angle)), angle * u.deg
    seen = beta * np.sin(angle).value / (1 - beta * cos)
    assert beta_intrinsic(seen, angle).value == pytest.approx(beta, rel=1e-9)
    gamma = lorentz_factor(beta)
    assert gamma.value == pytest.approx((1 - beta**2) ** -0.5)
    assert minimum_lorentz_factor(seen) <= gamma * (1 + 1e-9)
    assert angle <= maximum_viewing_angle(seen) + 1e-6 * u.deg
    delta = doppler_factor(beta, angle)
    assert delta.value == pytest.approx(1 / gamma.value / (1 - beta * cos))
    back = viewing_angle(-seen, delta)
    assert back.to_value(u.deg) == pytest.approx(angle.value, rel=1e-5)


def test_speeds_with_another_unit_are_refused():
    for function in (lorentz_factor, minimum_lorentz_factor, maximum_viewing_angle):
        with pytest.raises(ValueError, match="got km / s: divide them by astropy.con"):
            function(100 * u.km / u.s)
