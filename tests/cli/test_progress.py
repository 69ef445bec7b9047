# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What long runs say: how far they are."""

import re

import pytest

QUICK = ["--scales", "2", "--max-speed", "36 mas/yr", "--n-trials", "20", "--seed", "1"]
SURVEY = """
[defaults]
scales = [2]
max_speed = "36 mas/yr"
n_trials = 20
[sources.Gone]
epochs = "gone/*.fits"
[sources.Jet]
epochs = "{0}/*.fits"
[sources.Twin]
epochs = "{0}/*.fits"
"""


@pytest.fixture
def command(jet, here):
    """The words of a command that is quick."""

    def words(name):
        if name == "survey":
            (here / "s.toml").write_text(SURVEY.format(jet.as_posix()))
            return ["survey", "s.toml", "-o", "out", "--no-report"]
        more = {"measure": ["--no-report"], "track": ["--no-figures"]}
        more["profile"] = ["--bins", "2 8 16 mas"]
        files = sorted(map(str, jet.glob("*.fits")))
        if name == "track":
            return [name, *files, "-o", "out", *more[name]]
        return [name, *files, "-o", "out", *QUICK, *more[name]]

    return words


@pytest.mark.slow
@pytest.mark.parametrize("name", ["measure", "profile", "track", "survey"])
def test_every_long_command_tells_how_far_it_is(name, command, astro_scc, monkeypatch):
    # As if every half minute, and pytest's standard error is no terminal.
    monkeypatch.setattr("astro_scc.progress.EVERY", 0.001)
    status, _, err = astro_scc(*command(name))
    assert status == 0
    said = {line.partition(":")[0] for line in err.splitlines()}
    labels = {
        "measure": {"Decomposing", "Correlating", "Searching"},
        "profile": {"Decomposing", "Correlating", "Searching"},
        "track": {"Fitting"},
        "survey": {"Sources"},
    }[name]
    assert labels <= said
    for line in err.splitlines():
        if line.partition(":")[0] in labels:
            assert re.fullmatch(r"[\w ]+: \d+ (of \d+|done), \d+\.\d min", line)
