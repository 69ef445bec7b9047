# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Files, options and memory as they are in practice, see ``tools/inputs.py``."""

import os
import resource
import signal
import sys

import pytest
from astropy.table import QTable

from astro_scc.cli import main
from astro_scc.cli.survey import run_survey
from astro_scc.cli.survey_sources import read_survey
from astro_scc.epochs import EpochCube, read_components


@pytest.mark.slow
def test_every_case_gets_what_it_should(inputs, case, tmp_path):
    assert inputs.faults(inputs.run(case, tmp_path), case) == []


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes")
def test_nobody_waits_for_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe.fits")
    for name in (tmp_path / "pipe.fits", str(tmp_path / "*.fits")):
        with pytest.raises(OSError, match="pipe.fits: is no ordinary file"):
            read_components(name)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of files are of Linux")
@pytest.mark.parametrize("limit", [100, pytest.param(9000, marks=pytest.mark.slow)])
def test_a_disk_that_is_full_in_the_middle(epochs, measure, tmp_path, limit):
    """No file may grow beyond a limit, as if the disk were full there."""
    before = set(tmp_path.rglob("*"))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, hard))
        status, err = measure(*epochs, "-o", tmp_path / "a" / "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)
    assert status == 2
    (line,) = [text for text in err.splitlines() if not text.startswith("warning: ")]
    assert line.startswith("astro-scc measure: error: ")
    assert "cannot be written: File too large; make room there or choose" in line
    assert set(tmp_path.rglob("*")) == before


@pytest.mark.slow
def test_a_part_is_measured(inputs, epochs, measure, tmp_path):
    part, region = tmp_path / "part.reg", tmp_path / "jet.reg"
    part.write_text("image\nbox(24,21,38,30,0)\n")
    words = [*epochs, "-o", tmp_path / "out", "--crop", part]
    # Regions in pixels would be those of the part.
    region.write_text("image\ncircle(20,20,9)\n")
    status, err = measure(*words, "--region", region)
    assert status == 2
    assert f"{region}: is in pixels, which are others in a part of the images" in err
    region.write_text('fk5\nbox(10d,0d,0.0036",0.0026",0)\n')
    assert measure(*words, "--region", region)[0] == 0
    table = QTable.read(tmp_path / "out" / "components.ecsv")
    assert table["pm_ra_cosdec"][0].value == pytest.approx(-inputs.SPEED, abs=0.05)
    assert "cropped to pixels x 5 to 41, y 6 to 34" in table.meta["history"]


def test_more_than_the_machine_has(epochs, measure, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("astro_scc.epochs.reading.machine_memory", lambda: 1e4)
    status, err = measure(*epochs, "-o", tmp_path / "out")
    words = "6 images of 48 x 40 pixels are 0.000104 GB, this machine has 1e-05; read a"
    assert (status, len(err.splitlines())) == (2, 1)
    assert err.startswith(f"astro-scc measure: error: {words} region of them (region=")
    # Each file by itself can be looked at.
    assert main(["inspect", *map(str, epochs)]) == 0
    assert f"as one series: {words}" in capsys.readouterr().out
    assert EpochCube.read(epochs, region=(slice(5, 9), slice(5, 9))).shape == (6, 4, 4)


def rewrite(path, old, new):
    """Other content of the same size, with the time of the last change put back."""
    state = path.stat()
    path.write_bytes(path.read_bytes().replace(old, new))
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))


@pytest.mark.slow
def test_sources_of_a_survey_that_are_no_longer_finished(inputs, tmp_path, monkeypatch):
    (tmp_path / "jet").mkdir()
    inputs.series(tmp_path / "jet")
    (tmp_path / "s.toml").write_text(
        '[sources.Jet]\nepochs = "jet/*.fits"\nscales = [2]\nn_trials = 119\n'
        'max_speed = "5 mas/yr"\nalign = "t.csv"\nregions = {r = "r.reg"}\n'
    )
    (tmp_path / "r.reg").write_text("image\ncircle(24,20,20)\n")
    days = "".join(f"{day},0.0,0.0\n" for day in inputs.DAYS)
    (tmp_path / "t.csv").write_text(f"date,east_mas,north_mas\n{days}")

    def finished():
        told, plan = [], read_survey(tmp_path / "s.toml")
        run_survey(plan, tmp_path / "out", done=lambda *args: told.append(args[1]))
        return told[0]

    assert [finished(), finished()] == [False, True]
    for name, old, new in (
        ("jet/e1.fits", b"2001-01-31", b"2001-01-30"),
        ("r.reg", b"24", b"25"),
        ("t.csv", b"0.0,0.0\n", b"0.0,0.1\n"),
        ("s.toml", b"n_trials = 119", b"n_trials = 120"),
    ):
        rewrite(tmp_path / name, old, new)
        assert [finished(), finished()] == [False, True], name
    (state,) = (tmp_path / "out").rglob("part.json")
    for content in ("{}", "nothing"):
        state.write_text(content)
        assert not finished(), content
    name = "astro_scc.cli.survey_sources.versions"
    monkeypatch.setattr(name, lambda: {"astro_scc": "0"})
    assert not finished()
