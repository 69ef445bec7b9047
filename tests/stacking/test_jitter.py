# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Errors from shifted positions against what they must be for simple clumps."""

from dataclasses import replace

import numpy as np
import pytest

from astro_scc.stacking.stack import VelocityPeak
from astro_scc.stacking.trials import jitter_positions
from astro_scc.stacking.velocities import consecutive_pairs

PAIRS = consecutive_pairs([0.0, 0.5])
HALF_YEAR = 0.5


def errors(found):
    """Standard errors along both axes."""
    return np.sqrt(np.diag(found.covariance))


def component(v1=1.0, v2=-0.5):
    return VelocityPeak(v1, v2, 1.0, 0.3, 0.3, 0, 0, True)


def jitter(d, n_trials=1000, *, pairs=PAIRS, at=None, box=(3.0, 3.0), seed=0):
    return jitter_positions(
        d, pairs, at or component(), box, n_trials, rng=np.random.default_rng(seed)
    )


def expected_error(s, n, shared=0.0):
    """
    Standard deviation of the maximum of n Gaussians of width s at random places.

    A share of the variance s^2 of the places is common to all.  The maximum
    of f = sum g(x_i, y_i) lies at -f'/f'' to first order; with the variance q
    of the rest in units of s^2, E[f'^2] = n q / (1 + 2 q)^2 and
    E[f''] = -n / (1 + q)^2.
    """
    q = 1 - shared
    own = q * (1 + q) ** 4 / (1 + 2 * q) ** 2 / n
    return s * np.sqrt(shared + own)


@pytest.mark.parametrize("n", [60, 240])
def test_independent_ssps(clump, n):
    """Four thirds of s / sqrt(n): the maximum is less sure than the mean."""
    found = jitter(clump(n, s=(0.2, 0.2)))
    expected = expected_error(0.2 / HALF_YEAR, n)
    assert expected == pytest.approx(4 / 3 * 0.4 / np.sqrt(n))
    assert errors(found)[0] == pytest.approx(expected, rel=0.12)
    assert errors(found)[1] == pytest.approx(expected, rel=0.12)
    assert found.share == 1.0
    assert abs(found.covariance[0, 1]) < 0.15 * np.prod(errors(found))
    assert abs(found.bias[0]) < 5 * expected / np.sqrt(1000)
    assert abs(found.bias[1]) < 5 * expected / np.sqrt(1000)


def test_one_ssp_that_all_matches_share(clump):
    """Its shift moves all of them: its half of the variance does not average out."""
    found = jitter(clump(60, s=(0.2, 0.2), shared=True))
    expected = expected_error(0.4, 60, shared=0.5)
    assert expected > 0.4 / np.sqrt(2)
    assert errors(found)[0] == pytest.approx(expected, rel=0.08)
    assert errors(found)[1] == pytest.approx(expected, rel=0.08)


def chains(n, n_epochs):
    """SSPs that are matched from epoch to epoch, all at one velocity."""
    feature, epoch = np.mgrid[:n, : n_epochs - 1].reshape(2, -1)
    from astro_scc.stacking.velocities import VelocitySamples

    one = np.ones(feature.size)
    return VelocitySamples(
        d1=0.5 * one,
        d2=-0.25 * one,
        s1=0.2 * one,
        s2=0.2 * one,
        weight=one,
        reference=epoch,
        target=epoch + 1,
        ssp=epoch * n + feature,
        target_ssp=(epoch + 1) * n + feature,
        n_ssps=np.full(n_epochs, n),
    )


def test_shifts_of_chains_cancel():
    """What an SSP adds to the one displacement it takes from the next."""
    d = chains(20, 9)
    pairs = consecutive_pairs(HALF_YEAR * np.arange(9))
    chained = jitter(d, pairs=pairs)
    apart = jitter(replace(d, target_ssp=np.full(len(d), -1)), pairs=pairs)
    assert errors(apart)[0] == pytest.approx(expected_error(0.4, 160), rel=0.12)
    assert errors(chained)[0] < 0.75 * errors(apart)[0]


def test_share_of_the_trials_that_stay_in_the_box(clump):
    """One match of width s; a box of half-width s holds its maximum to 68%."""
    found = jitter(clump(1, s=(0.2, 0.02)), box=(0.8, 3.0))
    # The outermost of 25 points counts as outside.
    assert found.share == pytest.approx(0.65, abs=0.05)
    assert errors(found)[0] < 0.4


def test_a_maximum_at_the_border_of_the_box_is_compared_with_the_component(clump):
    d = clump(1, velocity=(1.5, -0.5), s=(0.1, 0.1))
    found = jitter(d, at=component(1.0, -0.5), box=(1.0, 1.0))
    assert 0 < found.bias[0] < 0.5
    assert found.share < 0.6


@pytest.mark.parametrize("n_trials", [0, 1, 2])
def test_too_few_trials_have_no_error(clump, n_trials):
    found = jitter(clump(10), n_trials)
    for name in ("covariance", "bias"):
        assert np.all(np.isnan(getattr(found, name)))
    assert found.share == (1.0 if n_trials else 0.0)


def test_no_match_in_reach_no_maximum(clump):
    found = jitter(clump(10), 10, at=component(9.0, 9.0))
    assert found.share == 0.0
    assert np.isnan(errors(found)[0])
    assert jitter(clump(10).select(slice(0, 0)), 10).share == 0.0
