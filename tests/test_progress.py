# Licensed under a 3-clause BSD style license - see LICENSE.rst
import sys

import pytest

from astro_scc.progress import progress


def test_shows_label_and_steps_on_standard_error(capsys):
    with progress(4, "Correlating") as done:
        done(1)
        done(3)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Correlating" in captured.err
    assert "4/4" in captured.err


@pytest.mark.parametrize(("total", "show"), [(4, False), (0, True), (0, False)])
def test_nothing_is_shown_and_nothing_imported(capsys, monkeypatch, total, show):
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with progress(total, "Correlating", show=show) as done:
        assert done(1) is None
    assert capsys.readouterr() == ("", "")


def test_an_error_passes_and_closes_the_bar(capsys):
    with pytest.raises(RuntimeError, match="broken"), progress(4, "Correlating"):
        raise RuntimeError("broken")
    with progress(2, "Again") as done:
        done(2)
    assert "2/2" in capsys.readouterr().err
