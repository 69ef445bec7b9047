# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc profile``, from files to tables, and what users get wrong."""

import astropy.units as u
import pytest
from astropy.table import QTable

from astro_scc.cli import main
from astro_scc.simulation import JetSimulation, Stream


@pytest.fixture(scope="module")
def cube_file(tmp_path_factory):
    flow = Stream("flow", dx=8.0, sigma=3.0, density=0.4)
    cube = JetSimulation([flow], n_epochs=6).run(rng=2).cube
    path = tmp_path_factory.mktemp("epochs") / "cube.fits"
    cube.write(path)
    return str(path)


OPTIONS = ["--position-angle", "270 deg", "--max-speed", "20 mas/yr", "--scales", "2",
           "--n-trials", "25"]  # fmt: skip


@pytest.mark.slow
def test_the_whole_stretch(cube_file, tmp_path, capsys):
    """Its acceleration, and the speeds of its scales."""
    out = tmp_path / "out"
    options = [*OPTIONS, "--scales", "1,2"]
    command = ["profile", cube_file, "-o", str(out), "--bins", "0 20 mas", *options]
    assert main(command) == 0
    text = capsys.readouterr().out
    assert "acceleration: " in text
    assert "Speeds of the finest and coarser scales: " in text
    table = QTable.read(out / "profile.ecsv", format="ascii.ecsv")
    found = table.meta["acceleration"]
    assert found["acceleration"].unit == u.mas / u.yr**2
    assert 0 <= found["p_value"] <= 1
    (row,) = QTable.read(out / "scales.ecsv", format="ascii.ecsv")
    assert (row["first"], row["second"]) == ("finest", "coarser")


@pytest.mark.slow
def test_profile(cube_file, tmp_path, capsys):
    out = tmp_path / "out"
    command = ["profile", cube_file, "-o", str(out), "--bins", "0 10 20 mas",
               "--redshift", "0.1", "--seed", "1", *OPTIONS]  # fmt: skip
    assert main(command) == 0
    text = capsys.readouterr().out
    assert "separation (mas)" in text
    assert "p_fdr" in text
    assert "speeds in c: redshift 0.1, FlatLambdaCDM with H0 = 71 km/s/Mpc" in text
    names = sorted(path.name for path in out.iterdir())
    assert names == [
        "config.toml", "position_angles.png", "profile.ecsv", "profile.png",
        "publication", "velocity_maps.png",
    ]  # fmt: skip
    table = QTable.read(out / "profile.ecsv", format="ascii.ecsv")
    assert table.colnames[:3] == ["r_min", "r_max", "r_mid"]
    assert "p_fdr" in table.colnames
    assert table["beta_app"].unit == u.one
    # The configuration does it again, to the bit.
    again = tmp_path / "again"
    config = str(out / "config.toml")
    assert main(["profile", "--config", config, "-o", str(again), "--quiet"]) == 0
    first, second = ((p / "profile.ecsv").read_text() for p in (out, again))
    assert first == second


@pytest.mark.slow
def test_along_the_ridge_with_windows(cube_file, tmp_path):
    out = tmp_path / "out"
    command = ["profile", cube_file, "-o", str(out), "--bins", "8 14 mas", "--quiet",
               "--window", "10 mas", *OPTIONS]  # fmt: skip
    command[command.index("270 deg")] = "ridge"
    assert main(command) == 0
    table = QTable.read(out / "profile.ecsv", format="ascii.ecsv")
    assert QTable.read(out / "publication" / "profile.vot").colnames == table.colnames
    assert table.meta["along"] == "ridge"
    assert set(table["r_max"].to_value(u.mas)) <= {13.0, 19.0}


@pytest.mark.slow
def test_a_region_without_patterns(cube_file, tmp_path, capsys):
    region = tmp_path / "r.reg"
    region.write_text("image\ncircle(3,3,2)\n")
    command = ["profile", cube_file, "-o", str(tmp_path / "out"), *OPTIONS]
    assert main([*command, "--bins", "0 10 mas", "--region", str(region)]) == 2
    said = capsys.readouterr().err.splitlines()
    warned, refused = (line for line in said if not line.startswith("note: "))
    assert warned.startswith(f"warning: {region}: no significant pattern has its cent")
    assert "no SSP lies in the bins" in refused
    assert not (tmp_path / "out").exists()
