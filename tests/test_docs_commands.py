# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the documentation shows and no doctest runs: commands, TOML, scripts."""

import re
import runpy
import shlex
import tomllib
import warnings
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
SHOWN = [
    (page.name, words)
    for page, text in (TEXTS | HELP).items()
    for words in commands(unfolded(text))
]


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
    text = TEXTS[START] + TEXTS[START.with_name("method.rst")]
    for path in tmp_path.iterdir():
        assert f"images/start/{path.name}" in text
        assert (IMAGES / path.name).stat().st_size < 250_000


def test_numbers_of_the_first_page():
    page = " ".join(TEXTS[START].split())
    printed = (IMAGES / "measure.txt").read_text(encoding="utf-8")
    number = r"([\d.]+) \+- ([\d.]+)"
    for pattern, words in (
        (rf"^Motion: {number} mas/yr", "{} ± {} mas/yr"),
        (rf"  {number}$", "needs no features, gives {} ± {} mas/yr"),
        (rf"acceleration: {number} mas/yr", "significant, {} ± {} mas/yr²"),
    ):
        value, error = re.search(pattern, printed, re.MULTILINE).groups()
        digits = 3 if "acceleration" in pattern else 2
        text = words.format(*(f"{float(v):.{digits}f}" for v in (value, error)))
        assert text in page, pattern
    speed, n = re.search(r"^Motion: .* \((\S+) .* (\d+) features", printed).groups()
    assert f"or {speed} c" in page
    assert f"mean of {n} secure features" in page
    assert f"Lorentz factor, {np.hypot(1, float(speed)):.1f} " in page


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
        assert len(read_survey(path).names) == 2
    else:
        given, _ = read_config(path)
        assert Settings(**given).epochs


@pytest.mark.slow
def test_python_that_is_no_doctest_runs(tmp_path, monkeypatch):
    """The lines of the README for a real jet, on a simulated one of that name."""
    (text,) = blocks(REPOSITORY / "README.rst", "python")
    monkeypatch.chdir(tmp_path)
    beams = [Beam(size * u.mas, 0.8 * u.mas, 0 * u.deg) for size in (1.0, 1.1, 0.9, 1)]
    flow = Stream("flow", dx=6.0, sigma=3.0, density=0.6)
    small = {"shape": (64, 128), "extent": (20.0, 100.0), "axis": 32.0, "core": 3.0}
    jet = JetSimulation([flow], n_epochs=4, beams=beams, **small).run(rng=1)
    write_epochs(jet.cube, "3c273")
    names = {}
    with warnings.catch_warnings():
        # Features crowd about its core, and four epochs are too few for a p-value.
        warnings.simplefilter("ignore")
        exec(text.replace("n_trials=1000", "n_trials=10"), names)
    assert "pm" in names["result"].components.colnames
