# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Grids, pairs of dates, and orders of the epochs."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.stats import chisquare

from astro_scc.paper import baseline_pairs, consecutive_pairs, draw_orders, image_pairs
from astro_scc.paper.stack import velocity_axes

speed = st.floats(0.01, 100.0)


@given(speed, speed, st.floats(0.02, 3.0), st.floats(0.02, 3.0))
def test_covers_what_is_asked_symmetrically_with_a_point_at_zero(v1, v2, n1, n2):
    step = v1 / n1 / 20, v2 / n2 / 20
    axes = velocity_axes((v1, v2), step)
    assert [axis[-1] for axis in axes] == pytest.approx([v1, v2])
    for axis, largest in zip(axes, step, strict=True):
        assert 0 in axis
        np.testing.assert_allclose(axis, -axis[::-1])
        np.testing.assert_allclose(np.diff(axis), axis[1] - axis[0])
        assert axis[1] - axis[0] <= largest * (1 + 1e-6)


dates = st.lists(
    st.integers(0, 4000).map(lambda day: day / 365.25), min_size=1, max_size=12
).map(sorted)


@example([0.0, 0.0, 1.0], 0.0, 2.0)
@given(dates, st.floats(0, 5), st.floats(0.01, 5))
def test_baseline_pairs_are_all_whose_separation_lies_inside(years, shortest, width):
    longest = shortest + width
    pairs = baseline_pairs(years, shortest, longest)
    found = set(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True))
    for i, j in np.ndindex(len(years), len(years)):
        separation = years[j] - years[i]
        if separation <= 0:
            assert (i, j) not in found
        elif shortest <= separation <= longest:
            assert (i, j) in found
        elif not shortest - 2e-3 <= separation <= longest + 2e-3:
            assert (i, j) not in found
    years = np.asarray(years)
    interval = years[pairs.second] - years[pairs.first]
    np.testing.assert_array_equal(pairs.interval, interval)
    if len(pairs):
        assert pairs.weight.mean() == pytest.approx(1.0)
        # Inverse variances: a displacement error over the interval is one of velocity.
        ratio = pairs.weight / pairs.interval**2
        np.testing.assert_allclose(ratio, ratio[0])


def test_all_orders_of_a_short_series_are_equally_likely():
    pairs = consecutive_pairs(np.arange(4.0))
    orders = draw_orders(pairs, 6000, np.random.default_rng(0))
    assert orders.shape == (6000, 4)
    kinds, counts = np.unique(orders, axis=0, return_counts=True)
    assert len(kinds) == 24
    assert [0, 1, 2, 3] in kinds.tolist()
    assert chisquare(counts).pvalue > 1e-3


@pytest.mark.parametrize(
    ("n", "most"), [(60, 5000), (87, 5000), (180, 5000), (20, 100)]
)
def test_long_series_need_few_ordered_pairs(n, most):
    """Every order is a permutation; epochs are exchanged within groups alone."""
    pairs = consecutive_pairs(np.arange(float(n)))
    orders = draw_orders(pairs, 3000, np.random.default_rng(1), most_pairs=most)
    np.testing.assert_array_equal(np.sort(orders, axis=1), [range(n)] * 3000)
    partners = [set(orders[:, date].tolist()) for date in range(n)]
    # Whom an epoch is exchanged with are the same for all of its group.
    assert all(partners[other] == some for some in partners for other in some)
    sizes = [len(some) for some in partners]
    assert min(sizes) >= min(5, n)
    needed = image_pairs(pairs, orders)
    assert len(needed) <= max(1.5 * most, 1.5 * 25 * len(pairs))
    # Many different orders all the same.
    assert len(np.unique(orders, axis=0)) == 3000


def test_ordered_pairs_are_those_of_all_orders_and_of_the_observed_one():
    rng = np.random.default_rng(2)
    pairs = baseline_pairs(np.arange(6.0), 1.0, 2.0)
    orders = draw_orders(pairs, 3, rng)
    expected = set()
    for order in [range(6), *orders.tolist()]:
        dates = zip(pairs.first, pairs.second, strict=True)
        expected |= {(order[a], order[b]) for a, b in dates}
    assert list(map(tuple, image_pairs(pairs, orders).tolist())) == sorted(expected)
