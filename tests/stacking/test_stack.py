# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stack, exact and fast, against the paper's sums, and permutations."""

import math
from dataclasses import replace
from itertools import permutations
from math import exp

import numpy as np
import pytest
from astro_scc.streams.permutations import permutations_of_epochs
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chisquare

from astro_scc.stacking.stack import (
    PairMaps,
    _Stretch,
    gaussian_sum,
    number_of_permutations,
    permuted_z_score,
    random_permutations,
    stack,
)
from astro_scc.stacking.velocities import (
    VelocityGrid,
    VelocitySamples,
    baseline_pairs,
    consecutive_pairs,
)

COARSE = VelocityGrid.covering((4.0, 3.0), (0.5, 0.6))


def rng(seed=0):
    return np.random.default_rng(seed)


def random_displacements(rng, n_epochs=4, n=60, *, reach=3.0, s1=(0.2, 0.6), s2=None):
    """Matches between random epochs, of SSPs that exist, some landing on none."""
    n_ssps = rng.integers(1, 9, n_epochs)
    first = np.cumsum(n_ssps) - n_ssps
    reference = rng.integers(n_epochs, size=n)
    target = (reference + rng.integers(1, n_epochs, size=n)) % n_epochs
    landed = first[target] + rng.integers(n_ssps[target])
    return VelocitySamples(
        d1=rng.uniform(-reach, reach, n),
        d2=rng.uniform(-reach, reach, n),
        s1=rng.uniform(*s1, n),
        s2=rng.uniform(*(s2 or s1), n),
        weight=rng.uniform(0.5, 1.0, n),
        reference=reference,
        target=target,
        ssp=first[reference] + rng.integers(n_ssps[reference]),
        target_ssp=np.where(rng.random(n) < 0.2, -1, landed),
        n_ssps=n_ssps,
    )


def all_stacks(maps, orders, **kwargs):
    return np.concatenate(list(maps.stacks(orders, **kwargs)))


def literal(d, pairs, grid, order):
    """Sum over pairs of dates, SSPs and peaks, over the number of SSPs."""
    owner = np.repeat(np.arange(d.n_epochs), d.n_ssps)
    total, number = np.zeros(grid.shape), 0.0
    for a, b, interval, weight in zip(
        pairs.first, pairs.second, pairs.interval, pairs.weight, strict=True
    ):
        reference, target = order[a], order[b]
        for ssp in np.flatnonzero(owner == reference):
            number += weight
            for p in np.flatnonzero((d.ssp == ssp) & (d.target == target)):
                assert d.reference[p] == reference
                for row, v2 in enumerate(grid.v2):
                    for column, v1 in enumerate(grid.v1):
                        u1 = (v1 - d.d1[p] / interval) / (d.s1[p] / interval)
                        u2 = (v2 - d.d2[p] / interval) / (d.s2[p] / interval)
                        g = exp(-0.5 * (u1 * u1 + u2 * u2))
                        total[row, column] += weight * d.weight[p] * g
    return total / number


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
def test_is_the_papers_equation(seed, every_pair, shuffled):
    rng = np.random.default_rng(seed)
    d = random_displacements(rng, n_epochs=4, n=25)
    years = np.cumsum(rng.uniform(0.3, 1.5, 4))
    pairs = baseline_pairs(years, 0.0, 9.0) if every_pair else consecutive_pairs(years)
    order = rng.permutation(4) if shuffled else np.arange(4)
    found = stack(d, pairs, COARSE, order=order if shuffled else None)
    # Gaussians further than five sigma from the grid are left out.
    np.testing.assert_allclose(found, literal(d, pairs, COARSE, order), atol=1e-5)


def test_without_matches_or_ssps_it_is_zero():
    none = random_displacements(np.random.default_rng(4)).select(slice(0, 0))
    pairs = consecutive_pairs([0.0, 0.4, 1.0, 1.1])
    for d in (none, replace(none, n_ssps=np.zeros(4, dtype=int))):
        np.testing.assert_array_equal(stack(d, pairs, COARSE), 0.0)
        found = all_stacks(PairMaps(d, pairs, COARSE), np.array([[3, 0, 1, 2]] * 5))
        assert found.shape == (5, *COARSE.shape)
        np.testing.assert_array_equal(found, 0.0)


def test_blocks_of_matches_give_the_same_sum(monkeypatch):
    d, pairs = random_displacements(rng(6)), consecutive_pairs(0.5 * np.arange(4))
    whole = stack(d, pairs, COARSE)
    # The function hides the module of the same name.
    monkeypatch.setitem(gaussian_sum.__globals__, "BLOCK", 7)
    np.testing.assert_allclose(stack(d, pairs, COARSE), whole)


# -- the fast stacks of many orders -----------------------------------------------


GRID = VelocityGrid.covering((4.0, 3.0), (0.25, 0.3))


def check(d, pairs, orders, shift=(0.0, 0.0)):
    found = all_stacks(PairMaps(d, pairs, GRID), orders, shift=shift)
    assert found.shape == (len(orders), *GRID.shape)
    moved = replace(d, d1=d.d1 + shift[0], d2=d.d2 + shift[1])
    for one, order in zip(found, orders, strict=True):
        exact = stack(moved, pairs, GRID, order=order)
        np.testing.assert_allclose(one, exact, atol=1e-3 * exact.max())


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_uneven_dates_and_kernels_of_all_shapes(seed, every_pair):
    rng = np.random.default_rng(seed)
    d = random_displacements(rng, 5, 120, s1=(0.2, 0.8), s2=(0.4, 1.5))
    years = np.cumsum(rng.uniform(0.2, 1.5, 5))
    pairs = baseline_pairs(years, 0.0, 9.0) if every_pair else consecutive_pairs(years)
    check(d, pairs, random_permutations(5, 4, rng))
    shift = rng.uniform(-0.5, 0.5, 2)
    check(d, pairs, random_permutations(5, 4, rng), shift=shift)


def test_evenly_spaced_dates_which_share_one_interval():
    rng = np.random.default_rng(0)
    pairs = consecutive_pairs(0.7 * np.arange(6))
    d = random_displacements(rng, 6, 200)
    check(d, pairs, random_permutations(6, 9, rng))


def test_maps_made_as_needed_give_the_same_numbers(monkeypatch):
    rng = np.random.default_rng(8)
    d = random_displacements(rng, 6, 200)
    pairs = consecutive_pairs(np.cumsum(rng.uniform(0.4, 0.7, 6)))
    orders = random_permutations(6, 12, rng)
    maps = PairMaps(d, pairs, GRID)
    whole = all_stacks(maps, orders)
    for n_maps in (0, 1, 7):
        limit = n_maps * maps.map_bytes
        monkeypatch.setitem(gaussian_sum.__globals__, "MAP_BYTES", limit)
        again = all_stacks(PairMaps(d, pairs, GRID), orders)
        np.testing.assert_allclose(again, whole, atol=1e-6)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.3)])
def test_many_intervals_are_few_for_the_maps(shift):
    """A spline between intervals: hundreds of pairs of dates, 1e-3 as ever."""
    rng = np.random.default_rng(9)
    d = random_displacements(rng, 14, 900, reach=5.0, s1=(0.4, 0.8), s2=(0.5, 1.0))
    pairs = baseline_pairs(np.cumsum(rng.uniform(0.1, 0.3, 14)), 0.0, 1.2)
    stretch = _Stretch(PairMaps(d, pairs, GRID), (0.0, 0.0))
    assert len(stretch.share) < 0.7 * len(pairs)
    np.testing.assert_allclose(stretch.share.sum(axis=0), pairs.weight, rtol=1e-5)
    check(d, pairs, random_permutations(14, 4, rng), shift=shift)


@pytest.mark.parametrize("farthest", [0.5, 50.0])
def test_matches_beyond_the_largest_velocity_do_not_widen_the_maps(farthest):
    d = random_displacements(np.random.default_rng(7), reach=farthest)
    pairs = consecutive_pairs(0.5 * np.arange(4.0))
    maps = PairMaps(d, pairs, GRID)
    assert len(maps.axis1) >= 15
    assert maps.axis1[-1] <= min(4.0 * 0.5, farthest) + 5 * d.s1.max()
    check(d, pairs, np.array([[0, 1, 2, 3]]))


# -- permutations of the epochs ---------------------------------------------------


@pytest.mark.parametrize(
    ("n", "trials"), [(1, 2), (2, 2), (3, 5), (4, 2), (5, 40), (6, 99), (7, 5039)]
)
def test_few_epochs_are_gone_through_in_every_order(n, trials):
    orders = permutations_of_epochs(n, trials, rng())
    assert orders.shape == (math.factorial(n) - 1, n)
    every = {tuple(order) for order in orders.tolist()}
    assert every == set(permutations(range(n))) - {tuple(range(n))}


@pytest.mark.parametrize("n", range(1, 6))
def test_an_order_and_its_reversal_are_one(n):
    every = {min(order, order[::-1]) for order in permutations(range(n))}
    assert number_of_permutations(n) == len(every)
    # Of many there are orders without end.
    assert number_of_permutations(1000) == number_of_permutations(20) > 1e18


YEARS = [0.0, 0.4, 1.2, 1.5, 2.6]


def test_orders_are_permutations_and_all_of_them_occur_equally_often():
    orders = random_permutations(4, 6000, np.random.default_rng(0))
    assert orders.shape == (6000, 4)
    np.testing.assert_array_equal(np.sort(orders, axis=1), [[0, 1, 2, 3]] * 6000)
    kinds, counts = np.unique(orders, axis=0, return_counts=True)
    assert len(kinds) == 24
    assert [0, 1, 2, 3] in kinds.tolist()
    assert chisquare(counts).pvalue > 1e-3


@pytest.mark.parametrize("shift", [None, (0.3, 0.2)])
def test_the_z_score_is_among_the_stacks_of_the_orders(shift):
    """A shift is added in four directions in turn."""
    d, pairs, done = random_displacements(rng(), 5, 300), consecutive_pairs(YEARS), []
    grid = VelocityGrid.covering((16.0, 12.0), (0.5, 0.6))
    observed, how = stack(d, pairs, grid), {"shift": shift, "progress": done.append}
    found = permuted_z_score(observed, d, pairs, grid, 30, rng=rng(1), **how)
    assert sum(done) == 30
    moved = [d] * 4
    if shift is not None:
        moved = [replace(d, d1=d.d1 + x) for x in (0.3, -0.3)]
        moved += [replace(d, d2=d.d2 + x) for x in (0.2, -0.2)]
    orders = random_permutations(5, 30, rng(1))
    each = [stack(moved[i % 4], pairs, grid, order=o) for i, o in enumerate(orders)]
    std = np.std(each, axis=0, ddof=1)
    # Where hardly a trial has a match, a tiny coefficient is no discovery.
    assert (std < 0.01 * std.max()).any()
    z = (observed - np.mean(each, axis=0)) / np.maximum(std, 0.01 * std.max())
    np.testing.assert_allclose(found, z, atol=0.05)
    # Without any correlation it is zero.
    none = replace(d, weight=np.zeros(len(d)))
    found = permuted_z_score(observed, none, pairs, grid, 30, rng=rng(1))
    np.testing.assert_array_equal(found, 0.0)
