# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The page with linked panels: what it holds, and what a reader does with it."""

import re
import shutil
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from astro_scc.measurement.result import velocity_hdus
from astro_scc.streams.members import mean_speed
from astro_scc.visualization import explore, images

pytest.importorskip("bokeh", reason="bokeh is in the extra explore")

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
DOCUMENT = "Bokeh.documents[0]"
SOURCE = f"{DOCUMENT}.get_model_by_name('table').source"
#: Pixel on the screen of a point of the data of a plot.
PLACE = """([name, x, y]) => {
  let plot = Bokeh.documents[0].get_model_by_name(name)
  plot = plot.children ? plot.children[0] : plot
  const view = Bokeh.index.find_one_by_id(plot.id)
  const box = view.canvas_view.el.getBoundingClientRect()
  return [box.x + view.frame.x_scale.compute(x), box.y + view.frame.y_scale.compute(y)]
}"""


def parts(result):
    return result.streams, result.features, velocity_hdus(result)


@pytest.fixture(scope="module")
def page(result):
    return explore.Page(*parts(result), result.cube)


@pytest.fixture(scope="module")
def path(result, tmp_path_factory):
    return result.explore(tmp_path_factory.mktemp("explore") / "explore.html")


@contextmanager
def browser(path):
    playwright = pytest.importorskip("playwright.sync_api")
    if CHROMIUM is None:
        pytest.skip("there is no chromium or chrome")
    how = {"executable_path": CHROMIUM, "args": ["--no-sandbox"]}
    with playwright.sync_playwright() as driver, driver.chromium.launch(**how) as own:
        tab = own.new_page(viewport={"width": 1280, "height": 900})
        problems, local = [], ("file:", "data:", "blob:")
        tab.on("pageerror", lambda error: problems.append(str(error)))
        tab.on("request", lambda r: r.url.startswith(local) or problems.append(r.url))
        tab.goto(path.as_uri())
        ready = f"window.Bokeh && Bokeh.documents.length && {DOCUMENT}.is_idle"
        tab.wait_for_function(ready)
        yield tab
        assert problems == []


def selected(tab, expected):
    """Whether these rows are selected, or will be when the page has heard of it."""
    end, found = time.monotonic() + 20, None
    while found != expected and time.monotonic() < end:
        found = tab.evaluate(f"() => [...{SOURCE}.selected.indices]")
        tab.wait_for_timeout(50)
    return found == expected


@pytest.mark.slow
def test_a_reader_selects_and_looks(path, page, result):
    stream, own = result.streams[0], result.features["stream"]
    rows = np.flatnonzero(own == 1).tolist()
    with browser(path) as tab:
        status = tab.get_by_role("status")
        assert status.inner_text().startswith(f"All {len(own)} features")
        # A click on the first stream selects its features in all panels.
        names = "pm_parallel", "pm_transverse"
        peak = [stream[k].to_value(page.pm_unit) for k in names]
        tab.mouse.click(*tab.evaluate(PLACE, ["velocity", *map(float, peak)]))
        assert selected(tab, rows)
        words = status.inner_text().split()
        assert words[:2] == [str(len(rows)), "selected"]
        # Their mean and dispersion are those of the streams.
        names = ("pm", "pm_err", "n_epochs")
        columns = (np.asarray(page.features.data[k])[rows] for k in names)
        of_features, _, dispersion, _ = mean_speed(*columns)
        mean, spread = (
            float(words[words.index(w) + 1]) for w in ("motion", "dispersion")
        )
        assert mean == pytest.approx(of_features, rel=0.01)
        assert spread == pytest.approx(dispersion, rel=0.05, abs=0.01)


def test_large_images_are_binned_and_there_may_be_no_features(bare, monkeypatch):
    monkeypatch.setattr(explore, "PIXELS", 2_500)
    page = explore.Page(*parts(bare), bare.cube)
    roots = [root.name for root in page.document().roots]
    assert roots == ["choose", "velocity", "sky", "diagram", "time", "table"]
    assert page.notes == ["the images are binned by 6 x 6 pixels"]
    assert len(page.features.data["pm"]) == 0


def test_one_small_file_that_loads_nothing_and_runs_no_code(result, path, tmp_path):
    text = path.read_text(encoding="utf-8")
    assert len(text) < 2.6e6
    assert not re.search(r"""<(script|link|img)[^>]*(src|href)=["'](http|//)""", text)
    assert "simulated jet: features and velocities" in text
    *tables, hdus = parts(result)
    # Names from headers are text.
    hdus[0].header["OBJECT"] = "<script>alert(1)</script>"
    notes = ["without <images>"]
    path = explore.write_explore(tmp_path / "page.html", *tables, hdus, notes=notes)
    text = path.read_text(encoding="utf-8")
    assert "Note: without &lt;images&gt;." in text
    assert "CategoricalSlider" not in text.rpartition('"application/json"')[2]
    assert "<script>alert" not in text


@pytest.mark.parametrize("turned", [False, True])
def test_planes_are_the_images(jet_cube, turned):
    cube = jet_cube
    if turned:
        wcs = cube.wcs.deepcopy()
        wcs.wcs.pc = [[0, -1], [1, 0]]
        cube = replace(cube, wcs=wcs)
    step = cube.pixel_scale.value
    limits = images.image_limits(cube) + 0.005 * step * np.array([1, -1])
    planes, sides, n_bins = images.image_planes(cube, limits, 1e9)
    assert n_bins == 1
    assert planes.min() >= 1
    np.testing.assert_allclose(sides, limits, atol=1.1 * step)
    row, column = np.unravel_index(planes[2].argmax(), planes[2].shape)
    y, x = np.unravel_index(cube.data[2].argmax(), cube.data[2].shape)
    expected = [axis.value for axis in cube.pixel_to_offset(x, y)]
    found = sides[:, 0] + step * (np.array([column, row]) + 0.5)
    np.testing.assert_allclose(found, expected, atol=step)
