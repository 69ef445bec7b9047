# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc simulate``, ``restore`` and ``inspect``: images, and what they hold."""

import re

import astropy.units as u
from astropy.io import fits
from astropy.table import QTable

from astro_scc import EpochCube
from astro_scc.epochs import Beam


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
    # One epoch cannot be measured.
    out, _ = done("simulate", "static", "d", "--epochs", 1, "--seed", 1)
    assert out == "1 epoch and truth.ecsv in d (seed 1)\n"


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
    done("restore", *paths, "-o", "b", *beam, *noise, "--seed", seed)
    assert same(here / "a", here / "b")
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
    _, *lines = [line.split() for line in out.splitlines() if line]
    assert lines[0] == ["0430+052", "3C", "120", "2", "2006-01-09", "2006-02-09"]
    assert lines[1] == ["x", "-", "2", "2006-01-09", "2006-02-09"]
    how = ["--beam", "1 mas", "--pixel", "0.2 mas", "-o", "images", "t.ecsv"]
    assert "--list lists them" in refused("restore", *how)
    done("restore", *how, "--source", "3C 120")


def test_inspect(jet, done, here):
    EpochCube.read(jet[:3]).write("cube.fits")
    for files, names in ((jet[:3], [k.name for k in jet]), (["cube.fits"], [""] * 3)):
        out, err = done("inspect", *files, "--speed", "6 mas/yr")
        lines = out.splitlines()
        assert err == ""
        dates = [line.split()[1] for line in lines[1:4]]
        assert dates == ["2000-01-01", "2000-01-31", "2000-03-01"]
        for line, name in zip(lines[1:4], names, strict=False):
            assert line.startswith(name)
            assert {"128 x 64", "1 x 1 mas at 0 deg"} <= {*re.split("  +", line)}
        assert "No problems." in lines
        # In 30 days of a beam of 1 mas.
        assert re.search(r'^6 +0.49 +"0.05 yr 0.17 yr" +3', out, re.MULTILINE)
        assert "speeds of 3.04 to 26.3 mas/yr are searched, faster ones with --" in out
    assert [path.name for path in here.iterdir()] == ["cube.fits"]


def test_inspect_says_what_is_wrong(series, done, refused, here):
    paths = series([None, 1, 1])
    (here / "note.fits").write_text("no image")
    out, _ = done("inspect", *paths, "note.fits")
    problems = out.split("Problems:\n")[1].splitlines()
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
