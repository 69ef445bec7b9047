# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc demo``, and what it leaves."""

import subprocess
import sys

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable

from astro_scc.cli import main
from astro_scc.cli.measure import STALE
from astro_scc.report.page import PRODUCTS

#: What a measurement without a report writes.
TABLES = [name for name in PRODUCTS if name != "publication"]


@pytest.fixture
def quick(no_figures, monkeypatch):
    """A demo of few trials and no figures."""
    monkeypatch.setattr("astro_scc.cli.demo.N_TRIALS", 30)


@pytest.mark.slow
def test_demo_in_short(quick, astro_scc, here):
    status, out, err = astro_scc("demo")
    assert (status, err) == (0, "")
    simulated, measured = out.split("Measured:")
    assert {"slow", "fast"} <= set(simulated.split())
    assert "Report: astro_scc_demo/report.html" in measured
    folder = here / "astro_scc_demo"
    assert len(list((folder / "epochs").glob("*.fits"))) == 10
    table = QTable.read(folder / "components.ecsv")
    assert table.meta["configuration"]["region"] == "astro_scc_demo/region.reg"


@pytest.mark.slow
def test_demo(tmp_path, monkeypatch):
    command = [sys.executable, "-m", "astro_scc"]
    done = subprocess.run(
        [*command, "demo", "-o", "out"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    simulated, measured = done.stdout.split("Measured:")
    assert {"slow", "fast"} <= set(simulated.split())
    assert "Report: out/report.html" in measured
    folder = tmp_path / "out"
    found = {path.name for path in folder.iterdir()}
    needed = {*TABLES, "report.html", "publication", "epochs", "region.reg"}
    assert needed <= found <= {*needed, *STALE}
    table = QTable.read(folder / "components.ecsv")
    step = (0.1 * u.mas / (30 * u.day)).to(u.mas / u.yr)
    assert list(table["kind"][:2]) == ["moving", "moving"]
    for truth in (5, 20):
        apart = np.hypot(table["pm_parallel"] - truth * step, table["pm_transverse"])
        assert np.min(apart[:2]) < 1.5 * step
    # The demo is a measurement like any other.
    monkeypatch.chdir(tmp_path)
    again = ["measure", "--config", "out/config.toml", "-o", "again", "--no-report"]
    assert main(again) == 0
    for name in TABLES:
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()
