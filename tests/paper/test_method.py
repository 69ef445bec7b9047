# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The paper's method from images to its table, figure and maps."""

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.paper.method import measure_as_in_paper
from astro_scc.report.answer import paper_lines
from astro_scc.simulation import simulate_two_fluid
from astro_scc.units import PM_UNIT

WEST = {"position_angle": 270 * u.deg, "scales": [2, 3], "alpha": 0.01}


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
    return measure_as_in_paper(cube, settings(), region=region, n_trials=99, rng=1)


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
    assert any("at fitted speeds" in k.get_text() for k in legend.get_texts())


def test_axes_of_the_sky_and_workers_give_the_same(jet_cube):
    found = measure_as_in_paper(jet_cube, settings(), n_trials=19, rng=1)
    how = {"n_trials": 19, "rng": 1, "n_workers": 2}
    sky = measure_as_in_paper(jet_cube, settings(position_angle="any"), **how)
    assert sky.frame.axis_names == ("east", "north")
    for name in ("pm_ra_cosdec", "pm_dec", "z_score", "coefficient"):
        first = u.Quantity(sky.components[name][0]).value
        expected = u.Quantity(found.components[name][0]).value
        assert first == pytest.approx(expected, rel=1e-3, abs=1e-3)


def test_what_cannot_be_measured_is_refused(jet_cube):
    nothing = np.zeros(jet_cube.shape[1:], dtype=bool)
    nothing[0, 0] = True
    for change, region, words in [
        ({"baseline": [5, 6] * u.yr}, None, "no two epochs are 5 to 6 yr apart"),
        ({"outward": True}, None, "^outward is for method spectrum"),
        ({}, nothing, "^the region: no significant pattern"),
    ]:
        with pytest.raises(ValueError, match=words):
            measure_as_in_paper(jet_cube, settings(**change), region=region, n_trials=2)
