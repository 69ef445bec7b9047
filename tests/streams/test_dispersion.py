# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams of features: their mean and dispersion, and whether they are one or two."""

from itertools import product

import numpy as np
import pytest
from scipy.stats import norm

from astro_scc.streams import SearchSettings
from astro_scc.streams.chains import Feature
from astro_scc.streams.dispersion import (
    ONE_DISPERSIONS,
    TWO_DISPERSIONS,
    alignment_response,
    feature_speeds,
    random_effects,
    separate_streams,
)
from astro_scc.streams.search import Stream

SEARCH = SearchSettings()


def features_of(speeds, errors):
    """Features of given speeds and errors, of which nothing else counts."""
    return [
        Feature(*[np.arange(4)] * 2, v, e, 0.0, e, np.zeros(2), 2e3, 2.0, np.zeros(4))
        for v, e in zip(speeds, np.broadcast_to(errors, np.shape(speeds)), strict=True)
    ]


class TestRandomEffects:
    def test_it_is_the_posterior_by_integration(self):
        rng = np.random.default_rng(1)
        x, e = rng.normal(1, 0.4, 9), rng.uniform(0.05, 0.5, 9)
        found = random_effects(x, e)
        tau, m = np.linspace(0, 1.5, 601)[:, None], np.linspace(0, 2, 2001)
        posterior = norm(0, 0.3 * np.median(x)).pdf(tau) * np.ones(m.shape)
        for value, error in zip(x, e, strict=True):
            posterior *= norm.pdf(value, m, np.hypot(tau, error))
        posterior[[0, -1]] *= 0.5
        posterior /= posterior.sum()
        mean = (m * posterior).sum()
        dispersion = (tau * posterior).sum()
        deviation = np.sqrt((tau**2 * posterior).sum() - dispersion**2)
        inside = posterior[:, np.abs(m - found.mean) <= found.error].sum()
        assert found.mean == pytest.approx(mean, rel=1e-3)
        assert found.dispersion == pytest.approx(dispersion, rel=5e-3)
        assert found.dispersion_error == pytest.approx(deviation, rel=0.02)
        assert inside == pytest.approx(0.6827, abs=0.003)

    @pytest.mark.parametrize("value", [0.5, -4.0])
    def test_a_single_value_knows_the_mean_no_better_than_the_prior(self, value):
        found = random_effects([value], [0.01])
        assert found.mean == value
        assert 0.15 * abs(value) < found.error < 0.3 * abs(value)
        assert np.isnan([found.dispersion, found.dispersion_error]).all()

    @pytest.mark.slow
    @pytest.mark.parametrize(("n", "tau"), [(3, 0.2), (6, 0.2), (15, 0.1)])
    def test_the_interval_holds_the_mean_of_the_flow_in_68_percent(self, n, tau):
        rng, n_trials = np.random.default_rng(n), 600
        errors = rng.uniform(0.03, 0.12, (n_trials, n))
        values = 1 + tau * rng.normal(size=(n_trials, n))
        values += errors * rng.normal(size=errors.shape)
        found = [random_effects(v, e) for v, e in zip(values, errors, strict=True)]
        off = np.array([f.mean for f in found]) - 1
        inside = np.mean(np.abs(off) <= [f.error for f in found])
        assert 0.63 <= inside <= 0.76


def test_errors_of_features_hold_blends_and_the_pull_of_the_core():
    speed, error = feature_speeds(features_of([1.0, -2.0], [0.1, 0.0]))
    np.testing.assert_array_equal(speed, [1.0, -2.0])
    np.testing.assert_allclose(error, [np.hypot(0.13, 0.02), 0.04])


class TestAlignmentResponse:
    """What a displacement of whole epochs does to the mean speed."""

    def stream(self, lines, years, speeds, shift=0.0, scatter=0.0):
        """Features seen in all, in the first five and in the last four epochs."""
        rng = np.random.default_rng(3)
        position, epoch = lines(
            speeds, [0, 4, 8], years, scatter=scatter, rng=rng
        )  # fmt: skip
        position = position + np.stack([shift + 0 * years, 0 * years], 1)[epoch]
        ssps = np.arange(18).reshape(6, 3).T
        ssps = [ssps[0], ssps[1][:5], ssps[2][2:]]
        features = [
            Feature.through(s, epoch[s], years[epoch[s]], position[s]) for s in ssps
        ]
        along = random_effects(*feature_speeds(features))
        return Stream("moving", "", 0.0, along, along, features=tuple(features))

    def test_of_different_speeds_with_the_weights_of_the_mean(self, lines):
        years, step = np.array([0.0, 0.7, 1.2, 2.3, 3.0, 3.4]), 1e-4
        speeds = [0.3, 0.7, 0.6]
        stream = self.stream(lines, years, speeds, scatter=0.05)
        speed, error = feature_speeds(stream.features)
        weight = 1 / (error**2 + stream.along.dispersion**2)
        mean = np.average(speed, weights=weight)
        assert mean == pytest.approx(stream.along.mean, rel=0.02)
        assert stream.along.dispersion > 0
        found = alignment_response(stream, 6)
        for k in range(6):
            shift = step * (np.arange(6) == k)
            moved = self.stream(lines, years, speeds, shift, scatter=0.05)
            moved = [f.speed for f in moved.features]
            change = (np.average(moved, weights=weight) - mean) / step
            assert found[k] == pytest.approx(change, rel=1e-6)

    def test_of_a_single_feature_and_of_none(self, lines):
        years = np.array([0.0, 0.7, 1.2, 2.3, 3.0, 3.4])
        stream = self.stream(lines, years, [0.5] * 3)
        (feature, *_) = stream.features
        single = random_effects([feature.speed], [feature.error])
        alone = Stream("moving", "", 0.0, single, single, features=(feature,))
        np.testing.assert_allclose(alignment_response(alone, 6), feature.response)
        none = Stream("not significant", "", 0.0, single, single)
        np.testing.assert_array_equal(alignment_response(none, 7), np.zeros(7))


def log_normal(rng, n, centre, dispersion, error):
    true = centre * np.exp(rng.normal(0, dispersion, n))
    return true * (1 + error * rng.normal(size=n))


class TestSeparateStreams:
    @pytest.mark.parametrize("dispersion", [0.1, 0.4])
    def test_p_is_even_for_one_stream(self, dispersion):
        p = []
        for seed in range(60):
            rng = np.random.default_rng(seed)
            speed = log_normal(rng, 6, 0.5, dispersion, 0.03)
            p.append(separate_streams(features_of(speed, 0.03 * speed), 59, rng)[0])
        p = np.sort(p)
        # Kolmogorov and Smirnov, at one in a thousand: 1.95 / sqrt(60).
        assert np.abs(p - (np.arange(60) + 0.5) / 60).max() < 0.25
        assert np.mean(p <= 0.05) <= 10 / 60

    @pytest.mark.parametrize("sign", [1, -1])
    @pytest.mark.parametrize("n", [(4, 4), (3, 6), (2, 5)])
    def test_two_streams_are_told_apart(self, n, sign):
        rng = np.random.default_rng(2)
        slow = log_normal(rng, n[0], 0.3, 0.1, 0.03)
        fast = log_normal(rng, n[1], 1.2, 0.1, 0.03)
        speed = np.concatenate([fast, slow])
        order = rng.permutation(sum(n))
        found = features_of(sign * speed[order], 0.03 * speed[order])
        p, second = separate_streams(found, 99, rng)
        assert p <= 0.05
        np.testing.assert_array_equal(second, order < n[1])

    def test_speeds_far_below_their_errors_are_one_stream(self):
        found = features_of([0.001, 0.002, 0.9, 1.0, 0.003], 9.0)
        assert separate_streams(found, 999, np.random.default_rng(1))[0] == 1

    @pytest.mark.parametrize("n", [0, 1, 3])
    def test_three_features_are_one_stream(self, n):
        speed = np.array([0.1, 1.0, 1.1])[:n]
        p, second = separate_streams(
            features_of(speed, 0.01), 99, np.random.default_rng(1)
        )
        assert p == 1
        np.testing.assert_array_equal(second, np.zeros(n, dtype=bool))

    def test_the_likelihoods_by_a_loop(self):
        """The ratio of the largest of two components and of one."""
        from astro_scc.streams.dispersion import _one, _two

        rng = np.random.default_rng(4)
        y, e = (
            np.sort(rng.normal(0, 0.4, (3, 6)), axis=1),
            rng.uniform(0.02, 0.2, (3, 6)),
        )
        one, mean, tau, linear = _one(y, e)
        two, where = _two(y, e)
        constant = 6 * 0.5 * np.log(2 * np.pi)
        for k in range(3):
            best = -np.inf
            for width in ONE_DISPERSIONS:
                s = np.hypot(e[k], width)
                m = np.average(y[k], weights=s**-2.0)
                value = norm.logpdf(y[k], m, s).sum() + constant
                if value > best:
                    best, found = value, (m, width, 0)
                # A normal distribution of v is one of y = log v, times v.
                v = np.exp(y[k])
                s = np.hypot(e[k] * v, width * v.mean())
                m = np.average(v, weights=s**-2.0)
                value = (norm.logpdf(v, m, s) + y[k]).sum() + constant
                if value > best:
                    best, found = value, (np.log(m), width, 1)
            assert one[k] == pytest.approx(best)
            assert (mean[k], tau[k], linear[k]) == pytest.approx(found)
            best = -np.inf
            for split in range(1, 6):
                parts = slice(None, split), slice(split, None)
                for widths in product(TWO_DISPERSIONS, repeat=2):
                    total = 0
                    for part, width in zip(parts, widths, strict=True):
                        s = np.hypot(e[k], width)
                        m = np.average(y[k, part], weights=s[part] ** -2.0)
                        share = len(y[k, part]) / 6
                        total = total + share * norm.pdf(y[k], m, s)
                    value = np.log(total).sum() + constant
                    if value > best:
                        best, found = value, split
            assert two[k] == pytest.approx(best)
            assert where[k] == found

    @pytest.mark.slow
    @pytest.mark.parametrize("draw", ["normal", "uniform"])
    def test_one_broad_stream_is_seldom_two(self, draw):
        """At a level of 0.05, of speeds that scatter by a third or a half."""
        rng = np.random.default_rng(6)
        found = 0
        for _ in range(40):
            if draw == "normal":
                speed = np.abs(rng.normal(1, 0.3, 10))
            else:
                speed = rng.uniform(0.1, 1.9, 10)
            p, _ = separate_streams(features_of(speed, 0.02), 99, rng)
            found += p <= 0.05
        # 2 of 40 expected; more than 8 with a probability of 1e-4.
        assert found <= 8
