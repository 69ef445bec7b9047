# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Results stay the same: tables that were made once, and are measured again."""

from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time

from astro_scc import Beam, EpochCube, StackedCrossCorrelation
from astro_scc.cli import main
from astro_scc.epochs import read_components, restore

#: Tables of `astro-scc` on simulated images; a script may import and rewrite them.
SIMULATED = {
    "jet": (["jet", "--epochs", "8"], ["measure"], "streams"),
    "two_fluid": (["two-fluid", "--epochs", "6"],
                  ["measure", "--max-speed", "40 mas/yr", "--redshift", "0.1"],
                  "streams"),
    "profile": (["jet", "--epochs", "8"],
                ["profile", "--bins", "1 4 8 mas", "--position-angle", "270 deg"],
                "profile"),
    "tracks": (["jet", "--epochs", "6"], ["track"], "features"),
    "features": (["jet", "--epochs", "8"], ["measure"], "features"),
}  # fmt: skip
BEAMS = {"0430+052": Beam(1.2 * u.mas, 0.5 * u.mas, -5 * u.deg)}
BEAMS["1226+023"] = Beam(1.0 * u.mas, 0.5 * u.mas, -7 * u.deg)
REAL = ("0003+380", "paper_test", *BEAMS)


def simulated(name, folder):
    """The table of a command on simulated images."""
    jet, command, table = SIMULATED[name]
    assert main(["simulate", *jet, str(folder / "epochs"), "--seed", "3"]) == 0
    files = sorted(map(str, (folder / "epochs").glob("*.fits")))
    options = ["-o", str(folder / "out"), "--seed", "1", "--scales", "1,2,3"]
    options += ["--n-trials", "199"] * (command != ["track"])
    assert main([*command, *files, *options, "--quiet"]) == 0
    return QTable.read(folder / "out" / f"{table}.ecsv")


def real(name, shared_data):
    """The streams of a jet that was observed, or of the paper's."""
    if name in BEAMS:
        components = read_components(shared_data / "mojave_xviii" / f"{name}.ecsv")
        how = {"pixel_scale": 0.1 * u.mas, "noise": 0.3 * u.mJy / u.beam, "rng": 1}
        cube = restore(components, beam=BEAMS[name], **how)[::3]
    elif name == "paper_test":
        cube = EpochCube.read(str(shared_data / name / "two_fluid" / "*.fits"))
    else:
        cube = EpochCube.read(str(shared_data / name / "*.fits")).to_common_beam()
    return StackedCrossCorrelation()(cube, n_trials=199, rng=1).streams


def compare(table, path):
    """Both tables have the same columns and the same values, to rounding."""
    golden = QTable.read(path)
    assert table.colnames == golden.colnames
    assert len(table) == len(golden)
    for name in golden.colnames:
        new, old = table[name], golden[name]
        if isinstance(old, Time):
            new, old = (np.asarray(c.decimalyear) for c in (new, old))
        assert new.dtype.kind == old.dtype.kind, name
        if old.dtype.kind in "fc":
            assert getattr(new, "unit", None) == getattr(old, "unit", None), name
            new, old = (np.asarray(getattr(c, "value", c)) for c in (new, old))
            # At a maximum, rounding by another processor moves the place by its root;
            # planes are of single precision.
            rtol = 1e-3 if name.endswith("jitter") else 1e-4
            np.testing.assert_allclose(new, old, rtol=rtol, atol=1e-6, err_msg=name)
        else:
            assert list(new) == list(old), name


GOLDEN = Path(__file__).parent / "golden"


@pytest.mark.slow
@pytest.mark.parametrize("name", SIMULATED)
def test_commands_give_the_same_tables(name, tmp_path):
    compare(simulated(name, tmp_path), GOLDEN / f"{name}.ecsv")


@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_real_jets_give_the_same_streams(name, shared_data):
    compare(real(name, shared_data), GOLDEN / f"{name}.ecsv")
