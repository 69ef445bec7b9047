# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""One-to-one choices, against trying everything."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from astro_scc.tracking.linking import assign


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
def test_large_choices_are_as_good_as_those_of_a_full_table(seed):
    rng = np.random.default_rng(seed)
    row, column = rng.integers(0, 60, (2, 400))
    weight = rng.uniform(0.5, 1, 400)
    table = np.zeros((60, 60))
    np.maximum.at(table, (row, column), weight)
    chosen = assign(row, column, weight)
    assert len(set(row[chosen])) == len(set(column[chosen])) == chosen.sum()
    best = table[linear_sum_assignment(table, maximize=True)].sum()
    assert weight[chosen].sum() == pytest.approx(best)


def test_nothing_is_chosen_of_nothing():
    assert len(assign([], [], [])) == 0
    assert not assign([0, 1], [0, 1], [0.0, -1.0]).any()
