# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc measure``, ``demo`` and ``explore``: what they write and say."""

import re
import shutil
import sys
import tomllib

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.report.page import PRODUCTS

QUICK = ["--scales", "2", "--max-speed", "30 mas/yr", "--n-trials", "99"]
TABLES = [name for name in PRODUCTS if name != "publication"]


def same(one, other):
    return all((one / k).read_bytes() == (other / k).read_bytes() for k in TABLES)


def test_tables_maps_and_settings(measured, jet):
    # Nothing is left of an old measurement.
    assert {path.name for path in measured.iterdir()} == {*TABLES, "notes.txt"}
    table = QTable.read(measured / "streams.ecsv")
    config = tomllib.loads((measured / "config.toml").read_text(encoding="utf-8"))
    assert config.pop("versions") == table.meta["versions"]
    assert config == table.meta["configuration"]
    wanted = {
        "epochs": [str(path) for path in jet], "align": "none", "common_beam": False,
        "max_speed": "30.0 mas / yr", "position_angle": "-90.0 deg",
        "seed": table.meta["seed"], "redshift": 0.158, "cosmology": "H0=71,Om0=0.27",
    }  # fmt: skip
    assert wanted.items() <= config.items()
    header = fits.getheader(measured / "scc.fits")
    assert f"seed = {config['seed']}" in list(header["COMMENT"])


@pytest.mark.slow
def test_the_same_from_python_and_from_the_configuration(measured, jet, done, here):
    seed = QTable.read(measured / "streams.ecsv").meta["seed"]
    how = {"scales": [2], "max_speed": 30 * u.mas / u.yr}
    scc = StackedCrossCorrelation(position_angle=-90 * u.deg, **how)
    cube = EpochCube.read(jet).align("none")
    expected = scc(cube, n_trials=99, rng=seed).streams
    table = QTable.read(measured / "streams.ecsv")
    for name in expected.colnames:
        np.testing.assert_array_equal(table[name], expected[name], err_msg=name)
    again = ["measure", "--config", measured / "config.toml", "--no-report"]
    out, err = done(*again, "-o", "out", "--workers", "2", "--ds9-regions")
    assert err == ""
    assert "Tables and maps: out" in out
    assert same(here / "out", measured)
    # The command line comes before the file.
    other = ["--distance", "16.7 Mpc", "--n-trials", "130", "--seed", "5"]
    other += ["--common-beam", "--before", "2001-05-15"]
    assert done(*again, "-o", "new", *other)[1] == ""
    meta = QTable.read(here / "new" / "streams.ecsv").meta
    wanted = {"n_trials": 130, "seed": 5, "common_beam": True}
    assert wanted.items() <= meta["configuration"].items()
    assert not {"redshift", "cosmology"} & set(meta["configuration"])
    assert meta["distance"] == 16.7 * u.Mpc
    assert set(QTable.read(here / "new" / "ssps.ecsv")["epoch"]) == {*range(6)}


def test_other_versions_are_noted(measured, astro_scc, here):
    text = (measured / "config.toml").read_text()
    (here / "old.toml").write_text(re.sub('numpy = ".*"', 'numpy = "1.0"', text))
    _, _, err = astro_scc("measure", "--config", "old.toml", "-o", "x", "--n-trials", 1)
    note, error = err.splitlines()
    assert note.startswith("note: old.toml was written with numpy 1.0 (here ")
    assert "--n-trials" in error


def test_the_method_of_the_paper(measured, jet, done, here, no_figures):
    words = ["measure", *jet, *QUICK, "--method", "paper", "--position-angle", "270deg"]
    out, _ = done(*words, "-o", "out", "--seed", 1, "--redshift", 0.1)
    assert out.startswith("Paper's method: ")
    table = QTable.read(here / "out" / "streams.ecsv")
    scc = StackedCrossCorrelation(
        scales=[2], max_speed=30 * u.mas / u.yr, position_angle=270 * u.deg,
        method="paper",
    )  # fmt: skip
    own = scc(EpochCube.read(jet).align("none"), n_trials=99, rng=1)
    for name in own.streams.colnames:
        np.testing.assert_array_equal(table[name], own.streams[name], err_msg=name)


def test_what_cannot_be_measured(jet, series, refused, here):
    (here / "p.toml").write_text("method = 'paper'\nbins = '1 2 mas'\n")
    line = refused("profile", *jet, "--config", here / "p.toml", "-o", "out")
    assert "method is 'paper', which astro-scc measure has: leave it out" in line
    (here / "c.toml").write_text("cosmology = 'Planck18'\n")
    line = refused("measure", *jet, "--config", "c.toml", "-o", "out")
    assert line.endswith("error: c.toml: cosmology needs a redshift")
    for words in (["measure"], ["profile", "--bins", "1 2 mas"]):
        line = refused(*words, *jet[:5], *QUICK, "-o", "out")
        assert "too few epochs: 5 images, 6 are needed" in line
    words = ["measure", *series([None] * 6), "-o", "out"]
    assert "the epochs have no beams" in refused(*words, "--common-beam")
    assert "epochs have none" in refused(*words, "--align", "core")


def test_demo_of_a_small_jet(done, here, monkeypatch, no_figures, make_jet):
    monkeypatch.setattr("astro_scc.cli.measure.N_TRIALS", 20)
    monkeypatch.setattr("astro_scc.cli.measure.LAST", 110)
    monkeypatch.setattr(
        "astro_scc.simulation.simulate_two_fluid", lambda rng: make_jet(6)
    )
    out, err = done("demo")
    assert out.startswith("Simulated:\nstream")
    assert "Report: astro_scc_demo/report.html" in out
    table = QTable.read(here / "astro_scc_demo" / "streams.ecsv")
    assert table.meta["configuration"]["region"] == "astro_scc_demo/region.reg"
    # What is warned of is in the report, too.
    (line,) = err.splitlines()
    assert line.startswith("warning: 20 trials allow no p_global below 0.04")
    page = (here / "astro_scc_demo" / "report.html").read_text()
    assert line.removeprefix("warning: ") in page


def test_measurements_that_no_page_can_show(measured, here, refused, monkeypatch):
    pytest.importorskip("bokeh", reason="bokeh is in the extra explore")
    out = shutil.copytree(measured, here / "out")
    (out / "scc.fits").write_text("nothing")
    assert "scc.fits: is no FITS file; measure again" in refused("explore", "out")
    (out / "scc.fits").unlink()
    assert "scc.fits: does not exist; measure again" in refused("explore", "out")
    (out / "features.ecsv").write_text("nothing\n")
    assert "out/features.ecsv: is no ECSV table: " in refused("explore", "out")
    monkeypatch.setitem(sys.modules, "bokeh.models", None)
    monkeypatch.delitem(sys.modules, "astro_scc.visualization.explore", raising=False)
    assert "pip install bokeh" in refused("explore", "out")
