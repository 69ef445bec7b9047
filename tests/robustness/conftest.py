# Licensed under a 3-clause BSD style license - see LICENSE.rst
import runpy
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest

from astro_scc.cli import main

TOOLS = Path(__file__).parents[2] / "tools"


@cache
def load_tool(name):
    """The names of a script of ``tools``."""
    return SimpleNamespace(**runpy.run_path(str(TOOLS / f"{name}.py")))


def pytest_generate_tests(metafunc):
    if "case" in metafunc.fixturenames:
        cases = load_tool("inputs").CASES
        metafunc.parametrize("case", cases, ids=lambda case: case.name)


@pytest.fixture
def inputs():
    return load_tool("inputs")


@pytest.fixture
def tool():
    return load_tool


@pytest.fixture
def epochs(inputs, tmp_path):
    """Six images of the small jet."""
    folder = tmp_path / "jet"
    folder.mkdir()
    return inputs.series(folder)


@pytest.fixture
def measure(inputs, capsys):
    """Run ``astro-scc measure`` quickly; its status and what it says."""

    def run(*words):
        argv = ["measure", "--no-report", *inputs.QUICK, *words]
        status = main([str(word) for word in argv])
        return status, capsys.readouterr().err

    return run
