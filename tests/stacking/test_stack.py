# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stack against the paper's equations, written out as sums."""

from dataclasses import replace
from math import exp

import numpy as np
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
