# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The paper's method from images to its table, figure and maps."""

import astropy.units as u
import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.measurement.result import map_hdus
from astro_scc.paper.method import measure_as_in_paper
from astro_scc.report.answer import paper_lines
from astro_scc.simulation import simulate_two_fluid
from astro_scc.units import PM_UNIT

WEST = {"position_angle": 270 * u.deg, "scales": [1, 2, 3], "alpha": 0.01}


def settings(**change):
    return StackedCrossCorrelation(**WEST | change)


@pytest.fixture(scope="module")
def cube():
    return simulate_two_fluid(rng=2001, dense=True).cube


@pytest.fixture(scope="module")
def region(cube):
    region = np.zeros(cube.shape[1:], dtype=bool)
    region[:, 60:161] = True
    return region


@pytest.fixture(scope="module")
def found(cube, region):
    return measure_as_in_paper(cube, settings(), region=region, n_trials=200, rng=1)


def test_both_streams_are_significant(cube, found):
    """The map reaches four beams in an interval, as the paper's does."""
    table = found.components
    step = (cube.pixel_scale / np.diff(cube.years).mean()).to(PM_UNIT)
    far = [found.grid.v1[-1], found.grid.v2[-1]]
    assert far == pytest.approx(2 * [40 * step.value], rel=1e-3)
    moving = table[table["kind"] == "moving"]
    assert len(moving) == 2
    along = np.sort((moving["pm_parallel"] / step).value)
    assert along == pytest.approx([5.0, 20.0], abs=1.2)
    assert np.all(abs(moving["pm_transverse"]) < 4 * moving["pm_transverse_err"])
    assert np.all(moving["pm_err"] < 1.0 * step)
    assert np.all(moving["p_global"] <= 0.01)
    assert np.all(moving["z_score"] >= found.level)
    assert np.all(moving["found"] > 0.95)
    # Towards the west.
    assert np.all(moving["pm_ra_cosdec"] < 0)
    earlier = found.matched.select & (found.matched.ssps.epoch < len(cube) - 1)
    assert (table.meta["n_pairs"], table.meta["n_ssp"]) == (9, earlier.sum())
    assert repr(found) == f"<PaperMeasurement: 10 epochs, {len(table)} streams>"
    lines = paper_lines(table, found.level)
    assert lines[0].startswith("Paper's method: 2 streams with a z-score above")
    assert "p_normal" in lines[2].split()
    legend = found.plot().axes[1].get_legend()
    assert "maxima of the correlation" in [k.get_text() for k in legend.get_texts()]


def test_axes_of_the_sky_and_workers_give_the_same(cube, region, found):
    own = settings(position_angle="any")
    sky = measure_as_in_paper(
        cube, own, region=region, n_trials=200, rng=1, n_workers=2
    )
    assert sky.frame.axis_names == ("east", "north")
    for name in ("pm_ra_cosdec", "pm_dec", "z_score", "coefficient"):
        first = u.Quantity(sky.components[name][0]).value
        expected = u.Quantity(found.components[name][0]).value
        assert first == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_maps_are_those_of_the_stack(found, tmp_path):
    path = tmp_path / "scc.fits"
    fits.HDUList(map_hdus(found, text="a = 1")).writeto(path)
    with fits.open(path) as hdus:
        np.testing.assert_array_equal(hdus["COEFFICIENT"].data, found.coefficient)
        np.testing.assert_array_equal(hdus["ZSCORE"].data, found.z_score)
        wcs = WCS(hdus[1].header)
        x, y = 7, 11
        world = [float(v) for v in wcs.wcs_pix2world(x, y, 0)]
        assert list(wcs.wcs.cunit) == [PM_UNIT] * 2
        assert world == pytest.approx([found.grid.v1[x], found.grid.v2[y]])
    found.plot(unit="mas/yr").draw_without_rendering()


def test_settings_that_do_not_fit_the_images_are_refused(jet_cube):
    for change, words in [
        ({"baseline": [5, 6] * u.yr}, "no two epochs are 5 to 6 yr apart"),
        ({"outward": True}, "^outward is for method spectrum"),
    ]:
        with pytest.raises(ValueError, match=words):
            measure_as_in_paper(jet_cube, settings(**change), n_trials=2)


def test_regions_and_images_without_patterns_are_refused(jet_cube):
    nothing = np.zeros(jet_cube.shape[1:], dtype=bool)
    nothing[0, 0] = True
    with pytest.raises(ValueError, match="^the region: no significant pattern"):
        measure_as_in_paper(jet_cube, settings(), region=nothing, n_trials=2)
    noise = np.random.default_rng(0).normal(size=(3, 64, 64))
    empty = EpochCube.from_arrays(
        noise, ["2000-01-01", "2000-02-01", "2000-03-01"], pixel_scale=0.1 * u.mas
    )
    own = settings(detection=9.0)
    with pytest.raises(ValueError, match="no significant pattern .SSP. in any epoch"):
        measure_as_in_paper(empty, own, n_trials=2)
    with pytest.raises(ValueError, match="n_trials"):
        measure_as_in_paper(jet_cube, settings(), n_trials=1)
