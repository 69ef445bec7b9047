# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The steps of the search for a ridge line against slow and plain versions."""

import astropy.units as u
import numpy as np
import pytest

from astro_scc.epochs import Beam, EpochCube
from astro_scc.epochs.restoring import add_gaussians
from astro_scc.kinematics import find_ridge_line, fit_position_angle
from astro_scc.kinematics.ridge_search import (
    STEP,
    _jackknife,
    _met_again,
    _slice_point,
    _smoothed,
)


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


@pytest.mark.parametrize("n", [2, 5])
def test_jackknife_of_a_direction(n):
    sums = np.random.default_rng(n).normal([3.0, 5.0], 1.0, (n, 2))
    total = sums.sum(axis=0)
    angles = [
        np.degrees(np.arctan2(*(total - one)) - np.arctan2(*total)) for one in sums
    ]
    expected = np.sqrt((n - 1) * np.var(angles))
    assert _jackknife(sums, total) == pytest.approx(expected)
    assert np.isinf(_jackknife(sums[:1], sums[0]))


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
    expected = np.degrees(np.arctan2(*sums.sum(axis=0))) % 360
    assert angle.to_value(u.deg) == pytest.approx(expected)
    assert error.to_value(u.deg) == pytest.approx(_jackknife(sums, sums.sum(axis=0)))


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


def test_a_slice_that_is_bright_to_its_ends():
    image = np.ones((50, 50))
    cube = cube_of(image[None], reference=(0, 0))
    guess = np.array([-2.5, 2.5])
    middle, top = _slice_point(cube, image, guess, np.array([0.0, 1.0]), 1.0)
    np.testing.assert_allclose(middle, guess)
    assert top == 1


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


def test_where_a_line_meets_itself():
    t = np.arange(0, 2 * np.pi, 0.1)
    points = list(np.stack([3 * np.cos(t), 3 * np.sin(t)], axis=1))
    assert _met_again(points, np.array([3.0, -0.1]), 1.0) == 0
    assert _met_again(points, 1.2 * points[20], 1.0) == 20
    # What lies just before is always near.
    assert _met_again(points, points[-12], 0.2) is None
    assert _met_again(points, points[-13], 0.2) == len(points) - 13
    assert _met_again(points[:12], points[0], 1.0) is None


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


def test_beams_of_different_epochs_have_a_mean_area():
    cube = along(-np.linspace(0, 9, 300), np.zeros(300), n=2)
    beams = [Beam(0.6 * u.mas, 0.5 * u.mas), Beam(1.2 * u.mas, 1.0 * u.mas)]
    cube = EpochCube(
        data=cube.data, times=cube.times, wcs=cube.wcs, unit=cube.unit, beams=beams,
        noise=cube.noise,
    )  # fmt: skip
    line = find_ridge_line(cube, position_angle=270 * u.deg)
    assert line.meta["width"].to_value(u.mas) == pytest.approx(np.sqrt(0.75))


def test_without_beams_four_pixels_are_the_width():
    cube = along(-np.linspace(0, 9, 300), np.zeros(300), beam=None)
    line = find_ridge_line(cube, position_angle=270 * u.deg, half_width=1 * u.mas)
    assert line.meta["width"].to_value(u.mas) == pytest.approx(0.4)
