# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Hidden folders, and those that killed processes left."""

import os
import signal
import subprocess
import sys

import pytest

from astro_scc import writing
from astro_scc.writing import hold, partial_folder, remove_left, replace_when_complete

fcntl = pytest.importorskip("fcntl")

HOLDER = """
import sys, time
from pathlib import Path
from astro_scc.writing import partial_folder
with partial_folder(Path(sys.argv[1]), ".part-") as folder:
    (folder / "half").write_text("x")
    print(folder.name, flush=True)
    time.sleep(60)
"""


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_and_a_file_that_are_gone_unless_complete(tmp_path):
    with pytest.raises(RuntimeError), partial_folder(tmp_path, ".part-") as folder:
        raise RuntimeError((folder / "a").write_text("x"))
    assert names(tmp_path) == []
    with partial_folder(tmp_path, ".part-") as folder:
        folder.rename(tmp_path / "whole")
    # What a killed process left goes, and nothing else.
    left = tmp_path / f".astro_scc-{writing._machine()}-0123abcd"
    left.mkdir()
    (left / "a.txt").write_text("half")
    (tmp_path / ".astro_scc-work").mkdir()
    with replace_when_complete(tmp_path / "a.txt") as part:
        part.write_text("complete")
    assert names(tmp_path) == [".astro_scc-work", "a.txt", "whole"]


def test_of_a_process_that_lives_and_of_one_that_was_killed(tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, tmp_path], stdout=subprocess.PIPE, text=True
    ) as process:
        name = process.stdout.readline().strip()
        assert remove_left(tmp_path, ".part-") == [tmp_path / name]
        with partial_folder(tmp_path, ".part-") as other:
            assert names(tmp_path) == sorted([name, other.name])
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert names(tmp_path) == [name]
    # Of something else.
    assert remove_left(tmp_path, ".other-") == []
    assert names(tmp_path) == [name]
    assert remove_left(tmp_path, ".part-") == []
    assert names(tmp_path) == []


def test_what_is_not_its_own_stays(tmp_path, monkeypatch):
    left = tmp_path / f".p-{writing._machine()}-0123abcd"
    left.mkdir()
    (left / "half").write_text("x")
    for name in (".p-mine", ".p-01234567-0123abcd9", "x.p-01234567-0123abcd"):
        (tmp_path / name).mkdir()
    (tmp_path / ".p-01234567-00000000").write_text("a file")
    (tmp_path / ".p-01234567-11111111").symlink_to(tmp_path / ".p-mine")
    before = names(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("platform.node", lambda: "elsewhere")
        assert remove_left(tmp_path, ".p-") == [left]
        # Where folders cannot be locked.
        patch.undo()
        patch.setitem(sys.modules, "fcntl", None)
        assert remove_left(tmp_path, ".p-") == [left]
        with hold(left) as held, hold(left):
            assert held is False
        with partial_folder(tmp_path, ".p-") as folder:
            assert folder.is_dir()
    assert names(tmp_path) == before
    assert remove_left(tmp_path, ".p-") == []
    assert names(tmp_path) == [name for name in before if name != left.name]
    assert remove_left(tmp_path / "nowhere", ".p-") == []


def test_somebody_takes_it_for_left_before_it_is_held(tmp_path, monkeypatch):
    lock, seen = fcntl.flock, []

    def race(number, how):
        seen.append(how)
        if len(seen) == 1:
            for path in tmp_path.iterdir():
                path.rmdir()
        if len(seen) == 2:
            raise BlockingIOError
        lock(number, how)

    monkeypatch.setattr("fcntl.flock", race)
    with partial_folder(tmp_path, ".p-") as folder:
        assert folder.is_dir()
        # What was in the way when it could not be held stays for others.
        assert len(names(tmp_path)) == 2
        assert len(seen) == 3
    assert os.listdir(tmp_path) != []
    assert remove_left(tmp_path, ".p-") == []
    assert names(tmp_path) == []
