# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the package promises before it computes anything."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import astro_scc

REPOSITORY = Path(__file__).parents[1]
#: What may be imported together with the classes, but costs a second or more.
SLOW = "astropy.cosmology matplotlib photutils regions reproject scipy.stats".split()
HEAVY = [*SLOW, *"astropy dask ndcube numpy scipy skimage".split()]


def test_the_files_for_citation_agree_with_the_changes():
    changes = (REPOSITORY / "CHANGES.rst").read_text(encoding="utf-8")
    # Of the last release that has a date.
    version, date = re.search(r"^(\S+) \((\d\S+)\)\n-", changes, re.M).groups()
    meta = json.loads((REPOSITORY / "codemeta.json").read_text(encoding="utf-8"))
    cff = (REPOSITORY / "CITATION.cff").read_text(encoding="utf-8")
    assert (meta["version"], meta["dateModified"]) == (version, date)
    assert f"version: '{version}'\ndate-released: '{date}'\n" in cff
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text("utf-8"))
    assert meta["description"] == project["project"]["description"]
    assert meta["softwareRequirements"] == project["project"]["dependencies"]


LATER = "cli EpochCube decomposition,paper,kinematics,streams visualization,report"
PARTS = [pytest.param(k, SLOW, marks=pytest.mark.slow) for k in LATER.split()]


@pytest.mark.parametrize(("names", "absent"), [("__version__", HEAVY), *PARTS])
def test_libraries_are_imported_at_first_use(names, absent):
    code = f"from astro_scc import {names}\nimport sys\nprint(*sys.modules)"
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert set(done.stdout.split()).isdisjoint(absent)


def test_public_names_and_folders_are_attributes_and_nothing_else():
    for name in astro_scc.__all__:
        assert getattr(astro_scc, name).__name__ == name
    assert set(astro_scc.__all__) == set(astro_scc._PUBLIC) <= set(dir(astro_scc))
    folders = Path(astro_scc.__file__).parent.glob("*/__init__.py")
    # The command line is a program, not for use from Python.
    rooms = {path.parent.name for path in folders} - {"cli"}
    modules = {"expansion", "grid", "patterns", "recovery"}
    assert rooms | modules == set(astro_scc._FOLDERS)
    for name in astro_scc._FOLDERS:
        assert getattr(astro_scc, name).__name__ == f"astro_scc.{name}"
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        astro_scc.nothing  # noqa: B018


def test_documented_bounds_are_those_of_the_metadata():
    with open(REPOSITORY / "pyproject.toml", "rb") as file:
        dependencies = tomllib.load(file)["project"]["dependencies"]
    install = (REPOSITORY / "docs" / "install.rst").read_text(encoding="utf-8")
    tox = (REPOSITORY / "tox.ini").read_text(encoding="utf-8")
    for dependency in dependencies:
        name, oldest = dependency.split(">=")
        assert re.search(rf"^{name} +{re.escape(oldest)} ", install, re.MULTILINE), name
        assert f"oldestdeps: {name}=={oldest}" in tox, name
