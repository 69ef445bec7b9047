# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Every table of the documentation can be made again, and is what its command makes."""

import csv
import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

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
        "docs/images/paper/3c120-speeds.txt",
    }  # fmt: skip
    files = [*(REPOSITORY / "benchmarks").rglob("results/*.csv")]
    names = {path.relative_to(REPOSITORY).as_posix() for path in files}
    assert {name for name in names if not KEPT.fullmatch(name)} <= MADE


def test_commands_are_those_of_scripts_that_are_there():
    for name, entry in TOOL.ENTRIES.items():
        _, script, *_ = entry.command.split()
        assert (REPOSITORY / script).is_file(), name
        assert entry.minutes > 0


def test_what_changed_in_a_table_is_said(tmp_path):
    path = tmp_path / "a.csv"
    assert TOOL.read_cells(path) == {}
    path.write_text("jet,speed\nA,2.0 ± 0.1\nB,3.0\n")
    before = TOOL.read_cells(path)
    path.write_text("jet,speed\nA,2.5 ± 0.1\nB,3.0\nC,1\n")
    first, *lines = TOOL.compare(before, TOOL.read_cells(path))
    assert first == "3 of 6 changed, at most by words"
    assert lines[0] == "  row 1, speed: 2.0 ± 0.1 -> 2.5 ± 0.1"
    assert lines[1] == "  row 3, jet: (none) -> C"
    assert TOOL.compare(before, before) == []


#: Cheap tables: the arguments that make some of their rows.
CHEAP = {
    "files": ["{data}"],
    "real_images": ["{data}"],
    "subpixel": [],
    "mojave": ["{data}/mojave_xviii", "--only", "0003+380"],
}


#: Columns of the time and memory of a machine.
TIMES = {"CPU s", "GB"}


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
