# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``measure --resume``: goes on after an interrupt, and ends the same."""

import pytest

from astro_scc.cli import main
from astro_scc.cli.measure import WORK
from astro_scc.correlation.correlate import match_block
from astro_scc.simulation import simulate_two_fluid, write_simulation

QUICK = ["--scales", "2", "--max-speed", "30 mas/yr", "--n-trials", "20", "--no-report"]
TABLES = ("components.ecsv", "ssps.ecsv", "scc.fits", "config.toml")


@pytest.fixture(scope="module")
def jet(tmp_path_factory):
    """A folder with the images of a jet."""
    folder = tmp_path_factory.mktemp("jet")
    write_simulation(simulate_two_fluid(n_epochs=4, rng=1), folder)
    return folder


@pytest.fixture
def measure(jet, tmp_path, monkeypatch, capsys):
    """Run a measurement in an empty folder; its status and messages."""
    monkeypatch.chdir(tmp_path)

    def run(*argv):
        status = main(["measure", *map(str, sorted(jet.glob("*.fits"))), *QUICK, *argv])
        return status, capsys.readouterr().err

    return run


@pytest.fixture
def blocks(monkeypatch):
    """Blocks that were correlated."""
    done = []

    def count(block):
        done.append(block)
        return match_block(block)

    monkeypatch.setattr("astro_scc.correlation.correlate.match_block", count)
    monkeypatch.setattr("astro_scc.correlation.correlate.BLOCK_WORK", 1)
    return done


def products(folder):
    return {name: (folder / name).read_bytes() for name in TABLES}


@pytest.mark.slow
def test_goes_on_and_ends_the_same(measure, blocks, tmp_path, monkeypatch):
    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("astro_scc.scc.stack_matches", interrupt)
        status, err = measure("-o", "out", "--resume")
    assert status == 130
    assert err.endswith("interrupted; the same command goes on from what is done\n")
    out = tmp_path / "out"
    assert [p.name for p in out.iterdir()] == [WORK]
    status, err = measure("-o", "out", "--resume")
    assert (status, len(blocks)) == (0, 4)
    first = products(out)
    # Done already: to the bit, with the seed that was drawn, and at once.
    assert measure("-o", "out", "--resume")[0] == 0
    assert len(blocks) == 4
    assert products(out) == first
    assert sorted(p.name for p in (out / WORK).iterdir()) == [
        "matches.fits",
        "seed.txt",
    ]
    # And as it is without.
    seed = (out / WORK / "seed.txt").read_text().strip()
    assert measure("-o", "plain", "--seed", seed)[0] == 0
    assert products(tmp_path / "plain") == first


@pytest.mark.slow
def test_stale_matches_are_told_in_one_line(measure, blocks, tmp_path):
    assert measure("-o", "out", "--resume", "--seed", "1")[0] == 0
    status, err = measure("-o", "out", "--resume", "--seed", "1", "--kappa", "0.7")
    assert (status, len(blocks)) == (0, 8)
    (line,) = [line for line in err.splitlines() if "matches" in line]
    assert line.startswith("warning: out/.astro_scc-work/matches.fits: is of other ")
    assert line.endswith("settings of the correlation; not used, the epochs are "
                         "matched again")  # fmt: skip
    assert measure("-o", "fresh", "--seed", "1", "--kappa", "0.7")[0] == 0
    assert products(tmp_path / "fresh") == products(tmp_path / "out")


def test_folders_of_others_are_refused(measure, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("keep")
    status, err = measure("-o", "out", "--resume")
    assert status == 2
    assert "out: exists and is not of a run with --resume; choose another" in err
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["mine.txt"]
    (tmp_path / "file").write_text("keep")
    status, err = measure("-o", "file", "--resume")
    assert status == 2
    assert "file: cannot be made or used" in err


@pytest.mark.slow
def test_nothing_is_left_of_what_was_not_begun(measure, tmp_path):
    status, err = measure("-o", "deep/out", "--resume", "--region", "no.reg")
    assert status == 2
    assert "no.reg" in err
    status, _ = measure("-o", "out", "--resume", "--baseline", "7 yr 8 yr")
    assert status == 2
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_scheduler_that_is_not_there(measure, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("astro_scc.correlation.parallel.TIMEOUT", 0.2)
    status, err = measure("-o", "out", "--scheduler", "tcp://127.0.0.1:9")
    assert status == 2
    assert "scheduler tcp://127.0.0.1:9: cannot be reached" in err
    assert not list(tmp_path.iterdir())
