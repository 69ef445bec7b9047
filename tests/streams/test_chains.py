# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features followed through the epochs, on lines that are known."""

from dataclasses import replace

import numpy as np
import pytest

from astro_scc.streams import SearchSettings, find_streams
from astro_scc.streams.chains import (
    PULL,
    Feature,
    clear_of,
    find_chains,
    standing_features,
)
from astro_scc.streams.diagram import Rays
from astro_scc.streams.dispersion import feature_speeds, separate_streams

SEARCH = SearchSettings()
#: Uneven: followers differ from features by the dates.
YEARS = np.array([0.0, 0.7, 1.2, 2.3, 3.0, 3.4, 4.6, 5.2])


def follow(d, speeds=(0.3, 0.8)):
    rays = Rays.of(d.years, 1.5, SEARCH)
    return find_chains(d, speeds, rays)[0]


def through(years, position, **settings):
    n = np.arange(len(years))
    return Feature.through(n + 3, n, years, position, SearchSettings(**settings))


# -- one feature -------------------------------------------------------------------


@pytest.mark.parametrize("n", [2, 3, 9])
def test_the_line_and_its_errors_are_those_of_polyfit(n):
    rng = np.random.default_rng(n)
    years, position = np.sort(rng.uniform(0, 5, n)), rng.normal(size=(n, 2))
    found = through(years, position, position_error=0.5)
    speeds = (found.speed, found.error), (found.across, found.across_error)
    for k, (speed, error) in enumerate(speeds):
        slope, offset = np.polyfit(years, position[:, k], 1)
        assert speed == pytest.approx(slope)
        squares = np.sum((position[:, k] - offset - slope * years) ** 2)
        # Of the residuals and of three that are assumed.
        variance = (squares + 3 * 0.5**2) / (n - 2 + 3)
        unit = np.sum((years - years.mean()) ** 2)
        assert error == pytest.approx(np.sqrt(variance / unit))
    assert found.place == pytest.approx(position[:, 0].mean())
    assert found.motion == pytest.approx(abs(found.speed) * np.ptp(years))
    assert found.response @ position[:, 0] == pytest.approx(found.speed)
    assert len(found) == n
    assert np.isfinite(found.acceleration) == (n >= 5)


def test_two_dates_have_no_acceleration():
    years = np.array([0.0, 0.0, 1.0, 1.0, 1.0])
    found = through(years, np.outer(years, [0.5, 0.0]))
    assert (found.speed, np.isnan(found.acceleration)) == (0.5, True)


# -- features that move --------------------------------------------------------------


@pytest.mark.parametrize(
    ("speeds", "starts"),
    # The faster one overtakes, and a comb in which each follows 1.2 beams behind.
    [([0.3, 0.8], [1.4, 0.0]), ([0.5] * 6, 1.2 * np.arange(6))],
)
def test_features_are_not_confused_with_others(lines, axis_matches, speeds, starts):
    n = len(speeds)
    found = follow(axis_matches(*lines(speeds, starts, YEARS), YEARS))
    assert len(found) == n
    for feature in found:
        k = feature.ssp[0]
        np.testing.assert_array_equal(feature.ssp, n * np.arange(8) + k)
        assert feature.speed == pytest.approx(speeds[k])


@pytest.mark.parametrize("off", [0.2, 0.28, -0.25])
def test_an_outlier_is_left_out(lines, axis_matches, off):
    position, epoch = lines([0.5], [0.0], YEARS)
    position[3, 0] += off
    (found,) = follow(axis_matches(position, epoch, YEARS))
    assert found.ssp.tolist() == [0, 1, 2, 4, 5, 6, 7]
    assert found.speed == pytest.approx(0.5)


def test_outliers_hidden_by_others_are_left_out_in_rounds(lines, axis_matches):
    years = np.arange(12.0)
    position, epoch = lines([0.5], [0.0], years)
    position[[2, 9], 0] += 0.16, 0.25
    (found,) = follow(axis_matches(position, epoch, years))
    assert found.ssp.tolist() == [k for k in range(12) if k not in (2, 9)]


def test_of_two_ssps_on_the_line_the_nearer_is_of_the_feature(lines, axis_matches):
    position, epoch = lines([0.5], [0.0], YEARS)
    position = np.concatenate([[position[4] + (0.1, 0)], position])
    (found,) = follow(axis_matches(position, np.append(4, epoch), YEARS))
    np.testing.assert_array_equal(found.ssp, np.arange(1, 9))


@pytest.mark.parametrize(("n", "number"), [(3, 0), (4, 1)])
def test_four_epochs_make_a_feature(lines, axis_matches, n, number):
    position, epoch = lines([0.6], [0.0], YEARS)
    seen = epoch < n
    assert len(follow(axis_matches(position[seen], epoch[seen], YEARS))) == number


@pytest.mark.parametrize(("last", "scale"), [(8, 1), (5, 2)])
def test_a_feature_of_two_scales_is_one(lines, axis_matches, last, scale):
    """Of the finer scale, unless it is seen longer on the coarser one."""
    position, epoch = lines([0.5, 0.5], [0.0, 0.1], YEARS)
    scales = np.tile([2, 1], 8)
    seen = (scales == 2) | (epoch <= last)
    d = axis_matches(position[seen], epoch[seen], YEARS, scale=scales[seen])
    (found,) = follow(d)
    np.testing.assert_array_equal(d.scale[found.ssp], scale)


#: Two groups of three epochs; 3.5 beams from one to the other, beyond the radius.
GAP = np.array([0.0, 0.5, 1.1, 8.0, 8.6, 9.2])


@pytest.mark.parametrize(
    ("off", "n"),
    # Moving twice as fast it is on the line at one date.
    [(0.0, [6]), (0.5 * (GAP[3:] - GAP[4]), []), (3.0, [])],
    ids=["one line", "another speed", "beside the line"],
)
def test_parts_before_and_after_a_long_interval(lines, axis_matches, off, n):
    rng = np.random.default_rng(1)
    position, epoch = lines([0.5], [1.0], GAP, scatter=0.01, rng=rng)
    position[3:, 0] += off
    assert [len(f) for f in follow(axis_matches(position, epoch, GAP))] == n


def test_of_two_parts_that_both_fit_none_is_joined(lines, axis_matches):
    position, epoch = lines([0.5], [1.0], GAP)
    position = np.concatenate([position, position[3:] + [0.6, 0.0]])
    epoch = np.append(epoch, epoch[3:])
    order = np.argsort(epoch, kind="stable")
    assert follow(axis_matches(position[order], epoch[order], GAP)) == []


# -- features that stand still ---------------------------------------------------------


def test_what_stands_still_is_found(lines, axis_matches):
    rng = np.random.default_rng(1)
    position = lines([0, 0, 0.5], [0.0, 3.0, 6.0], YEARS, scatter=0.02, rng=rng)
    d = axis_matches(*position, YEARS)
    found = sorted(standing_features(d, SEARCH), key=lambda f: f.place)
    assert [f.ssp.tolist() for f in found] == [list(range(k, 24, 3)) for k in (0, 1)]
    assert abs(found[0].speed) <= 2 * found[0].error
    for nothing in (
        d.select(np.zeros(len(d), dtype=bool)),
        replace(d, target_ssp=np.full(len(d), -1)),
    ):
        assert standing_features(nothing, SEARCH) == []


@pytest.mark.parametrize(
    ("speed", "epochs", "number"),
    [(0.0, range(0, 12, 2), 1), (0.0, range(0, 10, 2), 0), (0.004, range(12), 1),
     (0.05, range(12), 0)],
    ids=["in half of the epochs", "in fewer", "slow", "drifting"],
)  # fmt: skip
def test_what_counts_as_standing(lines, axis_matches, speed, epochs, number):
    years = np.arange(12.0)
    position, epoch = lines([speed], [0.0], years)
    seen = np.isin(epoch, epochs)
    found = standing_features(axis_matches(position[seen], epoch[seen], years), SEARCH)
    assert [f.speed for f in found] == pytest.approx([speed] * number)


def test_images_of_one_date_are_no_time(axis_matches):
    """Four images of one date, and four more without the feature."""
    years = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0])
    position = np.outer([1, 1, 1, 1, 9, 19, 29, 39], [1.0, 0.0])
    d = axis_matches(position, np.arange(8), years)
    assert standing_features(d, SEARCH) == []


# -- a feature at 0.5 beams a year that leaves a standing one, which pushes it ---------


@pytest.fixture
def samples(lines, axis_matches):
    position, epoch = lines([0.0, 0.5], [0.0, 0.5], YEARS)
    position[(position[:, 0] > 0) & (position[:, 0] < 1.5), 0] += 0.2
    return axis_matches(position, epoch, YEARS)


@pytest.fixture
def pair(samples):
    """The features that moves and that stands."""
    ssps = np.arange(1, 16, 2), np.arange(0, 16, 2)
    epoch = np.arange(8)
    return [Feature.through(s, epoch, YEARS, samples.position[s]) for s in ssps]


def test_positions_near_a_standing_feature_do_not_count(samples, pair):
    moving, standing = pair
    assert moving.speed < 0.47
    (found,) = clear_of([moving], [standing], samples, SEARCH)
    assert found.speed == pytest.approx(0.5)
    np.testing.assert_array_equal(found.ssp, moving.ssp)
    assert found.motion == moving.motion
    # The response is to shifts of the SSPs that count.
    away = samples.position[moving.ssp, 0] > PULL
    assert 4 <= away.sum() < 8
    assert not found.response[~away].any()
    velocity = found.response @ samples.position[found.ssp]
    assert velocity[0] == pytest.approx(found.speed)
    # So is the stream measured.
    search = find_streams(
        lambda angle: samples, [0.0], 1.5, n_trials=99, rng=np.random.default_rng(1)
    )
    assert [s.kind for s in search.streams] == ["moving", "stationary"]
    assert search.streams[0].along.mean == pytest.approx(0.5, abs=0.01)


def test_they_count_where_too_few_are_left(samples, pair, monkeypatch):
    moving, standing = pair
    monkeypatch.setattr("astro_scc.streams.chains.PULL", 3.0)
    (found,) = clear_of([moving], [standing], samples, SEARCH)
    assert (found.speed, found.error) == (moving.speed, moving.error)
    assert (moving.pulled, found.pulled) == (False, True)
    _, (error, larger) = feature_speeds([moving, found], SEARCH)
    assert larger == pytest.approx(np.hypot(error, 0.2 * moving.speed))


def test_the_pull_does_not_make_two_streams_one():
    epoch = np.arange(4)
    speeds = [0.3, 1.05, 0.32, 0.33, 1.0, 0.98]
    features = [through(epoch, np.outer(epoch, [v, 0])) for v in speeds]
    pulled = [replace(f, pulled=True) for f in features]
    one, other = (
        separate_streams(group, 99, np.random.default_rng(1))[0]
        for group in (features, pulled)
    )
    assert one == other < 0.05
