# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What long runs say: how long they will take, and how far they are."""

import re

import numpy as np
import pytest

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.cli.inputs import measuring_time, tell_time
from astro_scc.cli.program import Reporter
from astro_scc.measurement.decomposing import decompose_epochs, matching_time
from astro_scc.settings import Settings

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


@pytest.fixture
def cores(monkeypatch):
    """Eight cores, on any machine."""
    monkeypatch.setattr("astro_scc.cli.inputs._n_cores", lambda: 8)


@pytest.mark.parametrize(
    ("shared", "alone", "workers", "said"),
    [
        (290, 9, 1, None),
        (290, 20, 1, "5.2 min (what); --workers 8 shortens it to 0.94 min"),
        (
            8000,
            0,
            8,
            "17 min (what); a --region, a --crop or fewer --scales shorten it",
        ),
        # More processes than cores do not help.
        (8000, 0, 80, "17 min (what); a --region, a --crop or fewer"),
        (100, 9000, 1, "2.5 h (what); fewer --n-trials shorten it"),
        (1e6, 0, 2, "5.8 d (what); --workers 8 shortens it to 35 h"),
        (9000, 0, 1, "2.5 h (what); --workers 8 shortens it to 19 min"),
    ],
)
def test_what_shortens_a_run(cores, capsys, shared, alone, workers, said):
    tell_time(Reporter("astro-scc test"), workers, lambda: (shared, alone, "what"))
    out, err = capsys.readouterr()
    assert out == ""
    if said is None:
        assert err == ""
    else:
        assert err.startswith(f"note: this will take about {said}")
        assert err.count("\n") == 1


def test_sources_are_shared_by_no_more_processes_than_sources(cores, capsys):
    sources = {"less": "less", "most": 2}
    tell_time(Reporter("x"), 1, lambda: (1200, 0, "2 sources"), **sources)
    assert (
        "20 min (2 sources); --workers 2 shortens it to 10 min"
        in capsys.readouterr()[1]
    )
    tell_time(Reporter("x"), 2, lambda: (1200, 0, "2 sources"), **sources)
    assert capsys.readouterr()[1].endswith("10 min (2 sources); less\n")


@pytest.mark.parametrize(
    "name",
    [
        "measure",
        pytest.param("profile", marks=pytest.mark.slow),
        pytest.param("survey", marks=pytest.mark.slow),
    ],
)
def test_a_long_run_says_so_before_it_begins(
    name, command, astro_scc, cores, monkeypatch
):
    def stop(*args, **kwargs):
        raise ValueError("begun")

    for long in ("StackedCrossCorrelation.match", "StackedCrossCorrelation.__call__"):
        monkeypatch.setattr(f"astro_scc.scc.{long}", stop)
    words = command(name)
    # These images take seconds.
    status, _, err = astro_scc(*words)
    assert status == 2
    assert "this will take" not in err
    monkeypatch.setattr("astro_scc.cli.inputs.LONG", 0.01)
    status, _, err = astro_scc(*words)
    assert status == 2
    # A slow machine may tell its progress before.
    (first,) = [line for line in err.splitlines() if "this will take" in line]
    what = {
        "survey": r"3 sources",
    }.get(name, r"6 epochs of 256 x 128 pixels with about \d+ patterns")
    assert re.fullmatch(
        rf"note: this will take about \d\S* min \({what}\); .* shortens? it.*", first
    )
    assert "begun" in err.partition(first)[2]
    # On a cluster nothing is known of the processes, and --quiet is quiet.
    assert "this will take" not in astro_scc(*words, "--quiet")[2]


def test_a_survey_without_images_says_nothing(astro_scc, here, monkeypatch):
    monkeypatch.setattr("astro_scc.cli.inputs.LONG", 0)
    (here / "s.toml").write_text("[sources.Gone]\nepochs = 'gone/*.fits'\n")
    status, _, err = astro_scc("survey", "s.toml", "-o", "out")
    assert status == 2
    assert "this will take" not in err


def test_the_estimate_counts_patterns_and_grows_as_the_work_does(jet):
    cube = EpochCube.read(str(jet / "*.fits"))
    scc = StackedCrossCorrelation(scales=[1, 2])
    decomposer = scc.decomposer(cube)
    number = sum(len(d.ssps) for d in decompose_epochs(cube, decomposer))
    seconds, estimated = matching_time(cube, decomposer, (20, 20))
    assert estimated == pytest.approx(number, rel=0.2)
    # With two epochs instead of five, and in larger windows.
    planes = matching_time(cube, decomposer, (20, 20), n_targets=0)[0]
    fewer, _ = matching_time(cube, decomposer, (20, 20), n_targets=2)
    assert (fewer - planes) / (seconds - planes) == pytest.approx(2 / 5)
    wider, _ = matching_time(cube, decomposer, (62, 62))
    assert 1.2 < (wider - planes) / (seconds - planes) < 9
    # Windows end where no pattern can be reached.
    far, farther = (
        matching_time(cube, decomposer, (reach, reach))[0] for reach in (300, 600)
    )
    assert far == farther
    # Of a corner without patterns.
    region = np.zeros(cube.shape[1:], bool)
    region[0, 0] = True
    assert matching_time(cube, decomposer, (20, 20), region=region) == (planes, 0)


def test_the_estimate_grows_with_directions_and_bins(jet):
    cube = EpochCube.read(str(jet / "*.fits"))
    known = Settings(scales="2", position_angle="270 deg", n_trials=100_000)
    anywhere = Settings(scales="2", position_angle="any", n_trials=100_000)
    shared, alone, _ = measuring_time(cube, known)
    assert measuring_time(cube, known, 4)[1] > alone
    again, more, _ = measuring_time(cube, anywhere)
    assert more > alone
    assert again == pytest.approx(shared)


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
