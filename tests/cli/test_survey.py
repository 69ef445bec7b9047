# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Surveys of a file and of a table of components: read, run and gone on with."""

import io
import re
from types import SimpleNamespace

import astropy.units as u
import numpy as np
import pytest
from astropy.io.votable import validate
from astropy.table import QTable, Table, vstack

from astro_scc.cli import survey, survey_sources
from astro_scc.cli.survey import measure_part, run_survey
from astro_scc.cli.survey_sources import Part, alone, folder_names, read_survey
from astro_scc.report.page import write_overview

TEXT = """
[defaults]
scales = [2]
max_speed = "30 mas/yr"
n_trials = 20

[sources."One/../../up"]
epochs = "one.fits"
redshift = 0.1
regions = {left = "left.reg", right = "right.reg"}

[sources.Two]
epochs = "two.fits"
published_pm = "18 2 mas/yr"
scales = [1, 2]
scale_groups = {fine = [1], coarse = [2]}

[sources.Gone]
epochs = "gone/*.fits"
"""
#: Names of its rows, and what became of them.
ROWS = """
One/../../up left all measured
One/../../up right all empty
Two all fine measured
Two all coarse measured
Gone all all failed
"""


@pytest.fixture(scope="module")
def folder(make_jet, tmp_path_factory):
    """A survey of two small cubes, and of one that is not there."""
    folder = tmp_path_factory.mktemp("in")
    for name in ("one", "two"):
        make_jet().cube.write(folder / f"{name}.fits")
    (folder / "left.reg").write_text("image\nbox(50,32,90,60,0)\n")
    (folder / "right.reg").write_text("image\ncircle(124,4,3)\n")
    (folder / "survey.toml").write_text(TEXT)
    return folder


@pytest.fixture(scope="module")
def serial(folder, tmp_path_factory):
    """The survey, measured here."""
    out = tmp_path_factory.mktemp("serial") / "out"
    return run_survey(read_survey(folder / "survey.toml"), out), out


def written(out):
    """All that a survey wrote, but when."""
    return {
        str(path.relative_to(out)): path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.suffix in (".ecsv", ".toml", ".fits")
    }  # fmt: skip


def test_every_source_region_and_group_has_a_row(serial, done, here):
    table, out = serial
    rows = table["source", "region", "scale_group", "status"]
    assert [*dict.fromkeys(" ".join(row) for row in rows)] == ROWS.strip().split("\n")
    (nothing,) = table[table["status"] == "empty"]
    assert nothing["message"] == "no significant pattern here on these scales"
    gone = table[-1]
    assert "gone/*.fits" in gone["message"]
    assert gone["pm"].mask
    assert np.all(np.isfinite(table["p_fdr"][table["status"] == "measured"]))
    # Groups have speeds of their own, and features, which have no scale, are once.
    done("profile", "--config", out / "sources/Two/all/fine/config.toml", "-o", "one")
    found = QTable.read("one/profile.ecsv")
    features = QTable.read(out / "features.ecsv")
    both, one = (k[k["source"] == "Two"] for k in (table, features))
    np.testing.assert_allclose(found["pm"], both["pm"], rtol=1e-6)
    assert set(one["scale_group"]) == {"all"}
    assert len(np.unique(one["feature"])) == len(one) > 0


def test_the_overview_counts_sources(tmp_path):
    kinds = [
        *("A moving", "A not significant", "B not significant", "B stationary"),
        *("C stationary", "D empty", "E failed", "F failed", "G not confirmed"),
    ]
    rows = [
        (own[0], str(k), own[2:], "") if own[2:] in ("empty", "failed") else
        (own[0], str(k), "measured", own[2:]) for k, own in enumerate(kinds)
    ]  # fmt: skip
    table = QTable(rows=rows, names=("source", "region", "status", "kind"))
    table["scale_group"], table["caution"] = "all", "-"
    table["pm"] = np.r_[np.full(8, 2.0), 7.0] * u.mas / u.yr
    table["pm_err"] = np.full(9, 0.1) * u.mas / u.yr
    table["p_global"], table["p_fdr"] = 0.01, 0.02
    table["n_features"], table["share"] = [0] + [3] * 7 + [0], 0.5
    table["pm_from"] = ["spectrum"] + ["features"] * 8
    table = vstack([table[:1], table])
    table["pm"][0], table["share"][0] = 9 * u.mas / u.yr, 0.4
    known = {"A": [1.9] * u.mas / u.yr} | {k: [np.nan] * u.mas / u.yr for k in "BCDEFG"}
    parts = [Part(k, r, "all", "", None, known[k], status=s) for k, r, s, _ in rows]
    page = write_overview(table, QTable(), parts, tmp_path).read_text("utf-8")
    said = "significant motion, 1 is stationary, 1 has nothing to test and 2 failed."
    words = "Of 7 sources, 1 moves, 1 has motion that is not confirmed, 1 shows no "
    assert words + said in page
    assert "of the published one: 1 of 1." in page
    assert "from spectrum" in page
    assert not re.search(">[79].0|nan standard errors", page)


def test_sources_in_other_units_share_those_of_most():
    jy, none = [1.0] * u.Jy, [3.0]
    hours = {"pm": [1] * u.mas / u.h, "t_ej": [51544.5] * u.d, "t_ej_err": [1] * u.d}
    years = {"pm": [2] * u.mas / u.yr, "t_ej": [2001] * u.yr, "t_ej_err": [1] * u.yr}
    tables = [
        QTable(hours | {"flux": none, "part": [0]}),
        QTable(years | {"flux": jy, "part": [1]}),
        QTable(years | {"flux": 1000 * jy.to(u.mJy), "part": [2]}),
    ]
    survey._share_units(tables)
    both = vstack(tables)
    assert [both[k].unit for k in hours] == [u.mas / u.yr, u.yr, u.yr]
    np.testing.assert_allclose(both["pm"].value, [8766, 2, 2])
    np.testing.assert_allclose(both["t_ej"].value, [2000, 2001, 2001], rtol=1e-12)
    assert both["t_ej_err"][0] == 1 * u.d
    assert both["flux"].mask.tolist() == [True, False, False]
    assert both["flux"][2] == 1000 * u.Jy
    assert "other units: none" in both["flux"].info.description


def test_folder_names_are_harmless(tmp_path):
    names = [
        "..", ".", "", "/etc/passwd", "a/b", "a\\b", "~", "-rf", ".hidden", "CON",
        "nul.x", "a\0b", "x" * 500, "Ünï", "a b", "a.", "\n", "C:",
    ]  # fmt: skip
    for name, folder in folder_names(names).items():
        assert folder != name
        assert len(folder) <= 70
        assert folder[0].isalnum()
        assert re.fullmatch(r"[\w.-]+", folder, re.ASCII)
        assert (tmp_path / folder).resolve().parent == tmp_path.resolve()
        (tmp_path / folder).mkdir()


@pytest.mark.slow
def test_interrupted_and_started_again(serial, folder, here, astro_scc, monkeypatch):
    _, reference = serial
    out = here / "out"

    def interrupted(part, output, **options):
        if part.source == "Two":
            raise KeyboardInterrupt
        return measure_part(part, output, **options)

    argv = ("survey", folder / "survey.toml", "-o", out, "--no-report")
    with monkeypatch.context() as patch:
        patch.setattr("astro_scc.cli.survey.measure_part", interrupted)
        status, _, err = astro_scc(*argv, "--quiet")
    assert status == 130
    assert "the same command goes on" in err
    assert not (out / "survey.ecsv").exists()
    status, said, _ = astro_scc(*argv, "--workers", 2)
    assert status == 0
    assert "One/../../up, left: finished before" in said
    # Processes give the same.
    assert written(out) == written(reference)
    assert not list(out.rglob(".partial-*"))


def test_a_second_run_in_a_folder_ends_at_once(folder, here, refused):
    out = here / "out"
    out.mkdir()
    (out / "survey.toml").write_text("# first\n")
    (out / "sources").mkdir()
    with alone(out):
        line = refused("survey", folder / "survey.toml", "-o", out)
        assert "out: another run writes into it; wait for its end" in line
    assert (out / "survey.toml").read_text() == "# first\n"


@pytest.mark.slow
def test_a_part_that_fails_costs_itself_only(folder, tmp_path, monkeypatch):
    *_, two, coarse, _ = read_survey(folder / "survey.toml")[0]
    real = survey.write_measurement

    def wrong(result, epochs, folder, **options):
        if options["title"] == "Two, fine":
            # As a mistake of the program, half way.
            (folder / "streams.ecsv").touch()
            (folder / "publication").mkdir()
            raise AssertionError("odd")
        return real(result, epochs, folder, **options)

    monkeypatch.setattr(survey, "write_measurement", wrong)
    fine, coarse = (measure_part(part, tmp_path) for part in (two, coarse))
    assert (fine.status, fine.message) == ("failed", "AssertionError: odd")
    assert coarse.status in ("measured", "empty")
    folder = tmp_path / "sources" / "Two" / "all" / "fine"
    assert {path.name for path in folder.iterdir()} == {"error.txt", "part.json"}
    assert "AssertionError: odd" in (folder / "error.txt").read_text()


#: The beginning of a survey of one source, and what is wrong in it.
A = "[sources.A]\nepochs = 'a'\n"
WRONG = [
    ("a = " + "[" * 5000, "is not a TOML file: nested too deep"),
    ("", "names no source"),
    ("[other]", "unknown key 'other'"),
    (f"{A}regions = {{b = 3}}", "regions.b must be the path"),
    ("[sources.A]", "sources.A: has no epochs"),
    (f"{A}region = 'b'", "region is no setting of a survey"),
    (f"{A}regions = 'b'", "regions must be a table"),
    (f"{A}scale_groups = {{b = 'c'}}", "scale_groups = {'b': 'c'} must be two groups"),
    ("[defaults]\npublished_pm = '1 mas/yr'\n[sources.A]", "published_pm is no"),
    (f"{A}published_pm = '-1 mas/yr'", "A: published_pm = '-1 mas/yr' must be a sp"),
]


def test_files_and_folders_that_make_no_sense(folder, refused, here):
    for text, reason in WRONG:
        (here / "s.toml").write_text(text)
        line = refused("survey", "s.toml", "-o", "out")
        assert line.startswith("astro-scc survey: error: s.toml: ")
        assert reason in line
    (here / "mine.txt").write_text("keep")
    words = "survey", folder / "survey.toml", "-o"
    assert "exists and is not of a survey" in refused(*words, here)
    assert "mine.txt: cannot be made or used" in refused(*words, "mine.txt")
    assert "--workers must be" in refused(*words, "x", "--workers", "0")
    assert "z.csv: cannot be" in refused(*words, "x", "--redshifts", "z.csv")
    line = refused(*words, "x", "--source", "two")
    assert "--source is for a table of components, not for" in line
    (here / "images").mkdir()
    for text, reason in {
        "": "is no table: ",
        "a b\n1 2\n": "needs the columns source and redshift; it has 'a', 'b'",
        "name z\ntwo '68600 km/s'\n": "its column z must be numbers without a unit, as",
    }.items():
        (here / "z.txt").write_text(text)
        words = ["survey", "images", "-o", "out", "--redshifts", "z.txt"]
        assert f"z.txt: {reason}" in refused(*words)
    line = refused("survey", "images", "-o", "out")
    assert "images: has no folder of FITS images" in line
    for name in ("one", "empty"):
        (here / "images" / name).mkdir()
    (here / "images" / "one" / "a.fits").touch()
    args = SimpleNamespace(survey="images", workers=1)
    with pytest.warns(UserWarning, match="images/empty: no FITS images in the folder"):
        survey_sources.write_survey(args, here / "out", None)


def test_defaults_and_what_replaces_them(tmp_path):
    (tmp_path / "s.toml").write_text(
        "[defaults]\nredshift = 0.1\ncosmology = 'Planck18'\nalign = 't.csv'\n"
        "[sources.A]\nepochs = ['a*', '/b']\ndistance = '3 Mpc'\n"
        "[sources.B]\nepochs = 'b'\nscale_groups = {x = '0.2 mas', y = '0.1 mas'}\n"
        "[sources.C]\nepochs = 'c'\nalign = 'core 9 deg'\nscales = [3, 1]\n"
        "redshift = '15.8 %'\nposition_angle = '-112deg'\n"
    )
    parts, _ = read_survey(tmp_path / "s.toml", {"B": 0.3})
    a, b, other, c = (part.settings for part in parts)
    assert b.redshift == 0.3
    assert (a.distance, a.redshift, a.cosmology) == (3 * u.Mpc, None, None)
    assert a.epochs == [str(tmp_path / "a*"), "/b"]
    assert a.align == str(tmp_path / "t.csv")
    assert b.cosmology == "Planck18"
    assert (b.scales, [*b.scale_groups]) == (None, ["x", "y"])
    assert b.scale_groups == other.scale_groups
    assert (c.scales, c.redshift, c.align) == ((3, 1), 0.158, "core 9 deg")
    assert c.position_angle == 248 * u.deg


BOTH = ("0003+380", "0010+405")
BEAM = ["--beam", "0.9 mas 0.6 mas 0 deg", "--pixel", "0.2 mas"]


@pytest.fixture
def table(shared_data, here):
    """The head of the journal's own table, and rows of two sources."""
    text = (shared_data / "mojave_xviii" / "apjac230ft4_mrt.txt").read_text()
    head, _, rows = text.rpartition("-" * 80 + "\n")
    kept = [r for r in rows.splitlines() if r.startswith(BOTH)]
    # A source that cannot be measured does not stop the others.
    kept.append("9999+999  1   2006 Mar  9     7.2  3.98 121.8  0.72 1.       Y ")
    rows = "\n".join([*kept, ""])
    (here / "table_mrt.txt").write_text(f"{head}{'-' * 80}\n{rows}")
    return "table_mrt.txt"


@pytest.mark.slow
def test_without_options(table, done, here, astro_scc, monkeypatch):
    """Beam, pixels and noise suit the table; archives read the catalogues."""
    (here / "z.csv").write_text("Name,z\n0003+380,0.229\n0010+405,\nelsewhere,1\n")
    _, said = done("survey", table, "-o", "out", "--redshifts", "z.csv", "--seed", "1")
    (beam,) = re.findall("restored with one of (.*), the median", said)
    assert "pixels and noise that suit" in said
    assert "z.csv: 1 source is not of the survey" in said
    out = here / "out"
    folder = out / "publication"
    for name, file in (("streams", "survey"), ("features", "features")):
        ecsv = QTable.read(out / f"{file}.ecsv")
        rows = [row for row in ecsv if file == "features" or row["status"] != "failed"]
        assert set(ecsv["redshift"][ecsv["source"] == "0003+380"]) == {0.229}
        assert np.all(ecsv["redshift"].mask[ecsv["source"] == "0010+405"])
        found = Table.read(folder / f"{name}_mrt.txt", format="mrt")
        assert found["source"].tolist() == [row["source"] for row in rows]
        assert validate(folder / f"{name}.vot", output=io.StringIO())
    assert np.ma.count(ecsv["published"]) >= 5
    page = (out / "overview.html").read_text(encoding="utf-8")
    assert "in units of c, of sources with a redshift" in page
    assert (out / "population.png").is_file()
    # The beam does not depend on the sources that are chosen.
    monkeypatch.setattr("astro_scc.cli.survey_sources.images.write_images", print)
    _, _, said = astro_scc("survey", table, "-o", "a", "--source", BOTH[0])
    assert f"restored with one of {beam}, the median" in said


def test_sources_and_folders_that_are_refused(table, refused, here):
    words = ["survey", table, "-o", "out", *BEAM]
    (here / "one_2001-01-01.mod").write_text("1 0 0\n")
    line = refused("survey", "one_2001-01-01.mod", "-o", "out")
    assert "no epoch of the table has two components apart; give --beam" in line
    # Another folder, and a survey of other images, are left alone.
    out = here / "out"
    out.mkdir()
    for name in ("mine", "survey.toml"):
        (out / name).write_text("[sources.a]\nepochs = 'images/*.fits'\n")
        line = refused(*words)
        assert "out: exists and is not of a survey of a table; choose another" in line
