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


def test_shows_label_and_steps_on_standard_error(monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    with progress(4, "Correlating") as done:
        done(1)
        done(3)
    assert "Correlating" in terminal.getvalue()
    assert "4/4" in terminal.getvalue()


def test_a_notebook_shows_a_bar(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    with progress(4, "Correlating") as done:
        done(4)
    assert "4/4" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("total", "line"),
    [(40, r"Searching: 3 of 40, 0\.0 min"), (None, r"Searching: 3 done, 0\.0 min")],
)
def test_lines_where_there_is_no_terminal(monkeypatch, capsys, total, line):
    monkeypatch.setattr("astro_scc.progress.EVERY", 0.01)
    threads = threading.active_count()
    with progress(total, "Searching") as done:
        done(1)
        done(2)
        # Without another step.
        time.sleep(0.2)
    captured = capsys.readouterr()
    assert captured.out == ""
    lines = captured.err.splitlines()
    assert len(lines) >= 2
    assert re.fullmatch(line, lines[-1])
    assert threading.active_count() == threads


def test_half_a_minute_is_waited_for(capsys):
    with progress(4, "Correlating") as done:
        done(4)
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(("total", "show"), [(4, False), (0, True), (0, False)])
def test_nothing_is_shown_and_nothing_imported(capsys, monkeypatch, total, show):
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with progress(total, "Correlating", show=show) as done:
        assert done(1) is None
    assert capsys.readouterr() == ("", "")


def test_an_error_passes_and_closes_the_bar(monkeypatch):
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    with pytest.raises(RuntimeError, match="broken"), progress(4, "Correlating"):
        raise RuntimeError("broken")
    with progress(2, "Again") as done:
        done(2)
    assert "2/2" in terminal.getvalue()
