# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Orders of the epochs: complete where they are few, uniform where they are many."""

import math
from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.stacking import (
    AllOrders,
    BlockOrders,
    ReversedBlocks,
    WithoutSuccessors,
)

EVERY = (
    AllOrders(),
    WithoutSuccessors(),
    BlockOrders(2),
    BlockOrders(3),
    ReversedBlocks(2),
    ReversedBlocks(3),
)


def rng(seed=0):
    return np.random.default_rng(seed)


def as_set(orders):
    return {tuple(int(k) for k in order) for order in orders}


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
def test_few_epochs_are_gone_through_in_every_order(n):
    orders = AllOrders().draw(n, math.factorial(n) - 1, rng())
    assert orders.shape == (math.factorial(n) - 1, n)
    assert as_set(orders) == set(permutations(range(n))) - {tuple(range(n))}
    assert AllOrders().number(n) == math.factorial(n) / 2


def test_more_epochs_are_drawn():
    orders = AllOrders().draw(5, 118, rng())
    assert orders.shape == (118, 5)
    np.testing.assert_array_equal(np.sort(orders, axis=1), [range(5)] * 118)
    assert AllOrders().draw(60, 20, rng()).shape == (20, 60)
    assert AllOrders().number(60) > 1e18


def test_the_papers_variant_keeps_no_successor():
    wanted = {
        o
        for o in permutations(range(4))
        if all(b - a != 1 for a, b in zip(o, o[1:], strict=False))
    }
    assert as_set(WithoutSuccessors().draw(4, 100, rng())) == wanted
    drawn = WithoutSuccessors().draw(10, 300, rng())
    assert 60 < len(drawn) < 180
    assert not (np.diff(drawn, axis=1) == 1).any()


@pytest.mark.parametrize(("n", "length"), [(6, 2), (7, 2), (7, 3), (5, 1), (3, 5)])
def test_blocks_come_in_every_order(n, length):
    blocks = [list(range(n))[i : i + length] for i in range(0, n, length)]
    wanted = {tuple(sum(order, [])) for order in permutations(blocks)}
    strategy = BlockOrders(length)
    assert strategy.number(n) == math.factorial(len(blocks))
    orders = strategy.draw(n, 10_000, rng())
    assert as_set(orders) == wanted - {tuple(range(n))}
    assert orders.shape[1] == n
    # And where they are drawn, they are of these.
    if len(wanted) > 6:
        drawn = strategy.draw(n, 5, rng())
        assert drawn.shape == (5, n)
        assert as_set(drawn) <= wanted


@pytest.mark.parametrize(("n", "length"), [(6, 2), (7, 2), (8, 3), (2, 2), (3, 5)])
def test_blocks_turn_round_in_their_places(n, length):
    blocks = [list(range(n))[i : i + length] for i in range(0, n, length)]
    ways = [{tuple(b), tuple(b[::-1])} for b in blocks]
    wanted = {tuple(sum(map(list, way), [])) for way in product(*ways)}
    strategy = ReversedBlocks(length)
    assert strategy.number(n) == len(wanted)
    assert as_set(strategy.draw(n, 10_000, rng())) == wanted - {tuple(range(n))}
    if len(wanted) > 4:
        assert as_set(strategy.draw(n, 3, rng())) <= wanted


def test_a_single_epoch_has_no_other_order():
    for strategy in EVERY:
        assert strategy.draw(1, 10, rng()).shape == (0, 1)
        assert strategy.number(1) <= 1


@pytest.mark.parametrize("strategy", EVERY)
def test_draws_are_even(strategy):
    """Each epoch is at each date that it can be at as often as it should be."""
    n, n_trials = 12, 4000
    drawn = strategy.draw(n, n_trials, rng(1))
    few = strategy.number(n) <= n_trials
    if few:
        # All but the observed one: with it they are even.
        drawn = np.concatenate([drawn, np.arange(n)[None]])
    share = np.array([np.mean(drawn == k, axis=0) for k in range(n)])
    places = share > 0
    expected = places / places.sum(axis=0)
    tolerance = 0.05 if not isinstance(strategy, WithoutSuccessors) else 0.08
    np.testing.assert_allclose(share, expected, atol=tolerance)


@given(st.integers(1, 30), st.integers(2, 40), st.integers(0, 2**32 - 1))
def test_every_order_is_one_of_the_epochs(n, n_trials, seed):
    for strategy in EVERY:
        orders = strategy.draw(n, n_trials, rng(seed))
        assert orders.ndim == 2
        np.testing.assert_array_equal(
            np.sort(orders, axis=1), np.tile(np.arange(n), (len(orders), 1))
        )
        assert len(orders) <= max(n_trials, 1)


def test_a_block_has_epochs():
    with pytest.raises(ValueError, match="a block needs 1 epochs or more, got 0"):
        BlockOrders(0)
    with pytest.raises(ValueError, match="a block needs 2 epochs or more, got 1"):
        ReversedBlocks(1)
