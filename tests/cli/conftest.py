# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images to run commands on, and commands that are run or refused."""

import astropy.units as u
import pytest
from astropy.io import fits

from astro_scc.cli import main
from astro_scc.simulation import simulate_two_fluid, write_simulation


@pytest.fixture(scope="session")
def jet(tmp_path_factory):
    """A folder with the images of a jet."""
    folder = tmp_path_factory.mktemp("jet")
    write_simulation(simulate_two_fluid(n_epochs=6, rng=1), folder)
    return folder


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder to run in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def no_figures(monkeypatch):
    """Reports without the time that figures take."""
    monkeypatch.setattr("astro_scc.report.page.draw_figures", lambda *_, **_k: {})


@pytest.fixture
def astro_scc(capsys):
    """Run a command; its status, output and messages."""

    def run(*argv):
        status = main([str(word) for word in argv])
        out, err = capsys.readouterr()
        return status, out, err

    return run


@pytest.fixture
def refused(astro_scc, here):
    """Run a command that is refused in one line; the line."""

    def run(*argv):
        before = set(here.rglob("*"))
        status, out, err = astro_scc(*argv)
        assert status == 2
        assert out == ""
        assert set(here.rglob("*")) == before
        (line,) = [line for line in err.splitlines() if not line.startswith("note: ")]
        assert line.startswith(f"astro-scc {argv[0]}: error: ")
        return line

    return run


@pytest.fixture
def series(here):
    """Write epochs with beams of their own, or none."""

    def write(beams, name="series", **changes):
        jet = simulate_two_fluid(n_epochs=len(beams), rng=1)
        paths = write_simulation(jet, here / name)[:-1]
        for path, beam in zip(paths, beams, strict=True):
            with fits.open(path, mode="update") as hdus:
                header = hdus[0].header
                for key in ("BMAJ", "BMIN", "BPA"):
                    header.remove(key, ignore_missing=True)
                if beam is not None:
                    header["BMAJ"] = header["BMIN"] = beam.major.to_value(u.deg)
                    header["BPA"] = 0.0
                header.update(changes)
        return paths

    return write
