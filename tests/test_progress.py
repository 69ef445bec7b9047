# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Bars on a terminal, and lines elsewhere."""

import io
import re
import sys
import threading
import time

import pytest

from astro_scc.progress import progress


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
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert len(lines) >= 2
    assert re.fullmatch(rf"Searching: {steps}, 0\.0 min", lines[-1])
    assert threading.active_count() == threads


@pytest.mark.parametrize(("total", "show"), [(4, False), (0, True)])
def test_nothing_is_shown_and_nothing_imported(capsys, monkeypatch, total, show):
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with progress(total, "Correlating", show=show) as done:
        assert done(1) is None
    assert capsys.readouterr() == ("", "")
