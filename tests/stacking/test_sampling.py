# Licensed under a 3-clause BSD style license - see LICENSE.rst
from dataclasses import replace

import numpy as np
import pytest

from astro_scc.stacking import (
    Displacements,
    VelocityGrid,
    baseline_pairs,
    component_near,
    sampling_scatter,
    stack,
)

GRID = VelocityGrid.covering(12, 0.5)


def scene(n=20):
    """A velocity of 6 from pairs of 0.5 and 1 years."""
    one = np.ones(n)
    long = np.arange(n) % 2
    d = Displacements(
        d1=3 * (1 + long), d2=0 * one, s1=one, s2=one, weight=one * (1 + 2 * long),
        reference=np.zeros(n, int), target=1 + long, ssp=np.arange(n),
        target_ssp=np.arange(n), n_ssps=np.array([n, n, n]),
    )  # fmt: skip
    pairs = baseline_pairs([0, 0.5, 1.0], 0.4, 1.1)
    return d, pairs, component_near(stack(d, pairs, GRID), GRID, (10, 10), 6, 0)


def test_the_error_over_the_intervals():
    d, pairs, peak = scene()
    # Pairs weigh with the square of their interval.
    rate = np.average([2, 1], weights=[0.25 * 1, 1 * 3])
    found = sampling_scatter(d, pairs, peak, GRID, 0.02)
    np.testing.assert_allclose(found, (0.02 * rate) ** 2 * np.eye(2), rtol=1e-6)


def test_nothing_without_a_fit_or_without_weight():
    d, pairs, peak = scene()
    unfitted = replace(peak, fitted=False)
    assert not unfitted.fitted
    assert not sampling_scatter(d, pairs, unfitted, GRID, 0.02).any()
    weightless = replace(d, weight=0 * d.weight)
    assert not sampling_scatter(weightless, pairs, peak, GRID, 0.02).any()


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_twice_the_error_is_four_times_the_variance(factor):
    d, pairs, peak = scene()
    one, other = (
        sampling_scatter(d, pairs, peak, GRID, e) for e in (0.02, 0.02 * factor)
    )
    np.testing.assert_allclose(other, factor**2 * one)
