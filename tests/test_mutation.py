# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The tool that changes the package at random."""

import ast
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TOOL = Path(__file__).parents[1] / "tools" / "mutation.py"
SOURCE = '''"""A module."""
import numpy as np

__all__ = ["clipped"]

#: Text.
LIMIT = 3


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
def mutation(monkeypatch):
    spec = importlib.util.spec_from_file_location("_astro_scc_mutation", TOOL)
    module = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def box(tmp_path):
    """A repository of one module."""
    room = tmp_path / "repository" / "astro_scc" / "correlation"
    room.mkdir(parents=True)
    for folder in (room, room.parent):
        (folder / "__init__.py").touch()
    (room / "box.py").write_text(SOURCE)
    return room / "box.py"


def test_what_is_changed(mutation, box):
    found = {(m.line, m.before, m.after) for m in mutation.mutants_of(box)}
    assert {
        (7, "3", "4"),
        (7, "3", "2"),
        (10, "0", "1"),
        (12, "len(values) < 1", "len(values) <= 1"),
        (12, "len(values) < 1", "len(values) >= 1"),
        (12, "not np.any(values)", "np.any(values)"),
        (12, "np.any(values)", "np.all(values)"),
        (14, "[:2]", "[1:2]"),
        (14, "[:2]", "[:]"),
        (15, "part - low", "part + low"),
        (15, "np.minimum(part - low, LIMIT, dtype=float)",
         "np.minimum(part - low, LIMIT)"),
        (15, "np.minimum(part - low, LIMIT, dtype=float)",
         "np.maximum(part - low, LIMIT, dtype=float)"),
        (19, "2", "1"),
    } <= found  # fmt: skip
    # Nothing in text, errors and annotations.
    assert {line for line, _, _ in found} == {7, 10, 12, 14, 15, 19}


def test_every_mutant_is_another_program(mutation, box):
    texts = [mutation.mutated(mutant) for mutant in mutation.mutants_of(box)]
    assert ast.unparse(ast.parse(SOURCE)) + "\n" not in texts
    assert len(set(texts)) == len(texts)
    for text in texts:
        compile(text, box, "exec")


@pytest.mark.slow
def test_tests_kill_what_they_see(box):
    clone = box.parents[2]
    (clone / "tools").mkdir()
    shutil.copy(TOOL, clone / "tools")
    tests = clone / "tests" / "correlation"
    tests.mkdir(parents=True)
    (tests / "test_box.py").write_text(
        "import numpy as np\n"
        "from astro_scc.correlation.box import clipped\n"
        "def test_it():\n"
        "    assert clipped(np.array([1.0, 9.0]), low=0).tolist() == [1, 3]\n"
    )
    command = [sys.executable, clone / "tools" / "mutation.py", "correlation"]
    command += ["--number", "6"]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    # One array is tested, an empty one and the class are not.
    assert "return None" not in found.stdout
    assert 0 < int(found.stdout.split()[1]) < 6
    assert box.read_text() == SOURCE
    (tests / "test_box.py").write_text("def test_it():\n    assert False\n")
    found = subprocess.run(command, capture_output=True, check=False)
    assert found.returncode == 1
