# Licensed under a 3-clause BSD style license - see LICENSE.rst
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.stacking.velocities import VelocityGrid

speed = st.floats(0.01, 100.0)


@given(speed, speed, st.floats(0.02, 3.0), st.floats(0.02, 3.0))
def test_covers_what_is_asked_symmetrically_with_a_point_at_zero(v1, v2, n1, n2):
    step = v1 / n1 / 20, v2 / n2 / 20
    grid = VelocityGrid.covering((v1, v2), step)
    assert grid.v_max == pytest.approx((v1, v2))
    assert grid.shape == (len(grid.v2), len(grid.v1))
    for axis, largest, found in zip((grid.v1, grid.v2), step, grid.step, strict=True):
        assert 0 in axis
        np.testing.assert_allclose(axis, -axis[::-1])
        np.testing.assert_allclose(np.diff(axis), found)
        assert found <= largest * (1 + 1e-6)


def test_one_speed_and_one_step_hold_for_both_axes():
    grid = VelocityGrid.covering(2.0, 0.5)
    assert grid.shape == (9, 9)
    assert grid.step == (0.5, 0.5)


def test_spacing_grows_where_there_would_be_too_many():
    grid = VelocityGrid.covering((10.0, 1.0), 1e-6, max_size=101)
    assert grid.shape == (101, 101)
    assert grid.v_max == (10.0, 1.0)


def test_a_step_beyond_the_largest_velocity_leaves_three():
    assert VelocityGrid.covering(1.0, 5.0).v1.tolist() == [-1.0, 0.0, 1.0]


@pytest.mark.parametrize("wrong", [0.0, -1.0, np.nan, np.inf, (1.0, 0.0)])
def test_numbers_must_be_positive_and_finite(wrong):
    with pytest.raises(ValueError, match="largest velocity must be positive"):
        VelocityGrid.covering(wrong, 0.1)
    with pytest.raises(ValueError, match="velocity step must be positive"):
        VelocityGrid.covering(1.0, wrong)
