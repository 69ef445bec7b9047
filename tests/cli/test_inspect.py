# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc inspect``: what it tells before anything is measured."""

import re

import astropy.units as u
import pytest
from astropy.io import fits

from astro_scc import EpochCube
from astro_scc.epochs import Beam
from astro_scc.simulation import simulate_jet, simulate_two_fluid

QUICK = ["--scales", "2", "--max-speed", "30 mas/yr", "--n-trials", "20"]


def epochs(folder):
    return sorted(folder.glob("*.fits"))


@pytest.mark.slow
def test_inspect(jet, astro_scc, here):
    status, out, err = astro_scc("inspect", *epochs(jet))
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0].split()[:3] == ["epoch", "date", "pixels"]
    for line, path in zip(lines[1:7], epochs(jet), strict=True):
        assert line.startswith(path.name)
        assert "256 x 128" in line
        assert "1 x 1 mas at 0 deg" in line
    assert "No problems." in lines
    assert any("Consecutive epochs suit speeds" in line for line in lines)
    assert not list(here.iterdir())


@pytest.mark.slow
def test_inspect_explains_speeds(jet, astro_scc):
    # Six epochs 30 days apart, a beam of 1 mas.
    def rows(*argv):
        status, out, err = astro_scc("inspect", *epochs(jet), *argv)
        assert (status, err) == (0, "")
        table = out.split("pairs\n")[1].splitlines()
        return [line for line in table if line[:1].isdigit()]

    rising = rows()
    assert len(rising) == 4
    assert rising[-1].split()[1] == "1.5"
    (row,) = rows("--speed", "6 mas/yr")
    motion = 6 * 30 / 365.25
    baseline = f'"{0.3 / 6:.2g} yr {1.5 / 6:.2g} yr"'
    assert row.split() == ["6", f"{motion:.2g}", *baseline.split(), "12"]
    (row,) = rows("--speed", "0.01 mas/yr")
    assert row.split()[2:] == ["too", "slow", "for", "this", "series", "0"]


@pytest.mark.slow
def test_the_baseline_that_inspect_gives_is_understood(jet, astro_scc, here):
    _, out, _ = astro_scc("inspect", *epochs(jet), "--speed", "12 mas/yr")
    baseline = re.search(r'^12 .*"(.*)"', out, flags=re.MULTILINE)[1]
    argv = ("measure", *epochs(jet), "-o", "out", *QUICK, "--no-report")
    assert astro_scc(*argv, "--baseline", baseline)[0] == 0


def test_inspect_says_what_is_wrong(series, astro_scc, here):
    paths = series([None, *[Beam(1 * u.mas, 1 * u.mas)] * 2])
    (here / "note.fits").write_text("no image")
    status, out, _ = astro_scc("inspect", *paths, "note.fits")
    assert status == 0
    problems = out.split("Problems:\n")[1].splitlines()
    assert any("no beam where others have one" in line for line in problems)
    assert any("note.fits: cannot be read as FITS" in line for line in problems)
    assert problems[-1].startswith("  as one series: ")


def test_inspect_one_epoch_without_a_date(series, astro_scc):
    path = series([None] * 3)[0]
    status, out, _ = astro_scc("inspect", path)
    assert status == 0
    assert "velocities need at least two epochs of different date." in out
    with fits.open(path, mode="update") as hdus:
        for key in ("DATE-OBS", "MJD-OBS"):
            hdus[0].header.remove(key, ignore_missing=True)
    status, out, _ = astro_scc("inspect", path)
    assert status == 0
    assert "no date of observation" in out


def test_inspect_a_cube_file(jet, astro_scc, here):
    EpochCube.read(epochs(jet)[:3]).write("cube.fits")
    status, out, _ = astro_scc("inspect", "cube.fits")
    assert status == 0
    assert [line.split()[1] for line in out.splitlines()[1:4]] == [
        "2000-01-01",
        "2000-01-31",
        "2000-03-01",
    ]


@pytest.mark.slow
def test_inspect_advises_an_alignment(astro_scc, here):
    """An unaligned jet, one that is aligned, and ones of which only the core tells."""
    said = {}
    for name, jet in {
        "bad": simulate_jet(n_epochs=8, alignment_error=0.4, rng=2),
        "good": simulate_jet(n_epochs=8, rng=2),
        "two": simulate_jet(n_epochs=2, alignment_error=0.6, rng=1),
        "dense": simulate_two_fluid(n_epochs=6, core=5.0, rng=1),
    }.items():
        jet.cube.write(f"{name}.fits")
        status, out, _ = astro_scc("inspect", f"{name}.fits")
        assert status == 0
        said[name], choices = out.split("pairs\n")[-1].split("\n\n")[1:3]
        head, align, scales, direction = choices.splitlines()
        assert head == "Without options, astro-scc measure takes:"
        taken = "core" if name == "bad" else "none"
        assert align.startswith(f"  --align {taken}: ")
        assert scales.startswith("  --scales 1,2,3,4: ")
        assert direction.startswith('  --position-angle "2')
    number = r"^The epochs are aligned to 0\.(\d\d) beams\."
    advice = r"appear to move: align them on the core,\nif there is one, or by a table"
    assert int(re.match(number, said["bad"])[1]) >= 20
    assert re.search(advice, said["bad"])
    assert int(re.match(number, said["good"])[1]) <= 5
    assert "--align core" not in said["good"]
    nobody = "The images do not show how well the epochs are aligned.\n"
    assert said["dense"] == nobody.rstrip()
    assert said["two"].startswith(f"{nobody}The core as it is fitted scatters by 0.")
    assert re.search(advice, said["two"])


@pytest.mark.parametrize(("speed", "pairs"), [(2, 6), (4, 5), (8, 3)])
def test_inspect_counts_the_pairs_of_a_night(astro_scc, here, speed, pairs):
    """Of epochs ten minutes apart are those pairs counted that would be measured."""
    simulate_two_fluid(n_epochs=4, interval=10 * u.min, rng=1).cube.write("night.fits")
    speed = (speed * u.mas / u.hr).to(u.mas / u.yr)
    status, out, _ = astro_scc("inspect", "night.fits", "--speed", f"{speed:.8g}")
    assert status == 0
    assert out.split("pairs\n")[1].splitlines()[0].split()[-1] == str(pairs)


def test_a_damaged_cube_is_one_line(refused, here):
    simulate_two_fluid(n_epochs=2, rng=1).cube.write("whole.fits")
    with fits.open("whole.fits") as hdus:
        fits.HDUList([hdus[0].copy()]).writeto("cube.fits")
    assert "cube.fits" in refused("inspect", "cube.fits")
