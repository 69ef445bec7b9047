# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The tool that changes the package at random: what it changes, and what it tells."""

import ast
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).parents[1] / "tools" / "mutation.py"


@pytest.fixture(scope="module")
def mutation():
    spec = importlib.util.spec_from_file_location("_astro_scc_mutation", TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SOURCE = '''"""A module."""
import numpy as np

__all__ = ["clipped"]

#: Text.
LIMIT = 3
CACHE_BYTES = 2**20


def clipped(values, *, low: int = 0):
    """No more than LIMIT."""
    if len(values) < 1 or not np.any(values):
        raise ValueError(f"{len(values)} values, 1 is needed")
    part = values[:2]
    return np.minimum(part - low, LIMIT, dtype=float)


class Box:
    side = 2

    def __repr__(self):
        return f"<{self.side + 1}>"
'''


@pytest.fixture
def clone(tmp_path):
    """A repository of one module."""
    room = tmp_path / "repository" / "astro_scc" / "correlation"
    room.mkdir(parents=True)
    for folder in (room, room.parent):
        (folder / "__init__.py").touch()
    (room / "box.py").write_text(SOURCE)
    return tmp_path / "repository"


PATH = "astro_scc/correlation/box.py"


def test_what_is_changed(mutation, clone):
    found = {(m.line, m.before, m.after) for m in mutation.candidates(clone, PATH)}
    assert {
        (7, "3", "4"),
        (7, "3", "2"),
        (11, "0", "1"),
        (13, "len(values) < 1", "len(values) <= 1"),
        (13, "len(values) < 1", "len(values) >= 1"),
        (13, "not np.any(values)", "np.any(values)"),
        (13, "np.any(values)", "np.all(values)"),
        (15, "[:2]", "[1:2]"),
        (15, "[:2]", "[:]"),
        (16, "part - low", "part + low"),
        (16, "np.minimum(part - low, LIMIT, dtype=float)",
         "np.minimum(part - low, LIMIT)"),
        (16, "np.minimum(part - low, LIMIT, dtype=float)",
         "np.maximum(part - low, LIMIT, dtype=float)"),
        (20, "2", "1"),
    } <= found  # fmt: skip
    # Nothing in text, errors, annotations, and what bounds memory only.
    assert {line for line, _, _ in found} == {7, 11, 13, 15, 16, 20}


def test_every_mutant_is_another_program(mutation, clone):
    plain = ast.unparse(ast.parse(SOURCE))
    texts = [mutation.mutated(SOURCE, m) for m in mutation.candidates(clone, PATH)]
    assert plain not in texts
    assert len(set(texts)) == len(texts)
    for text in texts:
        compile(text, PATH, "exec")


def test_lines_whose_tests_are_run(mutation, clone):
    scopes = {m.line: m.scopes for m in mutation.candidates(clone, PATH)}
    body = list(range(12, 17))
    # A constant by what uses it, a default by its function.
    assert scopes[7][0] == body
    assert scopes[11][0] == body
    assert scopes[13][:2] == [[13], body]
    assert scopes[16][:2] == [[16], body]


def test_draws_repeat_by_their_seed(mutation, clone):
    def draw(number, seed):
        return [str(m) for m in mutation.draw(clone, "correlation", number, seed)]

    assert draw(5, 1) == draw(5, 1)
    assert draw(5, 1) != draw(5, 2)
    every = mutation.candidates(clone, PATH)
    assert sorted(draw(999, 1)) == sorted(str(m) for m in every)


def test_summary(mutation, clone):
    mutants = mutation.draw(clone, "correlation", 4, 1)
    verdicts = ["killed", "survived", "time", "killed"]
    pairs = list(zip(mutants, verdicts, strict=True))
    lines = mutation.summary({"correlation": pairs}).splitlines()
    assert lines[1].split() == ["correlation", "4", "3", "1", "75.0%", "(19.4%", "to",
                                "99.4%)"]  # fmt: skip
    assert lines[-1].strip() == f"{mutants[1].before}  ->  {mutants[1].after}"
    assert lines[-2] == f"correlation/box.py:{mutants[1].line}: {mutants[1].source}"


@pytest.mark.slow
def test_tests_kill_what_they_see(clone, tmp_path):
    folder = tmp_path / "work"
    (clone / "tools").mkdir()
    shutil.copy(TOOL, clone / "tools")
    tests = clone / "tests" / "correlation"
    tests.mkdir(parents=True)
    (tests / "test_box.py").write_text(
        "import numpy as np\n"
        "from astro_scc.correlation.box import clipped\n"
        "def test_it():\n"
        "    assert clipped(np.array([1.0, 9.0]), low=0) is not None\n"
    )
    command = [sys.executable, clone / "tools" / "mutation.py", folder]
    command += ["--rooms", "correlation", "--number", "12"]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    assert "return None" not in found.stdout
    row = found.stdout.splitlines()[3].split()
    assert row[:2] == ["correlation", "12"]
    # Not more is seen than that something comes back.
    assert 0 < int(row[2]) < 12
    assert (clone / PATH).read_text() == SOURCE
    assert (folder / "clone" / PATH).read_text() == SOURCE
    (tests / "test_box.py").write_text("def test_it():\n    assert False\n")
    found = subprocess.run([*command, "--record"], capture_output=True, check=False)
    assert found.returncode == 1
