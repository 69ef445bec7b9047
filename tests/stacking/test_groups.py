# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Two groups of sightings: differences that are there, and that are not."""

import numpy as np
import pytest
from scipy.stats import binom

from astro_scc.stacking import compare_groups, paired_p_value


def sample(rng, difference=0.0, own=0.3, n_blocks=20, each=15, unequal=1):
    """Features with speeds of their own, each seen by both groups."""
    block = np.repeat(np.arange(n_blocks), (1 + unequal) * each)
    second = np.tile(np.arange((1 + unequal) * each) < each, n_blocks)
    speed = 2 + own * rng.normal(size=n_blocks)
    v = speed[block] + difference * second + rng.normal(0, 0.2, len(block))
    return v, np.full(len(v), 0.2), np.ones(len(v)), second, block


def test_a_difference_that_is_there():
    found = compare_groups(*sample(np.random.default_rng(1), 0.3), rng=1)
    assert found.p_value < 0.01
    assert abs(found.difference - 0.3) < 3 * found.difference_err
    assert found.difference == pytest.approx(found.speed[1] - found.speed[0])
    assert found.n_blocks == 20
    # Both groups see the same features, so the difference is better known.
    assert found.difference_err < found.error.max()


def test_speed_is_the_maximum_of_the_stack():
    v, s, w, second, block = sample(np.random.default_rng(2))
    found = compare_groups(v, s, w, second, block, n_trials=9, rng=1)
    grid = np.linspace(1, 3, 4001)
    for k in (0, 1):
        own = second == bool(k)
        c = sum(np.exp(-0.5 * ((grid - a) / 0.4) ** 2) for a in v[own])
        assert found.speed[k] == pytest.approx(grid[c.argmax()], abs=2e-3)


@pytest.mark.parametrize("unequal", [1, 4])
def test_probabilities_of_no_difference(unequal):
    rng = np.random.default_rng(3)
    p = np.array(
        [
            compare_groups(*sample(rng, unequal=unequal), n_trials=99, rng=rng).p_value
            for _ in range(60)
        ]
    )
    for level in (0.05, 0.2):
        assert np.sum(p <= level) <= binom.ppf(0.999, len(p), level)


def test_groups_of_other_features_are_not_told_apart_by_few():
    # Five features of one group, five of the other: their own speeds differ.
    rng = np.random.default_rng(4)
    p = []
    for _ in range(40):
        v, s, w, _, block = sample(rng, n_blocks=10)
        p.append(compare_groups(v, s, w, block % 2 == 0, block, n_trials=99).p_value)
    assert np.mean(np.array(p) <= 0.05) < 0.25


def test_few_blocks_and_no_group():
    v, s, w, second, block = sample(np.random.default_rng(5), n_blocks=3)
    found = compare_groups(v, s, w, second, block, n_trials=99)
    assert np.isinf(found.error).all()
    assert found.p_value >= 0.1
    with pytest.raises(ValueError, match="one has none"):
        compare_groups(v, s, w, np.zeros(len(v), bool), block)


def test_probability_counts_ties():
    assert paired_p_value(1.0, [1.0, -1.0, 0.0]) == 0.75
    assert paired_p_value(0.0, [0.0] * 9) == 1.0
