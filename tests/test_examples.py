# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The scripts of the gallery: they run, and print what the gallery shows."""

import doctest
import importlib
import itertools
import re
import runpy
import sys
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy.table import Table

FOLDER = Path(__file__).parents[1] / "examples"
#: Modules of functions, which run nothing.
MODULES = "common", "relativity"
NAMES = sorted({path.stem for path in FOLDER.glob("*.py")} - {*MODULES})
SIMULATED = ("hubble", "protostar", "shell", "sun", "texture", "two_fluid")
#: Of the journal, which the pages say how to get.
TABLE = "apjac230ft4_mrt.txt"
#: The dates to which real series are cut here, so that they take seconds.
EARLY = {
    "quasar_0003": {},
    "quasar_3c273": {"before": "1998-01-01"},
    "galaxy_3c120": {"before": "1998-06-01"},
    "galaxy_m87": {"before": "2001-01-01"},
}


@pytest.fixture(autouse=True)
def _folder_of_the_examples(monkeypatch):
    """Import as from a script of that folder, and leave nothing behind."""
    # Another folder of scripts has a module of this name.
    monkeypatch.delitem(sys.modules, "common", raising=False)
    monkeypatch.syspath_prepend(FOLDER)
    yield
    for name in (*NAMES, *MODULES):
        sys.modules.pop(name, None)


def printed(name):
    return (FOLDER / "results" / f"{name}.txt").read_text(encoding="utf-8")


def test_every_example_is_tested_and_shown():
    assert NAMES == sorted([*SIMULATED, *EARLY])
    pages = (FOLDER.parent / "docs" / f"{page}.rst" for page in ("gallery", "paper"))
    gallery, paper = (page.read_text(encoding="utf-8") for page in pages)
    for name in NAMES:
        assert (FOLDER / "results" / f"{name}.png").stat().st_size < 150_000
        command = f"python examples/{name}.py"
        command += "" if name in SIMULATED else f" {TABLE}"
        for shown in (command, f"<../examples/{name}.py>", f"notebooks/{name}.ipynb"):
            assert shown in gallery, shown
        for result in (f"{name}.txt", f"{name}.png"):
            assert result in gallery + paper, result
        assert f"    {command}\n" in (FOLDER / f"{name}.py").read_text("utf-8")


@pytest.mark.parametrize("name", NAMES)
def test_notebooks_define_what_the_scripts_do(name):
    pytest.importorskip("sphinx", reason="it configures the documentation")
    conf = runpy.run_path(str(FOLDER.parent / "docs" / "conf.py"))
    title, *cells = conf["notebook_of"](FOLDER / f"{name}.py")["cells"]
    assert title["source"].startswith("# ")
    *setting_up, measuring, figure = [cell["source"] for cell in cells]
    names = {}
    for cell in setting_up:
        assert "from common" not in cell
        exec(cell, names)
    assert names["brief"](Table({"a": [1.5]}), "a").colnames == ["a"]
    given = "" if name in SIMULATED else f'"{TABLE}"'
    assert measuring == f"table, figure = measure({given})\ntable"
    for cell, kind in zip(cells[-2:], ("text/plain", "image/png"), strict=True):
        assert cell["outputs"][0]["data"][kind]
    if name == "shell":
        exec(measuring.replace("\ntable", ""), names)
        assert list(names["table"].colnames) == printed(name).splitlines()[0].split()
        exec(figure, names)


@pytest.mark.slow
@pytest.mark.parametrize("name", SIMULATED)
def test_simulated_examples_print_what_the_gallery_shows(name, tmp_path, capsys):
    example = importlib.import_module(name)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [f"{name}.py", "--output", str(tmp_path)])
        example.run(example.measure, example.__doc__)
    text = capsys.readouterr().out
    # Rows that are not significant depend on the last digits.
    pages = (page.splitlines() for page in (printed(name), text))
    shown, found = ([k for k in page if "not significant" not in k] for page in pages)
    assert shown[:2] == found[:2]
    for one, other in zip(shown[3:], found[3:], strict=True):
        assert re.findall("[a-z]+", one) == re.findall("[a-z]+", other)
        assert numbers(one) == pytest.approx(numbers(other), rel=0.02, abs=0.02)


def numbers(line):
    return [float(number) for number in re.findall(r"-?\d+\.?\d*", line)]


@pytest.mark.slow
@pytest.mark.parametrize("name", EARLY)
def test_examples_of_real_jets_run(name, shared_data):
    example = importlib.import_module(name)
    table, figure = example.measure(
        shared_data / "mojave_xviii" / TABLE, n_trials=119, **EARLY[name]
    )
    assert table.colnames == printed(name).splitlines()[0].split()
    assert figure.axes


def test_relativity_in_its_doctests_and_there_and_back():
    relativity = importlib.import_module("relativity")
    assert doctest.testmod(relativity).failed == 0
    for beta, theta in itertools.product((0.1, 0.6, 0.999), (1, 40, 89)):
        t, d = np.radians(theta), 10 * u.kpc
        cos = beta * np.cos(t)
        rate = (beta * np.sin(t) / d.to_value(u.m) * 299792458) * u.rad / u.s
        motions = rate / (1 - cos), rate / (1 + cos)
        found = relativity.two_sided_jet(*motions, d, n_trials=2)
        assert found["beta"][0] == pytest.approx(beta, rel=1e-9)
        assert found["angle"][0].to_value(u.deg) == pytest.approx(theta, rel=1e-9)
        far = found["beta_max_distance"]
        at = relativity.two_sided_jet(*motions, far, n_trials=2)
        assert at["beta"][0] == pytest.approx(1)
