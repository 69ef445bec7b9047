# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Permutations of the epochs, and permuted stacks against a loop over them."""

import math
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chisquare

from astro_scc.stacking.pair_maps import PairMaps
from astro_scc.stacking.stack import stack
from astro_scc.stacking.trials import (
    number_of_permutations,
    permute_stacks,
    random_permutations,
)
from astro_scc.stacking.velocities import VelocityGrid, consecutive_pairs
from astro_scc.streams.permutations import permutations_of_epochs


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize(
    ("n", "trials"), [(1, 2), (2, 2), (3, 5), (4, 2), (5, 40), (6, 99), (7, 5039)]
)
def test_few_epochs_are_gone_through_in_every_order(n, trials):
    orders = permutations_of_epochs(n, trials, rng())
    assert orders.shape == (math.factorial(n) - 1, n)
    every = {tuple(order) for order in orders.tolist()}
    assert every == set(permutations(range(n))) - {tuple(range(n))}


@pytest.mark.parametrize(
    ("n", "number"), [(1, 1), (2, 1), (3, 3), (4, 12), (5, 60), (8, 20160)]
)
def test_an_order_and_its_reversal_are_one(n, number):
    assert number_of_permutations(n) == number
    if n < 6:
        every = {min(order, order[::-1]) for order in permutations(range(n))}
        assert len(every) == number


@given(st.integers(1, 30), st.integers(2, 40), st.integers(0, 2**32 - 1))
def test_every_order_is_one_of_the_epochs(n, n_trials, seed):
    orders = permutations_of_epochs(n, n_trials, rng(seed))
    every = math.factorial(n) - 1
    assert len(orders) == (every if n <= 6 else min(n_trials, every))
    np.testing.assert_array_equal(
        np.sort(orders, axis=1), np.tile(np.arange(n), (len(orders), 1))
    )
    np.testing.assert_array_equal(
        orders, permutations_of_epochs(n, n_trials, rng(seed))
    )


GRID = VelocityGrid.covering((4.0, 3.0), (0.25, 0.3))
YEARS = [0.0, 0.4, 1.2, 1.5, 2.6]


@pytest.fixture(scope="module")
def maps(random_displacements):
    d = random_displacements(np.random.default_rng(0), 5, 300)
    return PairMaps.of(d, GRID.v_max, 1.1)


@pytest.fixture(scope="module")
def pairs():
    return consecutive_pairs(YEARS)


def run(maps, pairs, n_trials=30, seed=1, **kwargs):
    rng = np.random.default_rng(seed)
    return permute_stacks(maps, pairs, GRID, n_trials, rng=rng, **kwargs)


def test_orders_are_permutations_and_all_of_them_occur_equally_often():
    orders = random_permutations(4, 6000, np.random.default_rng(0))
    assert orders.shape == (6000, 4)
    np.testing.assert_array_equal(np.sort(orders, axis=1), [[0, 1, 2, 3]] * 6000)
    kinds, counts = np.unique(orders, axis=0, return_counts=True)
    assert len(kinds) == 24
    assert [0, 1, 2, 3] in kinds.tolist()
    assert chisquare(counts).pvalue > 1e-3


def test_mean_and_std_are_those_of_the_stacks_of_the_orders(maps, pairs):
    found = run(maps, pairs)
    orders = random_permutations(5, 30, np.random.default_rng(1))
    d = maps.samples
    stacks = np.array([stack(d, pairs, GRID, order=order) for order in orders])
    tolerance = 1e-3 * stacks.max()
    np.testing.assert_allclose(found.mean, stacks.mean(axis=0), atol=tolerance)
    np.testing.assert_allclose(found.std, stacks.std(axis=0, ddof=1), atol=tolerance)
    observed = stack(d, pairs, GRID)
    z = (observed - stacks.mean(axis=0)) / stacks.std(axis=0, ddof=1)
    np.testing.assert_allclose(found.z_score(observed), z, atol=0.02)


def test_a_shift_is_added_in_four_directions_in_turn(maps, pairs):
    found = run(maps, pairs, shift=(0.3, 0.2))
    orders = random_permutations(5, 30, np.random.default_rng(1))
    d = maps.samples
    moved = [
        replace(d, d1=d.d1 + 0.3),
        replace(d, d1=d.d1 - 0.3),
        replace(d, d2=d.d2 + 0.2),
        replace(d, d2=d.d2 - 0.2),
    ]
    stacks = np.array(
        [stack(moved[i % 4], pairs, GRID, order=o) for i, o in enumerate(orders)]
    )
    tolerance = 1e-3 * stacks.max()
    np.testing.assert_allclose(found.mean, stacks.mean(axis=0), atol=tolerance)
    np.testing.assert_allclose(found.std, stacks.std(axis=0, ddof=1), atol=tolerance)
    assert np.abs(found.mean - run(maps, pairs).mean).max() > 10 * tolerance


def test_progress_counts_the_trials(maps, pairs):
    done = []
    run(maps, pairs, progress=done.append)
    assert done == [1] * 30
    done.clear()
    run(maps, pairs, progress=done.append, shift=(0.3, 0.2))
    assert sum(done) == 30


def test_small_standard_deviations_are_floored(maps, pairs):
    """Where hardly a trial has a match, a tiny coefficient is no discovery."""
    found = run(maps, pairs)
    std = found.std.copy()
    std[0, 0] = 1e-9
    found = replace(found, std=std)
    z = found.z_score(found.mean + std.max())
    assert z[0, 0] == pytest.approx(100.0)
    assert z.max() == pytest.approx(100.0)


def test_without_any_correlation_the_z_score_is_zero(maps, pairs):
    d = maps.samples
    none = replace(d, weight=np.zeros(len(d)))
    found = run(PairMaps.of(none, GRID.v_max, 1.1), pairs)
    np.testing.assert_array_equal(found.std, 0.0)
    np.testing.assert_array_equal(found.z_score(np.ones(GRID.shape)), 0.0)


@pytest.mark.parametrize("n_trials", [-1, 0, 1])
def test_needs_at_least_two_trials(maps, pairs, n_trials):
    with pytest.raises(ValueError, match=f"at least 2 trials, got {n_trials}"):
        run(maps, pairs, n_trials=n_trials)


def test_of_many_epochs_there_are_orders_without_end():
    assert number_of_permutations(1000) == number_of_permutations(20) > 1e18
