# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""``astro-scc survey`` of a table of components, and what no survey can be."""

import io
import re

import astropy.units as u
import numpy as np
import pytest
from astropy.io.votable import validate
from astropy.table import QTable, Table

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


def test_without_neighbours_there_is_no_beam(refused, here):
    table = QTable({"source": ["a"] * 5, "component": [0] * 5, "flux": [1] * 5 * u.Jy})
    table["epoch"] = [f"200{k}-01-01" for k in range(5)]
    table["separation"] = [0] * 5 * u.mas
    table["position_angle"] = [0] * 5 * u.deg
    table.write(here / "one.ecsv")
    line = refused("survey", "one.ecsv", "-o", "out")
    assert "no epoch of the table has two components apart; give --beam" in line


def test_sources_and_folders_that_are_refused(table, refused, here):
    words = ["survey", table, "-o", "out", *BEAM]
    assert "no source '0003+38'; it has 0003" in refused(*words, "--source", "0003+38")
    other = ["--source", "9999+999", "--origin", "map"]
    assert "no core component" in refused(*words, *other)
    # Another folder, and a survey of other images, are left alone.
    out = here / "out"
    out.mkdir()
    for name, text in {
        "mine": "mine",
        "survey.toml": "[sources.a]\nepochs = 'images/*.fits'\n",
    }.items():
        (out / name).write_text(text)
        line = refused(*words)
        assert "out: exists and is not of a survey of a table; choose another" in line


def test_redshifts_and_folders_that_make_no_sense(refused, here):
    (here / "images").mkdir()
    for text, reason in {
        "": "is no table: ",
        "a b\n1 2\n": "needs the columns source and redshift; it has a, b",
        "name z\ntwo '68600 km/s'\n": "its column z must be numbers without a unit, as",
    }.items():
        (here / "z.txt").write_text(text)
        words = ["survey", "images", "-o", "out", "--redshifts", "z.txt"]
        assert f"z.txt: {reason}" in refused(*words)
    line = refused("survey", "images", "-o", "out")
    assert "images: has no folder of FITS images" in line
