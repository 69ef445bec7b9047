# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Maxima and their fits on surfaces whose maxima are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.stacking.stack import find_velocity_peaks, fit_gaussian
from astro_scc.stacking.velocities import VelocityGrid

GRID = VelocityGrid.covering((10.0, 8.0), (0.5, 0.4))
BOX = (6.0, 6.0)


def gaussian(grid, x, y, sx, sy, angle=0.0, height=1.0):
    u, v = grid.v1 - x, grid.v2[:, None] - y
    c, s = np.cos(angle), np.sin(angle)
    p, q = c * u + s * v, -s * u + c * v
    return height * np.exp(-0.5 * ((p / sx) ** 2 + (q / sy) ** 2))


def marginal(sx, sy, angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.hypot(c * sx, s * sy), np.hypot(s * sx, c * sy)


@given(
    st.floats(-0.5, 0.5),
    st.floats(-0.5, 0.5),
    st.floats(0.8, 2.0),
    st.floats(0.8, 2.0),
    st.floats(0, np.pi),
    st.floats(1e-6, 1e6),
)
def test_fit_of_a_gaussian_is_exact(x, y, sx, sy, angle, height):
    grid = VelocityGrid.covering(2.0, 0.25)
    surface = gaussian(grid, x, y, sx, sy, angle, height)
    found = fit_gaussian(surface, grid.v1, grid.v2)
    np.testing.assert_allclose(found[:2], (x, y), atol=1e-6)
    assert found[2] == pytest.approx(height)
    np.testing.assert_allclose(found[3:], marginal(sx, sy, angle), rtol=1e-6)


def test_fit_far_from_zero_keeps_its_digits():
    x = 1e4 + np.linspace(-2, 2, 9)
    y = -3e3 + np.linspace(-1, 1, 9)
    f = np.exp(-0.5 * ((x - 1e4 - 0.25) ** 2 + (y[:, None] + 3e3) ** 2 / 0.04))
    np.testing.assert_allclose(
        fit_gaussian(f, x, y), (1e4 + 0.25, -3e3, 1, 1, 0.2), rtol=1e-7
    )


def test_fit_follows_the_high_values_under_noise():
    """Weights f^2: errors of the logarithm of low values do not count."""
    rng = np.random.default_rng(0)
    x = y = np.linspace(-3, 3, 25)
    errors = []
    for _ in range(100):
        centre = rng.uniform(-0.3, 0.3, 2)
        f = np.exp(-0.5 * ((x - centre[0]) ** 2 + (y[:, None] - centre[1]) ** 2))
        f = np.clip(f + rng.normal(scale=0.02, size=f.shape), 0, None)
        errors.append(fit_gaussian(f, x, y)[:2] - centre)
    assert np.abs(errors).max() < 0.1
    assert np.std(errors) < 0.02


@pytest.mark.parametrize(
    "surface",
    [
        np.zeros((5, 5)),
        -np.ones((5, 5)),
        np.ones((5, 5)),
        np.add.outer(np.arange(5.0), np.arange(5.0)),  # a slope
        np.exp(0.1 * np.add.outer(np.arange(-2, 3) ** 2, -np.arange(-2.0, 3))),
        np.exp(0.1 * np.multiply.outer(np.arange(-2, 3.0), np.arange(-2, 3))),  # saddle
        np.eye(5),  # too few values
    ],
)
def test_no_maximum_no_fit(surface):
    axis = np.arange(-2.0, 3)
    assert fit_gaussian(surface, axis, axis) is None


def test_a_line_of_values_has_no_fit():
    surface = np.zeros((7, 7))
    surface[3] = np.exp(-0.1 * np.arange(-3, 4) ** 2)
    assert fit_gaussian(surface, np.arange(7.0), np.arange(7.0)) is None


@pytest.mark.parametrize(
    ("x", "y", "sx", "sy", "angle"),
    [
        (0.0, 0.0, 1.5, 1.5, 0.0),
        (3.13, -2.29, 1.0, 2.0, 0.0),
        (-4.75, 4.2, 2.0, 1.0, 0.6),
        (-1.6, 0.33, 1.2, 2.4, 2.2),
    ],
)
def test_one_gaussian_is_one_component(x, y, sx, sy, angle):
    scc = gaussian(GRID, x, y, sx, sy, angle, height=0.3)
    (c,) = find_velocity_peaks(scc, GRID, BOX)
    assert c.fitted
    np.testing.assert_allclose((c.v1, c.v2), (x, y), atol=1e-6)
    np.testing.assert_allclose((c.width1, c.width2), marginal(sx, sy, angle))
    assert c.row == np.abs(GRID.v2 - y).argmin()
    assert c.column == np.abs(GRID.v1 - x).argmin()
    assert c.coefficient == scc[c.row, c.column] == scc.max()


@given(st.floats(-6, 6), st.floats(-5, 5))
def test_the_grid_point_is_the_maximum_wherever_it_lies(x, y):
    scc = gaussian(GRID, x, y, 1.1, 0.7, 0.4)
    components = find_velocity_peaks(scc, GRID, BOX)
    best = components[0]
    assert scc[best.row, best.column] == scc.max()
    np.testing.assert_allclose((best.v1, best.v2), (x, y), atol=1e-5)


@pytest.mark.parametrize("box", [(4.0, 4.0), (6.0, 6.0), (10.0, 10.0)])
@pytest.mark.parametrize("second", [1.0, 0.6])
@pytest.mark.parametrize("separation", [5.0, 6.0, 8.0])
def test_overlapping_gaussians_are_kept_apart(separation, second, box):
    """Four widths and more apart; the box holds the neighbour too."""
    x = np.array([-0.4, separation - 0.4])
    scc = gaussian(GRID, x[0], 0.3, 1.2, 1.0)
    scc += gaussian(GRID, x[1], -0.2, 1.2, 1.0, height=second)
    first, other = sorted(find_velocity_peaks(scc, GRID, box), key=lambda c: c.v1)
    assert first.fitted
    assert other.fitted
    np.testing.assert_allclose((first.v1, other.v1), x, atol=0.05)
    np.testing.assert_allclose((first.v2, other.v2), (0.3, -0.2), atol=0.05)


def test_at_three_widths_each_fit_stays_at_its_own_maximum():
    scc = gaussian(GRID, -2.0, 0.0, 1.3, 1.3) + gaussian(GRID, 2.0, 0.0, 1.3, 1.3)
    first, other = sorted(
        find_velocity_peaks(scc, GRID, (10.0, 10.0)), key=lambda c: c.v1
    )
    np.testing.assert_allclose((first.v1, other.v1), (-2.0, 2.0), atol=0.3)
    np.testing.assert_allclose((first.v2, other.v2), 0.0, atol=1e-6)


def test_a_level_beneath_does_not_widen_the_fit():
    scc = 0.1 + gaussian(GRID, 1.3, -0.7, 1.2, 1.2, height=0.9)
    (c,) = find_velocity_peaks(scc, GRID, (8.0, 8.0))
    np.testing.assert_allclose((c.v1, c.v2), (1.3, -0.7), atol=0.01)
    assert c.width1 == pytest.approx(1.2, rel=0.12)


def test_sorted_by_falling_coefficient_and_cut_at_the_threshold():
    heights = {-6.0: 0.2, 0.0: 0.5, 6.0: 0.3}
    scc = sum(gaussian(GRID, x, 0.0, 0.8, 0.8, height=h) for x, h in heights.items())
    found = find_velocity_peaks(scc, GRID, BOX)
    assert [round(c.v1) for c in found] == [0, 6, -6]
    np.testing.assert_allclose([c.coefficient for c in found], [0.5, 0.3, 0.2])
    assert len(find_velocity_peaks(scc, GRID, BOX, threshold=0.25)) == 2
    assert find_velocity_peaks(scc, GRID, BOX, threshold=0.9) == []


@pytest.mark.parametrize("place", [(10.0, 0.0), (0.0, -8.0), (10.0, 8.0), (11.0, 0.0)])
def test_a_maximum_on_the_border_is_none(place):
    assert find_velocity_peaks(gaussian(GRID, *place, 1.0, 1.0), GRID, BOX) == []


def test_beside_the_border_the_box_is_cut():
    (c,) = find_velocity_peaks(gaussian(GRID, 9.2, -7.1, 1.0, 1.0), GRID, BOX)
    np.testing.assert_allclose((c.v1, c.v2), (9.2, -7.1), atol=1e-6)
    assert c.fitted


def test_an_empty_map_has_no_components():
    assert find_velocity_peaks(np.zeros(GRID.shape), GRID, BOX) == []


def test_too_narrow_for_a_fit_the_quadratic_serves():
    """A kernel below the grid's spacing: fewer than six points reach half."""
    scc = gaussian(GRID, 0.1, 0.0, 0.25, 0.2)
    (c,) = find_velocity_peaks(scc, GRID, BOX)
    assert not c.fitted
    assert np.isnan(c.width1)
    assert np.isnan(c.width2)
    assert abs(c.v1 - 0.1) < 0.25
    assert abs(c.v2) < 0.2


def test_a_box_smaller_than_the_grid_still_holds_the_neighbours():
    scc = gaussian(GRID, 2.6, 1.1, 1.5, 1.5)
    (c,) = find_velocity_peaks(scc, GRID, (1e-3, 1e-3))
    assert c.fitted
    np.testing.assert_allclose((c.v1, c.v2), (2.6, 1.1), atol=1e-6)
