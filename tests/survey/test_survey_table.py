# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A survey of the sources of a table of components."""

import io
import re
import shutil
import tomllib

import astropy.units as u
import numpy as np
import pytest
from astropy.io.votable import parse, validate
from astropy.table import QTable, Table

from astro_scc.cli import main
from astro_scc.epochs import write_epochs
from astro_scc.simulation import simulate_two_fluid

BOTH = ("0003+380", "0010+405")
BEAM = ["--beam", "0.9 mas 0.6 mas 0 deg", "--pixel", "0.2 mas"]
OPTIONS = [*BEAM, "--noise", "0.5 mJy/beam", "--seed", "1", "--no-report", "--quiet"]


@pytest.fixture(params=["mrt", "cds"])
def table(request, shared_data, tmp_path):
    """The head of the journal's own table, and rows of two sources, in both forms."""
    text = (shared_data / "mojave_xviii" / "apjac230ft4_mrt.txt").read_text()
    head, _, rows = text.rpartition("-" * 80 + "\n")
    kept = [r for r in rows.splitlines() if r.startswith(BOTH)]
    # A source that cannot be measured does not stop the others.
    kept.append("9999+999  1   2006 Mar  9     7.2  3.98 121.8  0.72 1.       Y ")
    rows = "\n".join([*kept, ""])
    if request.param == "mrt":
        path = tmp_path / "table_mrt.txt"
        path.write_text(f"{head}{'-' * 80}\n{rows}")
        return path
    path = tmp_path / "table4.dat"
    path.write_text(rows)
    file = head.replace("file: apjac230ft4_mrt.txt", "file: table4.dat")
    (tmp_path / "ReadMe").write_text(f"{file}{'-' * 80}\n")
    return path


@pytest.mark.slow
def test_all_sources_are_restored_and_measured(table, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out"
    assert main(["survey", str(table), "-o", str(out), *OPTIONS]) == 0
    survey = QTable.read(out / "survey.ecsv")
    status = dict(zip(survey["source"], survey["status"], strict=True))
    assert status == dict.fromkeys(BOTH, "measured") | {"9999+999": "failed"}
    first = sorted((out / "images" / "0003+380").glob("*.fits"))
    assert len(first) == 10
    before = [path.stat().st_mtime_ns for path in first]
    # The same command goes on; with another beam, it begins again.
    assert main(["survey", str(table), "-o", str(out), *OPTIONS]) == 0
    assert [path.stat().st_mtime_ns for path in first] == before
    other = [*OPTIONS, "--pixel", "0.25 mas", "--source", "0003+380,0010+405"]
    assert main(["survey", str(table), "-o", str(out), *other]) == 0
    assert [path.stat().st_mtime_ns for path in first] != before
    assert set(QTable.read(out / "survey.ecsv")["source"]) == set(BOTH)
    # Sources of one call after the other stay.
    one, two = (
        ["survey", str(table), "-o", "each", *OPTIONS, "--source", k] for k in BOTH
    )
    assert main(one) == main(two) == 0
    assert set(QTable.read("each/survey.ecsv")["source"]) == set(BOTH)
    # The file can be changed, for a redshift, and given to the command.
    plan = out / "survey.toml"
    plan.write_text(plan.read_text() + "redshift = 0.229\n")
    assert main(["survey", str(plan), "-o", str(out), "--no-report", "--quiet"]) == 0
    assert "beta_app" in QTable.read(out / "survey.ecsv").colnames


@pytest.mark.slow
def test_without_options(table, tmp_path, capsys):
    """Beam, pixels and noise suit the table; archives read the catalogues."""
    out, redshifts = tmp_path / "out", tmp_path / "z.csv"
    redshifts.write_text("Name,z\n0003+380,0.229\n0010+405,\nelsewhere,1\n")
    argv = ["survey", str(table), "-o", str(out), "--redshifts", str(redshifts)]
    assert main(argv) == 0
    said = capsys.readouterr().err
    assert "restored with one of" in said
    assert "pixels and noise that suit" in said
    assert not list(out.rglob("report.html"))
    assert not list((out / "sources").rglob("publication"))
    folder = out / "publication"
    for name, file in (("components", "survey"), ("features", "features")):
        ecsv = QTable.read(out / f"{file}.ecsv")
        rows = [row for row in ecsv if file == "features" or row["status"] != "failed"]
        assert set(ecsv["redshift"][ecsv["source"] == "0003+380"]) == {0.229}
        assert np.all(ecsv["redshift"].mask[ecsv["source"] == "0010+405"])
        readers = [
            Table.read(folder / f"{name}_mrt.txt", format="mrt"),
            Table.read(folder / f"{name}.dat", readme=folder / "ReadMe", format="cds"),
            QTable.read(folder / f"{name}.vot"),
        ]
        for found in readers:
            assert found["source"].tolist() == [row["source"] for row in rows]
            # Without a feature there is no speed in print.
            shown = [file == "features" or r["n_features"] > 0 for r in rows]
            pm, known = u.Quantity(found["pm"])[shown], [r["pm"] for r in rows]
            known = u.Quantity(known)[shown]
            np.testing.assert_allclose(pm.value, known.value, atol=1e-3)
        assert validate(folder / f"{name}.vot", output=io.StringIO())
        for field in parse(folder / f"{name}.vot").get_first_table().fields:
            assert field.ucd, field.name
            assert field.description, field.name
            assert field.unit is not None or field.datatype != "double", field.name
    assert np.ma.count(ecsv["published"]) >= 5
    page = (out / "overview.html").read_text(encoding="utf-8")
    assert "as published" in page
    assert "in units of c, of sources with a redshift" in page
    assert (out / "population.png").is_file()


@pytest.mark.slow
def test_folders_of_images(tmp_path, capsys):
    folder, out = tmp_path / "images", tmp_path / "out"
    for name in ("one [1]", "two"):
        cube = simulate_two_fluid(n_epochs=4, rng=1).cube
        write_epochs(cube.crop((slice(70, 186), slice(20, 170))), folder / name)
    (folder / "notes").mkdir()
    # A measurement beside its images is no source.
    measured = shutil.copytree(folder / "two", folder / "two-measured")
    (measured / "components.ecsv").touch()
    argv = ["survey", str(folder), "-o", str(out), "--quiet"]
    assert main(argv) == 0
    table = QTable.read(out / "survey.ecsv")
    assert set(table["source"]) == {"one [1]", "two"}
    assert "failed" not in table["status"]
    assert main([*argv, "--redshifts", "none.csv"]) == 2
    assert "none.csv: cannot be read" in capsys.readouterr().err
    (tmp_path / "z.txt").write_text("a b\n1 2\n")
    assert main([*argv, "--redshifts", str(tmp_path / "z.txt")]) == 2
    assert "needs the columns source and redshift; it has a, b" in (
        capsys.readouterr().err
    )
    (tmp_path / "z.txt").write_text("name z\ntwo '68600 km/s'\n")
    assert main([*argv, "--redshifts", str(tmp_path / "z.txt")]) == 2
    said = capsys.readouterr().err
    assert "z.txt: its column z must be numbers without a unit, as 0.158: " in said
    assert "68600 km/s" in said
    # What has been added to the file stays, and the redshift is replaced.
    plan = out / "survey.toml"
    plan.write_text(plan.read_text() + "n_trials = 50\n")
    for z in 0.2, 0.158:
        (tmp_path / "z.txt").write_text(f"name z\ntwo {z}\n")
        assert main([*argv, "--redshifts", str(tmp_path / "z.txt")]) == 0
    own = tomllib.loads(plan.read_text())["sources"]["two"]
    assert (own["redshift"], own["n_trials"]) == (0.158, 50)
    # A folder that is new is a source more.
    shutil.copytree(folder / "two", folder / "three")
    assert main(argv) == 0
    assert len(QTable.read(out / "survey.ecsv")["source"]) >= 3
    # A table with its name in another form cannot be found in the text.
    before = plan.read_text()
    plan.write_text(before.replace('[sources."two"]', "[sources.two]"))
    assert main([*argv, "--redshifts", str(tmp_path / "z.txt")]) == 2
    said = "survey.toml: write the redshift of two into it"
    assert said in capsys.readouterr().err
    plan.write_text(before + "n_trials = \n")
    assert main(argv) == 2
    assert "survey.toml: Invalid value" in capsys.readouterr().err
    (tmp_path / "z.txt").write_text("")
    assert main([*argv, "--redshifts", str(tmp_path / "z.txt")]) == 2
    assert "z.txt: is no table: " in capsys.readouterr().err
    plan = [str(out / "survey.toml"), "-o", str(out), "--redshifts", "z.txt"]
    assert main(["survey", *plan]) == 2
    assert "--redshifts is not for a .toml file; write them to it" in (
        capsys.readouterr().err
    )
    for what in folder, out / "survey.toml":
        assert main(["survey", str(what), "-o", str(out), "--source", "two"]) == 2
        assert "--source is for a table of components, not for" in (
            capsys.readouterr().err
        )
    assert main(["survey", str(out), "-o", str(tmp_path / "other")]) == 2
    assert "has no folder of FITS images" in capsys.readouterr().err


def test_without_neighbours_there_is_no_beam(tmp_path, capsys):
    path = tmp_path / "one.ecsv"
    table = QTable({"source": ["a"] * 5, "component": [0] * 5})
    table["epoch"] = [f"200{k}-01-01" for k in range(5)]
    table["flux"] = np.ones(5) * u.Jy
    table["separation"], table["position_angle"] = np.zeros((2, 5))
    table["separation"].unit, table["position_angle"].unit = u.mas, u.deg
    table.write(path)
    assert main(["survey", str(path), "-o", str(tmp_path / "out")]) == 2
    assert "no epoch of the table has two components apart; give --beam" in (
        capsys.readouterr().err
    )


def test_a_beam_does_not_depend_on_the_sources_that_are_chosen(
    table, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("astro_scc.cli.survey_sources.images.write_images", print)
    said = set()
    for k, source in enumerate(["0003+380", "0010+405", "0003+380,0010+405", ""]):
        more = ["--source", source] if source else []
        main(["survey", str(table), "-o", str(tmp_path / str(k)), *more])
        said |= set(re.findall("restored with one of (.*),", capsys.readouterr().err))
    assert len(said) == 1


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ([*BEAM, "--source", "0003+38"], "no source '0003+38'; it has 0003"),
        ([*BEAM, "--source", "9999+999", "--origin", "map"], "no core component"),
    ],
)
def test_refusals_are_one_line(table, tmp_path, capsys, more, message):
    assert main(["survey", str(table), "-o", str(tmp_path / "out"), *more]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert message in line
    assert not (tmp_path / "out").exists()


def test_another_folder_is_left_alone(table, tmp_path, capsys):
    out = tmp_path / "out"
    out.mkdir()
    refused = "out: exists and is not of a survey of a table; choose another folder"
    (out / "mine").write_text("mine")
    assert main(["survey", str(table), "-o", str(out), *BEAM]) == 2
    assert refused in capsys.readouterr().err
    # A survey of other images has its own.
    (out / "survey.toml").write_text("[sources.a]\nepochs = 'images/*.fits'\n")
    (out / "images").mkdir()
    assert main(["survey", str(table), "-o", str(out), *BEAM]) == 2
    assert refused in capsys.readouterr().err
    assert {path.name for path in out.iterdir()} == {"mine", "survey.toml", "images"}
