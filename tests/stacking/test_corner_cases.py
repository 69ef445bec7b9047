# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Places that ordinary data do not come to."""

import sys

import numpy as np
import pytest

from astro_scc.stacking.stack import find_velocity_peaks, velocity_peak_near
from astro_scc.stacking.velocities import VelocityGrid


@pytest.mark.parametrize("height", [0.0, -1.0])
def test_a_stack_without_anything_has_no_component(height):
    grid = VelocityGrid.covering(2.0, 0.2)
    scc = np.full(grid.shape, height)
    found = velocity_peak_near(scc, grid, (1.0, 1.0), 0.52, -0.38)
    assert not found.fitted
    assert (found.v1, found.v2) == (0.52, -0.38)
    assert found.coefficient == height
    assert grid.v1[found.column] == pytest.approx(0.6)
    assert grid.v2[found.row] == pytest.approx(-0.4)


@pytest.mark.parametrize("aside", [(0.9, 0), (-0.9, 0), (0, 1.4), (0, -1.4)])
@pytest.mark.parametrize("times", [1.0, 1.2])
def test_a_fit_outside_the_box_is_none(aside, times, monkeypatch):
    module = sys.modules[find_velocity_peaks.__module__]
    grid = VelocityGrid.covering(4.0, 0.25)
    scc = np.exp(-(grid.v1**2 + grid.v2[:, None] ** 2) / 2)
    place = times * np.array(aside)
    fit = (*place, 1.0, 0.7, 0.8)
    monkeypatch.setattr(module, "fit_gaussian", lambda *args: fit)
    (found,) = find_velocity_peaks(scc, grid, (1.8, 2.8))
    assert found.fitted == (times == 1)
    expected = place if times == 1 else (0, 0)
    np.testing.assert_allclose((found.v1, found.v2), expected, atol=1e-6)
    assert np.isnan(found.width1) == (times > 1)
