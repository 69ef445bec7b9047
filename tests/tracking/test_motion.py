# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Fitted motions, against least squares and against known motions."""

import numpy as np
import pytest

from astro_scc.tracking import ejection_epoch, fit_motion
from astro_scc.tracking.motion import average_with_scatter, track_profile, turn_between


def test_a_straight_line_is_that_of_weighted_least_squares():
    rng = np.random.default_rng(1)
    time = np.sort(rng.uniform(2000, 2010, 12))
    error = rng.uniform(0.5, 1.5, (2, 12))
    # Residuals so alike that none loses weight.
    position = 0.3 * time + error * np.where(np.arange(12) % 2, 1.0, -1.0)
    fit = fit_motion(time, position, error)
    for axis in range(2):
        slope, level = np.polyfit(
            time - fit.middle, position[axis], 1, w=1 / error[axis]
        )
        assert fit.coefficients[axis] == pytest.approx([level, slope])
    assert np.all(fit.weight == 1.0)
    assert fit.middle == pytest.approx((time[0] + time[-1]) / 2)
    assert fit.at([fit.middle])[:, 0] == pytest.approx(fit.coefficients[:, 0])


def test_an_acceleration_is_found():
    time = np.arange(12.0)
    position = np.stack([1 + 0.5 * (time - 5.5) + 0.05 * (time - 5.5) ** 2, 0 * time])
    fit = fit_motion(time, position, np.full((2, 12), 0.01), degree=2)
    assert fit.coefficients[0] == pytest.approx([1.0, 0.5, 0.1])
    assert fit.at(time) == pytest.approx(position)


def test_outliers_hardly_matter():
    time = np.arange(20.0)
    rng = np.random.default_rng(2)
    position = np.stack([0.2 * time, 0 * time]) + rng.normal(0, 0.05, (2, 20))
    spoilt = position.copy()
    spoilt[0, 18] += 5.0
    error = np.full((2, 20), 0.05)
    before, after = (fit_motion(time, p, error) for p in (position, spoilt))
    plain = np.polyfit(time, spoilt[0], 1)[0]
    moved = abs(after.coefficients[0, 1] - before.coefficients[0, 1])
    assert moved < 0.1 * abs(plain - before.coefficients[0, 1])
    assert after.weight[0, 18] < 0.1


@pytest.mark.parametrize("n", [5, 12])
def test_one_standard_error_holds_two_thirds(n):
    rng = np.random.default_rng(3)
    hits = []
    for _ in range(120):
        time = np.sort(rng.uniform(0, 5, n))
        fit = fit_motion(time, rng.normal(0, 0.3, (2, n)), np.full((2, n), 0.1))
        hits += list(np.abs(fit.coefficients[:, 1]) < fit.errors[:, 1])
    assert 0.58 < np.mean(hits) < 0.80


def test_errors_are_not_below_those_of_the_positions():
    time = np.arange(6.0)
    fit = fit_motion(time, [time, time], np.full((2, 6), 0.1))
    least = 0.1 / np.sqrt(np.sum((time - 2.5) ** 2))
    assert fit.errors[:, 1] == pytest.approx([least, least])


def test_residuals_that_follow_one_another_widen_the_error():
    time = np.arange(40.0)
    wave = 0.5 * np.sin(time / 4)
    mixed = np.random.default_rng(0).permutation(wave)
    error = np.full((2, 40), 0.05)
    slow, quick = (fit_motion(time, [w, w], error).errors[0, 1] for w in (wave, mixed))
    assert slow > 1.8 * quick


def test_too_few_dates_are_refused():
    with pytest.raises(ValueError, match="degree 1 needs 2 different dates, got 1"):
        fit_motion([1.0, 1.0], np.zeros((2, 2)), np.ones((2, 2)))
    exact = fit_motion([0.0, 2.0], [[0, 1], [0, 0]], np.ones((2, 2)))
    assert exact.coefficients[0, 1] == pytest.approx(0.5)
    assert np.all(np.isfinite(exact.errors))


# -- ejection ----------------------------------------------------------------------


def radial_fit(*, turn=0.0, speed=0.3, noise=0.01):
    time = np.arange(2000.0, 2008.0)
    away = speed * (time - 1997.5)
    angle = np.radians(40 + turn)
    position = np.stack([away * np.sin(np.radians(40)), away * np.cos(np.radians(40))])
    if turn:
        middle = position.mean(axis=1, keepdims=True)
        along = speed * (time - time.mean())
        position = middle + np.stack([along * np.sin(angle), along * np.cos(angle)])
    return fit_motion(time, position, np.full((2, 8), noise))


def test_a_radial_feature_was_at_the_core():
    epoch, error = ejection_epoch(radial_fit(), 0.5)
    assert epoch == pytest.approx(1997.5)
    assert 0 < error < 0.2


def test_the_error_of_the_epoch_is_that_of_trials():
    rng = np.random.default_rng(5)
    time = np.arange(2000.0, 2008.0)
    exact = np.stack([0.3 * (time - 1997.5), 0.2 * (time - 1997.5)])
    error = np.full((2, 8), 0.02)
    found = [
        ejection_epoch(
            fit_motion(time, exact + rng.normal(0, 0.02, (2, 8)), error), 0.5
        )
        for _ in range(150)
    ]
    epochs, errors = np.array(found).T
    assert epochs.mean() == pytest.approx(1997.5, abs=0.05)
    assert np.std(epochs) == pytest.approx(np.median(errors), rel=0.35)


@pytest.mark.parametrize(
    ("fit", "accelerated"),
    [
        (radial_fit(), True),
        (radial_fit(turn=60), False),
        (radial_fit(turn=180), False),
        (radial_fit(noise=2.0), False),
    ],
)
def test_there_is_no_epoch_without_radial_steady_motion(fit, accelerated):
    assert ejection_epoch(fit, 0.5, accelerated=accelerated) == (None, None)


@pytest.mark.parametrize("beam", [0.3, 0.7, 1.2, 3.0])
def test_a_line_that_misses_the_core_by_more_than_a_beam_has_no_epoch(beam):
    # To the north at 6 to 9 mas, and 1 mas beside the core: 8 degrees off the radius.
    time = np.arange(2000.0, 2008.0)
    for side in (-1, 1):
        position = np.stack([np.full(8, side * 1.0), 6 + 0.4 * (time - 2000)])
        fit = fit_motion(time, position, np.full((2, 8), 0.01))
        epoch, _ = ejection_epoch(fit, beam)
        if beam < 1:
            assert epoch is None
        else:
            assert epoch == pytest.approx(1985)


def test_a_feature_on_the_core_has_no_epoch():
    time = np.arange(-3.0, 4.0)
    fit = fit_motion(time, [0.3 * time, 0 * time], np.full((2, 7), 0.01))
    assert ejection_epoch(fit, 0.5) == (None, None)


def test_a_feature_at_rest_has_any_direction():
    fit = fit_motion(np.arange(4.0), np.ones((2, 4)), np.full((2, 4), 0.1))
    length, angle = fit.velocity_errors
    assert length > 0
    assert angle == pytest.approx(np.pi)
    assert turn_between((0, 0), (1, 1)) == 0
    assert turn_between((0, 1), (0, -2)) == pytest.approx(180)


# -- profile -----------------------------------------------------------------------


def test_the_profile_follows_an_accelerating_flow():
    # r = (t - t0)^2 / 8: the speed at a distance r is sqrt(r / 2).
    time, distance, track = [], [], []
    for number, born in enumerate((1990.0, 1992.0, 1995.0)):
        t = born + np.arange(1.0, 12.0, 0.25)
        time += t.tolist()
        distance += ((t - born) ** 2 / 8).tolist()
        track += [number] * len(t)
    speed, error, n = track_profile(
        time, distance, np.full(len(time), 0.05), track, [2.0, 8.0, 50.0],
        half_width=0.7,
    )  # fmt: skip
    assert n.tolist() == [3, 3, 0]
    assert speed[:2] == pytest.approx([1.0, 2.0], rel=0.05)
    assert error[2] == speed[2] == 0


def test_tracks_with_few_features_there_do_not_count():
    time = np.arange(10.0)
    args = time, time, np.full(10, 0.1), np.zeros(10, int), [5.0]
    assert track_profile(*args, half_width=1.0, min_epochs=4)[2].tolist() == [0]
    assert track_profile(*args, half_width=1.0, min_epochs=3)[2].tolist() == [1]


def test_the_same_feature_on_two_scales_is_one_feature():
    time = np.tile(np.arange(10.0), 2)
    track = np.repeat([0, 1], 10)
    args = time, time, np.full(20, 0.1), track, [5.0]
    one = track_profile(*args, half_width=9.0)[1]
    two = track_profile(*args, half_width=9.0, scale=track + 1.0)[1]
    assert two == pytest.approx(one * np.sqrt(2))


def test_averages_with_and_without_scatter():
    mean, error = average_with_scatter([1.0, 1.1, 0.9], [1.0, 1.0, 1.0])
    assert (mean, error) == pytest.approx((1.0, 3**-0.5))
    values = np.random.default_rng(1).normal(2, 0.5, 400)
    mean, error = average_with_scatter(values, np.full(400, 0.1))
    assert error == pytest.approx(np.std(values) / 20, rel=0.05)
    assert average_with_scatter([3.0], [0.2]) == pytest.approx((3.0, 0.2))
