# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Files, options and memory as in practice; nothing in a stranger's file is run."""

import os
import re
import resource
import signal
import sys

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable

from astro_scc.cli import main
from astro_scc.cli.program import Reporter
from astro_scc.cli.survey import run_survey
from astro_scc.cli.survey_sources import read_survey
from astro_scc.epochs import EpochCube, read_components, write_epochs
from astro_scc.epochs.align import offsets_from_table


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
        *(("jet/e1.fits", b"2001-01-31", b"2001-01-30"), ("r.reg", b"24", b"25")),
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


HOSTILE = (
    "../../evil", "/etc/passwd", "..", ".", "a/../../b", "CON", "x\\..\\y", "$HOME",
    "`id`", "%00", "~root", "<script>alert(1)</script>", "{{7*7}}", "-rf",
)  # fmt: skip


def test_objects_name_files_of_their_folder_only(inputs, tmp_path):
    cube = EpochCube.read(inputs.series(tmp_path, n=2))
    folder = tmp_path / "a" / "b" / "out"
    folder.mkdir(parents=True)
    before = set(tmp_path.rglob("*"))
    for name in HOSTILE:
        cube.meta["object"] = name
        for prefix in (None, name):
            for path in write_epochs(cube, folder, prefix=prefix, overwrite=True):
                assert path.parent == folder
                assert re.fullmatch(r"[\w+.-]+", path.name)
    assert all(path.parent == folder for path in set(tmp_path.rglob("*")) - before)


@pytest.mark.slow
def test_nothing_is_written_beside_the_products(inputs, tmp_path):
    """With every name that a header has, and a page that runs nothing of them."""
    names = "OBJECT", "TELESCOP", "OBSERVER", "FILTER", "LABEL"
    hostile = dict.fromkeys(names, "../<script>alert(1)</script>{{7*7}}")
    paths, out = inputs.series(tmp_path, lambda i: hostile), tmp_path / "out"
    before = set(tmp_path.rglob("*"))
    assert main(["measure", *map(str, paths), "-o", str(out), *inputs.QUICK]) == 0
    assert all(out in (p, *p.parents) for p in set(tmp_path.rglob("*")) - before)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "../&lt;script&gt;alert(1)&lt;/script&gt;{{7*7}}" in page
    assert "<script" not in page


BAD = "!!python/object/apply:os.mkdir [{path}]"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"unit: {BAD}", "bad.fits: cannot be read as astro_scc Epoch"),
        ("unit: !!python/name:os.system", "bad.fits: cannot be read as astro_scc Epo"),
        ("'!class': os.PathLike", r"bad.fits: .* its \w+ is of another version"),
        ("'!class': astro_scc.images.fits.Path", r"its \w+ is of another version"),
    ],
)
def test_files_make_dataclasses_of_this_package_only(inputs, tmp_path, text, words):
    EpochCube.read(inputs.series(tmp_path, n=2)).write(tmp_path / "cube.fits")
    text = text.format(path=tmp_path / "made")
    with fits.open(tmp_path / "cube.fits") as hdus:
        content = np.frombuffer(f"{text}\n".encode(), np.uint8)
        hdus["META"] = fits.ImageHDU(content, name="META")
        hdus.writeto(tmp_path / "bad.fits")
    with pytest.raises(OSError, match=words):
        EpochCube.read(tmp_path / "bad.fits")
    assert not (tmp_path / "made").exists()


def test_yaml_in_tables_makes_no_objects(tmp_path):
    (tmp_path / "t.ecsv").write_text(
        f"# %ECSV 1.0\n# ---\n# datatype:\n# - {{name: epoch, datatype: string}}\n"
        f"# meta: {{a: {BAD.format(path=tmp_path / 'made')}}}\nepoch\n2001-01-01\n"
    )
    with pytest.raises(ValueError, match=r"t.ecsv: is neither CSV nor ECSV"):
        offsets_from_table(tmp_path / "t.ecsv", None, [])
    assert not (tmp_path / "made").exists()


def test_codes_for_the_terminal_are_letters(capsys):
    reporter = Reporter("astro-scc test")
    reporter.say("a\x1b[2Jb\x07\n\tc")
    reporter.warn("\x9b31m")
    reporter.error("\x1b]0;title")
    out, err = capsys.readouterr()
    assert out == "a\\x1b[2Jb\\x07\n\tc\n"
    assert err == "warning: \\x9b31m\nastro-scc test: error: \\x1b]0;title\n"


def test_sound_files_are_read(tool, tmp_path):
    fuzz = tool("fuzz")
    for suffix, content, reader in fuzz.sources(tmp_path).values():
        path = tmp_path / f"sound{suffix}"
        path.write_bytes(content)
        assert fuzz.read(path, reader) == "read"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits are of Linux")
def test_damaged_files_are_read_or_refused(tool):
    fuzz = tool("fuzz")
    with fuzz.limits():
        counts, faults = fuzz.fuzz(270, seed=2, seconds=8)
    assert faults == []
    # The damage is neither harmless nor the end of everything.
    whole = counts.total()
    assert 0.05 * whole < sum(n for (_, what), n in counts.items() if what == "read")
