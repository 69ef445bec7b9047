# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the pages show and no doctest runs: commands, TOML, scripts, numbers."""

import importlib
import re
import runpy
import shlex
import sys
import tomllib
import warnings
from itertools import chain, pairwise
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest

from astro_scc.cli.program import COMMANDS, build_parser
from astro_scc.cli.survey_sources import read_survey
from astro_scc.epochs import Beam, write_epochs
from astro_scc.settings import Settings, read_config
from astro_scc.simulation import JetSimulation, Stream

REPOSITORY = Path(__file__).parents[1]
IMAGES = REPOSITORY / "docs" / "images" / "start"
START = REPOSITORY / "docs" / "start.rst"
FOLDERS = REPOSITORY / "docs", REPOSITORY / "benchmarks", REPOSITORY
PAGES = sorted(path for folder in FOLDERS for path in folder.glob("*.rst"))
# A line of a literal block, or what stands in double quotes or in none.
COMMAND = re.compile(
    r"^ +(?:.*&& )?(?:\.venv/bin/)?astro-scc (.+)$|`astro-scc ([^`]+)`"
)
SCRIPT = re.compile(
    r"^ +(?:\.venv/bin/)?python (\S+\.py)(.*)$|``python (\S+\.py)(.*?)``", re.MULTILINE
)


def unfolded(text):
    """A text with lines that end in a backslash joined."""
    return re.sub(r" *\\\n +", " ", text)


def commands(text):
    """The arguments of every command line in a text."""
    for line in text.splitlines():
        for match in COMMAND.finditer(line):
            words = match[1] or match[2]
            # COMMAND, SHELL and dots stand for what a reader chooses.
            if not re.search(r"\bCOMMAND\b|\bSHELL\b|\.\.\.", words):
                yield words.partition(" > ")[0]


TEXTS = {page: page.read_text(encoding="utf-8") for page in PAGES}
HELP = {Path(name): own["epilog"] for name, own in COMMANDS.items()}
EVERY = (TEXTS | HELP).items()
SHOWN = [(page.name, k) for page, text in EVERY for k in commands(unfolded(text))]


@pytest.mark.parametrize(("page", "words"), SHOWN)
def test_every_command_that_is_shown_is_understood(page, words):
    argv = shlex.split(words)
    if len(argv) == 1 and argv[0] not in ("demo", "--help", "--version"):
        # The name of a command, not a line to type.
        assert argv[0] in COMMANDS
    elif argv[-1] in ("--help", "--version") or argv[0] == "--print-completion":
        with pytest.raises(SystemExit) as stop:
            build_parser().parse_args(argv)
        assert stop.value.code == 0
    else:
        assert build_parser().parse_args(argv).command == argv[0]


def test_what_is_shown_is_found():
    names = {words.split()[0] for _, words in SHOWN}
    assert set(COMMANDS) <= names
    assert {page for page, _ in TOML} == {"command_line.rst", "survey.rst"}
    # Other Python is doctests.
    assert [page.name for page in PAGES if blocks(page, "python")] == ["README.rst"]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_every_script_of_the_documentation_is_there(page):
    for match in SCRIPT.finditer(unfolded(TEXTS[page])):
        script, options = match[1] or match[3], match[2] or match[4] or ""
        source = REPOSITORY / script
        if script.startswith("benchmarks/") and not source.parent.is_dir():
            # A source distribution has none.
            continue
        assert source.is_file(), script
        for option in re.findall(r"--[a-z-]+", options):
            assert f'"{option}"' in source.read_text(encoding="utf-8"), option


@pytest.mark.slow
def test_the_first_page_shows_what_its_commands_write(tmp_path, shared_data):
    tool = runpy.run_path(str(REPOSITORY / "tools" / "first_jet.py"))
    shown = [words[0] for words in tool["commands"]("t.txt")]
    assert shown == ["restore", "inspect", "measure"]
    tool["keep"](shared_data, tmp_path, ["--before", "1996-09-01"])
    pages = ("start", "method", "paper_method")
    text = "".join(TEXTS[START.with_name(f"{page}.rst")] for page in pages)
    for path in tmp_path.iterdir():
        assert f"images/start/{path.name}" in text
        assert (IMAGES / path.name).stat().st_size < 250_000


def blocks(page, language):
    """The code blocks of a language, without their indentation."""
    pattern = rf"^\.\. code-block:: {language}\n\n((?:(?: +.*)?\n)+)"
    found = re.findall(pattern, TEXTS[page], re.MULTILINE)
    return [re.sub(r"^ {1,4}", "", block, flags=re.MULTILINE) for block in found]


TOML = [(page.name, text) for page in PAGES for text in blocks(page, "toml")]


@pytest.mark.parametrize(("page", "text"), TOML)
def test_toml_of_the_documentation_is_understood(page, text, tmp_path):
    path = tmp_path / "settings.toml"
    path.write_text(text, encoding="utf-8")
    if "sources" in tomllib.loads(text):
        assert len({part.source for part in read_survey(path)[0]}) == 2
    else:
        given, _ = read_config(path)
        assert Settings(**given).epochs


@pytest.mark.slow
def test_python_that_is_no_doctest_runs(tmp_path, monkeypatch):
    """The lines of the README for the images of the demo, on a smaller jet."""
    (text,) = blocks(REPOSITORY / "README.rst", "python")
    monkeypatch.chdir(tmp_path)
    beams = [Beam(size * u.mas, 0.8 * u.mas, 0 * u.deg) for size in (1.0, 1.1, 0.9, 1)]
    flow = Stream("flow", dx=6.0, sigma=3.0, density=0.6)
    small = {"shape": (64, 128), "extent": (20.0, 100.0), "axis": 32.0, "core": 3.0}
    jet = JetSimulation([flow], n_epochs=4, beams=beams, **small).run(rng=1)
    write_epochs(jet.cube, "astro_scc_demo/epochs")
    names = {}
    with warnings.catch_warnings():
        # Features crowd about its core, and four epochs are too few for a p-value.
        warnings.simplefilter("ignore")
        exec(text.replace("n_trials=1000", "n_trials=10"), names)
    assert "pm" in names["result"].components.colnames


PAPER_IMAGES = REPOSITORY / "docs" / "images" / "paper"
RESULTS = REPOSITORY / "examples" / "results"
PAGE = (REPOSITORY / "docs" / "paper.rst").read_text(encoding="utf-8")
TOOL = REPOSITORY / "tools" / "paper_jets.py"
WORDS = " ".join(PAGE.split())
FIRST = " ".join(TEXTS[START].split())
SIMULATED = ("demo", "two-fluid", "random-jet", "random")


def printed(name, folder=PAPER_IMAGES):
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
    kept |= {"3c120-diverging"}
    assert {path.stem for path in PAPER_IMAGES.glob("*.txt")} == kept
    assert kept <= set(commands)
    for path in PAPER_IMAGES.glob("*.png"):
        assert f"images/paper/{path.name}" in PAGE
        assert path.stat().st_size < 100_000


#: What the paper has, and a difference of two printed numbers.
OTHERS = {"5.5 ± 0.5", "25.0 ± 1.0", "20.5 ± 0.8", "4.0 ± 0.2", "6.0 ± 0.4"}
OTHERS |= {"0.10 ± 0.11"}


def test_every_number_with_an_error_is_printed():
    """Both stand in one line of what is kept, to more digits or as many."""
    kept, found = [*IMAGES.parent.rglob("*.txt"), *RESULTS.glob("*.txt")], set()
    for line in chain.from_iterable(path.read_text().splitlines() for path in kept):
        found |= set(pairwise(numbers(line)))
    shown = re.findall(r"(-?[\d.]*\d) ± ([\d.]*\d)", WORDS + FIRST)
    assert len(shown) > 20
    for value, error in shown:
        a, b = (len(number.partition(".")[2]) for number in (value, error))
        known = OTHERS | {f"{x:.{a}f} ± {y:.{b}f}" for x, y in found}
        assert f"{value} ± {error}" in known


def test_other_numbers_of_the_first_page():
    printed = (IMAGES / "measure.txt").read_text(encoding="utf-8")
    speed, n = re.search(r"^Motion: .* \((\S+) .* (\d+) features", printed).groups()
    assert f"or {speed} c" in FIRST
    assert f"mean of {n} secure features" in FIRST
    assert f"Lorentz factor, {np.hypot(1, float(speed)):.1f} " in FIRST


def test_other_numbers_of_the_simulated_jets():
    slow, fast = (row for row in rows(printed("two-fluid")) if "moving" in row)
    assert f"11.4 and 6.7 in the paper, {slow[5]} and {fast[5]} here" in WORDS
    first = next(row for row in rows(printed("random")) if "not significant" in row)
    reached = f"row 1 has {first[5]}, which {first[6]} of the shuffled series reach"
    assert reached in WORDS
    assert f"- nothing significant, p_global {first[6]} " in WORDS


def test_what_is_said_of_the_real_jets():
    table = [numbers(line) for line in printed("quasar_3c273", RESULTS).splitlines()]
    widths = [row[-1] for row in table if row[:2] == [1, 6]]
    assert "is {} and {} degrees".format(*widths) in WORDS
    # The rows of the profile have the same p-values in their last lines.
    lines = re.findall(r"p of equal speeds ([\d.]+)$", printed("3c273-speeds"), re.M)
    assert [float(p) for p in lines] == pytest.approx(table[-1][-7::3], abs=0.01)
    # By how far the paper's difference of 1.5 c is missed, as the page says.
    errors = zip(table[-1][-9::3], table[-1][-8::3], strict=True)
    inner, *outer = (abs(1.5 - value) / error for value, error in errors)
    assert inner < 1
    assert min(outer) > 2
    text = printed("galaxy_3c120", RESULTS)
    assert float(re.search(r"acceleration: .*, p ([^ ,]+),", text)[1]) < 0.005
    assert "(p of a constant speed below 0.005, Student's distribution)" in WORDS
    k, k_err, p = re.search(r"k (\S+) \+- (\S+), p (\S+)", text).groups()
    assert f"k is {k} ± {k_err} (p {p}, not significant)," in WORDS


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
