# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Bars on a terminal, and lines elsewhere."""

import io
import re
import sys
import threading
import time

import pytest

from astro_scc.progress import progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_bar_on_a_terminal_and_in_a_notebook(monkeypatch, capsys):
    with monkeypatch.context() as patch:
        patch.setattr(sys, "stderr", terminal := Terminal())
        with pytest.raises(RuntimeError, match="broken"), progress(4, "Correlating"):
            raise RuntimeError("broken")
        with progress(2, "Again") as done:
            done(1)
            done(1)
    assert "Correlating" in terminal.getvalue()
    assert "2/2" in terminal.getvalue()
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    with progress(4, "Correlating") as done:
        done(4)
    assert "4/4" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("total", "line"),
    [(40, r"Searching: 3 of 40, 0\.0 min"), (None, r"Searching: 3 done, 0\.0 min")],
)
def test_lines_where_there_is_no_terminal(monkeypatch, capsys, total, line):
    # For half a minute there are none.
    with progress(total, "Searching") as done:
        done(3)
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr("astro_scc.progress.EVERY", 0.01)
    threads = threading.active_count()
    with progress(total, "Searching") as done:
        done(1)
        done(2)
        # Without another step.
        time.sleep(0.1)
    captured = capsys.readouterr()
    lines = captured.err.splitlines()
    assert (captured.out, len(lines) >= 2) == ("", True)
    assert re.fullmatch(line, lines[-1])
    assert threading.active_count() == threads


@pytest.mark.parametrize(("total", "show"), [(4, False), (0, True), (0, False)])
def test_nothing_is_shown_and_nothing_imported(capsys, monkeypatch, total, show):
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with progress(total, "Correlating", show=show) as done:
        assert done(1) is None
    assert capsys.readouterr() == ("", "")
