# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Ridge lines against a circle, and as they are found in images of known jets."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.components.restoring import add_gaussians
from astro_scc.epochs import Beam, EpochCube
from astro_scc.kinematics import (
    PositionAngleFrame,
    RidgeLine,
    find_ridge_line,
    fit_position_angle,
)
from astro_scc.kinematics.frames import frame_displacements
from astro_scc.kinematics.ridge_line import (
    STEP,
    _slice_point,
    _smoothed,
)

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


def cube_of(data, *, beam=1.0, scale=0.1, reference=(20, 20), noise=1e-3):
    return EpochCube.from_arrays(
        data,
        [f"20{i:02d}-01-01" for i in range(len(data))],
        pixel_scale=scale * u.mas,
        unit=u.Jy / u.beam,
        beams=None if beam is None else Beam(beam * u.mas, beam * u.mas),
        noise=noise * u.Jy / u.beam,
        reference_pixel=reference,
    )


def bent_images(n=1, noise=0.002, turn=0.0):
    """A smooth jet along the circle, on pixels that may be turned."""
    cube = cube_of(np.zeros((n, 140, 140)), reference=(25, 25), noise=noise)
    if turn:
        wcs = cube.wcs.deepcopy()
        c, s = np.cos(turn), np.sin(turn)
        wcs.wcs.pc = [[c, -s], [s, c]]
        cube = replace(cube, wcs=wcs)
    t = np.linspace(0, 1.0, 120)
    x, y = cube.offset_to_pixel(*(v * u.mas for v in on_circle(t)))
    rng = np.random.default_rng(1)
    for image in cube.data:
        covariance = np.broadcast_to((4.5**2) * np.eye(2), (len(t), 2, 2))
        add_gaussians(image, x, y, 0.1 * np.exp(-t), covariance)
        image += rng.normal(0, noise, image.shape)
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


def test_options_are_lengths_and_angles():
    cube = bent_images()
    with pytest.raises(ValueError, match="half_width = 0.0 mas must be finite and"):
        find_ridge_line(cube, half_width=0 * u.mas)
    for option in ("half_width", "smoothing", "r_max"):
        with pytest.raises(ValueError, match=f"{option} = nan mas must be finite"):
            find_ridge_line(cube, **{option: np.nan * u.mas})
    with pytest.raises(ValueError, match="pa = nan deg must be finite"):
        find_ridge_line(cube, position_angle=np.nan * u.deg)


def along(x, y, n=1, size=(120, 120), **options):
    """Images of a thin jet of even brightness through places in mas."""
    cube = cube_of(np.zeros((n, *size)), **options)
    px, py = cube.offset_to_pixel(x * u.mas, y * u.mas)
    covariance = np.broadcast_to((0.42 / 0.1) ** 2 * np.eye(2), (len(x), 2, 2))
    for image in cube.data:
        add_gaussians(image, px, py, np.full(len(x), 0.1), covariance)
    return cube


@pytest.mark.parametrize("size", [1.0, 0.02])
def test_smoothing_is_a_parabola_at_each_point(size):
    # Large errors are more than the scatter, small ones less.
    rng = np.random.default_rng(1)
    points = np.cumsum(rng.uniform(0.1, 0.4, (14, 2)), axis=0)
    error = size * rng.uniform(0.05, 0.2, 14)
    width = 0.8
    s = np.append(0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    smooth, spread = _smoothed(points, error, width, 0.1)
    gains, windows = np.empty((14, 14)), np.empty((14, 14))
    for k in range(14):
        windows[k] = np.exp(-((s - s[k]) ** 2) / (2 * width**2))
        # polyfit squares its weights.
        w = np.sqrt(windows[k]) / error
        for axis in range(2):
            fit = np.polyfit(s - s[k], points[:, axis], 2, w=w)
            assert smooth[k, axis] == pytest.approx(fit[-1], abs=1e-9)
        for j, unit in enumerate(np.eye(14)):
            gains[k, j] = np.polyfit(s - s[k], unit, 2, w=w)[-1]
    rest = ((points - smooth) ** 2).sum(axis=1) / 2
    for k in range(14):
        own = sum(
            gains[k, j] ** 2 * max(error[j] ** 2, np.average(rest, weights=windows[j]))
            for j in range(14)
        )
        assert spread[k] == pytest.approx(np.sqrt(own / STEP), rel=1e-9)


def test_position_angle_is_that_of_a_loop_over_pixels():
    rng = np.random.default_rng(2)
    data = rng.normal(0, 1e-3, (3, 12, 15)) + 0.01 * rng.random((12, 15))
    data[0, 3, 4] = np.nan
    cube = cube_of(data, beam=0.35, reference=(7, 3))
    start = np.array([0.1, -0.05])
    mean, noise = np.nanmean(data, axis=0), 1e-3 / np.sqrt(3)
    east, north = (o.value for o in cube.offsets())
    sums = np.zeros((3, 2))
    for (row, column), value in np.ndenumerate(mean):
        x, y = east[row, column] - start[0], north[row, column] - start[1]
        if value > 8 * noise and np.hypot(x, y) > 0.35:
            for epoch in range(3):
                if np.isfinite(data[epoch, row, column]):
                    sums[epoch] += data[epoch, row, column] * np.array([x, y])
    angle, error = fit_position_angle(cube, origin=start * u.mas, threshold=8)
    total = sums.sum(axis=0)
    expected = np.degrees(np.arctan2(*total)) % 360
    assert angle.to_value(u.deg) == pytest.approx(expected)
    # The jackknife, of the direction without one epoch.
    angles = [np.degrees(np.arctan2(*(total - one))) % 360 for one in sums]
    assert error.to_value(u.deg) == pytest.approx(np.sqrt(2 * np.var(angles)))


def test_a_slice_has_the_middle_of_what_is_above_half():
    # A profile across that is lopsided, and a second ridge beside it.
    y = np.arange(81)[:, None] * 0.1
    one = np.where(y < 4, np.exp(-((y - 4) ** 2) / 0.5), np.exp(-((y - 4) ** 2) / 2))
    two = 0.95 * np.exp(-((y - 7) ** 2) / 0.1)
    image = np.repeat(one + two, 30, axis=1)
    cube = cube_of(image[None], reference=(0, 0))
    guess, half = np.array([-1.5, 4.3]), 3.5
    middle, top = _slice_point(cube, image, guess, np.array([-1.0, 0.0]), half)
    n = np.linspace(4.3 - half, 4.3 + half, 61)
    values = np.interp(n, y[:, 0], image[:, 0])
    own = (values >= 0.5 * values.max()) & (n < 6.3)
    assert middle[0] == pytest.approx(-1.5)
    assert middle[1] == pytest.approx(np.average(n[own], weights=values[own]), abs=1e-9)
    assert top == pytest.approx(values.max(), abs=1e-9)
    outside = np.array([500.0, 500.0])
    assert _slice_point(cube, image, outside, np.array([-1.0, 0.0]), half) is None
    assert _slice_point(cube, -image, guess, np.array([-1.0, 0.0]), half) is None


@pytest.mark.parametrize("side", [-1, 1])
def test_a_gap_of_one_point_ends_a_slice(side):
    # Points of the slice are pixels: a plateau, a gap, the maximum, a plateau.
    values = np.full(61, 0.8)
    values[30] = 1.0
    values[30 + side] = 0.1
    image = np.repeat(values[:, None], 9, axis=1)
    cube = cube_of(image[None], reference=(0, 0))
    guess, ahead = np.array([-0.4, 3.0]), np.array([-1.0, 0.0])
    middle, _ = _slice_point(cube, image, guess, ahead, 3.0 - 1e-9)
    y = np.arange(61) * 0.1
    own = slice(30, None) if side < 0 else slice(0, 31)
    assert middle[1] == pytest.approx(np.average(y[own], weights=values[own]))


def test_a_jet_longer_than_the_image_is_wide():
    t = np.linspace(0, 1.6 * np.pi, 400)
    cube = along(-4.8 * np.sin(t), 4.8 * (1 - np.cos(t)), reference=(60, 10))
    line = find_ridge_line(cube, position_angle=270 * u.deg)
    assert line.length.value == pytest.approx(4.8 * t[-1], abs=1.5)
    assert line.length.value > 12 * np.sqrt(2)


def test_errors_of_a_line_are_those_of_its_slices():
    # A straight jet of even brightness: every slice has the same error, but
    # for the core's, and nothing scatters.
    cube = along(-np.linspace(0, 9, 300), np.zeros(300), n=4, noise=2e-3)
    line = find_ridge_line(cube, position_angle=270 * u.deg)
    inner = (line.distances > 2 * u.mas) & (line.distances < 7 * u.mas)
    assert np.ptp(line.error[inner]) < 0.2 * line.error[inner].mean()
    snr = np.nanmax(cube.data) / (2e-3 / np.sqrt(4))
    every = np.full(len(line.east), 1 / (np.sqrt(2) * snr))
    every[0] *= 1e-2
    points = np.stack([line.east.value, line.north.value], axis=1)
    _, expected = _smoothed(points, every, 2.0, STEP)
    np.testing.assert_allclose(line.error[inner].value, expected[inner], rtol=0.1)
    assert line.error[0] < 0.1 * line.error[inner].mean()
    assert line.meta["width"].to_value(u.mas) == pytest.approx(1.0)
    assert line.meta["smoothing"].to_value(u.mas) == pytest.approx(2.0)


def test_a_line_that_comes_back_keeps_half_of_the_way():
    # A loop that ends across its beginning.
    t = np.linspace(-np.pi / 2, np.pi, 300)
    down = np.linspace(2.5, 1, 30)
    east = -np.concatenate(
        [np.linspace(0, 6, 150), 6 + 2.5 * np.cos(t), 3.5 + 0 * down]
    )
    north = np.concatenate([np.zeros(150), 2.5 + 2.5 * np.sin(t), down])
    cube = along(east, north, reference=(25, 30))
    line = find_ridge_line(cube, position_angle=270 * u.deg, half_width=0.8 * u.mas)
    # From where it is met, 3.5, to a beam before it comes there again.
    end = 6 + 2.5 * 1.5 * np.pi + 1.5
    assert line.length.value == pytest.approx(0.5 * (3.5 + end), abs=1.0)


def test_defaults_are_in_beams():
    t = np.linspace(0, 1.2, 300)
    cube = along(-7 * np.sin(t), 7 * (1 - np.cos(t)), beam=0.8, reference=(30, 20))
    line = find_ridge_line(cube, position_angle=270 * u.deg)
    given = {"half_width": 1.2 * u.mas, "smoothing": 1.6 * u.mas, "threshold": 5}
    same = find_ridge_line(cube, position_angle=270 * u.deg, **given)
    np.testing.assert_allclose(line.north, same.north, atol=1e-12 * u.mas)
    for name, value in (("half_width", 0.4 * u.mas), ("smoothing", 0.8 * u.mas)):
        other = find_ridge_line(
            cube, position_angle=270 * u.deg, **{**given, name: value}
        )
        n = min(len(other.north), len(line.north))
        assert np.abs(other.north[:n] - line.north[:n]).max() > 1e-3 * u.mas


def test_the_direction_is_that_of_the_same_pixels():
    # Something faint aside turns the mean direction, unless it is too faint.
    cube = along(-np.linspace(0, 7, 300), np.zeros(300), reference=(30, 60))
    cube.data[:, 80:110, 40:60] += 0.15
    origin = [-0.2, 0.1] * u.mas
    angles = []
    for threshold in (5, 200):
        options = {"origin": origin, "threshold": threshold}
        angle, _ = fit_position_angle(cube, **options)
        line = find_ridge_line(cube, **options)
        again = find_ridge_line(cube, position_angle=angle, **options)
        np.testing.assert_array_equal(line.north, again.north)
        assert line.at(0 * u.mas)[0].value == pytest.approx(-0.2, abs=0.01)
        angles.append(angle.value)
    assert np.ptp(angles) > 1
