# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stack against the paper's equations, written out as sums."""

from dataclasses import replace
from math import exp

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.stacking.stack import (
    gaussian_sum,
    number_of_ssps,
    sample_velocities,
    stack,
)
from astro_scc.stacking.velocities import (
    VelocityGrid,
    VelocitySamples,
    baseline_pairs,
    consecutive_pairs,
)

GRID = VelocityGrid.covering((4.0, 3.0), (0.5, 0.6))


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
    if every_pair:
        pairs = baseline_pairs(years, 0.0, 9.0)
    else:
        pairs = consecutive_pairs(years)
    order = rng.permutation(4) if shuffled else np.arange(4)
    found = stack(d, pairs, GRID, order=order if shuffled else None)
    # Gaussians further than five sigma from the grid are left out.
    np.testing.assert_allclose(found, literal(d, pairs, GRID, order), atol=1e-5)


def test_one_match_is_a_gaussian_of_unit_height_at_its_velocity(clump):
    d = clump(1, velocity=(1.0, -0.6), interval=0.5, s=(0.3, 0.4))
    found = stack(d, consecutive_pairs([2000.0, 2000.5]), GRID)
    u1 = (GRID.v1 - 1.0) / 0.6
    u2 = (GRID.v2 + 0.6) / 0.8
    np.testing.assert_allclose(
        found, np.exp(-0.5 * (u1**2 + u2[:, None] ** 2)), atol=1e-12
    )


def test_is_linear_in_the_weights(random_displacements):
    rng = np.random.default_rng(0)
    d = random_displacements(rng)
    pairs = consecutive_pairs([0.0, 0.4, 1.0, 1.1])
    whole = stack(d, pairs, GRID)
    np.testing.assert_allclose(
        stack(replace(d, weight=3 * d.weight), pairs, GRID), 3 * whole
    )
    half = np.arange(len(d)) % 2 == 0
    np.testing.assert_allclose(
        stack(d.select(half), pairs, GRID) + stack(d.select(~half), pairs, GRID), whole
    )


def test_only_the_ratio_of_pair_weights_matters(random_displacements):
    d = random_displacements(np.random.default_rng(1))
    pairs = baseline_pairs([0.0, 0.4, 1.0, 1.1], 0.1, 2.0)
    doubled = replace(pairs, weight=2 * pairs.weight)
    np.testing.assert_allclose(stack(d, doubled, GRID), stack(d, pairs, GRID))


def test_reversed_order_of_evenly_spaced_dates_mirrors_reversed_displacements(
    random_displacements,
):
    d = random_displacements(np.random.default_rng(2))
    pairs = consecutive_pairs(np.arange(4.0))
    mirrored = replace(d, d1=-d.d1, d2=-d.d2)
    np.testing.assert_allclose(
        stack(mirrored, pairs, GRID, order=[3, 2, 1, 0]),
        stack(d, pairs, GRID, order=[3, 2, 1, 0])[::-1, ::-1],
        atol=1e-12,
    )


def test_ssps_without_a_match_count_in_the_denominator(clump):
    d = clump(4)
    pairs = consecutive_pairs([0.0, 0.5])
    more = replace(d, n_ssps=np.array([40, 4]))
    np.testing.assert_allclose(stack(more, pairs, GRID), stack(d, pairs, GRID) / 10)
    # The last epoch is no reference epoch.
    more = replace(d, n_ssps=np.array([4, 40]))
    np.testing.assert_array_equal(stack(more, pairs, GRID), stack(d, pairs, GRID))


def test_number_of_ssps_of_many_orders(random_displacements):
    d = random_displacements(np.random.default_rng(3))
    pairs = consecutive_pairs([0.0, 0.4, 1.0, 1.1])
    orders = np.array([[0, 1, 2, 3], [3, 1, 0, 2]])
    expected = [d.n_ssps[[0, 1, 2]].sum(), d.n_ssps[[3, 1, 0]].sum()]
    np.testing.assert_array_equal(number_of_ssps(d, pairs, orders), expected)
    assert number_of_ssps(d, pairs) == expected[0]


def test_orders_without_ssps_have_a_stack_of_zero(random_displacements):
    d = random_displacements(np.random.default_rng(3))
    pairs = consecutive_pairs([0.0, 0.4, 1.0, 1.1])
    nothing = replace(d, n_ssps=np.zeros(4, dtype=int))
    with np.errstate(all="raise", under="ignore"):
        np.testing.assert_array_equal(stack(nothing, pairs, GRID), 0.0)


def test_without_matches_or_ssps_it_is_zero(random_displacements):
    none = random_displacements(np.random.default_rng(4)).select(slice(0, 0))
    pairs = consecutive_pairs([0.0, 0.4, 1.0, 1.1])
    assert len(none) == 0
    np.testing.assert_array_equal(stack(none, pairs, GRID), 0.0)
    nothing = replace(none, n_ssps=np.zeros(4, dtype=int))
    np.testing.assert_array_equal(stack(nothing, pairs, GRID), 0.0)


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
    np.testing.assert_allclose(weight / d.weight[index] / interval**2, weight[0]
                               / d.weight[index[0]] / interval[0] ** 2)  # fmt: skip


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


def test_selections_of_displacements_keep_the_number_of_ssps(random_displacements):
    d = random_displacements(np.random.default_rng(7))
    keep = d.d1 > 0
    some = d.select(keep)
    assert isinstance(some, VelocitySamples)
    assert len(some) == keep.sum()
    np.testing.assert_array_equal(some.ssp, d.ssp[keep])
    np.testing.assert_array_equal(some.n_ssps, d.n_ssps)
    assert some.n_epochs == d.n_epochs == 4
    assert d.select([3, 1]).target.tolist() == [d.target[3], d.target[1]]


def test_mean_weights_of_a_baseline_leave_identical_matches_as_they_are(clump):
    """A pair of weight one: the stack is the mean coefficient at the velocity."""
    d = clump(5, velocity=(1.0, 0.0), interval=0.5)
    scc = stack(d, baseline_pairs([0.0, 0.5], 0.4, 0.6), GRID)
    assert scc.max() == pytest.approx(1.0)
