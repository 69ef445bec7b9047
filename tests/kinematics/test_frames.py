# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Axes of frames and ridge lines, against their definitions and known jets."""

import astropy.units as u
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from astro_scc.epochs import Beam, EpochCube
from astro_scc.epochs.restoring import add_gaussians
from astro_scc.kinematics import (
    ExpansionFrame,
    PositionAngleFrame,
    RadialFrame,
    RidgeLine,
    SkyFrame,
    find_ridge_line,
    fit_position_angle,
)
from astro_scc.kinematics.frames import STEP, _smoothed

OFFSET = st.floats(-50, 50)
CENTRE, RADIUS = [3.0, -2.0] * u.arcsec, 20 * u.arcsec


@settings(max_examples=40)
@given(pa=st.floats(-400, 400), length=st.floats(0.1, 10))
def test_parallel_is_along_the_position_angle(pa, length):
    frame, angle = PositionAngleFrame(pa * u.deg), np.radians(pa)
    along = length * np.array([np.sin(angle), np.cos(angle)])
    assert_allclose(frame.matrix() @ along, [length, 0], atol=1e-9)
    assert_array_equal(SkyFrame().matrix(np.zeros((3, 1)), 0.0), [[np.eye(2)]] * 3)


@settings(max_examples=40)
@given(x=OFFSET, y=OFFSET, x0=OFFSET, y0=OFFSET)
def test_radial_is_away_from_the_origin(x, y, x0, y0):
    matrix = RadialFrame([x0, y0] * u.mas).matrix(x, y)
    away = np.array([x - x0, y - y0])
    distance = np.hypot(*away)
    if distance == 0:
        assert np.all(np.isnan(matrix))
        return
    assert_allclose(matrix @ away, [distance, 0], atol=1e-9 * max(distance, 1))
    angle = np.arctan2(*away) * u.rad
    assert_allclose(matrix, PositionAngleFrame(angle).matrix(), atol=1e-9)


@settings(max_examples=40)
@given(angle=st.floats(0, 6.28), r=st.floats(5e3, 5e4), rate=st.floats(-0.1, 0.1))
def test_one_rate_is_one_velocity(angle, r, rate):
    place = r * np.array([np.sin(angle), np.cos(angle)])
    frame = ExpansionFrame(CENTRE, RADIUS)
    assert not frame.uniform
    position = place + CENTRE.to_value(u.mas)
    # The motion that is midway at the place is in proportion to it.
    motion = rate * place
    moved = frame.displacement((position - 0.5 * motion)[None], motion[None])
    assert_allclose(moved, [[rate * 2e4, 0]], atol=1e-6)
    # Within a fifth of the radius an expansion is hardly a motion.
    assert np.isnan(frame.matrix(*(CENTRE.to_value(u.mas) + [3.9e3, 0]))).all()
    matrix = frame.matrix(*position) * r / 2e4
    assert_allclose(matrix, RadialFrame(CENTRE).matrix(*position), atol=1e-12)


BEND = 10.0
WEST = 270 * u.deg


def on_circle(t, n=0.0):
    """Places at an angle along a circle, first west then north, n inside of it."""
    r = BEND - np.asarray(n)
    return -r * np.sin(t), BEND - r * np.cos(t)


CIRCLE = RidgeLine(*(v * u.mas for v in on_circle(np.linspace(0, np.pi / 2, 60))))


@settings(max_examples=20)
@given(t=st.floats(0.05, 1.5), n=st.floats(-4, 4))
def test_distances_offsets_and_axes_of_a_circle(t, n):
    # West to north turns to larger position angles, towards the centre.
    east, north = on_circle(t, n)
    s, offset = CIRCLE.coordinates(east * u.mas, north * u.mas)
    assert abs(s.value - BEND * t) < 0.01
    assert abs(offset.value - n) < 0.01
    matrix = CIRCLE.matrix(east, north)
    assert_allclose(matrix @ [-np.cos(t), np.sin(t)], [1, 0], atol=2e-2)
    assert_allclose(matrix @ matrix.T, np.eye(2), atol=1e-12)


def test_goes_on_straight_beyond_its_ends_and_comes_back_from_a_table():
    line = RidgeLine([0, -5, -10] * u.mas, [0, 0, 0] * u.mas)
    s, n = line.coordinates([3, -14] * u.mas, [1, 2] * u.mas)
    assert_allclose(s.value, [-3, 14])
    # To the west, larger position angles are north.
    assert_allclose(n.value, [1, 2])
    assert_allclose(u.Quantity(line.at([-3, 14] * u.mas)).value, [[3, -14], [0, 0]])
    assert line.position_angle(12 * u.mas).value == pytest.approx(270)
    moved = line.displacement(np.array([[-2.0, 0.0]]), np.array([[-1.0, 0.5]]))
    assert_allclose(moved, [[1.0, 0.5]])
    table = CIRCLE.to_table()
    again = RidgeLine(table["east"], table["north"], table["error"])
    assert_array_equal(again.east, CIRCLE.east)
    assert again.length == CIRCLE.length
    assert "60 points" in repr(CIRCLE)


def cube_of(data, *, beam=1.0, reference=(20, 20), noise=1e-3, turn=0.0):
    cube = EpochCube.from_arrays(
        data, [f"20{i:02d}-01-01" for i in range(len(data))], pixel_scale=0.1 * u.mas,
        unit=u.Jy / u.beam, beams=Beam(beam * u.mas, beam * u.mas),
        noise=noise * u.Jy / u.beam, reference_pixel=reference,
    )  # fmt: skip
    c, s = np.cos(turn), np.sin(turn)
    cube.wcs.wcs.pc = [[c, -s], [s, c]]
    return cube


def along(x, y, peak=0.1, sigma=4.2, n=1, size=(120, 120), rms=0.0, **options):
    """Images of a thin jet through places in mas."""
    cube = cube_of(np.zeros((n, *size)), **options)
    px, py = cube.offset_to_pixel(x * u.mas, y * u.mas)
    covariance = np.broadcast_to(sigma**2 * np.eye(2), (len(px), 2, 2))
    rng = np.random.default_rng(1)
    for image in cube.data:
        add_gaussians(image, px, py, np.broadcast_to(peak, px.shape), covariance)
        image += rng.normal(0, rms, image.shape)
    return cube


def bent_images(n=1, noise=0.002, turn=0.0):
    """A smooth jet along the circle, on pixels that may be turned."""
    t = np.linspace(0, 1.0, 120)
    options = {"size": (140, 140), "reference": (25, 25), "noise": noise, "rms": noise}
    return along(*on_circle(t), 0.1 * np.exp(-t), 4.5, n, turn=turn, **options)


LOUD, BENT = bent_images(noise=5.0), bent_images()


def test_lines_that_cannot_be():
    for function, cube, options, words in [
        (fit_position_angle, LOUD, {"threshold": 10}, "give a position angle"),
        (find_ridge_line, LOUD, {"position_angle": WEST, "threshold": 10},
         "less than three beams"),
        (find_ridge_line, BENT, {"half_width": 0 * u.mas}, "half_width = 0.0 mas must"),
        (PositionAngleFrame, 65, {}, "pa = 65 must be an angle with a"),
        (RadialFrame, [1, 2, 3] * u.mas, {}, r"origin = .* must be \(east, north\)"),
        (ExpansionFrame, [1.0] * u.mas, {"radius": RADIUS}, "two finite angles"),
        (ExpansionFrame, CENTRE, {"radius": 0 * u.mas}, "radius = 0.0 mas must be"),
        (RidgeLine, [1.0, 2.0] * u.mas, {"north": [1.0] * u.mas}, "two points"),
        (RidgeLine, [1.0, np.nan] * u.mas, {"north": [1.0, 2.0] * u.mas}, "finite"),
        (RidgeLine, [1.0, 1.0] * u.mas, {"north": [2.0, 2.0] * u.mas}, "differ"),
    ]:  # fmt: skip
        with pytest.raises(ValueError, match=words):
            function(cube, **options)


@pytest.mark.parametrize("size", [1.0, 0.02])
def test_smoothing_is_a_parabola_at_each_point(size):
    # Large errors are more than the scatter, small ones less.
    rng = np.random.default_rng(1)
    points = np.cumsum(rng.uniform(0.1, 0.4, (14, 2)), axis=0)
    error = size * rng.uniform(0.05, 0.2, 14)
    width = 0.8
    s = np.append(0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    smooth, spread = _smoothed(points, error, width)
    windows = np.exp(-((s - s[:, None]) ** 2) / (2 * width**2))
    gains = np.empty((14, 14))
    for k in range(14):
        # polyfit squares its weights.
        fit = {"x": s - s[k], "deg": 2, "w": np.sqrt(windows[k]) / error}
        assert_allclose(smooth[k], np.polyfit(y=points, **fit)[-1], atol=1e-9)
        gains[k] = np.polyfit(y=np.eye(14), **fit)[-1]
    rest = ((points - smooth) ** 2).sum(axis=1) / 2
    own = np.maximum(error**2, windows @ rest / windows.sum(axis=1))
    assert_allclose(spread, np.sqrt(gains**2 @ own / STEP), rtol=1e-9)


def test_position_angle_is_that_of_a_loop_over_pixels():
    rng = np.random.default_rng(2)
    data = rng.normal(0, 1e-3, (3, 12, 15)) + 0.01 * rng.random((12, 15))
    data[0, 3, 4] = np.nan
    cube = cube_of(data, beam=0.35, reference=(7, 3))
    # Above the sky.
    data = data - np.nanmedian(np.nanmean(data, axis=0))
    mean, noise = np.nanmean(data, axis=0), 1e-3 / np.sqrt(3)
    away = np.stack([o.value for o in cube.offsets()], axis=-1)
    sums = np.zeros((3, 2))
    for place, value in np.ndenumerate(mean):
        if value > 8 * noise and np.hypot(*away[place]) > 0.35:
            for epoch in range(3):
                sums[epoch] += np.nan_to_num(data[epoch][place]) * away[place]
    angle, error = fit_position_angle(cube, threshold=8)
    total = sums.sum(axis=0)
    assert angle.value == pytest.approx(np.degrees(np.arctan2(*total)) % 360)
    # The jackknife, of the direction without one epoch.
    angles = [np.degrees(np.arctan2(*(total - one))) % 360 for one in sums]
    assert error.value == pytest.approx(np.sqrt(2 * np.var(angles)))
    assert fit_position_angle(cube[:1])[1] == np.inf * u.deg


def test_a_jet_longer_than_the_image_is_wide_and_one_that_comes_back():
    t = np.linspace(0, 1.6 * np.pi, 400)
    cube = along(-4.8 * np.sin(t), 4.8 * (1 - np.cos(t)), reference=(60, 10))
    line = find_ridge_line(cube, position_angle=WEST)
    assert line.length.value == pytest.approx(4.8 * t[-1], abs=1.5)
    assert line.length.value > 12 * np.sqrt(2)
    # A loop that ends across its beginning.
    t, down = np.linspace(-np.pi / 2, np.pi, 300), np.linspace(2.5, 1, 30)
    out = np.linspace(0, 6, 150)
    east = -np.concatenate([out, 6 + 2.5 * np.cos(t), 3.5 + 0 * down])
    north = np.concatenate([0 * out, 2.5 + 2.5 * np.sin(t), down])
    cube = along(east, north, reference=(25, 30))
    line = find_ridge_line(cube, position_angle=WEST, half_width=0.8 * u.mas)
    # Half of the way from where it is met, 3.5, to a beam before it comes there again.
    end = 6 + 2.5 * 1.5 * np.pi + 1.5
    assert line.length.value == pytest.approx(0.5 * (3.5 + end), abs=1.0)
