# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Files and options as archives and mistakes make them, see ``tools/inputs.py``."""

import errno
import io
import os
import resource
import signal
import sys

import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.epochs import EpochCube, read_components
from astro_scc.epochs.fits import read_vlbi_fits


@pytest.mark.slow
def test_every_case_gets_what_it_should(inputs, case, tmp_path):
    assert inputs.faults(inputs.run(case, tmp_path), case) == []


def test_a_wrong_answer_would_be_seen(inputs):
    one = inputs.Case(name="", make=None, says="look", velocity=(1.0, 0.0))
    right = inputs.Outcome(0, "note: look", (1.0, 0.01), frozenset())
    assert inputs.faults(right, one) == []
    wrong = inputs.Outcome(2, "x\ny", (-1.0, 0.0), frozenset({"part"}))
    assert inputs.faults(wrong, one) == [
        "status 2", "left ['part']", "other words", "more than one line",
    ]  # fmt: skip
    assert inputs.faults(inputs.Outcome(0, "look", None, frozenset()), one) == [
        "wrong velocity"
    ]


def test_scales_must_differ_as_numbers_and_as_angles(inputs, tmp_path):
    import astropy.units as u

    with pytest.raises(ValueError, match=r"scales = .* must differ: leave out"):
        StackedCrossCorrelation(scales=[2, 2.0])
    cube = EpochCube.read(inputs.series(tmp_path, n=2))
    scc = StackedCrossCorrelation(scales=[0.39, 0.41] * u.mas)
    with pytest.raises(ValueError, match=r"scales = .* must differ: leave out"):
        scc.scale_numbers(cube)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no pipes")
@pytest.mark.parametrize("read", [EpochCube.read, read_vlbi_fits, read_components])
def test_nobody_waits_for_a_pipe(tmp_path, read):
    path = tmp_path / "pipe.fits"
    os.mkfifo(path)
    with pytest.raises(OSError, match="pipe.fits: is no ordinary file; give the name"):
        read(path)


# -- the folder of the products ----------------------------------------------------


def test_a_folder_below_a_file(epochs, measure, tmp_path):
    (tmp_path / "file").write_text("mine")
    status, err = measure(*epochs, "-o", tmp_path / "file" / "out")
    assert status == 2
    assert err.startswith(f"astro-scc measure: error: {tmp_path}/file/out: cannot be ")
    assert len(err.splitlines()) == 1


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere"
)
def test_a_folder_that_is_read_only(epochs, measure, tmp_path):  # pragma: no cover
    folder = tmp_path / "locked"
    folder.mkdir()
    folder.chmod(0o500)
    status, err = measure(*epochs, "-o", folder / "out")
    assert (status, len(err.splitlines())) == (2, 1)
    assert f"{folder}/out: cannot be made or used: Permission denied" in err
    assert not list(folder.iterdir())


def test_a_file_system_that_is_read_only(epochs, measure, tmp_path, monkeypatch):
    def refuse(path, *args, **kwargs):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    monkeypatch.setattr("pathlib.Path.mkdir", refuse)
    status, err = measure(*epochs, "-o", tmp_path / "out")
    assert (status, len(err.splitlines())) == (2, 1)
    assert "out: cannot be made or used: Read-only file system" in err


@pytest.mark.skipif(sys.platform != "linux", reason="limits of files are of Linux")
@pytest.mark.parametrize("limit", [100, 5000, 15000])
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
    assert line.endswith(
        "cannot be written: File too large; make room there or choose another folder"
    )
    assert set(tmp_path.rglob("*")) == before


def test_no_space_is_one_line_that_names_the_folder(epochs, measure, tmp_path):
    out = tmp_path / "out"

    def full(*args, **kwargs):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("astro_scc.measurement.products.velocity_hdus", full)
        status, err = measure(*epochs, "-o", out)
    assert status == 2
    assert err.splitlines()[-1].startswith(
        f"astro-scc measure: error: {out}: cannot be written: No space left on device;"
    )
    assert not out.exists()


def test_output_that_nobody_can_print(inputs, epochs, tmp_path, monkeypatch):
    """Terminals without Unicode get the answer too."""
    text = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr("sys.stdout", text)
    from astro_scc.cli import main

    words = ["measure", *map(str, epochs), "-o", str(tmp_path / "ö"), *inputs.QUICK]
    assert main([*words, "--no-report"]) == 0
    text.flush()
    assert b"\\xf6" in text.buffer.getvalue()
