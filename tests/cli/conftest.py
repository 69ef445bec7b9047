# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images to run commands on, and commands that are run or refused."""

import astropy.units as u
import pytest
from astropy.io import fits

from astro_scc.cli import main
from astro_scc.cli.measure import STALE
from astro_scc.simulation import JetSimulation, Stream, write_simulation

QUICK = ["--scales", "2", "--max-speed", "30 mas/yr", "--n-trials", "99"]


def small_jet(n_epochs=6):
    """Features that move 0.6 beam an epoch, and a core that shows the alignment."""
    flow = Stream("flow", dx=6.0, sigma=3.0, density=0.6, jitter=0.5)
    small = {"shape": (64, 128), "extent": (20.0, 100.0), "axis": 32.0}
    return JetSimulation([flow], n_epochs=n_epochs, core=3.0, **small).run(rng=2)


@pytest.fixture(scope="session")
def make_jet():
    return small_jet


@pytest.fixture(scope="session")
def jet(tmp_path_factory):
    """The images of a jet."""
    return write_simulation(small_jet(), tmp_path_factory.mktemp("jet"))[:-1]


@pytest.fixture(scope="session")
def measured(jet, tmp_path_factory):
    """A measurement without a report, in a folder that had all of an old one."""
    folder = tmp_path_factory.mktemp("measured") / "out"
    for name in (*STALE, "notes.txt"):
        path = folder / name / "old" if "." not in name else folder / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text("old")
    argv = ["measure", *jet, "-o", folder, *QUICK, "--redshift", "15.8 %"]
    argv += ["--position-angle", "-90deg", "--no-report", "--quiet", "--overwrite"]
    assert main([str(word) for word in argv]) == 0
    return folder


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder to run in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def no_figures(monkeypatch):
    """Reports and profiles without the time that figures take."""
    monkeypatch.setattr(
        "astro_scc.visualization.style.figure_files", lambda *_, **_k: {}
    )


@pytest.fixture
def astro_scc(capsys, here):
    """Run a command; its status, output and messages."""

    def run(*argv):
        status = main([str(word) for word in argv])
        out, err = capsys.readouterr()
        return status, out, err

    return run


@pytest.fixture
def done(astro_scc):
    """Run a command that is done; its output and messages."""

    def run(*argv):
        status, out, err = astro_scc(*argv)
        assert status == 0, err
        return out, err

    return run


@pytest.fixture
def refused(astro_scc, here):
    """Run a command that is refused in one line; the line."""

    def run(*argv):
        before = set(here.rglob("*"))
        status, out, err = astro_scc(*argv)
        assert (status, out) == (2, "")
        assert set(here.rglob("*")) == before
        notes = "note: ", "warning: "
        (line,) = [k for k in err.splitlines() if not k.startswith(notes)]
        assert line.startswith(f"astro-scc {argv[0]}: error: ")
        return line

    return run


@pytest.fixture
def series(here):
    """Write epochs with beams of their own, in mas, or none."""

    def write(sizes, **changes):
        paths = write_simulation(small_jet(len(sizes)), here / "series")[:-1]
        for path, size in zip(paths, sizes, strict=True):
            with fits.open(path, mode="update") as hdus:
                header = hdus[0].header
                for key in ("BMAJ", "BMIN", "BPA"):
                    header.remove(key, ignore_missing=True)
                if size is not None:
                    header["BMAJ"] = header["BMIN"] = (size * u.mas).to_value(u.deg)
                    header["BPA"] = 0.0
                header.update(changes)
        return paths

    return write
