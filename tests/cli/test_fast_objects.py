# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A microquasar: twelve daily images of a jet at 17 mas per day."""

import re

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time

from astro_scc import Beam
from astro_scc.cli import main
from astro_scc.epochs import write_epochs
from astro_scc.simulation import simulate_jet

SPEED = 17 * u.mas / u.d
FIRST = Time("2020-03-01T06:00:00")


@pytest.fixture(scope="module")
def microquasar(tmp_path_factory):
    beam = Beam(34 * u.mas, 26 * u.mas, 20 * u.deg)
    width = np.sqrt(beam.major * beam.minor)
    jet = simulate_jet(
        dates=FIRST + np.arange(12) * u.d, beam=beam, pixel_scale=3 * u.mas,
        speed=(SPEED * u.d / width).to_value(u.one), dispersion=0.05,
        position_angle=130 * u.deg, interval=1 * u.d, rng=5,
    )  # fmt: skip
    folder = tmp_path_factory.mktemp("mq")
    write_epochs(jet.cube, folder)
    return sorted(map(str, folder.glob("*.fits")))


@pytest.mark.slow
@pytest.mark.parametrize("command", ["inspect", "track", "measure"])
def test_speeds_are_per_day_everywhere(microquasar, command, tmp_path, capsys):
    out = tmp_path / "out"
    options = ["-o", str(out), "--seed", "1", "--distance", "9 kpc"]
    options = [] if command == "inspect" else options
    assert main([command, *microquasar, *options]) == 0
    text = capsys.readouterr().out
    units = set(re.findall(r"\b\w+ ?/ ?(?:yr|d|h)\b(?:\^2)?", text))
    assert {unit.replace(" ", "") for unit in units} <= {"mas/d", "mas/d^2"}
    # Neither decimal years, nor numbers with an exponent.
    assert not re.search(r"\b2020\.\d|\de-\d", text)
    if command == "inspect":
        return
    table = QTable.read(out / "features.ecsv")
    assert np.all(table["secure"])
    assert table["pm"].unit == u.mas / u.d
    assert table["acc_parallel"].unit == u.mas / u.d**2
    off = np.abs(table["pm"] - SPEED) / np.hypot(table["pm_err"], 0.05 * SPEED)
    assert np.median(off) < 1.5
    # The Modified Julian Date of the ejection.
    assert table["t_ej"].unit == u.d
    at = table["date"].mjd * u.d - table["separation"] / table["pm_radial"]
    np.testing.assert_allclose((table["t_ej"] - at).value, 0, atol=0.3)
    if command == "measure":
        for name in ("components", "sensitivity"):
            assert QTable.read(out / f"{name}.ecsv")["pm"].unit == u.mas / u.d
        page = (out / "report.html").read_text(encoding="utf-8")
        assert not re.search(
            r"arcsec/yr|mas/yr(?! along)", re.sub(r"data:\S+", "", page)
        )
