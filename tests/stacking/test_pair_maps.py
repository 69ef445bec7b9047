# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The fast stacks of many orders against the exact one of each."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.stacking.pair_maps import PairMaps
from astro_scc.stacking.stack import stack
from astro_scc.stacking.trials import random_permutations
from astro_scc.stacking.velocities import (
    VelocityGrid,
    baseline_pairs,
    consecutive_pairs,
)

pair_maps = sys.modules[PairMaps.__module__]
GRID = VelocityGrid.covering((4.0, 3.0), (0.25, 0.3))


def all_stacks(maps, pairs, grid, orders, **kwargs):
    return np.concatenate(list(maps.stacks(pairs, grid, orders, **kwargs)))


def check(maps, pairs, grid, orders, shift=(0.0, 0.0)):
    found = all_stacks(maps, pairs, grid, orders, shift=shift)
    assert found.shape == (len(orders), *grid.shape)
    d = maps.samples
    moved = replace(d, d1=d.d1 + shift[0], d2=d.d2 + shift[1])
    for one, order in zip(found, orders, strict=True):
        exact = stack(moved, pairs, grid, order=order)
        np.testing.assert_allclose(one, exact, atol=1e-3 * exact.max())


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_uneven_dates_and_kernels_of_all_shapes(random_displacements, seed, every_pair):
    rng = np.random.default_rng(seed)
    d = random_displacements(rng, 5, 120, s1=(0.2, 0.8), s2=(0.4, 1.5))
    years = np.cumsum(rng.uniform(0.2, 1.5, 5))
    if every_pair:
        pairs = baseline_pairs(years, 0.0, 9.0)
    else:
        pairs = consecutive_pairs(years)
    maps = PairMaps.of(d, GRID.v_max, pairs.interval.max())
    check(maps, pairs, GRID, random_permutations(5, 4, rng))
    shift = rng.uniform(-0.5, 0.5, 2)
    check(maps, pairs, GRID, random_permutations(5, 4, rng), shift=shift)


def test_evenly_spaced_dates_which_share_one_interval(random_displacements):
    rng = np.random.default_rng(0)
    d = random_displacements(rng, 6, 200)
    pairs = consecutive_pairs(0.7 * np.arange(6))
    maps = PairMaps.of(d, GRID.v_max, 0.7)
    # Few orders add the maps first and stretch once; many stretch each map first.
    for n_orders in (2, 40):
        check(maps, pairs, GRID, random_permutations(6, n_orders, rng))


def test_maps_made_as_needed_give_the_same_numbers(random_displacements, monkeypatch):
    rng = np.random.default_rng(8)
    d = random_displacements(rng, 6, 200)
    pairs = consecutive_pairs(np.cumsum(rng.uniform(0.4, 0.7, 6)))
    orders = random_permutations(6, 12, rng)
    maps = PairMaps.of(d, GRID.v_max, 0.7)
    whole = all_stacks(maps, pairs, GRID, orders)
    for n_maps in (0, 1, 7):
        limit = n_maps * maps.map_bytes
        monkeypatch.setattr(f"{PairMaps.__module__}.MAP_BYTES", limit)
        again = all_stacks(replace(maps), pairs, GRID, orders)
        np.testing.assert_allclose(again, whole, atol=1e-6)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.4, -0.3)])
def test_many_intervals_are_few_for_the_maps(random_displacements, shift):
    """A spline between intervals: hundreds of pairs of dates, 1e-3 as ever."""
    rng = np.random.default_rng(9)
    d = random_displacements(rng, 14, 900, reach=5.0, s1=(0.4, 0.8), s2=(0.5, 1.0))
    pairs = baseline_pairs(np.cumsum(rng.uniform(0.1, 0.3, 14)), 0.0, 1.2)
    stretch = pair_maps._Stretch(
        PairMaps.of(d, GRID.v_max, 1.2), pairs, GRID, (0.0, 0.0)
    )
    assert len(stretch.share) < 0.7 * len(pairs)
    np.testing.assert_allclose(stretch.share.sum(axis=0), pairs.weight, rtol=1e-5)
    check(
        PairMaps.of(d, GRID.v_max, pairs.interval.max()),
        pairs,
        GRID,
        random_permutations(14, 4, rng),
        shift=shift,
    )


def test_without_matches(random_displacements):
    rng = np.random.default_rng(4)
    none = random_displacements(rng, 3, 10).select(slice(0, 0))
    pairs = consecutive_pairs([0.0, 1.0, 3.0])
    maps = PairMaps.of(none, GRID.v_max, 2.0)
    found = all_stacks(maps, pairs, GRID, random_permutations(3, 5, rng))
    assert found.shape == (5, *GRID.shape)
    np.testing.assert_array_equal(found, 0.0)


@pytest.mark.parametrize("farthest", [0.5, 50.0])
def test_matches_beyond_the_largest_velocity_do_not_widen_the_maps(
    random_displacements, farthest
):
    d = random_displacements(np.random.default_rng(7), reach=farthest)
    maps = PairMaps.of(d, (4.0, 3.0), 0.5)
    assert len(maps.axis1) >= 15
    assert maps.axis1[-1] <= min(4.0 * 0.5, farthest) + 5 * d.s1.max()
    check(maps, consecutive_pairs(0.5 * np.arange(4.0)), GRID, [[0, 1, 2, 3]])
