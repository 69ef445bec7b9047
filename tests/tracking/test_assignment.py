# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""One-to-one choices, against trying everything."""

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.tracking import assign, assignment, groups_of


def best_total(row, column, weight):
    """Largest total weight, by trying every choice."""
    if len(row) == 0:
        return 0.0
    rest = list(range(1, len(row)))
    without = best_total(row[rest], column[rest], weight[rest])
    free = [k for k in rest if row[k] != row[0] and column[k] != column[0]]
    with_it = weight[0] + best_total(row[free], column[free], weight[free])
    return max(without, with_it)


pairs = st.lists(
    st.tuples(st.integers(0, 4), st.integers(0, 4), st.integers(-3, 8)), max_size=9
)


@settings(max_examples=60, deadline=None)
@given(pairs)
def test_it_is_the_best_choice_and_one_to_one(found):
    row, column, weight = (np.array(v, dtype=int) for v in zip(*found, strict=True)
                           ) if found else (np.empty(0, int),) * 3  # fmt: skip
    chosen = assign(row, column, weight)
    assert len(set(row[chosen])) == len(set(column[chosen])) == chosen.sum()
    assert weight[chosen].sum() == best_total(row, column, weight)
    assert np.all(weight[chosen] > 0)


@pytest.mark.parametrize("seed", range(3))
def test_large_groups_are_solved_as_small_ones_are(monkeypatch, seed):
    rng = np.random.default_rng(seed)
    row, column = rng.integers(0, 60, (2, 400))
    weight = rng.uniform(0.5, 1, 400)
    totals = []
    for limit in (0, 1000):
        monkeypatch.setattr(assignment, "DENSE", limit)
        chosen = assign(row, column, weight)
        assert len(set(row[chosen])) == len(set(column[chosen])) == chosen.sum()
        totals.append(weight[chosen].sum())
    assert totals[0] == pytest.approx(totals[1], abs=1e-9)


def test_nothing_is_chosen_of_nothing():
    assert len(assign([], [], [])) == 0
    assert len(groups_of([], [])) == 0
    assert not assign([0, 1], [0, 1], [0.0, -1.0]).any()


def test_fifty_features_in_one_group_take_less_than_a_second():
    rng = np.random.default_rng(1)
    row, column = (a.ravel() for a in np.mgrid[:50, :50])
    weight = rng.uniform(5, 6, 2500)
    assert groups_of(row, column).max() == 0
    start = time.perf_counter()
    assert assign(row, column, weight).sum() == 50
    assert time.perf_counter() - start < 1


def test_groups_are_what_pairs_connect():
    row, column = np.array([3, 3, 0, 9, 5]), np.array([1, 2, 2, 7, 8])
    found = groups_of(row, column)
    assert len({found[0], found[1], found[2]}) == 1
    assert len(set(found.tolist())) == 3
