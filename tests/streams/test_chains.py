# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features followed through the epochs, on lines that are known."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from astro_scc.streams import SearchSettings, find_streams
from astro_scc.streams.chains import (
    PULL,
    Feature,
    _on_line,
    clear_of,
    find_chains,
    standing_features,
)
from astro_scc.streams.diagram import Rays, fit_mixture
from astro_scc.streams.dispersion import feature_speeds, separate_streams

SEARCH = SearchSettings()
#: Uneven: followers differ from features by the dates.
YEARS = np.array([0.0, 0.7, 1.2, 2.3, 3.0, 3.4, 4.6, 5.2])


def follow(d, speeds=(0.3, 0.8), years=None):
    rays = Rays.of(d.years if years is None else years, 1.5, SEARCH)
    return find_chains(d, fit_mixture(d, speeds, rays), SEARCH)[0]


def by_place(features):
    return sorted(features, key=lambda f: f.place)


class TestFeature:
    @pytest.mark.parametrize("n", [2, 3, 8])
    def test_the_line_is_that_of_polyfit(self, n):
        rng = np.random.default_rng(n)
        years = 2000 + np.sort(rng.uniform(0, 5, n))
        position = rng.normal(size=(n, 2))
        found = Feature.through(np.arange(n) + 3, np.arange(n), years, position)
        (speed, across), _ = np.polyfit(years - 2000, position, 1)
        assert found.speed == pytest.approx(speed)
        assert found.across == pytest.approx(across)
        assert found.place == pytest.approx(position[:, 0].mean())
        assert found.motion == pytest.approx(abs(speed) * np.ptp(years))
        assert len(found) == n
        np.testing.assert_array_equal(found.ssp, np.arange(n) + 3)

    def test_the_error_is_of_the_residuals_and_three_assumed_ones(self):
        rng = np.random.default_rng(1)
        years, position = np.sort(rng.uniform(0, 5, 9)), rng.normal(size=(9, 2))
        found = Feature.through(
            *[np.arange(9)] * 2, years, position, SearchSettings(position_error=0.5)
        )
        for k, error in enumerate((found.error, found.across_error)):
            slope, offset = np.polyfit(years, position[:, k], 1)
            squares = np.sum((position[:, k] - offset - slope * years) ** 2)
            # The variance that polyfit gives without scaling is for sigma 1.
            _, unit = np.polyfit(years, position[:, k], 1, cov="unscaled")
            variance = (squares + 3 * 0.5**2) / (9 - 2 + 3)
            assert error == pytest.approx(np.sqrt(variance * unit[0, 0]))

    def test_the_response_is_the_change_of_the_speed(self):
        rng = np.random.default_rng(2)
        years, position = np.sort(rng.uniform(0, 5, 6)), rng.normal(size=(6, 2))
        found = Feature.through(*[np.arange(6)] * 2, years, position)
        for k in range(6):
            moved = position.copy()
            moved[k, 0] += 0.01
            other = Feature.through(*[np.arange(6)] * 2, years, moved)
            assert found.response[k] == pytest.approx(
                (other.speed - found.speed) / 0.01
            )
            assert other.across == found.across


class TestFindFeatures:
    def test_crossing_lines_without_noise(self, lines, axis_matches):
        """The faster of two features overtakes the slower one."""
        speeds, starts = np.array([0.8, 0.3]), np.array([0.0, 1.4])
        d = axis_matches(*lines(speeds, starts, YEARS), YEARS)
        fast, slow = sorted(follow(d), key=lambda f: -f.speed)
        assert fast.speed == pytest.approx(0.8)
        assert slow.speed == pytest.approx(0.3)
        np.testing.assert_array_equal(fast.ssp, 2 * np.arange(8))
        np.testing.assert_array_equal(slow.ssp, 2 * np.arange(8) + 1)

    def test_followers_are_not_the_feature(self, lines, axis_matches):
        """
        A comb of features, each 1.2 beams behind another.

        What moves to where the next one was matches as well as itself.
        """
        starts = 1.2 * np.arange(6)
        d = axis_matches(*lines([0.5] * 6, starts, YEARS), YEARS)
        backward = (d.d1 * d.interval < 0) & (np.abs(d.d1) < 1)
        assert backward.sum() > 50
        found = by_place(follow(d))
        assert len(found) == 6
        for k, feature in enumerate(found):
            assert feature.speed == pytest.approx(0.5)
            np.testing.assert_array_equal(feature.ssp, 6 * np.arange(8) + k)

    @pytest.mark.parametrize("off", [0.2, 0.28, -0.25])
    def test_an_outlier_is_left_out(self, lines, axis_matches, off):
        position, epoch = lines([0.5], [0.0], YEARS)
        position[3, 0] += off
        (found,) = follow(axis_matches(position, epoch, YEARS))
        assert 3 not in found.ssp
        assert len(found) == 7
        assert found.speed == pytest.approx(0.5)

    @pytest.mark.parametrize("seed", [1, 2, 70, 115])
    def test_outliers_hidden_by_others_are_left_out_in_three_rounds(self, seed):
        """Positions with errors of Cauchy's distribution, by polyfit."""
        off = 0.05 * np.random.default_rng(seed).standard_t(1, 12)
        years, chosen = np.arange(12.0), np.arange(12)
        for _ in range(3):
            line = np.polyfit(years[chosen], off[chosen], 1)
            left = np.abs(off[chosen] - np.polyval(line, years[chosen]))
            good = left <= max(2.5 * 1.4826 * np.median(left), 0.12)
            if good.all() or good.sum() < 4:
                break
            chosen = chosen[good]
        d = SimpleNamespace(
            years=years, epoch=np.arange(12), position=np.stack([off, 0 * off], axis=1)
        )
        np.testing.assert_array_equal(_on_line(np.arange(12), d, SEARCH), chosen)

    def test_of_two_ssps_on_the_line_the_nearer_is_of_the_feature(
        self, lines, axis_matches
    ):
        position, epoch = lines([0.5], [0.0], YEARS)
        position = np.concatenate([[position[4] + (0.1, 0)], position])
        epoch = np.concatenate([[4], epoch])
        (found,) = follow(axis_matches(position, epoch, YEARS))
        np.testing.assert_array_equal(found.ssp, np.arange(1, 9))

    @pytest.mark.parametrize(("n", "number"), [(3, 0), (4, 1)])
    def test_four_epochs_make_a_feature(self, lines, axis_matches, n, number):
        position, epoch = lines([0.6], [0.0], YEARS)
        seen = epoch < n
        found = follow(axis_matches(position[seen], epoch[seen], YEARS))
        assert len(found) == number

    def test_a_feature_of_two_scales_is_one(self, lines, axis_matches):
        position, epoch = lines([0.5, 0.5], [0.0, 0.1], YEARS)
        scale = np.tile([2, 1], 8)
        d = axis_matches(position, epoch, YEARS, scale=scale)
        (found,) = follow(d)
        # Of the finer scale.
        np.testing.assert_array_equal(scale[found.ssp], 1)
        # Unless it is seen longer on the coarser one.
        seen = ~((scale == 1) & (epoch > 5))
        d = axis_matches(position[seen], epoch[seen], YEARS, scale=scale[seen])
        (found,) = follow(d)
        np.testing.assert_array_equal(d.scale[found.ssp], 2)

    def test_features_one_after_the_other_in_one_place_are_two(
        self, lines, axis_matches
    ):
        years = np.concatenate([YEARS, YEARS + 6.0])
        position, epoch = lines([0.5, 0.5], [0.0, 0.0 - 3.5], years)
        first, second = epoch < 8, epoch >= 7
        seen = np.where(np.arange(32) % 2 == 0, first, second)
        d = axis_matches(
            position[seen], epoch[seen], years, scale=np.tile([1, 2], 16)[seen]
        )
        found = follow(d)
        assert sorted(len(f) for f in found) == [8, 9]


class TestLongIntervals:
    """A feature moves beyond the search radius between two epochs."""

    @pytest.fixture
    def gap(self):
        # Two groups of three epochs; 3.5 beams from one to the other.
        return np.array([0.0, 0.5, 1.1, 8.0, 8.6, 9.2])

    def test_its_parts_are_joined(self, lines, axis_matches, gap):
        rng = np.random.default_rng(1)
        d = axis_matches(*lines([0.5], [1.0], gap, scatter=0.01, rng=rng), gap)
        (found,) = follow(d)
        np.testing.assert_array_equal(found.ssp, np.arange(6))
        assert found.speed == pytest.approx(0.5, rel=0.02)

    @pytest.mark.parametrize("change", ["another speed", "beside the line"])
    def test_parts_of_other_motions_are_not(self, lines, axis_matches, gap, change):
        rng = np.random.default_rng(1)
        position, epoch = lines([0.5], [1.0], gap, scatter=0.01, rng=rng)
        # Moving twice as fast it is on the line at one date.
        off = 0.5 * (gap[3:] - gap[4]) if change == "another speed" else 3.0
        position[3:, 0] += off
        assert follow(axis_matches(position, epoch, gap)) == []

    def test_of_two_parts_that_both_fit_none_is_joined(self, lines, axis_matches, gap):
        position, epoch = lines([0.5], [1.0], gap)
        later = position[3:] + [0.6, 0.0]
        position, epoch = np.concatenate([position, later]), np.append(epoch, epoch[3:])
        order = np.argsort(epoch, kind="stable")
        assert follow(axis_matches(position[order], epoch[order], gap)) == []


class TestStandingFeatures:
    def test_what_stands_still_is_found(self, lines, axis_matches):
        rng = np.random.default_rng(1)
        d = axis_matches(
            *lines([0, 0, 0.5], [0.0, 3.0, 6.0], YEARS, scatter=0.02, rng=rng), YEARS
        )
        one, other = by_place(standing_features(d, SEARCH))
        np.testing.assert_array_equal(one.ssp, 3 * np.arange(8))
        np.testing.assert_array_equal(other.ssp, 3 * np.arange(8) + 1)
        assert abs(one.speed) <= 2 * one.error

    @pytest.mark.parametrize(("n", "number"), [(5, 0), (6, 1)])
    def test_in_half_of_the_epochs(self, lines, axis_matches, n, number):
        years = np.arange(12.0)
        position, epoch = lines([0.0], [0.0], years)
        seen = np.isin(epoch, np.arange(12)[::2][:n] if n < 6 else np.arange(0, 12, 2))
        d = axis_matches(position[seen], epoch[seen], years)
        assert len(standing_features(d, SEARCH)) == number

    def test_slow_drift_is_not_rest(self, lines, axis_matches):
        years = np.arange(12.0)
        drifting = axis_matches(*lines([0.05], [0.0], years), years)
        assert standing_features(drifting, SEARCH) == []
        resting = axis_matches(*lines([0.004], [0.0], years), years)
        (found,) = standing_features(resting, SEARCH)
        assert found.speed == pytest.approx(0.004)

    def test_images_of_one_date_are_no_time(self, lines, axis_matches):
        """Four images of one date, and four more without the feature."""
        years = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0])
        position = np.array([[1.0, 0]] * 4 + [[9.0, 0], [19, 0], [29, 0], [39, 0]])
        d = axis_matches(position, np.arange(8), years)
        assert standing_features(d, SEARCH) == []

    def test_nothing_there(self, lines, axis_matches):
        d = axis_matches(*lines([0.0], [0.0], YEARS), YEARS)
        nothing = d.select(np.zeros(len(d), dtype=bool))
        assert standing_features(nothing, SEARCH) == []
        assert (
            standing_features(replace(d, target_ssp=np.full(len(d), -1)), SEARCH) == []
        )


class TestClearOf:
    """A feature at 0.5 beams a year that leaves a standing one, which pushes it."""

    @pytest.fixture
    def samples(self, lines, axis_matches):
        position, epoch = lines([0.0, 0.5], [0.0, 0.5], YEARS)
        near = (position[:, 0] > 0) & (position[:, 0] < 1.5)
        position[near, 0] += 0.2
        return axis_matches(position, epoch, YEARS)

    @pytest.fixture
    def moving(self, samples):
        ssp = np.arange(1, 16, 2)
        return Feature.through(ssp, np.arange(8), YEARS, samples.position[ssp])

    @pytest.fixture
    def standing(self, samples):
        ssp = np.arange(0, 16, 2)
        return Feature.through(ssp, np.arange(8), YEARS, samples.position[ssp])

    def test_positions_near_a_standing_feature_do_not_count(
        self, samples, moving, standing
    ):
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

    def test_they_count_where_too_few_are_left(
        self, samples, moving, standing, monkeypatch
    ):
        monkeypatch.setattr("astro_scc.streams.chains.PULL", 3.0)
        (found,) = clear_of([moving], [standing], samples, SEARCH)
        assert (found.speed, found.error) == (moving.speed, moving.error)
        assert found.pulled
        assert not moving.pulled
        _, (error, larger) = feature_speeds([moving, found], SEARCH)
        assert larger == pytest.approx(np.hypot(error, 0.2 * moving.speed))

    def test_they_do_not_keep_two_streams_from_being_found(self):
        epoch = np.arange(4)
        speeds = [0.3, 1.05, 0.32, 0.33, 1.0, 0.98]
        features = [
            Feature.through(epoch, epoch, epoch, np.outer(epoch, [v, 0]))
            for v in speeds
        ]
        pulled = [replace(f, pulled=True) for f in features]
        found = [
            separate_streams(group, 99, np.random.default_rng(1))
            for group in (features, pulled)
        ]
        assert found[0][0] == found[1][0] < 0.05

    def test_the_stream_is_measured_without_them(self, samples):
        found = find_streams(
            lambda angle: samples, [0.0], 1.5, n_trials=99,
            rng=np.random.default_rng(1),
        )  # fmt: skip
        moving, still = found.streams
        assert (moving.kind, still.kind) == ("moving", "stationary")
        assert moving.along.mean == pytest.approx(0.5, abs=0.01)


def test_two_dates_have_no_acceleration():
    years = np.array([0.0, 0.0, 1.0, 1.0, 1.0])
    place = np.outer(years, [0.5, 0.0])
    feature = Feature.through(np.arange(5), np.arange(5), years, place)
    assert (feature.speed, np.isnan(feature.acceleration)) == (0.5, True)
