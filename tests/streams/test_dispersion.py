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
    _one,
    _two,
    feature_speeds,
    random_effects,
    separate_streams,
    velocity_of,
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
        tau, m = np.linspace(0, 1.5, 301)[:, None], np.linspace(0, 2, 2001)
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


@pytest.mark.parametrize("n_features", [3, 1])
def test_errors_of_the_alignment_are_those_of_shifted_epochs(lines, n_features):
    """Of features in all, in the first five and in the last four epochs."""
    years = np.array([0.0, 0.7, 1.2, 2.3, 3.0, 3.4])
    rng = np.random.default_rng(3)
    position, epoch = lines([0.3, 0.7, 0.6], [0, 4, 8], years, scatter=0.05, rng=rng)
    ssps = np.arange(18).reshape(6, 3).T
    ssps = [ssps[0], ssps[1][:5], ssps[2][2:]][:n_features]

    def features(shift):
        moved = position + np.stack([shift, 0 * shift], 1)[epoch]
        return [Feature.through(s, epoch[s], years[epoch[s]], moved[s]) for s in ssps]

    own = features(np.zeros(6))
    speed, error = feature_speeds(own)
    along = random_effects(speed, error)
    stream = Stream("moving", "", 0.0, along, along, features=tuple(own))
    # With the weights of the mean.
    weight = 1 / (error**2 + np.nan_to_num(along.dispersion) ** 2)
    mean = np.average(speed, weights=weight)
    assert mean == pytest.approx(along.mean, rel=0.02)
    for shift in np.eye(6):
        moved = [f.speed for f in features(1e-4 * shift)]
        change = (np.average(moved, weights=weight) - mean) / 1e-4
        found = velocity_of(stream, [1.0, 1.0], np.outer(shift, [0.2, 0.1])).alignment
        wanted = np.diag((change * np.array([0.2, 0.1])) ** 2)
        np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-12)


def log_normal(rng, n, centre, dispersion, error):
    true = centre * np.exp(rng.normal(0, dispersion, n))
    return true * (1 + error * rng.normal(size=n))


class TestSeparateStreams:
    @pytest.mark.parametrize(
        ("dispersion", "n"), [(0.1, 25), pytest.param(0.4, 60, marks=pytest.mark.slow)]
    )
    def test_p_is_even_for_one_stream(self, dispersion, n):
        p = []
        for seed in range(n):
            rng = np.random.default_rng(seed)
            speed = log_normal(rng, 6, 0.5, dispersion, 0.03)
            p.append(separate_streams(features_of(speed, 0.03 * speed), 59, rng)[0])
        # Kolmogorov and Smirnov, at one in a thousand.
        off = np.abs(np.sort(p) - (np.arange(n) + 0.5) / n)
        assert off.max() < 1.95 / np.sqrt(n)

    @pytest.mark.parametrize(("n", "sign"), [((4, 4), 1), ((3, 6), -1), ((2, 5), 1)])
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

    @pytest.mark.parametrize(
        ("speed", "error"),
        # Fewer than four, and speeds far below their errors.
        [([0.1, 1.0, 1.1], 0.01), ([], 0.01), ([0.001, 0.002, 0.9, 1.0, 0.003], 9.0)],
    )
    def test_what_is_always_one_stream(self, speed, error):
        found = features_of(speed, error)
        p, second = separate_streams(found, 99, np.random.default_rng(1))
        assert p == 1
        assert len(second) == len(speed)
        assert len(speed) > 3 or not second.any()

    def test_the_likelihoods_by_a_loop(self):
        """The ratio of the largest of two components and of one."""
        rng = np.random.default_rng(4)
        y = np.sort(rng.normal(0, 0.4, (3, 6)), axis=1)
        e = rng.uniform(0.02, 0.2, (3, 6))
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
