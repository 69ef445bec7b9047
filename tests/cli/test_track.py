# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc track``: what it writes, and what it refuses."""

import re
from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time

from astro_scc.cli import main
from astro_scc.cli.summary import feature_lines
from astro_scc.cli.track import PRODUCTS
from astro_scc.columns import cell
from astro_scc.features import find_features
from astro_scc.simulation import simulate_jet, simulate_static, write_simulation


@pytest.fixture(scope="module")
def jet(tmp_path_factory):
    folder = tmp_path_factory.mktemp("jet")
    write_simulation(simulate_jet(n_epochs=8, dispersion=0.1, rng=1), folder)
    return sorted(folder.glob("*.fits"))


@pytest.fixture
def astro_scc(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def run(*argv):
        status = main(["track", *(str(word) for word in argv)])
        return status, *capsys.readouterr()

    return run


def test_all_products_are_written(astro_scc, jet, tmp_path):
    status, out, err = astro_scc(
        *jet, "-o", "out", "--redshift", "0.1", "--seed", "1", "--pdf"
    )
    assert (status, err) == (0, "")
    assert {path.name for path in (tmp_path / "out").iterdir()} == set(PRODUCTS)
    features = QTable.read(tmp_path / "out" / "features.ecsv")
    positions = QTable.read(tmp_path / "out" / "positions.ecsv")
    secure = features[features["secure"]]
    assert f"{len(features)} features, {len(secure)} of them secure" in out
    row = secure[0]
    line = next(x for x in out.splitlines() if x.startswith(f"{row['feature']} "))
    for word in (
        row["first"].isot[:10],
        cell(row, "beta_app", "+-"),
    ):
        assert word in line
    assert set(positions["feature"]) == set(features["feature"])
    assert len(positions) == np.sum(features["n_epochs"])
    assert features.meta["configuration"]["seed"] == 1
    assert "speeds in c: redshift 0.1, FlatLambdaCDM with H0 = 71 km/s/Mpc, Om0" in out
    assert features.meta["cosmology"]["Om0"] == 0.27
    assert isinstance(features["beta_app"], u.Quantity)
    assert isinstance(positions["date"], Time)
    assert np.all(features["first"] < features["last"])
    assert np.all(features["first"] < features["date"])
    assert features.meta["versions"]
    assert len(QTable.read(tmp_path / "out" / "publication" / "features.vot")) == len(
        features
    )
    assert len(QTable.read(tmp_path / "out" / "publication" / "positions.vot")) == len(
        positions
    )


@pytest.mark.slow
@pytest.mark.parametrize("detections", ["gaussians", "ssp"])
def test_the_same_seed_gives_the_same_tables(astro_scc, jet, tmp_path, detections):
    for name, workers in (("a", "1"), ("b", "2")):
        words = ["-o", name, "--seed", "1", "--no-figures", "--workers", workers]
        assert astro_scc(*jet, *words, "--detections", detections)[0] == 0
    for table in ("features.ecsv", "positions.ecsv"):
        one, other = ((tmp_path / f / table).read_bytes() for f in "ab")
        assert one == other
    assert not list((tmp_path / "a").glob("*.png"))


def test_no_features_are_empty_tables(astro_scc, jet, tmp_path):
    status, out, _ = astro_scc(*jet[:3], "-o", "out", "--distance", "10 Mpc")
    assert status == 0
    assert "0 features, 0 of them secure." in out
    assert "No detections of four epochs or more are in steady motion." in out
    features = QTable.read(tmp_path / "out" / "features.ecsv")
    assert len(features) == 0
    assert {"pm", "t_ej", "beta_app"} <= set(features.colnames)
    assert len(QTable.read(tmp_path / "out" / "positions.ecsv")) == 0


def test_what_secure_features_would_need_is_said():
    features = find_features(simulate_static(n_epochs=6, rng=1).cube)
    lines = feature_lines(features.table)
    assert lines[0] == f"{len(features)} features, 0 of them secure."
    assert "moves by at least" in lines[1]
    assert re.match(r"The nearest to that is feature \d+: p_false .* errors", lines[2])
    (years,) = re.findall(r"would have to be seen for (\S+) yr", lines[2])
    assert float(years) > features.cube.years[-1].to_value(u.yr)


@pytest.mark.slow
def test_a_configuration_of_a_measurement_is_understood(astro_scc, jet, tmp_path):
    (tmp_path / "jet.toml").write_text(
        'scales = [2]\nmax_speed = "30 mas/yr"\nposition_angle = "radial"\n'
        "kappa = 0.7\ndetection = 5\nn_trials = 2\nseed = 3\n"
    )
    status, _, _ = astro_scc(*jet, "-o", "out", "--config", "jet.toml", "--no-figures")
    assert status == 0
    kept = QTable.read(tmp_path / "out" / "features.ecsv").meta["configuration"]
    assert (kept["seed"], kept["detection"]) == (3, 5)
    assert not {"max_speed", "kappa", "n_trials"} & set(kept)


def test_images_without_beams_have_features_of_ssps(astro_scc, tmp_path):
    cube = simulate_jet(n_epochs=8, dispersion=0.1, rng=1).cube
    replace(cube, beams=None).write(tmp_path / "cube.fits")
    assert astro_scc("cube.fits", "-o", "out", "--no-figures")[0] == 0
    features = QTable.read(tmp_path / "out" / "features.ecsv")
    assert features["secure"].any()
    assert np.all(features["size"].value == 0)


def test_a_region_without_emission(astro_scc, jet, tmp_path):
    (tmp_path / "r.reg").write_text("image\ncircle(3,3,2)\n")
    status, out, err = astro_scc(*jet, "-o", "out", "--region", "r.reg")
    assert status == 0
    assert (
        "warning: no emission beside the core was detected in any epoch in r.reg" in err
    )
    assert len(QTable.read(tmp_path / "out" / "features.ecsv")) == 0


def test_options_of_streams_are_none_of_features(astro_scc, jet, capsys):
    for option in ("--max-speed", "--position-angle", "--n-trials", "--profile"):
        with pytest.raises(SystemExit):
            astro_scc(*jet, "-o", "out", option, "1")
        assert f"unrecognized arguments: {option}" in capsys.readouterr().err
