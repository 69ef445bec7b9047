# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""Fixtures and settings of the tests and of the doctests of package and docs."""

import gc
import os
from pathlib import Path

# Tests run in as many processes as there are cores.  Libraries read these variables
# when they are loaded.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
# What is imported and collected stays to the end, and tests leave little in circles:
# that the collector of garbage looks through all again and again takes a twentieth of
# the time.
gc.disable()
gc.set_threshold(50_000)

import pytest
from pytest_astropy_header.display import PYTEST_HEADER_MODULES, TESTED_VERSIONS

import astro_scc

HERE = Path(__file__).parent


def pytest_configure(config):
    config.option.astropy_header = True
    PYTEST_HEADER_MODULES.clear()
    for name, module in {
        "numpy": "numpy",
        "scipy": "scipy",
        "astropy": "astropy",
        "scikit-image": "skimage",
        "photutils": "photutils",
        "regions": "regions",
        "reproject": "reproject",
        "matplotlib": "matplotlib",
    }.items():
        PYTEST_HEADER_MODULES[name] = module
    TESTED_VERSIONS["astro_scc"] = astro_scc.__version__
    os.environ.setdefault("MPLBACKEND", "Agg")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def find_shared_data():
    """Folder of the test data, or None."""
    given = os.environ.get("ASTRO_SCC_DATA")
    if given:
        folder = Path(given)
        if not folder.is_dir():
            raise pytest.UsageError(
                f"ASTRO_SCC_DATA={given} is not a folder; unset it or correct it"
            )
        return folder.resolve()
    folder = HERE.parent / "shared" / "data"
    return folder if folder.is_dir() else None


#: Table 4 of Lister et al. (2021), of which the pages say where it is.
MOJAVE_TABLE = "apjac230ft4_mrt.txt"
NO_DATA = (
    "the test data are not part of the repository: lay them in ../shared/data beside "
    "the clone or name their folder in ASTRO_SCC_DATA"
)


@pytest.fixture(scope="session")
def shared_data():
    """Path of the folder with the test data; skips where there is none."""
    folder = find_shared_data()
    if folder is None:
        pytest.skip(NO_DATA)
    return folder


@pytest.fixture(autouse=True)
def _scratch_folder_for_doctests(request, monkeypatch, tmp_path_factory):
    """
    Run doctests in a folder of their own, so that they may write files.

    The test data are in ``../shared/data``, and the journal's table of MOJAVE in the
    folder itself, as they are for a reader who pastes the example in a clone; a page
    that names them is skipped where there are none.
    """
    if isinstance(request.node, pytest.Function):
        return
    folder = find_shared_data()
    needed = "../shared/data", MOJAVE_TABLE
    if folder is None and any(x in request.node.dtest.docstring for x in needed):
        pytest.skip(NO_DATA)
    scratch = tmp_path_factory.mktemp("doctest")
    if folder is not None:
        (scratch / "shared").mkdir()
        (scratch / "shared" / "data").symlink_to(folder, target_is_directory=True)
    (scratch / "clone").mkdir()
    if folder is not None:
        table = folder / "mojave_xviii" / MOJAVE_TABLE
        (scratch / "clone" / MOJAVE_TABLE).symlink_to(table)
    monkeypatch.chdir(scratch / "clone")
