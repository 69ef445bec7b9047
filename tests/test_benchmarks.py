# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The benchmarks: every table can be made again, what they simulate and read."""

import csv
import importlib
import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from astro_scc.cli.survey import run_survey

REPOSITORY = Path(__file__).parents[1]
PATH = REPOSITORY / "benchmarks" / "run_all.py"
if not PATH.is_file():
    pytest.skip("the benchmarks are not part of this copy", allow_module_level=True)

TOOL = SimpleNamespace(**runpy.run_path(str(PATH)))
MADE = {name for entry in TOOL.ENTRIES.values() for name in entry.files}
#: Files of the benchmarks that are shown in another form, or that resume a run.
KEPT = re.compile(r"benchmarks/calibration/results/[^_]*\.csv")


def shown():
    """The tables and texts that the pages take from files of the repository."""
    docs = REPOSITORY / "docs"
    for page in docs.glob("*.rst"):
        text = page.read_text(encoding="utf-8")
        for name in re.findall(r"(?::file:|literalinclude::) (\S+\.(?:csv|txt))", text):
            path = (docs / name).resolve().relative_to(REPOSITORY.resolve())
            if path.parts[:2] != ("docs", "_build"):
                yield path.as_posix()


def test_every_table_of_the_pages_has_an_entry_and_nothing_else_is_kept():
    pages = {*shown()}
    assert pages <= MADE
    # A page builds one table from the first, and quotes the others.
    assert MADE - pages == {
        "benchmarks/results/paper_test.csv", "docs/images/paper/3c273-speeds.txt",
        "docs/images/paper/3c120-speeds.txt", "docs/images/paper/3c120-diverging.txt",
    }  # fmt: skip
    files = [*(REPOSITORY / "benchmarks").rglob("results/*.csv")]
    names = {path.relative_to(REPOSITORY).as_posix() for path in files}
    assert {name for name in names if not KEPT.fullmatch(name)} <= MADE


def test_commands_are_those_of_scripts_that_are_there():
    for name, entry in TOOL.ENTRIES.items():
        _, script, *_ = entry.command.split()
        assert (REPOSITORY / script).is_file(), name


#: Columns of the time and memory of a machine.
TIMES = {"CPU s", "GB"}
#: Cheap tables: the arguments that make some of their rows.
CHEAP = {"files": ["{data}"], "real_images": ["{data}"], "subpixel": []}
CHEAP["paper_test"] = ["{data}/paper_test"]
CHEAP["mojave"] = ["{data}/mojave_xviii", "--only", "0003+380"]


def read_rows(path):
    with open(path, newline="", encoding="utf-8") as file:
        return [*csv.DictReader(file)]


@pytest.mark.slow
@pytest.mark.parametrize("name", CHEAP)
def test_rows_of_cheap_tables_are_what_their_commands_make(
    name, shared_data, tmp_path, monkeypatch
):
    monkeypatch.setenv("ASTRO_SCC_RESULTS", str(tmp_path))
    words = [word.format(data=shared_data) for word in CHEAP[name]]
    command = [sys.executable, f"benchmarks/{name}.py", *words]
    subprocess.run(command, cwd=REPOSITORY, check=True, stdout=subprocess.DEVNULL)
    (path,) = (REPOSITORY / file for file in TOOL.ENTRIES[name].files)
    kept, made = (read_rows(file) for file in (path, tmp_path / path.name))
    first = next(iter(kept[0]))
    names = {row[first] for row in made}
    kept = [row for row in kept if row[first] in names]
    assert len(made) == len(kept) > 0
    for one, other in zip(kept, made, strict=True):
        for column in one.keys() - TIMES:
            change = TOOL.largest_change(one[column], other[column])
            assert change < 0.05, (column, one, other)


@pytest.fixture
def script(monkeypatch):
    """Import a benchmark by its name."""
    monkeypatch.syspath_prepend(str(PATH.parent))
    return importlib.import_module


def test_the_sources_of_a_large_survey_can_be_measured(script, tmp_path):
    survey = script("many_sources").write_sources(tmp_path, 1)
    assert run_survey(survey, tmp_path / "out")["status"].tolist() == ["measured"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [31001, 33001])
def test_features_of_scrambled_movies_are_no_motion(script, seed):
    # Five and eight features move by chance, and p_global is below 0.1.
    resolved = script("resolved")
    assert len(resolved.measure(("11x21d", "two", "scrambled", seed))[1]) == 0


def test_static_series_of_each_kind(script):
    level = script("level")
    for kind in level.KINDS:
        cube = level.static_cube(kind, 1, n_epochs=3)
        again = level.static_cube(kind, np.random.default_rng(1), n_epochs=3)
        assert np.array_equal(cube.data, again.data)


@pytest.mark.parametrize("speeds", [(5,), (2, 7, 12), (-8, 0, 25)])
def test_all_speeds_that_other_packages_find_are_read(script, speeds):
    reading, rng = script("comparison_reading"), np.random.default_rng(1)
    along = np.concatenate([rng.normal(speed, 1, 90) for speed in speeds])
    here = np.zeros(len(along))
    sample = reading.Sample(np.arange(len(along)) % 9, here, here, along, here)
    np.testing.assert_allclose(reading.read_speeds(sample), speeds, atol=0.5)
