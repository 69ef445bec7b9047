# Licensed under a 3-clause BSD style license - see LICENSE.rst
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.stacking.velocities import baseline_pairs, consecutive_pairs

dates = st.lists(
    st.integers(0, 4000).map(lambda day: day / 365.25), min_size=1, max_size=12
).map(sorted)


@given(dates)
def test_consecutive_pairs_are_neighbours_of_different_date(years):
    pairs = consecutive_pairs(years)
    expected = [i for i in range(len(years) - 1) if years[i + 1] > years[i]]
    assert pairs.first.tolist() == expected
    assert pairs.second.tolist() == [i + 1 for i in expected]
    assert np.all(pairs.interval > 0)
    np.testing.assert_array_equal(pairs.weight, 1.0)
    assert pairs.n_dates == len(years)
    assert len(pairs) == len(expected)


@given(dates, st.floats(0, 5), st.floats(0.01, 5))
def test_baseline_pairs_are_all_whose_separation_lies_inside(years, shortest, width):
    longest = shortest + width
    pairs = baseline_pairs(years, shortest, longest)
    found = set(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True))
    for i in range(len(years)):
        for j in range(len(years)):
            separation = years[j] - years[i]
            if separation <= 0:
                assert (i, j) not in found
            elif shortest <= separation <= longest:
                assert (i, j) in found
            elif not shortest - 2e-3 <= separation <= longest + 2e-3:
                assert (i, j) not in found
    years = np.asarray(years)
    np.testing.assert_array_equal(
        pairs.interval, years[pairs.second] - years[pairs.first]
    )
    if len(pairs):
        assert pairs.weight.mean() == pytest.approx(1.0)
        # Inverse variances: a displacement error over the interval is one of velocity.
        ratio = pairs.weight / pairs.interval**2
        np.testing.assert_allclose(ratio, ratio[0])


def test_edges_of_a_baseline_are_inside():
    years = np.array([0.0, 0.25, 0.75, 1.75])
    pairs = baseline_pairs(years, 0.5, 1.0)
    assert list(zip(pairs.first, pairs.second, strict=True)) == [(0, 2), (1, 2), (2, 3)]
    # Limits given in rounded days must not lose the pair that they mean.
    month = 30 / 365.25
    assert len(baseline_pairs([0.0, month], 0.082, 0.082)) == 1
    assert len(baseline_pairs([0.0, month], 0.084, 1.0)) == 0


def test_the_shortest_baseline_may_be_zero_but_equal_dates_make_no_pair():
    pairs = baseline_pairs([0.0, 0.0, 1.0], 0.0, 2.0)
    assert list(zip(pairs.first, pairs.second, strict=True)) == [(0, 2), (1, 2)]


@pytest.mark.parametrize(
    "limits", [(1.0, 0.5), (-0.5, 1.0), (0.0, 0.0), (np.nan, 1.0), (0.5, np.nan)]
)
def test_a_baseline_must_be_a_range(limits):
    with pytest.raises(ValueError, match="a baseline needs 0 <= shortest <= longest"):
        baseline_pairs([0.0, 1.0], *limits)


def test_images_of_an_order_and_of_many():
    pairs = consecutive_pairs([0.0, 1.0, 1.0, 3.0])
    reference, target = pairs.images([2, 0, 3, 1])
    assert reference.tolist() == [2, 3]
    assert target.tolist() == [0, 1]
    orders = np.array([[0, 1, 2, 3], [3, 2, 1, 0]])
    reference, target = pairs.images(orders)
    assert reference.tolist() == [[0, 2], [3, 1]]
    assert target.tolist() == [[1, 3], [2, 0]]


def test_dates_that_are_minutes_apart():
    minute = 1 / (365.25 * 1440)
    pairs = baseline_pairs(np.arange(10) * minute, minute, 3 * minute)
    assert len(pairs) == 9 + 8 + 7
    # Limits that are rounded to four digits lose nothing.
    rounded = baseline_pairs(np.arange(10) * minute, 1.9e-6, 5.7e-6)
    assert len(rounded) == 9 + 8 + 7
