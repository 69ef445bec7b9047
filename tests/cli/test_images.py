# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc simulate``, ``restore`` and ``inspect``: images, and what they hold."""

import re

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable

from astro_scc import EpochCube
from astro_scc.cli import main
from astro_scc.epochs import Beam, read_components, write_epochs
from astro_scc.simulation import simulate_jet, simulate_two_fluid


def same(one, other):
    return all(p.read_bytes() == (other / p.name).read_bytes() for p in one.iterdir())


def test_simulate_and_its_seed(done, here):
    words = ["simulate", "two-fluid", "--epochs", 3, "--dense"]
    out, err = done(*words, "a")
    assert err == ""
    seed = int(re.search(r"\(seed (\d+)\)", out).group(1))
    truth = QTable.read(here / "a" / "truth.ecsv")
    assert truth.meta["seed"] == seed
    assert set(truth["group"]) == {"slow", "fast"}
    out, _ = done(*words, "b/c/", "--seed", seed)
    assert "b/c/*.fits -o b/c-measured" in out
    assert same(here / "a", here / "b" / "c")
    assert len(list((here / "a").glob("*.fits"))) == 3
    # One epoch cannot be measured.
    for jet in ("static", "random-velocity", "ballistic", "unrelated"):
        out, err = done("simulate", jet, jet, "--epochs", 1, "--seed", 1)
        assert (out, err) == (f"1 epoch and truth.ecsv in {jet} (seed 1)\n", "")


def test_simulate_a_jet_of_surveys(done, here):
    done(
        "simulate", "jet", "a", "--motion", 0.4, "--features", 5, "--standing", 2,
        "--seed", 1, "--epochs", 3, "--dispersion", 0.2, "--distribution", "lognormal",
        "--flux-variation", 0,
    )  # fmt: skip
    a = QTable.read(here / "a" / "truth.ecsv")
    flow, standing = a.meta["streams"]
    assert (flow["speed"], flow["dispersion"], flow["n_features"]) == (0.4, 0.2, 5.0)
    assert flow["distribution"] == "lognormal"
    assert standing["n_features"] == 2
    assert np.all(a["flux"][a["group"] == "core"] == 1 * u.Jy)


def test_restore_and_inspect_components(done, here):
    paths = [here / f"3c1_200{year}-03-09.mod" for year in (6, 7)]
    for path in paths:
        path.write_text("1.0v 0.0v 0v 0.1v 1 0 1\n0.5v 1.5v 60v 0.3v 1 0 1\n")
    beam = ["--beam", "1.0 mas 0.5 mas -7 deg", "--pixel", "0.1 mas"]
    noise = ["--noise", "0.3 mJy/beam"]
    out, err = done("restore", *paths, "-o", "a", *beam, *noise)
    assert err == ""
    seed = re.search(r"seed of the noise (\d+)", out).group(1)
    cube = EpochCube.read(here / "a" / "*.fits")
    assert cube.beams == (Beam(1 * u.mas, 0.5 * u.mas, -7 * u.deg),) * 2
    assert cube.pixel_scale.round(6) == 0.1 * u.mas
    header = fits.getheader(min((here / "a").glob("*.fits")))
    assert any(f"seed {seed}" in line for line in header["HISTORY"])
    done("restore", *paths, "-o", "b", *beam, *noise, "--seed", seed)
    assert same(here / "a", here / "b")
    # Some dates without noise; and with the beam of the table.
    table = read_components(paths, beams=cube.beams[0]).to_table()
    table.write(here / "a.ecsv", format="ascii.ecsv")
    only = ["--before", "2007-01-01"]
    out, _ = done("restore", "--pixel", "100 uas", "-o", "d", "a.ecsv", *only)
    assert "seed" not in out
    some = EpochCube.read(here / "d" / "*.fits")
    assert some.beams == cube.beams[:1]
    assert some.times.isot.tolist() == ["2006-03-09T00:00:00.000"]
    # Lists of components alone are restored, with the beam that is given.
    out, _ = done("inspect", *paths, "--beam", "0.8 mas")
    assert "0.8 x 0.8 mas at 0 deg" in out
    assert "No problems." in out


def test_restore_lists_the_sources_of_tables(done, refused, here):
    words = "source epoch feature flux separation position_angle"
    rows = [f"{s} 2006-0{k}-09 0 1 0 0" for s in ("0430+052", "x") for k in (1, 2)]
    units = dict.fromkeys(words.split()[3:]) | {"flux": "Jy", "separation": "mas"}
    units["position_angle"] = "deg"
    table = QTable.read([words, *rows], format="ascii.basic")
    for name, unit in units.items():
        table[name].unit = unit
    table.write(here / "t.ecsv")
    out, err = done("restore", "t.ecsv", "--list")
    assert err == ""
    head, *lines = [line.split() for line in out.splitlines() if line]
    assert head == ["source", "also", "epochs", "first", "last"]
    assert lines == [
        ["0430+052", "3C", "120", "2", "2006-01-09", "2006-02-09"],
        ["x", "-", "2", "2006-01-09", "2006-02-09"],
    ]
    how = ["--beam", "1 mas", "--pixel", "0.2 mas", "-o", "images", "t.ecsv"]
    assert "--list lists them" in refused("restore", *how)
    assert "--list lists all" in refused("restore", *how, "--source", "3C 273")
    done("restore", *how, "--source", "3C 120")
    header = fits.getheader(min((here / "images").glob("*.fits")))
    # 04h30m +05.2 of B1950.
    assert header["CRVAL1"] == pytest.approx(68.164, abs=1e-3)
    assert header["CRVAL2"] == pytest.approx(5.305, abs=1e-3)


# -- inspect -------------------------------------------------------------------------


def table_of(text):
    """The rows of the table of speeds."""
    return [k for k in text.split("pairs\n")[1].splitlines() if k[:1].isdigit()]


def test_inspect(jet, done, here):
    EpochCube.read(jet[:3]).write("cube.fits")
    for files, names in ((jet[:3], [k.name for k in jet]), (["cube.fits"], [""] * 3)):
        out, err = done("inspect", *files, "--speed", "6 mas/yr")
        lines = out.splitlines()
        assert err == ""
        assert lines[0].split()[:3] == ["epoch", "date", "pixels"]
        dates = [line.split()[1] for line in lines[1:4]]
        assert dates == ["2000-01-01", "2000-01-31", "2000-03-01"]
        for line, name in zip(lines[1:4], names, strict=False):
            assert line.startswith(name)
            assert "128 x 64" in line
            assert "1 x 1 mas at 0 deg" in line
        assert "No problems." in lines
        assert any("Consecutive epochs suit speeds" in line for line in lines)
        # In 30 days of a beam of 1 mas.
        (row,) = table_of(out)
        assert row.split() == ["6", "0.49", '"0.05', "yr", "0.17", 'yr"', "3"]
    assert [path.name for path in here.iterdir()] == ["cube.fits"]


@pytest.mark.slow
def test_inspect_explains_speeds(jet, done):
    rising = table_of(done("inspect", *jet)[0])
    assert len(rising) == 4
    assert rising[-1].split()[1] == "1.5"
    (row,) = table_of(done("inspect", *jet, "--speed", "0.01 mas/yr")[0])
    assert row.split()[2:] == ["too", "slow", "for", "this", "series", "0"]
    # Of epochs ten minutes apart are those pairs counted that would be measured.
    simulate_two_fluid(n_epochs=4, interval=10 * u.min, rng=1).cube.write("night.fits")
    for speed, pairs in ((2, "6"), (8, "3")):
        speed = (speed * u.mas / u.hr).to(u.mas / u.yr)
        (row,) = table_of(done("inspect", "night.fits", "--speed", f"{speed:.8g}")[0])
        assert row.split()[-1] == pairs


def test_inspect_says_what_is_wrong(series, done, refused, here):
    paths = series([None, 1, 1])
    (here / "note.fits").write_text("no image")
    out, _ = done("inspect", *paths, "note.fits")
    problems = out.split("Problems:\n")[1].splitlines()
    assert any("no beam where other epochs have one" in line for line in problems)
    assert any("note.fits: cannot be read as FITS" in line for line in problems)
    assert problems[-1].startswith("  as one series: ")
    with fits.open(paths[0], mode="update") as hdus:
        for key in ("DATE-OBS", "MJD-OBS"):
            hdus[0].header.remove(key, ignore_missing=True)
    assert "no date of observation" in done("inspect", paths[0])[0]
    out, _ = done("inspect", paths[1])
    assert "velocities need at least two epochs of different date." in out
    EpochCube.read(paths[1:]).write("whole.fits")
    with fits.open("whole.fits") as hdus:
        fits.HDUList([hdus[0].copy()]).writeto("cube.fits")
    assert "cube.fits" in refused("inspect", "cube.fits")


@pytest.mark.slow
def test_inspect_advises_an_alignment(done):
    """An unaligned jet, one that is aligned, and ones of which only the core tells."""
    said = {}
    for name, jet in {
        "bad": simulate_jet(n_epochs=8, alignment_error=0.4, rng=2),
        "good": simulate_jet(n_epochs=8, rng=2),
        "two": simulate_jet(n_epochs=2, alignment_error=0.6, rng=1),
        "dense": simulate_two_fluid(n_epochs=6, core=5.0, rng=1),
    }.items():
        jet.cube.write(f"{name}.fits")
        out, _ = done("inspect", f"{name}.fits")
        _, *rest = out.split("pairs\n")[-1].split("\n\n")
        *said[name], choices = rest
        head, align, direction = choices.splitlines()
        assert head == "Without options, astro-scc measure takes:"
        taken = "core" if name == "bad" else "none"
        assert align.startswith(f"  --align {taken}: ")
        assert direction.startswith('  --position-angle "2')
        # How well they are aligned is said once.
        assert len(re.findall("aligned|the epochs scatter", out)) == 1
    assert said["bad"] == said["good"] == said["dense"] == []
    (line,) = said["two"]
    assert re.match(r"What is fitted as the core scatters by 0\.\d\d beams: ", line)


def test_inspect_tells_a_core_that_varies(monkeypatch, done):
    monkeypatch.setattr("astro_scc.cli.images._cores", lambda *_: ({}, 0.3))
    simulate_jet(n_epochs=8, rng=2).cube.write("jet.fits")
    out, _ = done("inspect", "jet.fits")
    assert "scatters by 0.30 beams, but the rest of the images by 0.0" in out
    assert "the epochs are left as they are" in out


def test_dates_of_one_day_are_told_apart(tmp_path, capsys):
    data = np.random.default_rng(1).normal(size=(2, 24, 32))
    dates = ["2015-06-18T10:00:00", "2015-06-18T10:00:00.5"]
    cube = EpochCube.from_arrays(data, dates, pixel_scale=1 * u.mas)
    write_epochs(cube, tmp_path / "jet")
    (tmp_path / "jet" / "x.fits").write_text("")
    assert main(["inspect", f"{tmp_path}/jet/*.fits"]) == 0
    out = capsys.readouterr().out
    assert "2015-06-18T10:00:00.000" in out
    assert "2015-06-18T10:00:00.500" in out
