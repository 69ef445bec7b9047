# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Permutations of the epochs: complete where they are few, uniform otherwise."""

import math
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.stacking.permutations import (
    number_of_permutations,
    permutations_of_epochs,
)


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


def test_more_epochs_are_drawn():
    orders = permutations_of_epochs(7, 118, rng())
    assert orders.shape == (118, 7)
    np.testing.assert_array_equal(np.sort(orders, axis=1), [range(7)] * 118)
    assert permutations_of_epochs(60, 20, rng()).shape == (20, 60)


@pytest.mark.parametrize(
    ("n", "number"), [(1, 1), (2, 1), (3, 3), (4, 12), (5, 60), (8, 20160)]
)
def test_an_order_and_its_reversal_are_one(n, number):
    assert number_of_permutations(n) == number
    if n < 6:
        every = {min(order, order[::-1]) for order in permutations(range(n))}
        assert len(every) == number


def test_of_many_epochs_there_are_orders_without_end():
    assert number_of_permutations(1000) == number_of_permutations(20) > 1e18


def test_draws_are_even():
    """Each epoch is at each date as often, within four standard errors."""
    n, n_trials = 12, 4000
    drawn = permutations_of_epochs(n, n_trials, rng(1))
    share = np.array([np.mean(drawn == k, axis=0) for k in range(n)])
    assert np.abs(share - 1 / n).max() < 4 * np.sqrt(1 / n / n_trials)


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
