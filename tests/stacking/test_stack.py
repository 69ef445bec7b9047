# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stack, exact and fast, against the paper's sums, and permutations."""

import math
from dataclasses import replace
from itertools import permutations
from math import exp

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chisquare

from astro_scc.stacking.stack import (
    PairMaps,
    _Stretch,
    gaussian_sum,
    number_of_permutations,
    number_of_ssps,
    permute_stacks,
    random_permutations,
    sample_velocities,
    stack,
)
from astro_scc.stacking.velocities import (
    VelocityGrid,
    baseline_pairs,
    consecutive_pairs,
)
from astro_scc.streams.permutations import permutations_of_epochs

COARSE = VelocityGrid.covering((4.0, 3.0), (0.5, 0.6))


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
def test_is_the_papers_equation(random_displacements, seed, every_pair, shuffled):
    rng = np.random.default_rng(seed)
    d = random_displacements(rng, n_epochs=4, n=25)
    years = np.cumsum(rng.uniform(0.3, 1.5, 4))
    pairs = baseline_pairs(years, 0.0, 9.0) if every_pair else consecutive_pairs(years)
    order = rng.permutation(4) if shuffled else np.arange(4)
    found = stack(d, pairs, COARSE, order=order if shuffled else None)
    # Gaussians further than five sigma from the grid are left out.
    np.testing.assert_allclose(found, literal(d, pairs, COARSE, order), atol=1e-5)


def test_number_of_ssps_of_many_orders(random_displacements):
    d = random_displacements(np.random.default_rng(3))
    pairs = consecutive_pairs([0.0, 0.4, 1.0, 1.1])
    orders = np.array([[0, 1, 2, 3], [3, 1, 0, 2]])
    expected = [d.n_ssps[[0, 1, 2]].sum(), d.n_ssps[[3, 1, 0]].sum()]
    np.testing.assert_array_equal(number_of_ssps(d, pairs, orders), expected)
    assert number_of_ssps(d, pairs) == expected[0]


def test_without_matches_or_ssps_it_is_zero(random_displacements):
    none = random_displacements(np.random.default_rng(4)).select(slice(0, 0))
    pairs = consecutive_pairs([0.0, 0.4, 1.0, 1.1])
    for d in (none, replace(none, n_ssps=np.zeros(4, dtype=int))):
        np.testing.assert_array_equal(stack(d, pairs, COARSE), 0.0)
        found = all_stacks(PairMaps(d, pairs, COARSE), np.array([[3, 0, 1, 2]] * 5))
        assert found.shape == (5, *COARSE.shape)
        np.testing.assert_array_equal(found, 0.0)


def test_velocities_are_displacements_over_intervals(random_displacements):
    d = random_displacements(np.random.default_rng(5), n_epochs=3)
    pairs = baseline_pairs([0.0, 0.5, 2.0], 0.0, 3.0)
    order = [2, 0, 1]
    index, v1, v2, s1, s2, weight = sample_velocities(d, pairs, order)
    date = np.argsort(order)
    years = np.array([0.0, 0.5, 2.0])
    forward = date[d.target] > date[d.reference]
    np.testing.assert_array_equal(index, np.flatnonzero(forward))
    interval = years[date[d.target[index]]] - years[date[d.reference[index]]]
    for rate, value in ((v1, d.d1), (v2, d.d2), (s1, d.s1), (s2, d.s2)):
        np.testing.assert_allclose(rate, value[index] / interval)
    ratio = weight / d.weight[index] / interval**2
    np.testing.assert_allclose(ratio, ratio[0])


def test_gaussian_sum_in_blocks_is_the_same(monkeypatch):
    rng = np.random.default_rng(6)
    columns = [*rng.normal(size=(2, 50)), *rng.uniform(0.2, 2, (3, 50))]
    axes = np.linspace(-3, 3, 12), np.linspace(-2, 2, 9)
    whole = gaussian_sum(*columns, *axes)
    expected = sum(
        w * np.exp(-0.5 * (((axes[0] - x) / sx) ** 2
                           + ((axes[1][:, None] - y) / sy) ** 2))
        for x, y, sx, sy, w in zip(*columns, strict=True)
    )  # fmt: skip
    np.testing.assert_allclose(whole, expected)
    # The function hides the module of the same name.
    monkeypatch.setitem(gaussian_sum.__globals__, "BLOCK", 7)
    np.testing.assert_allclose(gaussian_sum(*columns, *axes), whole)
    assert gaussian_sum(*np.empty((5, 0)), *axes).shape == (9, 12)


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
def test_uneven_dates_and_kernels_of_all_shapes(random_displacements, seed, every_pair):
    rng = np.random.default_rng(seed)
    d = random_displacements(rng, 5, 120, s1=(0.2, 0.8), s2=(0.4, 1.5))
    years = np.cumsum(rng.uniform(0.2, 1.5, 5))
    pairs = baseline_pairs(years, 0.0, 9.0) if every_pair else consecutive_pairs(years)
    check(d, pairs, random_permutations(5, 4, rng))
    shift = rng.uniform(-0.5, 0.5, 2)
    check(d, pairs, random_permutations(5, 4, rng), shift=shift)


def test_evenly_spaced_dates_which_share_one_interval(random_displacements):
    rng = np.random.default_rng(0)
    pairs = consecutive_pairs(0.7 * np.arange(6))
    d = random_displacements(rng, 6, 200)
    check(d, pairs, random_permutations(6, 9, rng))


def test_maps_made_as_needed_give_the_same_numbers(random_displacements, monkeypatch):
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
def test_many_intervals_are_few_for_the_maps(random_displacements, shift):
    """A spline between intervals: hundreds of pairs of dates, 1e-3 as ever."""
    rng = np.random.default_rng(9)
    d = random_displacements(rng, 14, 900, reach=5.0, s1=(0.4, 0.8), s2=(0.5, 1.0))
    pairs = baseline_pairs(np.cumsum(rng.uniform(0.1, 0.3, 14)), 0.0, 1.2)
    stretch = _Stretch(PairMaps(d, pairs, GRID), (0.0, 0.0))
    assert len(stretch.share) < 0.7 * len(pairs)
    np.testing.assert_allclose(stretch.share.sum(axis=0), pairs.weight, rtol=1e-5)
    check(d, pairs, random_permutations(14, 4, rng), shift=shift)


@pytest.mark.parametrize("farthest", [0.5, 50.0])
def test_matches_beyond_the_largest_velocity_do_not_widen_the_maps(
    random_displacements, farthest
):
    d = random_displacements(np.random.default_rng(7), reach=farthest)
    pairs = consecutive_pairs(0.5 * np.arange(4.0))
    maps = PairMaps(d, pairs, GRID)
    assert len(maps.axis1) >= 15
    assert maps.axis1[-1] <= min(4.0 * 0.5, farthest) + 5 * d.s1.max()
    check(d, pairs, np.array([[0, 1, 2, 3]]))


# -- permutations of the epochs ---------------------------------------------------


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
    # Of many there are orders without end.
    assert number_of_permutations(1000) == number_of_permutations(20) > 1e18


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


YEARS = [0.0, 0.4, 1.2, 1.5, 2.6]


@pytest.fixture(scope="module")
def d(random_displacements):
    return random_displacements(np.random.default_rng(0), 5, 300)


@pytest.fixture(scope="module")
def pairs():
    return consecutive_pairs(YEARS)


def run(d, pairs, **kwargs):
    rng = np.random.default_rng(1)
    return permute_stacks(d, pairs, GRID, 30, rng=rng, **kwargs)


def test_orders_are_permutations_and_all_of_them_occur_equally_often():
    orders = random_permutations(4, 6000, np.random.default_rng(0))
    assert orders.shape == (6000, 4)
    np.testing.assert_array_equal(np.sort(orders, axis=1), [[0, 1, 2, 3]] * 6000)
    kinds, counts = np.unique(orders, axis=0, return_counts=True)
    assert len(kinds) == 24
    assert [0, 1, 2, 3] in kinds.tolist()
    assert chisquare(counts).pvalue > 1e-3


@pytest.mark.parametrize("shift", [None, (0.3, 0.2)])
def test_mean_and_std_are_those_of_the_stacks_of_the_orders(d, pairs, shift):
    """A shift is added in four directions in turn."""
    done = []
    found = run(d, pairs, shift=shift, progress=done.append)
    assert sum(done) == 30
    moved = [d] * 4
    if shift is not None:
        moved = [replace(d, d1=d.d1 + x) for x in (0.3, -0.3)]
        moved += [replace(d, d2=d.d2 + x) for x in (0.2, -0.2)]
    orders = random_permutations(5, 30, np.random.default_rng(1))
    each = [stack(moved[i % 4], pairs, GRID, order=o) for i, o in enumerate(orders)]
    mean, std = np.mean(each, axis=0), np.std(each, axis=0, ddof=1)
    tolerance = 1e-3 * np.max(each)
    np.testing.assert_allclose(found.mean, mean, atol=tolerance)
    np.testing.assert_allclose(found.std, std, atol=tolerance)
    observed = stack(d, pairs, GRID)
    z = (observed - mean) / std
    np.testing.assert_allclose(found.z_score(observed), z, atol=0.02)


def test_small_standard_deviations_are_floored(d, pairs):
    """Where hardly a trial has a match, a tiny coefficient is no discovery."""
    found = run(d, pairs)
    std = found.std.copy()
    std[0, 0] = 1e-9
    found = replace(found, std=std)
    z = found.z_score(found.mean + std.max())
    assert z[0, 0] == pytest.approx(100.0)
    assert z.max() == pytest.approx(100.0)
    # Without any correlation it is zero.
    found = run(replace(d, weight=np.zeros(len(d))), pairs)
    np.testing.assert_array_equal(found.std, 0.0)
    np.testing.assert_array_equal(found.z_score(np.ones(GRID.shape)), 0.0)
