# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The page with linked panels of a measurement that is on the disk."""

import re
import shutil
import sys

import pytest
from astropy.io import fits

from astro_scc.cli import main

pytest.importorskip("bokeh", reason="bokeh is in the extra explore")
# The measurement that they share takes some seconds.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def measured(jet, tmp_path_factory):
    """A folder with images, and one with their measurement."""
    folder = tmp_path_factory.mktemp("explore")
    shutil.copytree(jet, folder / "jet")
    options = ["--scales", "2", "--n-trials", "20", "--seed", "1", "--quiet"]
    files = sorted(map(str, (folder / "jet").glob("*.fits")))
    assert main(["measure", *files, "-o", str(folder / "out"), *options]) == 0
    return folder


@pytest.fixture
def out(measured, here):
    shutil.copytree(measured / "out", here / "out")
    return here / "out"


def test_the_page_of_a_folder(measured, out, astro_scc):
    report = (out / "report.html").read_text(encoding="utf-8")
    assert f"<code>astro-scc explore {measured / 'out'}</code>" in report
    (out / "explore.html").write_text("an earlier page")
    status, said, notes = astro_scc("explore", "out")
    assert (status, notes) == (0, "")
    assert re.fullmatch(r"out/explore.html: 2\.\d MB\n", said)
    text = (out / "explore.html").read_text(encoding="utf-8")
    assert "two-fluid: features and velocities" in text
    assert "CategoricalSlider" in text.rpartition('"application/json"')[2]


@pytest.mark.parametrize(
    "change",
    ["moved", "fewer", "none"],
)
def test_without_its_images(change, measured, out, astro_scc):
    config = out / "config.toml"
    text = config.read_text(encoding="utf-8")
    if change == "moved":
        config.write_text(text.replace("two-fluid_00", "moved_00"), encoding="utf-8")
    elif change == "fewer":
        line = next(line for line in text.splitlines(True) if "two-fluid_00" in line)
        config.write_text(text.replace(line, ""), encoding="utf-8")
    else:
        config.unlink()
    status, _, notes = astro_scc("explore", out)
    assert status == 0
    assert notes.startswith("note: without images: ")
    assert notes.count("\n") == 1
    text = (out / "explore.html").read_text(encoding="utf-8")
    assert "Note: without images: " in text
    assert "CategoricalSlider" not in text.rpartition('"application/json"')[2]


def test_a_measurement_without_its_map(out, refused):
    (out / "scc.fits").unlink()
    assert "scc.fits: does not exist; measure again" in refused("explore", "out")
    (out / "scc.fits").write_text("nothing")
    assert "scc.fits: is no FITS file; measure again" in refused("explore", "out")


def test_a_table_that_is_none(out, refused):
    (out / "features.ecsv").write_text("nothing\n")
    assert "out/features.ecsv: is no ECSV table: " in refused("explore", "out")


@pytest.mark.parametrize("what", ["table", "column"])
def test_a_measurement_of_an_earlier_version(what, out, refused):
    if what == "table":
        with fits.open(out / "scc.fits") as hdus:
            del hdus["FEATURES"]
            hdus.writeto(out / "new.fits")
        (out / "new.fits").replace(out / "scc.fits")
    else:
        with fits.open(out / "scc.fits") as hdus:
            hdus["FEATURES"].columns.del_col("pm_axis1")
            hdus.writeto(out / "new.fits")
        (out / "new.fits").replace(out / "scc.fits")
    assert "out: is of an earlier version" in refused("explore", "out")


def test_without_bokeh(out, refused, monkeypatch):
    monkeypatch.setitem(sys.modules, "bokeh.models", None)
    for module in ("astro_scc.cli.explore", "astro_scc.visualization.explore"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    assert "pip install 'astro_scc[explore]'" in refused("explore", "out")
