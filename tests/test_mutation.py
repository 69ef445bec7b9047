# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The tool that changes the package at random."""

import ast
import importlib.util
import sys
from pathlib import Path

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


def test_what_is_changed(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("_astro_scc_mutation", TOOL)
    mutation = importlib.util.module_from_spec(spec)
    # Dataclasses look their module up.
    monkeypatch.setitem(sys.modules, spec.name, mutation)
    spec.loader.exec_module(mutation)
    box = tmp_path / "astro_scc" / "correlation" / "box.py"
    box.parent.mkdir(parents=True)
    for folder in box.parents[:2]:
        (folder / "__init__.py").touch()
    box.write_text(SOURCE)
    found = {(m.line, m.before, m.after) for m in mutation.mutants_of(box)}
    assert {
        (7, "3", "4"), (7, "3", "2"), (10, "0", "1"), (19, "2", "1"),
        (12, "len(values) < 1", "len(values) <= 1"),
        (12, "len(values) < 1", "len(values) >= 1"),
        (12, "not np.any(values)", "np.any(values)"),
        (12, "np.any(values)", "np.all(values)"),
        (14, "[:2]", "[1:2]"), (14, "[:2]", "[:]"), (15, "part - low", "part + low"),
        (15, "np.minimum(part - low, LIMIT, dtype=float)",
         "np.minimum(part - low, LIMIT)"),
        (15, "np.minimum(part - low, LIMIT, dtype=float)",
         "np.maximum(part - low, LIMIT, dtype=float)"),
    } <= found  # fmt: skip
    # Nothing in text, errors and annotations.
    assert {line for line, _, _ in found} == {7, 10, 12, 14, 15, 19}
    # Every mutant is another program.
    texts = [mutation.mutated(mutant) for mutant in mutation.mutants_of(box)]
    assert ast.unparse(ast.parse(SOURCE)) + "\n" not in texts
    assert len(set(texts)) == len(texts)
    for text in texts:
        compile(text, box, "exec")
