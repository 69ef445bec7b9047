# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Ridge lines against a circle, and as they are found in images of known jets."""

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.epochs import Beam, EpochCube
from astro_scc.epochs.restoring import add_gaussians
from astro_scc.kinematics import (
    PositionAngleFrame,
    RidgeLine,
    find_ridge_line,
    fit_position_angle,
)
from astro_scc.kinematics.frames import frame_displacements

RADIUS = 10.0


def circle(start=0.0, end=np.pi / 2, n=60):
    """From the origin to the west, then bending to the north."""
    t = np.linspace(start, end, n)
    return RidgeLine(-RADIUS * np.sin(t) * u.mas, RADIUS * (1 - np.cos(t)) * u.mas)


def on_circle(t, n=0.0):
    """Places at an angle along the circle and n towards its centre."""
    r = RADIUS - np.asarray(n)
    return -r * np.sin(t), RADIUS - r * np.cos(t)


@given(t=st.floats(0.05, 1.5), n=st.floats(-4, 4))
def test_distance_and_offset_of_a_circle(t, n):
    # West to north turns to larger position angles, towards the centre.
    east, north = on_circle(t, n)
    s, offset = circle().coordinates(east * u.mas, north * u.mas)
    assert abs(s.value - RADIUS * t) < 0.01
    assert abs(offset.value - n) < 0.01


@given(t=st.floats(0.1, 1.4), n=st.floats(-3, 3))
def test_axes_are_tangent_and_normal(t, n):
    east, north = on_circle(t, n)
    matrix = circle().matrix(east, north)
    np.testing.assert_allclose(matrix @ [-np.cos(t), np.sin(t)], [1, 0], atol=2e-2)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(2), atol=1e-12)


def test_displacement_follows_the_bend():
    start, end = np.array(on_circle(0.2)), np.array(on_circle(1.2))
    moved = circle().displacement(start[None], (end - start)[None])
    np.testing.assert_allclose(moved, [[RADIUS, 0.0]], atol=0.01)
    chord = np.hypot(*(end - start))
    assert chord < RADIUS - 0.3


@given(pa=st.floats(0, 359), x=st.floats(-20, 20), y=st.floats(-20, 20))
def test_straight_line_is_the_frame_of_its_position_angle(pa, x, y):
    p = np.radians(pa)
    s = np.array([0, 1.0, 2, 3, 4, 5])
    line = RidgeLine(s * np.sin(p) * u.mas, s * np.cos(p) * u.mas)
    frame = PositionAngleFrame(pa * u.deg)
    np.testing.assert_allclose(line.matrix(x, y), frame.matrix(), atol=1e-9)
    position, motion = np.array([[x, y]]), np.array([[0.3, -0.7]])
    np.testing.assert_allclose(
        frame_displacements(line, position, motion),
        frame_displacements(frame, position, motion),
        atol=1e-8,
    )


def test_goes_on_straight_beyond_its_ends():
    line = RidgeLine([0, -5, -10] * u.mas, [0, 0, 0] * u.mas)
    s, n = line.coordinates([3, -14] * u.mas, [1, 2] * u.mas)
    np.testing.assert_allclose(s.value, [-3, 14])
    # To the west, larger position angles are north.
    np.testing.assert_allclose(n.value, [1, 2])
    east, north = line.at([-3, 14] * u.mas)
    np.testing.assert_allclose(east.value, [3, -14])
    np.testing.assert_allclose(north.value, 0, atol=1e-12)
    assert line.position_angle(12 * u.mas).value == pytest.approx(270)


def test_table_there_and_back():
    line = circle()
    again = RidgeLine.from_table(line.to_table())
    np.testing.assert_array_equal(again.east, line.east)
    assert again.length == line.length
    assert "60 points" in repr(line)
    table = line.to_table()
    table.remove_column("north")
    with pytest.raises(ValueError, match="north is missing"):
        RidgeLine.from_table(table)


@pytest.mark.parametrize(
    ("east", "north", "message"),
    [
        ([1.0], [1.0], "two points"),
        ([1.0, 2.0], [1.0, 2.0, 3.0], "two points"),
        ([1.0, 1.0], [2.0, 2.0], "differ"),
        ([1.0, np.nan], [2.0, 2.0], "finite"),
    ],
)
def test_no_line(east, north, message):
    with pytest.raises(ValueError, match=message):
        RidgeLine(east * u.mas, north * u.mas)


def bent_images(n=1, noise=0.002, turn=0.0):
    """A smooth jet along the circle, on pixels that may be turned."""
    beam = Beam(1 * u.mas, 1 * u.mas)
    shape = (140, 140)
    cube = EpochCube.from_arrays(
        np.zeros((n, *shape)),
        [f"20{i:02d}-01-01" for i in range(n)],
        pixel_scale=0.1 * u.mas,
        unit=u.Jy / u.beam,
        beams=beam,
        noise=noise * u.Jy / u.beam,
        reference_pixel=(25, 25),
    )
    if turn:
        wcs = cube.wcs.deepcopy()
        c, s = np.cos(turn), np.sin(turn)
        wcs.wcs.pc = [[c, -s], [s, c]]
        cube = EpochCube(
            data=cube.data, times=cube.times, wcs=wcs, unit=cube.unit, beams=beam,
            noise=cube.noise,
        )  # fmt: skip
    t = np.linspace(0, 1.0, 120)
    x, y = cube.offset_to_pixel(*(v * u.mas for v in on_circle(t)))
    rng = np.random.default_rng(1)
    for image in cube.data:
        covariance = np.broadcast_to((4.5**2) * np.eye(2), (len(t), 2, 2))
        add_gaussians(image, x, y, 0.1 * np.exp(-t), covariance)
        image += rng.normal(0, noise, shape)
    return cube


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_ridge_line_of_an_image(turn):
    cube = bent_images(turn=turn)
    line = find_ridge_line(cube, position_angle=270 * u.deg, threshold=10)
    s = np.linspace(1, 9, 30) * u.mas
    east, north = line.at(s)
    away = np.hypot(east.value, north.value - RADIUS) - RADIUS
    assert np.abs(away).max() < 0.1
    assert np.all(line.error.value < 0.05)
    angle = line.position_angle(s).value
    np.testing.assert_allclose(angle, 270 + np.degrees(s.value / RADIUS), atol=6)


def test_ridge_line_ends_where_asked():
    line = find_ridge_line(
        bent_images(), position_angle=270 * u.deg, r_max=5 * u.mas,
        half_width=1 * u.mas, smoothing=0.5 * u.mas, origin=[0, 0] * u.mas,
    )  # fmt: skip
    assert 4 < line.length.value < 5.5


def test_position_angle_of_an_image():
    angle, error = fit_position_angle(bent_images(n=3))
    # The chord weighted by brightness of an arc from 270 to 327 deg.
    assert 285 < angle.value < 300
    assert 0 < error.value < 1
    assert fit_position_angle(bent_images())[1].value == np.inf


def test_nothing_to_follow():
    cube = bent_images(noise=5.0)
    with pytest.raises(ValueError, match="give a position angle"):
        fit_position_angle(cube, threshold=10)
    with pytest.raises(ValueError, match="less than three beams"):
        find_ridge_line(cube, position_angle=90 * u.deg, threshold=10)
    with pytest.raises(ValueError, match=r"origin = 3.0 mas must be \(east, north\)"):
        fit_position_angle(cube, origin=3 * u.mas)


def test_line_leaves_the_image():
    cube = bent_images(noise=1e-6)
    line = find_ridge_line(cube, position_angle=270 * u.deg, threshold=0.1)
    # Never longer than twice the diagonal, whatever it follows in the noise.
    assert line.length.value < 40


def test_options_are_lengths_and_angles():
    cube = bent_images()
    with pytest.raises(ValueError, match="half_width = 0.0 mas must be finite and"):
        find_ridge_line(cube, half_width=0 * u.mas)
    for option in ("half_width", "smoothing", "r_max"):
        with pytest.raises(ValueError, match=f"{option} = nan mas must be finite"):
            find_ridge_line(cube, **{option: np.nan * u.mas})
    with pytest.raises(ValueError, match="pa = nan deg must be finite"):
        find_ridge_line(cube, position_angle=np.nan * u.deg)


def test_no_beam():
    cube = bent_images()
    bare = EpochCube(
        data=cube.data, times=cube.times, wcs=cube.wcs, unit=cube.unit, noise=cube.noise
    )
    line = find_ridge_line(bare, position_angle=270 * u.deg, half_width=1.5 * u.mas,
                           smoothing=1 * u.mas)  # fmt: skip
    assert line.length.value > 8


def test_does_not_go_round_the_end():
    # With long slices the line would follow the rounded end of the jet back.
    cube = bent_images(noise=1e-5)
    line = find_ridge_line(cube, position_angle=270 * u.deg, half_width=2 * u.mas)
    assert line.length.value < 14
    angle = line.position_angle(line.distances).value
    assert np.all((angle > 240) & (angle <= 360))


def test_distances_of_unevenly_spaced_points():
    along = np.array([0, 1, 1.5, 4, 9, 9.5, 12.0])
    line = RidgeLine(0.6 * along * u.mas, 0.8 * along * u.mas)
    np.testing.assert_allclose(line.distances.to_value(u.mas), along, atol=1e-9)
    np.testing.assert_allclose(line.to_table()["s"].to_value(u.mas), along, atol=1e-9)
