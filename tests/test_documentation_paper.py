# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The page on the paper's results says what its commands and scripts print."""

import importlib
import re
import runpy
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
IMAGES = REPOSITORY / "docs" / "images" / "paper"
RESULTS = REPOSITORY / "examples" / "results"
PAGE = (REPOSITORY / "docs" / "paper.rst").read_text(encoding="utf-8")
TOOL = REPOSITORY / "tools" / "paper_jets.py"
WORDS = " ".join(PAGE.split())
SIMULATED = ("demo", "two-fluid", "random-jet", "random")


def printed(name, folder=IMAGES):
    return (folder / f"{name}.txt").read_text(encoding="utf-8")


def rows(text):
    """The cells of each line of a table, by the text in front of its numbers."""
    return [re.split(r"  +", line.strip()) for line in text.splitlines()]


def numbers(text):
    return [float(n) for n in re.findall(r"-?\d+\.?\d*(?:e-\d+)?", text)]


def test_the_page_is_short_and_shows_what_is_kept():
    assert len(PAGE.split()) < 1500
    commands = runpy.run_path(str(TOOL))["commands"]()
    assert tuple(commands)[:4] == SIMULATED
    kept = {"demo", "two-fluid", "random", "3c273-speeds", "3c120-speeds"}
    assert {path.stem for path in IMAGES.glob("*.txt")} == kept
    assert kept <= set(commands)
    for path in IMAGES.glob("*.png"):
        assert f"images/paper/{path.name}" in PAGE
        assert path.stat().st_size < 100_000


def test_numbers_of_the_simulated_jets():
    slow, fast = (row for row in rows(printed("two-fluid")) if "moving" in row)
    for row, paper in ((slow, "slow"), (fast, "fast")):
        ours = row[2].replace("+-", "±")
        assert re.search(rf"{paper} stream \(mas/yr\) - \S+ ± \S+ - {ours} ", WORDS)
    assert f"11.4 and 6.7 in the paper, {slow[5]} and {fast[5]} here" in WORDS
    peaks = [row for row in rows(printed("random")) if row[1:2] == ["not significant"]]
    first = max(peaks, key=lambda row: float(row[5]))
    assert f"row 1 has {first[5]}, and" in WORDS
    assert f"- nothing significant, p_global {first[6]} " in WORDS
    assert f"p is {first[6]}." in WORDS


def test_numbers_of_3c_273():
    table = [numbers(line) for line in printed("quasar_3c273", RESULTS).splitlines()]
    inner = {tuple(row[2:4]): row[4:] for row in table if row[:2] == [1, 6]}
    widths = []
    for scales, (speed, error, _, _, width) in inner.items():
        names = " and ".join(f"{scale:g}" for scale in scales)
        assert f"3C 273, scales {names}, 1 to 6 mas" in WORDS
        assert f"- {speed} ± {error} c " in WORDS
        widths.append(width)
    assert "is {} and {} degrees".format(*widths) in WORDS
    # The rows of the profile have the same p-values in their last lines.
    lines = re.findall(r"p of equal speeds ([\d.]+)$", printed("3c273-speeds"), re.M)
    assert [float(p) for p in lines] == pytest.approx(table[-1], abs=0.01)


def test_numbers_of_3c_120():
    text = printed("galaxy_3c120", RESULTS)
    table = {row[0]: row for row in map(numbers, text.splitlines()) if len(row) == 8}
    for place, paper in ((1.0, "4.0 ± 0.2 c"), (7.0, "6.0 ± 0.4 c")):
        _, speed, error, *_ = table[place]
        assert f"3C 120 at {place:g} mas - {paper} - {speed} ± {error} c" in WORDS
    *_, feature, feature_err, _, _, _ = table[7.0]
    assert f"features have {feature} ± {feature_err} c" in WORDS
    alone = re.search(r"slope of features: (\S+) \+- (\S+) c/mas", text).groups()
    assert "accelerate by {} ± {} c/mas".format(*alone) in WORDS
    slope, slope_err = re.search(r"slope: (\S+) \+- (\S+) c/mas", text).groups()
    p = re.search(r"acceleration: .*, p ([^ ,]+),", text)[1]
    assert f"by {slope} ± {slope_err} c/mas (p {p})" in WORDS
    k, k_err = re.search(r"k (\S+) \+- (\S+),", text).groups()
    assert f"about 0.3 - {k} ± {k_err} " in WORDS
    value = r"acceleration: (\S+) \+- (\S+) "
    script = re.search(value, text).groups()
    command = re.search(value, printed("3c120-speeds")).groups()
    assert command == script
    assert "the same acceleration, {} ± {} mas/yr²".format(*command) in WORDS


@pytest.mark.slow
def test_the_simulated_jets_print_what_the_page_shows(tmp_path, shared_data):
    tool = runpy.run_path(str(TOOL))
    table = shared_data / "mojave_xviii" / "apjac230ft4_mrt.txt"
    tool["keep"](table, tmp_path, SIMULATED)
    for name in ("demo", "two-fluid", "random"):
        shown, found = printed(name), printed(name, tmp_path)
        assert re.findall("[a-z]+", shown) == re.findall("[a-z]+", found)
        assert numbers(shown) == pytest.approx(numbers(found), rel=0.03, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["quasar_3c273", "galaxy_3c120"])
def test_the_real_jets_print_what_the_page_shows(name, shared_data, monkeypatch):
    monkeypatch.syspath_prepend(REPOSITORY / "examples")
    for module in (name, "common"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    example = importlib.import_module(name)
    found, _ = example.measure(shared_data / "mojave_xviii" / "apjac230ft4_mrt.txt")
    as_text = importlib.import_module("common").as_text
    for one, other in zip(
        printed(name, RESULTS).splitlines(), as_text(found).splitlines(), strict=True
    ):
        if "p " in one:
            # The p-values of tails depend on the last digits.
            one, other = one.partition("p ")[0], other.partition("p ")[0]
        assert numbers(one) == pytest.approx(numbers(other), rel=0.05, abs=0.15)
