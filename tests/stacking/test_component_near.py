# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The maximum nearest to a velocity, on surfaces whose maxima are known."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from astro_scc.stacking.stack import find_velocity_peaks, velocity_peak_near
from astro_scc.stacking.velocities import VelocityGrid

GRID = VelocityGrid.covering((8.0, 6.0), (0.25, 0.2))
BOX = (4.0, 2.0)


def surface(*peaks):
    """Gaussians of (v1, v2, height)."""
    return sum(
        h * np.exp(-0.5 * ((GRID.v1 - x) ** 2 + (GRID.v2[:, None] - y) ** 2) / 0.6**2)
        for x, y, h in peaks
    )


TWO = surface((-3.0, 1.0, 1.0), (2.0, -2.0, 0.3))


@pytest.mark.parametrize(
    ("near", "v1", "v2", "height"),
    [
        ((-3.0, 1.0), -3.0, 1.0, 1.0),
        ((-2.0, 1.5), -3.0, 1.0, 1.0),
        # The lower one, if it is the nearer.
        ((1.5, -1.8), 2.0, -2.0, 0.3),
    ],
)
def test_the_nearest_maximum_is_taken(near, v1, v2, height):
    c = velocity_peak_near(TWO, GRID, BOX, *near)
    assert c.fitted
    np.testing.assert_allclose((c.v1, c.v2), (v1, v2), atol=0.02)
    assert c.coefficient == pytest.approx(height, rel=0.02)
    assert c in find_velocity_peaks(TWO, GRID, BOX)


@given(st.floats(-8, 8), st.floats(-6, 6))
def test_within_half_the_box_or_at_the_velocity_itself(v1, v2):
    c = velocity_peak_near(TWO, GRID, BOX, v1, v2)
    distance = [
        np.hypot((f.v1 - v1) / BOX[0], (f.v2 - v2) / BOX[1])
        for f in find_velocity_peaks(TWO, GRID, BOX)
    ]
    if min(distance) <= 0.5:
        assert c == find_velocity_peaks(TWO, GRID, BOX)[int(np.argmin(distance))]
        return
    assert not c.fitted
    assert (c.v1, c.v2) == (v1, v2)
    assert np.isnan([c.width1, c.width2]).all()
    # The coefficient of the nearest point of the grid.
    assert abs(GRID.v1[c.column] - v1) <= GRID.step[0] / 2 + 1e-9
    assert abs(GRID.v2[c.row] - v2) <= GRID.step[1] / 2 + 1e-9
    assert c.coefficient == TWO[c.row, c.column]


def test_distance_is_in_units_of_the_box():
    """Farther in velocity, but nearer in the box that is long that way."""
    scc = surface((1.6, 0.0, 1.0), (0.0, 0.9, 1.0))
    c = velocity_peak_near(scc, GRID, BOX, 0.0, 0.0)
    assert c.v1 == pytest.approx(1.6, abs=0.1)
    c = velocity_peak_near(scc, GRID, BOX[::-1], 0.0, 0.0)
    assert c.v2 == pytest.approx(0.9, abs=0.1)


@pytest.mark.parametrize(
    "scc", [np.zeros(GRID.shape), np.ones(GRID.shape), -surface((0, 0, 1))]
)
def test_without_a_maximum_the_velocity_stays(scc):
    c = velocity_peak_near(scc, GRID, BOX, 0.5, 0.4)
    assert not c.fitted
    assert (c.v1, c.v2, c.row, c.column) == (0.5, 0.4, 32, 34)
    assert c.coefficient == scc[32, 34]


@given(st.floats(-6, 6), st.floats(-5, 5), st.floats(-1, 1), st.floats(-0.5, 0.5))
def test_one_peak_is_found_from_anywhere_nearby(x, y, dx, dy):
    assume(np.hypot(dx / BOX[0], dy / BOX[1]) < 0.45)
    c = velocity_peak_near(surface((x, y, 1.0)), GRID, BOX, x + dx, y + dy)
    np.testing.assert_allclose((c.v1, c.v2), (x, y), atol=0.01)
