# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc measure``, ``demo``, ``explore``, ``track``, ``explain``, ``profile``."""

import re
import shutil
import sys
import tomllib
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable
from astropy.time import Time

from astro_scc import Beam, EpochCube, StackedCrossCorrelation
from astro_scc.cli.inputs import output_of
from astro_scc.cli.measure import TRACKED
from astro_scc.columns import cell
from astro_scc.report.page import PRODUCTS
from astro_scc.settings import Settings
from astro_scc.simulation import simulate_jet, write_simulation

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
        "max_speed": "30.0 mas / yr", "position_angle": "270.0 deg",
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


def test_the_folder_is_named_after_the_object(series):
    args, files = Namespace(output=None, command="track"), series([1], OBJECT="3C 1")
    assert output_of(args, Settings(epochs=[*map(str, files)])) == Path("3C_1-track")


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
    how = {"scales": [2], "max_speed": "30 mas/yr", "position_angle": "270 deg"}
    scc = StackedCrossCorrelation(**how, method="paper")
    own = scc(EpochCube.read(jet).align("none"), n_trials=99, rng=1)
    for name in own.streams.colnames:
        np.testing.assert_array_equal(table[name], own.streams[name], err_msg=name)


def test_what_cannot_be_measured(jet, refused, here):
    (here / "p.toml").write_text("method = 'paper'\nbins = '1 2 mas'\n")
    line = refused("profile", *jet, "--config", here / "p.toml", "-o", "out")
    assert "method is 'paper', which astro-scc measure has: leave it out" in line
    (here / "old").mkdir()
    (here / "old" / "streams.ecsv").touch()
    (here / "old" / "config.toml").write_text("epochs = ['gone.fits']\n")
    line = refused("profile", *jet, "--bins", "1 2 mas", "-o", "old", "--overwrite")
    assert "old: holds streams.ecsv of other images; choose" in line
    (here / "c.toml").write_text("cosmology = 'Planck18'\n")
    line = refused("measure", *jet, "--config", "c.toml", "-o", "out")
    assert line.endswith("error: c.toml: cosmology needs a redshift")
    line = refused("profile", "--bins", "1 2 mas", *jet[:5], *QUICK, "-o", "out")
    assert "too few epochs: 5 images, 6 are needed" in line


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


SHOWN = {name for name in TRACKED if not name.endswith(("png", "pdf"))}


def tables_of(folder):
    return [QTable.read(folder / f"{name}.ecsv") for name in ("features", "positions")]


def test_features_alone_and_what_is_said(done, jet, here):
    how = ["--redshift", "0.1", "--no-figures"]
    out, err = done("track", *jet, "-o", "out", *how)
    assert err == ""
    assert {path.name for path in (here / "out").iterdir()} == SHOWN
    features, positions = tables_of(here / "out")
    secure = features[features["secure"]]
    assert f"{len(secure)} of them secure" in out
    row = secure[0]
    line = next(x for x in out.splitlines() if x.startswith(f"{row['feature']} "))
    assert row["first"].isot[:10] in line
    assert cell(row, "beta_app", "+-") in line
    assert len(positions) == np.sum(features["n_epochs"])
    assert "speeds in c: redshift 0.1, FlatLambdaCDM with H0 = 71 km/s/Mpc, Om0" in out
    alone = StackedCrossCorrelation().decompose(EpochCube.read(jet)).features
    assert alone.table["feature", "secure"].as_array().tolist() == [
        (row["feature"], row["secure"]) for row in features
    ]


def test_no_features_are_empty_tables(done, jet, here, no_figures):
    (here / "r.reg").write_text("image\ncircle(3,3,2)\n")
    how = ["-o", "out", "--distance", "10 Mpc", "--region", "r.reg"]
    out, err = done("track", *jet[:3], *how)
    assert "No detections of four epochs or more are in steady motion." in out
    said = "warning: no emission beside the core was detected in any epoch in r.reg"
    assert said in err
    features, positions = tables_of(here / "out")
    assert (len(features), len(positions)) == (0, 0)
    assert {"pm", "t_ej", "beta_app"} <= set(features.colnames)


def test_images_without_beams_have_features_of_ssps(done, jet, here):
    replace(EpochCube.read(jet), beams=None).write("cube.fits")
    done("track", "cube.fits", "-o", "out", "--no-figures", "--scales", "2")
    features, _ = tables_of(here / "out")
    assert features["secure"].any()
    assert np.all(features["size"].value == 0)


def test_features_by_chance(done):
    done("simulate", "unrelated", "chance", "--seed", "1", "--epochs", "7")
    how = "chance/*.fits", "--seed", "1"
    assert "for this alone" in done("measure", *how, "-o", "out", "--no-report")[0]
    assert "little in common" in done("explain", "out", "--feature", 212)[0]
    assert "by chance" in done("track", *how, "-o", "tracked", "--no-figures")[0]


def test_why_it_is_a_feature(done, refused, jet, here):
    done("track", *jet[:4], "-o", "out", "--no-figures")
    features, positions = tables_of(here / "out")
    row = features[features["secure"]][0]
    out, _ = done("explain", "out", "--feature", row["feature"])
    assert f"Feature {row['feature']} links {row['n_epochs']} epochs" in out
    place = positions[positions["feature"] == row["feature"]][0]
    offset = f"{place['ra_offset'].value} {place['dec_offset'].value} mas"
    again, _ = done("explain", "out", "--at", offset, "--date", place["date"].isot)
    assert again.splitlines()[-1] == out.splitlines()[-1]
    assert f"the date is {place['date'].isot[:10]}, 0 min from it.\n" in again
    again, _ = done("explain", "out", "--at", offset, "--date", "2030-01-01")
    assert " yr from it, more than half the median interval.\n" in again
    # A table of published features.
    published = {
        "epoch": positions["date"].isot, "feature": positions["feature"],
        "east": positions["ra_offset"], "north": positions["dec_offset"],
        "flux": np.ones(len(positions)) * u.Jy,
    }  # fmt: skip
    QTable(published).write("p.ecsv", format="ascii.ecsv")
    name = "--compare", "p.ecsv", "--published"
    again, _ = done("explain", "out", *name, row["feature"])
    assert again.splitlines()[-1] == out.splitlines()[-1]
    for argv, words in (
        ((*name, 9), "p.ecsv: has no feature 9; it has 1"),
        ((), "give one of --feature, --published, and --at with --date"),
        (("--at", "1 2 mas"), "--at and --date are given together"),
        (("--at", "2 mas", "--date", "2001-01-01"), "must be an offset to the east"),
        (("--published", 1), "--published needs --compare"),
    ):
        assert words in refused("explain", "out", *argv)
    assert "name a folder that" in refused("explain", "none", "--feature", 1)
    alone = features[features["feature"] == row["feature"]]
    assert len(alone) < len(features)
    alone.write(here / "out" / "features.ecsv", overwrite=True)
    _, err = done("explain", "out", "--feature", row["feature"])
    assert "its features are not those of the images now; measure again" in err


@pytest.mark.slow
def test_the_whole_stretch(jet, done, here, no_figures):
    """Its acceleration, and the speeds of its scales."""
    words = ["--position-angle", "270 deg", "--bins", "0 20 30 mas", "--seed", "1"]
    words += ["--scale-groups", "1; 2", "--max-speed", "20mas/yr"]
    out, _ = done("profile", *jet, "-o", "out", *words)
    assert "20 to 30 mas: nothing is seen" in out
    assert " on scale 1, " in out
    table = QTable.read(here / "out" / "profile.ecsv")
    found = table.meta["acceleration"]["1"]
    assert found["acceleration"].unit == u.mas / u.yr**2
    rows = QTable.read(here / "out" / "scales.ecsv")
    assert set(rows["first"]) | set(rows["second"]) == {"1", "2"}


SPEED = 17 * u.mas / u.d


@pytest.mark.slow
@pytest.mark.parametrize("command", ["track", "measure"])
def test_speeds_are_per_day_everywhere(command, done, here):
    beam = Beam(34 * u.mas, 26 * u.mas, 20 * u.deg)
    width = np.sqrt(beam.major * beam.minor)
    jet = simulate_jet(
        dates=Time("2020-03-01T06:00:00") + np.arange(12) * u.d, beam=beam,
        speed=(SPEED * u.d / width).to_value(u.one), dispersion=0.05, rng=5,
        pixel_scale=3 * u.mas, position_angle=130 * u.deg, interval=1 * u.d,
    )  # fmt: skip
    paths = write_simulation(jet, here / "mq")[:-1]
    how = ["-o", "out", "--seed", "1", "--distance", "9 kpc"]
    text, _ = done(command, *paths, *how)
    units = set(re.findall(r"\b\w+ ?/ ?(?:yr|d|h)\b(?:\^2)?", text))
    assert {unit.replace(" ", "") for unit in units} <= {"mas/d", "mas/d^2"}
    # Neither decimal years, nor numbers with an exponent.
    assert not re.search(r"\b2020\.\d|\de-\d", text)
    table = QTable.read(here / "out" / "features.ecsv")
    assert np.all(table["secure"])
    assert table["acc_parallel"].unit == u.mas / u.d**2
    off = np.abs(table["pm"] - SPEED) / np.hypot(table["pm_err"], 0.05 * SPEED)
    assert np.median(off) < 1.5
    if command == "measure":
        page = (here / "out" / "report.html").read_text(encoding="utf-8")
        page = re.sub(r"data:\S+", "", page)
        assert not re.search(r"arcsec/yr|mas/yr(?! along)", page)
