# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc measure``: what it writes, says and refuses."""

import re
import tomllib

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable
from regions import Regions

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.cli import main
from astro_scc.cli.measure import STALE
from astro_scc.epochs import Beam
from astro_scc.report.page import PRODUCTS
from astro_scc.simulation import simulate_jet, write_simulation

QUICK = ["--scales", "2", "--max-speed", "30 mas/yr", "--n-trials", "20"]
#: What a measurement without a report writes.
WITHOUT_REPORT = list(PRODUCTS)
TABLES = [
    f"{name}.ecsv" for name in "components features positions sensitivity ssps".split()
]


def epochs(folder):
    return sorted(folder.glob("*.fits"))


@pytest.fixture(scope="module")
def measured(jet, tmp_path_factory):
    """A measurement without a report, as a folder."""
    folder = tmp_path_factory.mktemp("measured") / "out"
    argv = ["measure", *epochs(jet), "-o", folder, *QUICK, "--redshift", "15.8 %"]
    argv += ["--position-angle", "-90deg", "--no-report", "--quiet"]
    assert main([str(word) for word in argv]) == 0
    return folder


def test_measure_writes_tables_maps_and_settings(measured, jet):
    assert {path.name for path in measured.iterdir()} == set(WITHOUT_REPORT)
    table = QTable.read(measured / "components.ecsv")
    assert table["pm"].unit == u.mas / u.yr
    assert table["beta_app"].unit == u.one
    with open(measured / "config.toml", "rb") as file:
        config = tomllib.load(file)
    assert config.pop("versions") == table.meta["versions"]
    assert config == table.meta["configuration"]
    assert config["epochs"] == [str(path) for path in epochs(jet)]
    assert config["align"] == "none"
    assert config["common_beam"] is False
    assert config["max_speed"] == "30.0 mas / yr"
    assert config["position_angle"] == "-90.0 deg"
    assert config["seed"] == table.meta["seed"]
    assert config["redshift"] == table.meta["redshift"] == 0.158
    assert config["cosmology"] == "H0=71,Om0=0.27"
    assert table.meta["cosmology"]["Om0"] == 0.27
    with fits.open(measured / "scc.fits") as hdus:
        assert hdus[0].header["SEED"] == config["seed"]
        assert f"seed = {config['seed']}" in list(hdus[0].header["COMMENT"])


@pytest.mark.slow
def test_files_for_other_programs(measured, jet, astro_scc, here):
    again = (
        "measure",
        "--config",
        measured / "config.toml",
        "--no-report",
        "-o",
        "out",
    )
    assert astro_scc(*again, "--ds9-regions")[0] == 0
    for name in ("components", "features", "positions", "ssps"):
        table = QTable.read(here / "out" / "publication" / f"{name}.vot")
        original = QTable.read(measured / f"{name}.ecsv")
        assert table.colnames == original.colnames
        assert len(table) == len(original)
    ssps = QTable.read(measured / "ssps.ecsv")
    files = sorted((here / "out" / "ssp_regions").iterdir())
    assert [file.name[3:-4] for file in files] == [path.stem for path in epochs(jet)]
    for i, file in enumerate(files):
        assert len(Regions.read(file)) == np.sum(ssps["epoch"] == i)
    # They go with the measurement that they are of.
    assert astro_scc(*again, "--overwrite")[0] == 0
    assert {path.name for path in (here / "out").iterdir()} == set(WITHOUT_REPORT)


@pytest.mark.slow
def test_measure_is_what_python_gives(measured, jet):
    seed = QTable.read(measured / "components.ecsv").meta["seed"]
    scc = StackedCrossCorrelation(
        scales=[2], max_speed=30 * u.mas / u.yr, position_angle=-90 * u.deg
    )
    cube = EpochCube.read(epochs(jet)).align("none")
    expected = scc(cube, n_trials=20, rng=seed).components
    table = QTable.read(measured / "components.ecsv")
    assert len(table) == len(expected)
    for name in expected.colnames:
        np.testing.assert_array_equal(table[name], expected[name], err_msg=name)


@pytest.mark.slow
def test_the_configuration_gives_the_same_to_the_bit(measured, astro_scc, here):
    status, out, err = astro_scc(
        "measure", "--config", measured / "config.toml", "-o", "again", "--no-report",
        "--workers", "2",
    )  # fmt: skip
    assert (status, err) == (0, "")
    assert "Tables and maps: again" in out
    for name in (*TABLES, "scc.fits", "config.toml"):
        assert (here / "again" / name).read_bytes() == (measured / name).read_bytes()


@pytest.mark.slow
def test_defaults_that_follow_from_the_images_are_repeated_to_the_bit(
    jet, astro_scc, here
):
    first = ["-o", "a", "--scales", "0.4 mas", "--n-trials", "20", "--no-report"]
    assert (
        astro_scc("measure", *epochs(jet)[:5], *first, "--baseline", "20 70 d")[0] == 0
    )
    text = (here / "a" / "config.toml").read_text()
    # What was not given is found again.
    assert "max_speed" not in text
    assert "20.0 d" in text
    again = ("measure", "--config", "a/config.toml", "-o", "b", "--no-report")
    assert astro_scc(*again)[0] == 0
    for name in TABLES:
        assert (here / "a" / name).read_bytes() == (here / "b" / name).read_bytes()


@pytest.mark.slow
def test_the_command_line_comes_before_the_file(measured, astro_scc, here):
    status, _, err = astro_scc(
        "measure", "--config", measured / "config.toml", "-o", "new", "--no-report",
        "--distance", "16.7 Mpc", "--n-trials", "30", "--seed", "5", "--common-beam",
        "--before", "2000-05-15",
    )  # fmt: skip
    assert (status, err) == (0, "")
    meta = QTable.read(here / "new" / "components.ecsv").meta
    config = meta["configuration"]
    assert (config["n_trials"], config["seed"]) == (30, 5)
    assert config["common_beam"] is True
    assert "redshift" not in config
    assert "cosmology" not in config
    assert meta["distance"] == 16.7 * u.Mpc
    assert set(QTable.read(here / "new" / "ssps.ecsv")["epoch"]) == {0, 1, 2, 3, 4}


@pytest.mark.slow
def test_a_distance_in_the_file_gives_way_to_a_redshift(jet, astro_scc, here):
    # Where there are no patterns.
    (here / "corner.reg").write_text("image\ncircle(3,3,2)\n")
    (here / "jet.toml").write_text("distance = '16.7 Mpc'\nregion = 'corner.reg'\n")
    status, out, _ = astro_scc(
        "measure", *epochs(jet)[:5], *QUICK, "-o", "out", "--no-report",
        "--config", "jet.toml", "--redshift", "0.1", "--cosmology", "Planck18",
    )  # fmt: skip
    assert status == 0
    assert out.startswith("No motion found: no pattern has a match in another epoch")
    assert "speeds in c: redshift 0.1, Planck18, FlatLambdaCDM with H0 = 67.66" in out
    table = QTable.read(here / "out" / "components.ecsv")
    assert len(table) == 0
    assert table["pm"].unit == u.mas / u.yr
    assert "beta_app" in table.colnames
    assert table.meta["cosmology"]["name"] == "Planck18"
    assert table.meta["configuration"]["cosmology"] == "Planck18"
    assert "distance" not in table.meta["configuration"]


def test_other_versions_are_noted(measured, astro_scc, here):
    text = (measured / "config.toml").read_text()
    (here / "old.toml").write_text(re.sub('numpy = ".*"', 'numpy = "1.0"', text))
    _, _, err = astro_scc("measure", "--config", "old.toml", "-o", "x", "--n-trials", 1)
    note, error = err.splitlines()
    assert note.startswith("note: old.toml was written with numpy 1.0 (here ")
    assert "--n-trials" in error


@pytest.mark.slow
def test_a_region_restricts_the_patterns(jet, astro_scc, here):
    (here / "jet.reg").write_text("image\nbox(61,65,40,60,0)\n")
    status, _, err = astro_scc(
        "measure", *epochs(jet)[:5], *QUICK, "-o", "out", "--region", "jet.reg",
        "--no-report",
    )  # fmt: skip
    assert (status, err) == (0, "")
    ssps = QTable.read(here / "out" / "ssps.ecsv")
    inside = (ssps["x"].value > 39) & (ssps["x"].value < 81)
    assert 0 < ssps["in_region"].sum() < len(ssps)
    assert np.all(inside[ssps["in_region"]])


@pytest.mark.slow
def test_beams_that_differ_become_one(series, astro_scc, here):
    beams = [Beam(size * u.mas, size * u.mas) for size in (1, 1.2, 1, 1, 1)]
    paths = series(beams)
    status, _, err = astro_scc("measure", *paths, *QUICK, "-o", "a", "--no-report")
    assert status == 0
    assert err.startswith("note: the beams differ: convolving to a common one")
    config = tomllib.loads((here / "a" / "config.toml").read_text())
    assert config["common_beam"] is True
    history = QTable.read(here / "a" / "ssps.ecsv").meta["history"]
    assert any(line.startswith("common beam") for line in history)
    status, _, err = astro_scc(
        "measure", *paths, *QUICK, "-o", "b", "--no-report", "--no-common-beam"
    )
    said = "note: the beams differ and are left so, as --no-common-beam states\n"
    assert (status, err) == (0, said)
    config = tomllib.loads((here / "b" / "config.toml").read_text())
    assert config["common_beam"] is False


@pytest.mark.slow
def test_images_without_beams_are_left_as_they_are(series, astro_scc, refused):
    paths = series([None] * 5)
    status, _, err = astro_scc("measure", *paths, *QUICK, "-o", "a", "--no-report")
    assert status == 0
    said = "note: the epochs have no beams and are left as they are\n"
    assert err == said
    line = refused("measure", *paths, *QUICK, "-o", "b", "--common-beam")
    assert "the epochs have no beams" in line
    line = refused("measure", *paths, *QUICK, "-o", "b", "--align", "core")
    assert "epochs have none" in line


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    ["core", pytest.param("correlate", marks=pytest.mark.slow), "wcs", "table"],
)
def test_alignments(method, series, astro_scc, here):
    beam = Beam(1 * u.mas, 1 * u.mas)
    paths = series([beam] * 5)
    if method == "table":
        dates = EpochCube.read(paths).times.isot
        (here / "cores.csv").write_text(
            "date,east_mas,north_mas\n" + "".join(f"{day},0.2,0\n" for day in dates)
        )
        method = "cores.csv"
    status, _, err = astro_scc(
        "measure", *paths, *QUICK, "-o", "a", "--no-report", "--align", method
    )
    assert status == 0
    said = err.splitlines()
    assert all(line.startswith("warning: ") for line in said)
    meta = QTable.read(here / "a" / "components.ecsv").meta
    assert meta["configuration"]["align"] == method
    assert any(line.startswith("aligned on") for line in meta["history"])


@pytest.mark.slow
def test_a_report_tells_warnings_and_epochs_left_out(
    series, astro_scc, here, no_figures
):
    beam = Beam(1 * u.mas, 1 * u.mas)
    paths = series([beam] * 6, OBJECT="3C <273>")
    status, out, err = astro_scc(
        "measure", *paths, *QUICK, "-o", "out", "--after", "2000-01-15",
        "--max-speed", "900 mas/yr",
    )  # fmt: skip
    assert status == 0
    assert out.splitlines()[-1] == "Report: out/report.html"
    (line,) = err.splitlines()
    assert line.startswith("warning: max_speed moves")
    page = (here / "out" / "report.html").read_text()
    assert "3C &lt;273&gt;" in page
    assert "max_speed moves" in page
    assert paths[0].name in page
    assert "before 2000-01-15" in page
    assert "astro-scc measure --config out/config.toml -o FOLDER" in page


@pytest.mark.slow
def test_too_few_epochs_are_one_line(jet, astro_scc, here, no_figures):
    status, _, err = astro_scc("measure", *epochs(jet)[:3], *QUICK, "-o", "out")
    assert status == 0
    (line,) = err.splitlines()
    assert line.startswith("warning: 3 epochs allow no p_global below 0.33 (2/N!), so")
    page = (here / "out" / "report.html").read_text()
    assert line.removeprefix("warning: ") in page
    assert "measure more epochs." in page


@pytest.mark.slow
def test_overwriting_leaves_nothing_of_the_old_measurement(jet, astro_scc, here):
    out = here / "out"
    out.mkdir()
    for name in (*STALE, "notes.txt"):
        if "." in name:
            (out / name).write_text("old")
        else:
            (out / name).mkdir()
    status, _, _ = astro_scc(
        "measure", *epochs(jet)[:5], *QUICK, "-o", out, "--overwrite", "--no-report"
    )
    assert status == 0
    assert {path.name for path in out.iterdir()} == {*WITHOUT_REPORT, "notes.txt"}
    files = [out / name for name in WITHOUT_REPORT if "." in name]
    assert all(path.read_bytes() != b"old" for path in files)


@pytest.mark.slow
def test_a_cube_file_is_measured(jet, astro_scc, here):
    EpochCube.read(epochs(jet)[:5]).write("cube.fits")
    status, _, err = astro_scc("measure", "cube.fits", *QUICK, "-o", "a", "--no-report")
    assert (status, err) == (0, "")


@pytest.mark.slow
def test_the_scatter_of_the_epochs_is_said_and_what_mends_it(
    astro_scc, here, no_figures
):
    jet = simulate_jet(
        n_epochs=6, n_features=0, standing=6, length=8.0, alignment_error=0.5, rng=3,
        shape=(48, 120),
    )  # fmt: skip
    paths = write_simulation(jet, here / "series")[:-1]
    for align, bad in (("none", True), ("core", False)):
        argv = ("measure", *paths, "--scales", "2", "--max-speed", "3 mas/yr",
                "--n-trials", "20", "-o", align, "--align", align)  # fmt: skip
        status, out, err = astro_scc(*argv)
        assert status == 0
        assert ("warning: the epochs are aligned to 0." in err) == bad
        (said,) = re.findall(r"The epochs are aligned to (0\.\d\d) beams\.", out)
        assert (float(said) >= 0.2) == bad
        page = (here / align / "report.html").read_text(encoding="utf-8")
        assert "misalignment beams" in page
        assert ("the epochs are aligned to 0." in page) == bad
        meta = QTable.read(here / align / "components.ecsv").meta
        assert f"{meta['misalignment_beams']:.2f}" == said
