# Licensed under a 3-clause BSD style license - see LICENSE.rst
import astropy.units as u
import numpy as np
import pytest

from astro_scc import EpochCube
from astro_scc.grid import (
    default_scales,
    flow_grids,
    has_core,
    region_weight,
    seen_flow,
)
from astro_scc.kinematics import (
    ExpansionFrame,
    PositionAngleFrame,
    RadialFrame,
    RidgeLine,
    SkyFrame,
)


@pytest.fixture(name="cube", scope="module")
def fixture_cube():
    data = np.random.default_rng(1).normal(size=(3, 64, 96))
    return EpochCube.from_arrays(
        data, ["2000-01-01", "2001-01-01", "2002-01-01"], pixel_scale=0.1 * u.mas,
        reference_pixel=(30, 32), beams=None,
    )  # fmt: skip


def grid_of(cube, frame, seen=None, core=False):
    seen = np.ones(cube.shape[1:], bool) if seen is None else seen
    return flow_grids(cube, frame, seen, 0.8, core=core)


def offsets(cube, grid):
    return [o.to_value(u.mas) for o in cube.pixel_to_offset(grid.x, grid.y)]


@pytest.mark.parametrize("angle", [0, 65, 270])
def test_coordinates_along_and_across(cube, angle):
    (grid,) = grid_of(cube, PositionAngleFrame(angle * u.deg))
    east, north = offsets(cube, grid)
    sin, cos = np.sin(np.radians(angle)), np.cos(np.radians(angle))
    along, across = east * sin + north * cos, east * cos - north * sin
    assert along == pytest.approx(grid.along[:, None] * 0.8 * np.ones_like(along))
    assert across == pytest.approx(grid.across * 0.8 * np.ones_like(along))


def test_a_counter_jet_is_the_other_half_outward(cube):
    (grid,) = grid_of(cube, PositionAngleFrame(90 * u.deg), core=True)
    east, north = offsets(cube, grid)
    assert grid.along.min() == 0
    assert grid.counter.any()
    assert east[-1, grid.counter].max() < 0 < east[-1, ~grid.counter].max()
    seen = np.zeros(cube.shape[1:], bool)
    seen[:, :28] = True
    (grid,) = grid_of(cube, PositionAngleFrame(90 * u.deg), seen, core=True)
    assert not grid.counter.any()


def test_radius_and_its_logarithm(cube):
    origin = [0.5, -0.3] * u.mas
    (grid,) = grid_of(cube, RadialFrame(origin))
    east, north = offsets(cube, grid)
    r = np.hypot(east - 0.5, north + 0.3)
    assert r == pytest.approx(0.8 * grid.along[:, None] * np.ones_like(r))
    assert grid.weight.max() == 1
    (shell,) = grid_of(cube, ExpansionFrame(origin, 2 * u.mas))
    east, north = offsets(cube, shell)
    r = np.hypot(east - 0.5, north + 0.3)
    assert np.log(r / 2) * 2 / 0.8 == pytest.approx(
        shell.along[:, None] * np.ones_like(r)
    )


def test_a_ridge_line_that_is_straight_is_a_position_angle(cube):
    line = RidgeLine([0, 1, 2, 3] * u.mas, [0, 1, 2, 3] * u.mas)
    (ridge,) = grid_of(cube, line)
    (straight,) = grid_of(cube, PositionAngleFrame(45 * u.deg))
    first = np.searchsorted(straight.along, -1e-9)
    n = min(len(ridge.along), len(straight.along) - first)
    assert np.allclose(ridge.along[:n], straight.along[first:][:n])
    both = np.intersect1d(ridge.across.round(6), straight.across.round(6))
    assert len(both) > 5


def test_twelve_directions_where_none_is_known(cube):
    grids = grid_of(cube, SkyFrame())
    assert len(grids) == 12
    assert np.ptp([g.angle for g in grids]) == pytest.approx(np.pi * 11 / 12)
    with pytest.raises(TypeError, match="no grid is known for the frame str"):
        grid_of(cube, "65 deg")


def test_regions_and_scales(cube):
    region = np.zeros(cube.shape[1:], bool)
    region[:, :40] = True
    (grid,) = grid_of(cube, PositionAngleFrame(270 * u.deg))
    weight = region_weight(region, grid)
    inside = grid.x < 38
    assert weight[inside & (grid.x > 0) & (grid.y > 0) & (grid.y < 63)].min() > 0.99
    assert weight[grid.x > 42].max() == 0
    assert default_scales(10.0) == (0, 1, 2)
    assert default_scales(2.0) == (0,)
    assert default_scales(40.0) == (2, 3, 4)


def test_what_is_seen(cube):
    data = cube.data.copy()
    data[:, 30:35, 40:50] += 100
    bright = EpochCube.from_arrays(data, cube.times, pixel_scale=0.1 * u.mas,
                                   reference_pixel=(30, 32))  # fmt: skip
    seen = seen_flow(bright, 0.8, core=False)
    assert seen[32, 45]
    assert seen.sum() < 70
    assert not seen_flow(bright, 3.0, core=True)[32, 45]
    assert not has_core(bright, 0.8)
    # On a sky that is not even, above which the noise of the sky leaves nothing.
    sky = np.linspace(0, 400, cube.shape[2])
    uneven = bright.with_step("a sky", data=data + sky)
    assert uneven.noise_rms().value.min() > 100
    assert seen_flow(uneven, 0.8, core=False)[32, 45]
    none = bright.with_step("nothing", data=cube.data + sky)
    assert not seen_flow(none, 0.8, core=False)[:, 10:-10].any()
