# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The commands: what they write, what they say, and what they refuse."""

import re
import subprocess
import sys
import tomllib
import warnings

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable, vstack
from astropy.time import Time
from regions import Regions

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.cli import main
from astro_scc.cli.measure import PRODUCTS, STALE
from astro_scc.cli.program import build_parser
from astro_scc.cli.reporter import Reporter
from astro_scc.cli.summary import component_lines, with_error
from astro_scc.epochs import Beam
from astro_scc.exceptions import EpochWarning
from astro_scc.simulation import simulate_two_fluid, write_simulation

QUICK = ["--scales", "2", "--max-speed", "30 mas/yr", "--n-trials", "20"]
TABLES = ("components.ecsv", "ssps.ecsv")


@pytest.fixture(scope="module")
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


def epochs(folder):
    return sorted(folder.glob("*.fits"))


# -- the program -------------------------------------------------------------------


def test_help_imports_nothing_that_takes_time():
    code = (
        "import sys\nfrom astro_scc.cli import main\n"
        "try:\n    main(sys.argv[1:])\nexcept SystemExit as leave:\n"
        "    assert leave.code == 0\n"
        "heavy = {'numpy', 'scipy', 'astropy', 'matplotlib', 'photutils', 'tqdm'}\n"
        "assert heavy.isdisjoint(sys.modules), heavy & set(sys.modules)"
    )
    for words in ([], ["demo"], ["measure"], ["inspect"], ["track"], ["survey"]):
        done = subprocess.run(
            [sys.executable, "-c", code, *words, "--help"],
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stdout.startswith("usage: astro-scc")


def test_an_option_of_several_commands_is_explained_alike():
    parser = build_parser()
    (commands,) = (a for a in parser._actions if hasattr(a, "choices") and a.choices)
    # What differs by what a command makes or takes.
    own = {"--output", "--votable", "--region", "--position-angle", "--kappa",
           "--n-trials", "--seed", "--epochs"}  # fmt: skip
    said = {}
    for command in commands.choices.values():
        for action in command._actions:
            for option in set(action.option_strings) - own:
                if option.startswith("--"):
                    said.setdefault(option, set()).add((action.metavar, action.help))
    assert {option for option, texts in said.items() if len(texts) > 1} == set()
    assert len(said) > 25


@pytest.mark.parametrize(
    ("argv", "line"),
    [
        ([], "astro-scc: error: the following arguments are required: COMMAND"),
        (["fly"], "astro-scc: error: argument COMMAND: invalid choice: 'fly'"),
        (["measure", "a.fits"], "astro-scc measure: error: the following arguments"),
        (["measure", "--bins", "3", "-o", "x"], "astro-scc: error: unrecognized arg"),
        (["simulate", "jet", "x"], "astro-scc simulate: error: argument JET: invalid"),
        (["simulate", "static", "x", "--epochs", "b"], "astro-scc simulate: error: "),
    ],
)
def test_arguments_that_are_not_understood(capsys, argv, line):
    with pytest.raises(SystemExit) as leave:
        main(argv)
    assert leave.value.code == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(line)
    assert len(err.splitlines()) == 1
    assert err.rstrip().endswith("--help")


def test_an_interrupt_is_one_line(astro_scc, here, monkeypatch):
    def interrupt(*args, **kwargs):
        raise KeyboardInterrupt

    monkeypatch.setattr("astro_scc.simulation.simulate_static", interrupt)
    status, out, err = astro_scc("simulate", "static", "out")
    assert (status, out) == (130, "")
    assert err == "astro-scc simulate: error: interrupted, nothing was written\n"
    assert not list(here.iterdir())
    with pytest.raises(KeyboardInterrupt):
        main(["simulate", "static", "out", "--debug"])


@pytest.mark.parametrize("error", [ValueError, TypeError, OSError, MemoryError])
def test_errors_of_the_library_are_one_line(astro_scc, monkeypatch, here, error):
    def fail(*args, **kwargs):
        raise error("it is\nwrong")

    monkeypatch.setattr("astro_scc.simulation.simulate_static", fail)
    status, _, err = astro_scc("simulate", "static", "out")
    assert status == 2
    assert re.fullmatch(r"astro-scc simulate: error: .*it is wrong\)?\n", err)
    with pytest.raises(error):
        main(["simulate", "static", "out", "--debug"])


def test_mistakes_of_the_program_are_not_hidden(monkeypatch, here):
    def fail(*args, **kwargs):
        raise AssertionError

    monkeypatch.setattr("astro_scc.simulation.simulate_static", fail)
    with pytest.raises(AssertionError):
        main(["simulate", "static", "out"])
    assert not list(here.iterdir())


def test_a_reader_that_goes_away_is_no_error(tmp_path):
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "astro_scc.cli",
            "simulate",
            "static",
            "x",
            "--epochs=1",
        ],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait() == 0


def test_warnings_are_lines_each_once(capsys):
    reporter = Reporter("astro-scc test")
    with reporter.warnings_as_lines():
        for _ in range(2):
            warnings.warn("look\n  here", EpochWarning, stacklevel=1)
    assert capsys.readouterr().err == "warning: look here\n"
    assert reporter.warnings == ["look here"]
    quiet = Reporter("astro-scc test", quiet=True)
    with quiet.warnings_as_lines():
        warnings.warn("look here", EpochWarning, stacklevel=1)
        quiet.note("this")
        quiet.say("that")
    assert capsys.readouterr() == ("", "")
    assert quiet.warnings == ["look here"]


# -- measure -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def measured(jet, tmp_path_factory):
    """A measurement without a report, as a folder."""
    folder = tmp_path_factory.mktemp("measured") / "out"
    argv = ["measure", *epochs(jet), "-o", folder, *QUICK, "--redshift", "0.158"]
    argv += ["--position-angle", "-90 deg", "--no-report", "--quiet"]
    assert main([str(word) for word in argv]) == 0
    return folder


def test_measure_writes_tables_maps_and_settings(measured, jet):
    assert {path.name for path in measured.iterdir()} == set(PRODUCTS[:4])
    table = QTable.read(measured / "components.ecsv")
    assert table["pm"].unit == u.mas / u.yr
    assert "beta_app" in table.colnames
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
    assert config["cosmology"] == "H0=71,Om0=0.27"
    assert table.meta["cosmology"]["Om0"] == 0.27
    with fits.open(measured / "scc.fits") as hdus:
        assert hdus[0].header["SEED"] == config["seed"]
        assert f"seed = {config['seed']}" in list(hdus[0].header["COMMENT"])


def test_files_for_other_programs(measured, jet, astro_scc, here):
    again = (
        "measure",
        "--config",
        measured / "config.toml",
        "--no-report",
        "-o",
        "out",
    )
    assert astro_scc(*again, "--votable", "--ds9-regions")[0] == 0
    for name in ("components", "ssps"):
        table = QTable.read(here / "out" / f"{name}.vot")
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
    assert {path.name for path in (here / "out").iterdir()} == set(PRODUCTS[:4])


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


def test_the_configuration_gives_the_same_to_the_bit(measured, astro_scc, here):
    status, out, err = astro_scc(
        "measure", "--config", measured / "config.toml", "-o", "again", "--no-report",
        "--workers", "2",
    )  # fmt: skip
    assert (status, err) == (0, "")
    assert "Tables and maps: again" in out
    for name in (*TABLES, "scc.fits", "config.toml"):
        assert (here / "again" / name).read_bytes() == (measured / name).read_bytes()


def test_defaults_that_follow_from_the_images_are_repeated_to_the_bit(
    jet, astro_scc, here
):
    first = ["-o", "a", "--scales", "0.4 mas", "--n-trials", "20", "--no-report"]
    assert (
        astro_scc("measure", *epochs(jet)[:5], *first, "--baseline", "20 70 d")[0] == 0
    )
    text = (here / "a" / "config.toml").read_text()
    assert 'max_speed = "' in text
    assert "20.0 d" in text
    assert astro_scc("measure", "--config", "a/config.toml", "-o", "b")[0] == 0
    for name in TABLES:
        assert (here / "a" / name).read_bytes() == (here / "b" / name).read_bytes()


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


def test_a_distance_in_the_file_gives_way_to_a_redshift(jet, astro_scc, here):
    (here / "jet.toml").write_text(
        "distance = '16.7 Mpc'\ndetection = 1e6\nsegmentation = 1e6\n"
    )
    status, out, _ = astro_scc(
        "measure", *epochs(jet)[:5], *QUICK, "-o", "out", "--no-report",
        "--config", "jet.toml", "--redshift", "0.1", "--cosmology", "Planck18",
    )  # fmt: skip
    assert status == 0
    assert out.startswith("No velocity component stands out.")
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
    assert (status, err) == (0, "")
    config = tomllib.loads((here / "b" / "config.toml").read_text())
    assert config["common_beam"] is False


def test_images_without_beams_are_left_as_they_are(series, astro_scc, refused):
    paths = series([None] * 5)
    status, _, err = astro_scc("measure", *paths, *QUICK, "-o", "a", "--no-report")
    assert status == 0
    assert err == "note: the epochs have no beams and are left as they are\n"
    line = refused("measure", *paths, *QUICK, "-o", "b", "--common-beam")
    assert "the epochs have no beams" in line
    line = refused("measure", *paths, *QUICK, "-o", "b", "--align", "core")
    assert "epochs have none" in line


@pytest.mark.parametrize("method", ["core", "correlate", "wcs", "table"])
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
    assert all(line.startswith("warning: ") for line in err.splitlines())
    meta = QTable.read(here / "a" / "components.ecsv").meta
    assert meta["configuration"]["align"] == method
    assert any(line.startswith("aligned on") for line in meta["history"])


def test_a_report_tells_warnings_and_epochs_left_out(series, astro_scc, here):
    beam = Beam(1 * u.mas, 1 * u.mas)
    paths = series([beam] * 6, OBJECT="3C <273>")
    status, out, err = astro_scc(
        "measure", *paths, *QUICK, "-o", "out", "--after", "2000-01-15",
        "--max-speed", "900 mas/yr",
    )  # fmt: skip
    assert status == 0
    assert out.splitlines()[-1] == "Report: out/report.html"
    (line,) = err.splitlines()
    assert line.startswith("warning: the largest speed moves")
    page = (here / "out" / "report.html").read_text()
    assert "3C &lt;273&gt;" in page
    assert "the largest speed moves" in page
    assert paths[0].name in page
    assert "before 2000-01-15" in page
    assert "astro-scc measure --config out/config.toml -o FOLDER" in page


def test_too_few_epochs_are_one_line(jet, astro_scc, here):
    status, _, err = astro_scc("measure", *epochs(jet)[:3], *QUICK, "-o", "out")
    assert status == 0
    (line,) = err.splitlines()
    assert line.startswith("warning: 3 epochs allow no p_global below 0.33 (2/N!), so")
    page = (here / "out" / "report.html").read_text()
    assert line.removeprefix("warning: ") in page
    assert "measure more epochs." in page


def test_overwriting_leaves_nothing_of_the_old_measurement(jet, astro_scc, here):
    out = here / "out"
    out.mkdir()
    for name in (*STALE, "notes.txt"):
        (out / name).write_text("old")
    status, _, _ = astro_scc(
        "measure", *epochs(jet)[:5], *QUICK, "-o", out, "--overwrite", "--no-report"
    )
    assert status == 0
    assert {path.name for path in out.iterdir()} == {*PRODUCTS[:4], "notes.txt"}
    assert all((out / name).read_bytes() != b"old" for name in PRODUCTS[:4])


def test_the_report_writes_what_is_known_to_be_stale():
    from astro_scc.report.figures import CAPTIONS

    assert set(PRODUCTS[5:]) == {f"{name}.png" for name in CAPTIONS}


def test_a_cube_file_is_measured(jet, astro_scc, here):
    EpochCube.read(epochs(jet)[:5]).write("cube.fits")
    status, _, err = astro_scc("measure", "cube.fits", *QUICK, "-o", "a", "--no-report")
    assert (status, err) == (0, "")


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--max-speed", "2 mas"], "--max-speed '2 mas': must be an angle per time"),
        (["--scales", "big"], "--scales 'big': "),
        (["--scales", "0.01 mas"], "scale 0.01 mas is 0.1 px"),
        (["--scales", "9"], "9"),
        (["--position-angle", "65"], "'65': must be radial, ridge, fit or an angle"),
        (["--baseline", "1 yr"], "--baseline '1 yr': must be a shortest and a longest"),
        (["--baseline", "5 6 yr"], "no two epochs are 5 to 6 yr apart"),
        (["--kappa", "1.2"], "kappa must be between 0 and 1"),
        (["--kernel", "9"], "kernel must be"),
        (["--n-trials", "1"], "--n-trials '1': must be 2 to"),
        (["--seed", "-3"], "--seed '-3': must be 0 to"),
        (["--workers", "0"], "--workers must be at least 1"),
        (["--redshift", "-1"], "--redshift '-1': must be above 0"),
        (["--redshift", "1", "--distance", "1 Mpc"], "--distance needs neither"),
        (["--cosmology", "Planck18"], "--cosmology needs a --redshift"),
        (["--redshift", "1", "--cosmology", "Big"], "--cosmology 'Big': is no cosmol"),
        (["--distance", "1 mas"], "--distance '1 mas': must be a length"),
        (["--before", "soon"], "--before 'soon': is no date"),
        (["--before", "1990-01-01"], "no epoch is left between --after and --before"),
        (["--before", "2000-01-15"], "velocities need at least two epochs"),
        (["--align", "coer"], "align method 'coer' is none of"),
        (["--region", "no.reg"], "no.reg: No such file or directory"),
        (["--region", "odd.reg"], "odd.reg: "),
        (["--config", "no.toml"], "no.toml: No such file or directory"),
        (["--config", "odd.toml"], "odd.toml: unknown key 'max_sped', did you mean"),
        (["--config", "unit.toml"], "unit.toml: max_speed = '2 mas' must be"),
        (["--config", "level.toml"], "level must be between 0 and 1, got 1.5"),
        (["-o", "file"], "file: is a file"),
        (["-o", "full"], "full: exists and is not empty"),
    ],
)
def test_what_a_user_gets_wrong(jet, refused, here, options, reason):
    (here / "odd.reg").write_text("image\ncircle(9999,9999,3)\n")
    (here / "odd.toml").write_text("max_sped = '2 mas/yr'\n")
    (here / "unit.toml").write_text("max_speed = '2 mas'\n")
    (here / "level.toml").write_text("level = 1.5\n")
    (here / "file").write_text("mine")
    (here / "full").mkdir()
    (here / "full" / "mine.txt").write_text("mine")
    assert reason in refused("measure", *epochs(jet), "-o", "out", *options)


def test_epochs_that_are_none(refused, here, jet):
    (here / "note.fits").write_text("no image")
    assert "no epochs were given" in refused("measure", "-o", "out")
    assert "no.fits: no such file" in refused("measure", "no.fits", "-o", "out")
    line = refused("measure", "no*.fit", "-o", "out")
    assert "no*.fit: no file matches" in line
    assert "note.fits: cannot be read as FITS" in refused(
        "measure", epochs(jet)[0], "note.fits", "-o", "out"
    )


# -- the other commands --------------------------------------------------------------


def test_simulate_and_its_seed(astro_scc, here):
    status, out, err = astro_scc("simulate", "two-fluid", "a", "--epochs", 3, "--dense")
    assert (status, err) == (0, "")
    seed = int(re.search(r"\(seed (\d+)\)", out).group(1))
    truth = QTable.read(here / "a" / "truth.ecsv")
    assert truth.meta["seed"] == seed
    assert set(truth["group"]) == {"slow", "fast"}
    status, out, _ = astro_scc(
        "simulate", "two-fluid", "b/c/", "--epochs", 3, "--dense", "--seed", seed
    )
    assert status == 0
    assert "b/c/*.fits -o b/c-measured" in out
    for path in (here / "a").iterdir():
        assert path.read_bytes() == (here / "b" / "c" / path.name).read_bytes()
    assert len(epochs(here / "a")) == 3


@pytest.mark.parametrize("jet", ["random-velocity", "ballistic", "static", "unrelated"])
def test_every_jet_is_simulated(astro_scc, here, jet):
    status, _, err = astro_scc("simulate", jet, "a", "--epochs", 2, "--seed", 1)
    assert (status, err) == (0, "")
    assert len(epochs(here / "a")) == 2


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["static", "x", "--dense"], "--dense is for the two-fluid jet"),
        (["static", "x", "--epochs", "0"], "--epochs must be at least 1"),
        (["static", "x", "--seed", "one"], "--seed 'one': must be a whole number"),
        (["static", "."], ".: exists and is not empty"),
    ],
)
def test_simulations_that_are_refused(refused, here, options, reason):
    (here / "mine.txt").write_text("mine")
    assert reason in refused("simulate", *options)


MODEL = "1.0v 0.0v 0v 0.2v 1 0 1\n0.3v 2.0v 45v 0.5v 1 0 1\n"


@pytest.fixture
def models(here):
    """Two models of difmap."""
    names = ["3c1_2006-03-09.mod", "3c1_2007-03-09.mod"]
    for name in names:
        (here / name).write_text(MODEL)
    return names


def test_restore(models, astro_scc, here):
    options = ["--beam", "1.0 mas 0.5 mas -7 deg", "--pixel", "0.1 mas"]
    noise = ["--noise", "0.3 mJy/beam"]
    status, out, err = astro_scc("restore", *models, "-o", "a", *options, *noise)
    assert (status, err) == (0, "")
    seed = re.search(r"seed of the noise (\d+)", out).group(1)
    cube = EpochCube.read(here / "a" / "*.fits")
    assert len(cube) == 2
    assert cube.beams[0] == Beam(1 * u.mas, 0.5 * u.mas, -7 * u.deg)
    assert cube.pixel_scale.round(6) == 0.1 * u.mas
    header = fits.getheader(epochs(here / "a")[0])
    assert any(f"seed {seed}" in line for line in header["HISTORY"])
    astro_scc("restore", *models, "-o", "b", *options, *noise, "--seed", seed)
    for path in (here / "a").iterdir():
        assert path.read_bytes() == (here / "b" / path.name).read_bytes()


def test_restore_some_dates_with_a_round_beam(models, astro_scc, here):
    status, out, _ = astro_scc(
        "restore", *models, "-o", "a", "--beam", "0.8 mas", "--pixel", "100 uas",
        "--before", "2007-01-01",
    )  # fmt: skip
    assert status == 0
    assert "seed" not in out
    cube = EpochCube.read(here / "a" / "*.fits")
    assert cube.times.isot.tolist() == ["2006-03-09T00:00:00.000"]
    assert cube.beams[0] == Beam(0.8 * u.mas, 0.8 * u.mas)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--beam", "1.0 0.5"], "--beam '1.0 0.5': has no unit at its end; give major"),
        (["--beam", "1 mas 2 mas"], "--beam '1 mas 2 mas': the beam's minor axis"),
        (["--beam", "1 mas 1 mas 1 Jy"], "--beam '1 mas 1 mas 1 Jy': "),
        (["--beam", "1 1 1 1 mas"], "has too many numbers"),
        (["--pixel", "0.1"], "--pixel '0.1': has no unit at its end; it must be one"),
        (["--pixel", "0.1 yr"], "--pixel '0.1 yr': must be one number above 0"),
        (["--pixel", "0 mas"], "--pixel '0 mas': must be one number above 0"),
        (["--noise", "1 mas"], "--noise '1 mas': must be one number above 0 with a u"),
        (["--seed", "x"], "--seed 'x': must be a whole number"),
        (["--after", "2011-01-01"], "no component is left"),
        (["--after", "later"], "--after 'later': is no date"),
        (["extra.xyz"], "extra.xyz: the suffix '.xyz' tells no format"),
        (["no.ecsv"], "no.ecsv: no such file"),
        (["bad_2006-03-09.mod"], "bad_2006-03-09.mod, line 1: "),
        (["--origin", "core"], "no core component (feature 0)"),
    ],
)
def test_restorations_that_are_refused(refused, models, here, options, reason):
    (here / "bad_2006-03-09.mod").write_text("1 2\n")
    given = ["--beam", "1 mas", "--pixel", "0.1 mas"]
    files = options if not options[0].startswith("-") else models
    options = options if options[0].startswith("-") else []
    line = refused("restore", *files, "-o", "out", *given, *options)
    assert reason in line


def test_inspect(jet, astro_scc, here):
    status, out, err = astro_scc("inspect", *epochs(jet))
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0].split()[:3] == ["epoch", "date", "pixels"]
    for line, path in zip(lines[1:7], epochs(jet), strict=True):
        assert line.startswith(path.name)
        assert "256 x 128" in line
        assert "1 x 1 mas at 0 deg" in line
    assert "No problems." in lines
    assert any("Consecutive epochs suit speeds" in line for line in lines)
    assert not list(here.iterdir())


def test_inspect_explains_speeds(jet, astro_scc):
    # Six epochs 30 days apart, a beam of 1 mas.
    def rows(*argv):
        status, out, err = astro_scc("inspect", *epochs(jet), *argv)
        assert (status, err) == (0, "")
        table = out.split("pairs\n")[1].splitlines()
        return [line for line in table if line[:1].isdigit()]

    rising = rows()
    assert len(rising) == 4
    assert rising[-1].split()[1] == "1.5"
    (row,) = rows("--speed", "6 mas/yr")
    motion = 6 * 30 / 365.25
    baseline = f'"{0.3 / 6:.2g} yr {1.5 / 6:.2g} yr"'
    assert row.split() == ["6", f"{motion:.2g}", *baseline.split(), "12"]
    (row,) = rows("--speed", "0.01 mas/yr")
    assert row.split()[2:] == ["too", "slow", "for", "this", "series", "0"]


def test_the_baseline_that_inspect_gives_is_understood(jet, astro_scc, here):
    _, out, _ = astro_scc("inspect", *epochs(jet), "--speed", "12 mas/yr")
    baseline = re.search(r'^12 .*"(.*)"', out, flags=re.MULTILINE)[1]
    argv = ("measure", *epochs(jet), "-o", "out", *QUICK, "--no-report")
    assert astro_scc(*argv, "--baseline", baseline)[0] == 0


@pytest.mark.parametrize(
    ("speed", "line"),
    [
        ("fast", "--speed 'fast': must be an angle per time with a unit, such as"),
        ("-2 mas/yr", "--speed '-2 mas/yr': must be above 0"),
    ],
)
def test_speeds_that_inspect_refuses(jet, refused, speed, line):
    assert line in refused("inspect", *epochs(jet), f"--speed={speed}")


def test_inspect_says_what_is_wrong(series, astro_scc, here):
    paths = series([None, *[Beam(1 * u.mas, 1 * u.mas)] * 2])
    (here / "note.fits").write_text("no image")
    status, out, _ = astro_scc("inspect", *paths, "note.fits")
    assert status == 0
    problems = out.split("Problems:\n")[1].splitlines()
    assert any("no beam where others have one" in line for line in problems)
    assert any("note.fits: cannot be read as FITS" in line for line in problems)
    assert problems[-1].startswith("  as one series: ")


def test_inspect_one_epoch_without_a_date(series, astro_scc):
    path = series([None] * 3)[0]
    status, out, _ = astro_scc("inspect", path)
    assert status == 0
    assert "velocities need at least two epochs of different date." in out
    with fits.open(path, mode="update") as hdus:
        for key in ("DATE-OBS", "MJD-OBS"):
            hdus[0].header.remove(key, ignore_missing=True)
    status, out, _ = astro_scc("inspect", path)
    assert status == 0
    assert "no date of observation" in out


def test_inspect_a_cube_file(jet, astro_scc, here):
    EpochCube.read(epochs(jet)[:3]).write("cube.fits")
    status, out, _ = astro_scc("inspect", "cube.fits")
    assert status == 0
    assert [line.split()[1] for line in out.splitlines()[1:4]] == [
        "2000-01-01",
        "2000-01-31",
        "2000-03-01",
    ]


def test_inspect_advises_an_alignment(astro_scc, here):
    cube = simulate_two_fluid(n_epochs=3, core=5.0, rng=1).cube
    shifted = EpochCube.from_arrays(
        np.stack([np.roll(image, 3 * i, axis=0) for i, image in enumerate(cube.data)]),
        Time(cube.times),
        pixel_scale=cube.pixel_scale,
        unit=cube.unit,
        beams=cube.beams,
        reference_pixel=cube.reference_pixel,
    )
    shifted.write("cube.fits")
    status, out, _ = astro_scc("inspect", "cube.fits")
    assert status == 0
    assert "measure with --align core" in out


def test_nothing_to_inspect(refused, here):
    for name in ("a.fits", "b.fits"):
        (here / name).write_text("no image")
    assert "no.fits: no such file" in refused("inspect", "no.fits")
    line = refused("inspect", "a.fits", "b.fits")
    assert line.endswith("(and 1 more like it)")
    assert "no*.fits: no file matches" in refused("inspect", "no*.fits")


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (12.345, 0.123, "12.35 +- 0.12"),
        (123.4, 12.0, "123 +- 12"),
        (0.5, float("nan"), "0.5 +- nan"),
        (0.5, 0.0, "0.5 +- 0"),
    ],
)
def test_numbers_with_errors(value, error, text):
    assert with_error(value, error) == text


@pytest.fixture(scope="module")
def radial(jet):
    """Components away from a point, which have no direction on the sky."""
    scc = StackedCrossCorrelation(
        scales=[2], max_speed=30 * u.mas / u.yr, position_angle="radial"
    )
    row = scc(EpochCube.read(epochs(jet)), n_trials=20, rng=1).components[:1]
    return vstack([row] * 3, metadata_conflicts="silent")


def test_summary(radial):
    table = radial.copy()
    table["kind"] = ["moving", "stationary", "uncertain"]
    table["p_global"] = [0.00099, 0.01, 0.5]
    lines = component_lines(table)
    assert len(lines) == 6
    assert "0.00099" in lines[1].split()
    assert lines[1].split()[4] == "-"
    assert lines[2].endswith("stationary, no discovery")
    assert lines[3].startswith("p_global: probability of as much at any velocity")
    assert lines[5] == (
        "1 of 3 rows of components.ecsv may be chance (p_global above 0.05)"
    )


def test_summary_of_chance(radial):
    table = radial.copy()
    table["kind"] = "uncertain"
    table.meta["settings"]["level"] = 0.01
    lines = component_lines(table)
    assert lines[0].startswith("No velocity component stands out.")
    assert lines[-1] == (
        "3 of 3 rows of components.ecsv may be chance (p_global above 0.01)"
    )


# -- as a program ------------------------------------------------------------------


def test_demo(tmp_path, monkeypatch):
    command = [sys.executable, "-m", "astro_scc.cli"]
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
    assert {path.name for path in folder.iterdir()} == {
        *PRODUCTS,
        "epochs",
        "region.reg",
    }
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
    for name in (*TABLES, "scc.fits", "config.toml"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()
