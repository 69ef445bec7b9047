# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What was kept of other data, settings or versions is not used."""

import os

import pytest

from astro_scc.cli.survey import run_survey
from astro_scc.cli.survey_sources import read_survey


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
    for content in ("", "{}", '{"key": 1}', "[]", "nothing"):
        state.write_text(content)
        assert not finished(), content
    name = "astro_scc.cli.survey_sources.versions"
    monkeypatch.setattr(name, lambda: {"astro_scc": "0"})
    assert not finished()
