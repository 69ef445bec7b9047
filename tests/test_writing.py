# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Files that are complete or not there; bars on a terminal, and lines elsewhere."""

import io
import re
import sys
import threading
import time

import pytest

from astro_scc.progress import progress
from astro_scc.writing import partial_folder, replace_when_complete


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_and_a_file_that_are_gone_unless_complete(tmp_path):
    with pytest.raises(RuntimeError), partial_folder(tmp_path, ".part-") as folder:
        raise RuntimeError((folder / "a").write_text("x"))
    with partial_folder(tmp_path, ".part-") as folder:
        folder.rename(tmp_path / "whole")
    file = tmp_path / "a"
    with pytest.raises(KeyboardInterrupt), replace_when_complete(file) as part:
        raise KeyboardInterrupt(part.write_text("half"))
    assert names(tmp_path) == ["whole"]
    with replace_when_complete(file) as part:
        part.write_text("complete")
    assert names(tmp_path) == ["a", "whole"]
    for path, words in {
        "a": "a: exists; pass overwrite=True to replace it",
        "whole": "whole: is a directory; give the name of a file",
        "nowhere/a": "its folder .*nowhere does not exist",
    }.items():
        with pytest.raises(OSError, match=words):
            replace_when_complete(tmp_path / path).__enter__()


@pytest.mark.parametrize("notebook", [False, True])
def test_a_terminal_and_a_notebook_show_a_bar(monkeypatch, notebook):
    terminal = io.StringIO()
    terminal.isatty = lambda: not notebook
    monkeypatch.setattr(sys, "stderr", terminal)
    if notebook:
        monkeypatch.setitem(sys.modules, "ipykernel", sys)
    # An error passes, and closes the bar.
    with pytest.raises(RuntimeError, match="broken"), progress(4, "First"):
        raise RuntimeError("broken")
    with progress(4, "Correlating") as done:
        done(1)
        done(3)
    assert re.search("Correlating.*4/4", terminal.getvalue())


@pytest.mark.parametrize(("total", "steps"), [(40, "3 of 40"), (None, "3 done")])
def test_lines_where_there_is_no_terminal(monkeypatch, capsys, total, steps):
    # Half a minute is waited for.
    with progress(4, "Correlating") as done:
        done(4)
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr("astro_scc.progress.EVERY", 0.01)
    threads = threading.active_count()
    with progress(total, "Searching") as done:
        done(1)
        done(2)
        # Without another step.
        time.sleep(0.1)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) >= 2
    assert re.fullmatch(rf"Searching: {steps}, 0\.0 min", lines[-1])
    assert threading.active_count() == threads


@pytest.mark.parametrize(("total", "show"), [(4, False), (0, True)])
def test_nothing_is_shown_and_nothing_imported(capsys, monkeypatch, total, show):
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with progress(total, "Correlating", show=show) as done:
        assert done(1) is None
    assert capsys.readouterr() == ("", "")
