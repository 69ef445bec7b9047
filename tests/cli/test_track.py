# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc track`` and ``profile``, and all commands on a fast object."""

import re
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time

from astro_scc import Beam, EpochCube
from astro_scc.cli.measure import TRACKED
from astro_scc.columns import cell
from astro_scc.simulation import simulate_jet, write_simulation

SHOWN = {name for name in TRACKED if not name.endswith(("png", "pdf"))}


def tables_of(folder):
    return [QTable.read(folder / f"{name}.ecsv") for name in ("features", "positions")]


def test_tables_and_what_is_said(done, jet, here):
    how = ["--redshift", "0.1", "--seed", "1", "--no-figures"]
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
    assert features.meta["configuration"]["seed"] == 1


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


def test_why_it_is_a_feature(done, refused, jet, here):
    done("track", *jet, "-o", "out", "--seed", "1", "--no-figures")
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
    published = QTable(
        {
            "epoch": positions["date"].isot, "feature": positions["feature"],
            "east": positions["ra_offset"], "north": positions["dec_offset"],
            "flux": np.ones(len(positions)) * u.Jy,
        }
    )  # fmt: skip
    published.write("p.ecsv", format="ascii.ecsv")
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
    words = ["--position-angle", "270 deg", "--bins", "0 20 30 mas", "--n-trials", "25"]
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
