# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
A fast guard of the probabilities: sets of matches with and without motion.

``benchmarks/calibration`` does the same on images, of many more jets.
"""

import numpy as np
import pytest
from scipy.stats import binom, kstest

from astro_scc.streams import find_streams

N_MOVING = 12
#: Epochs that are exchangeable: chance only, features that stand still, and both.
NULLS = [
    {"chance": 8, "length": 8.0},
    {"still": 6, "chance": 2, "length": 10.0, "seen": 0.7},
    {"still": 4, "chance": 5, "length": 6.0, "seen": 0.8},
]
#: What is there besides a stream.
OTHERS = {"still": 3, "chance": 4, "length": 12.0, "seen": 0.8}


def dates(rng, n):
    """Uneven ones, with a median interval of one year."""
    gaps = rng.lognormal(0, 0.3, n - 1)
    return np.concatenate([[0], np.cumsum(gaps / np.median(gaps))])


def search(d, rng):
    return find_streams(lambda angle: d, [0.0], 1.5, n_trials=99, rng=rng)


def null(jet, seed):
    """Return the smallest p_global of a set, and whether something is said to move."""
    rng = np.random.default_rng(seed)
    found = search(jet(rng, dates(rng, 7), **NULLS[seed % len(NULLS)]), rng)
    test = found.permutations
    alarm = any(stream.kind == "moving" for stream in found.streams)
    return test.p_values(*test.largest())[1], alarm


@pytest.mark.parametrize(
    ("n", "most", "rate"),
    # Of a larger rate of alarms there are more than these in 90% of all runs.
    [(24, 3, 0.28), pytest.param(100, 8, 0.14, marks=pytest.mark.slow)],
)
def test_p_global_is_even_and_alarms_are_rare(jet, n, most, rate):
    p, alarms = np.transpose([null(jet, seed) for seed in range(n)])
    # (b + 1) / (n + 1) is at the upper end of its hundredth.
    assert kstest(p - 0.005, "uniform").pvalue > 1e-3
    # Features must be seen to move besides.
    assert binom.sf(most, n, rate) > 0.9
    assert alarms.sum() <= most


@pytest.fixture(scope="module")
def moving(jet):
    """Eight features of half a beam a year and 10% dispersion, among others."""
    found = []
    for seed in range(N_MOVING):
        rng = np.random.default_rng(1000 + seed)
        d = jet(rng, dates(rng, 8), [(8, 0.5, 0.1)], **OTHERS)
        found.append(search(d, rng).streams)
    return found


def test_what_moves_is_found_within_its_error(moving):
    first = [streams[0] for streams in moving]
    assert all(stream.kind == "moving" for stream in first)
    # Mean of the log-normal distribution.
    true = 0.5 * np.exp(0.1**2 / 2)
    off = np.array([stream.along.mean - true for stream in first])
    error = np.array([stream.along.error for stream in first])
    assert np.abs(off).max() < 0.2 * true
    # If 68% are within their error, five or fewer of twelve are in 7%.
    assert binom.cdf(5, N_MOVING, 0.68) < 0.1
    assert np.sum(np.abs(off) <= error) > 5


def test_one_stream_is_seldom_two(moving):
    # At one in twenty, more than three of twelve in 0.2% of all runs.
    n_moving = [sum(s.kind == "moving" for s in streams) for streams in moving]
    assert sum(n > 1 for n in n_moving) <= 3
