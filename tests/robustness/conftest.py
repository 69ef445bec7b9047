# Licensed under a 3-clause BSD style license - see LICENSE.rst
import importlib.util
import sys
from pathlib import Path

import pytest

from astro_scc.cli import main

TOOLS = Path(__file__).parents[2] / "tools"


def load_tool(name):
    """A script of ``tools`` as a module."""
    full = f"_astro_scc_tools_{name}"
    if full not in sys.modules:
        spec = importlib.util.spec_from_file_location(full, TOOLS / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        # Dataclasses look their module up.
        sys.modules[full] = module
        spec.loader.exec_module(module)
    return sys.modules[full]


def pytest_generate_tests(metafunc):
    if "case" in metafunc.fixturenames:
        cases = [
            pytest.param(case, id=case.name, marks=[pytest.mark.slow] * case.slow)
            for case in load_tool("inputs").CASES
        ]
        metafunc.parametrize("case", cases)


@pytest.fixture(scope="session")
def inputs():
    return load_tool("inputs")


@pytest.fixture(scope="session")
def fuzz():
    return load_tool("fuzz")


@pytest.fixture(scope="session")
def interrupts():
    return load_tool("interrupts")


@pytest.fixture
def epochs(inputs, tmp_path):
    """Five images of the small jet."""
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
