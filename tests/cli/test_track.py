# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc track``: what it writes, and what it refuses."""

import astropy.units as u
import numpy as np
import pytest
from astropy.table import QTable
from astropy.time import Time

from astro_scc.cli import main
from astro_scc.cli.track import PRODUCTS
from astro_scc.simulation import simulate_two_fluid, write_simulation

QUICK = ["--scales", "2", "--position-angle", "-90 deg", "--along", "-6 36 mas/yr",
         "--across", "-12 12 mas/yr", "--n-trials", "2", "--seed", "1",
         "--max-gap", "0"]  # fmt: skip


@pytest.fixture(scope="module")
def jet(tmp_path_factory):
    folder = tmp_path_factory.mktemp("jet")
    write_simulation(simulate_two_fluid(n_epochs=5, rng=1), folder)
    return sorted(folder.glob("*.fits"))


@pytest.fixture
def astro_scc(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def run(*argv):
        status = main(["track", *(str(word) for word in argv)])
        return status, *capsys.readouterr()

    return run


def test_all_products_are_written(astro_scc, jet, tmp_path):
    profile = QTable(
        {"r_mid": [5.0], "pm_parallel": [6.0], "pm_parallel_err": [1.0]},
        units=["mas", "mas/yr", "mas/yr"],
    )
    profile.write(tmp_path / "stack.ecsv")
    status, out, err = astro_scc(
        *jet, "-o", "out", *QUICK, "--votable", "--redshift", "0.1",
        "--profile", "stack.ecsv", "--half-width", "3 mas",
    )  # fmt: skip
    assert (status, err) == (0, "")
    assert {path.name for path in (tmp_path / "out").iterdir()} == set(PRODUCTS)
    tracks = QTable.read(tmp_path / "out" / "tracks.ecsv")
    features = QTable.read(tmp_path / "out" / "features.ecsv")
    assert f"{len(tracks)} tracks" in out
    assert set(features["track"]) == set(tracks["track"])
    assert len(features) == np.sum(tracks["n_epochs"])
    assert np.all(np.isfinite(tracks["beta_app"]))
    assert tracks.meta["configuration"]["seed"] == 1
    along = u.Quantity(tracks.meta["settings"]["along"])
    assert np.all(along == [-6, 36] * u.mas / u.yr)
    assert "speeds in c: redshift 0.1, FlatLambdaCDM with H0 = 71 km/s/Mpc, Om0" in out
    assert tracks.meta["cosmology"]["Om0"] == 0.27
    assert isinstance(tracks["beta_app"], u.Quantity)
    assert isinstance(features["date"], Time)
    assert np.all(tracks["first"] < tracks["last"])
    assert tracks.meta["versions"]
    seen = QTable.read(tmp_path / "out" / "tracks.vot")
    assert len(seen) == len(tracks)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_tables(astro_scc, jet, tmp_path):
    for name in ("a", "b"):
        assert astro_scc(*jet, "-o", name, *QUICK, "--no-figures")[0] == 0
    for table in ("features.ecsv", "tracks.ecsv", "track_profile.ecsv"):
        one, other = ((tmp_path / f / table).read_bytes() for f in "ab")
        assert one == other
    assert not list((tmp_path / "a").glob("*.png"))


@pytest.mark.slow
def test_no_tracks_are_empty_tables(astro_scc, jet, tmp_path):
    status, out, _ = astro_scc(
        *jet, "-o", "out", *QUICK, "--max-interval", "1 d", "--distance", "10 Mpc"
    )
    assert status == 0
    assert "0 tracks, 0 with an ejection epoch" in out
    tracks = QTable.read(tmp_path / "out" / "tracks.ecsv")
    assert len(tracks) == 0
    assert {"pm", "t_ej", "beta_app"} <= set(tracks.colnames)
    assert len(QTable.read(tmp_path / "out" / "features.ecsv")) == 0


@pytest.mark.slow
def test_a_configuration_of_a_measurement_is_understood(astro_scc, jet, tmp_path):
    (tmp_path / "jet.toml").write_text(
        'scales = [2]\nmax_speed = "30 mas/yr"\nposition_angle = "radial"\n'
        "kappa = 0.7\ndetection = 5\nn_trials = 2\nseed = 3\n"
    )
    status, _, _ = astro_scc(*jet, "-o", "out", "--config", "jet.toml", "--no-figures")
    assert status == 0
    settings = QTable.read(tmp_path / "out" / "tracks.ecsv").meta["settings"]
    assert settings["max_speed"] == 30 * u.mas / u.yr
    assert settings["kappa"] == 0.5


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--along", "5 mas/yr"],
            "--along '5 mas/yr' must be a smallest and a largest",
        ),
        (["--across", "0 5"], "--across '0 5' has no unit at its end"),
        (["--max-interval", "3 mas"], "must be a time with a unit, such as '1 yr'"),
        (["--max-gap", "x"], "--max-gap 'x' must be a whole number"),
        (["--tolerance", "x"], "--tolerance 'x' must be a number"),
        (["--min-epochs", "1"], "--min-epochs '1' must be 3 or more"),
        (
            ["--half-width", "-1 mas"],
            "--half-width '-1 mas' must be finite and above 0",
        ),
        (["--profile", "none.ecsv"], "none.ecsv: does not exist"),
        (["--profile", "bad.ecsv"], "bad.ecsv: is no ECSV table"),
        (["--profile", "other.ecsv"], "is no profile, it has no r_mid"),
        (["--along", "0 5 mas/yr"], "--along and across need a --position-angle"),
        (["--workers", "0"], "--workers must be at least 1"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(astro_scc, jet, tmp_path, options, message):
    (tmp_path / "bad.ecsv").write_text("nothing")
    QTable({"a": [1]}).write(tmp_path / "other.ecsv")
    status, out, err = astro_scc(*jet, "-o", "out", "--scales", "2", *options)
    assert status == 2
    assert out == ""
    assert message in err.splitlines()[-1]
    assert not (tmp_path / "out").exists()


def test_no_epochs_are_refused(astro_scc):
    status, _, err = astro_scc("-o", "out")
    assert status == 2
    assert "no epochs were given" in err


@pytest.mark.slow
def test_a_region_without_patterns(astro_scc, jet, tmp_path):
    (tmp_path / "r.reg").write_text("image\ncircle(3,3,2)\n")
    status, out, err = astro_scc(*jet, "-o", "out", *QUICK, "--region", "r.reg")
    assert status == 0
    assert "warning: r.reg: no significant pattern has its centroid inside, " in err
    assert len(QTable.read(tmp_path / "out" / "tracks.ecsv")) == 0
