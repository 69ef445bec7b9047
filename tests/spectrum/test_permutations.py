# Licensed under a 3-clause BSD style license - see LICENSE.rst
from dataclasses import replace

import hypothesis.extra.numpy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.spectrum import permutations
from astro_scc.spectrum.diagram import correlate


def p_of(flow, seed=0, **how):
    rng = np.random.default_rng(seed)
    return permutations.permutation_test([correlate(flow)], rng=rng, **how)


def test_innovations_have_no_memory():
    rng = np.random.default_rng(1)
    years = np.cumsum(rng.uniform(0.1, 0.5, 25))
    decay = np.exp(-np.abs(years[:, None] - years) / 0.8)
    data = np.linalg.cholesky(decay) @ rng.normal(size=(25, 4000))
    data -= data.mean(axis=0)
    time, white, factor = permutations.memory_of(years, data @ data.T / 4000)
    assert time == pytest.approx(0.8, rel=0.3)
    assert white <= 0.1
    left = np.linalg.solve(factor, permutations.difference_matrix(25)) @ data
    covariance = left @ left.T / 4000
    assert np.allclose(covariance, np.eye(24) * covariance[0, 0], atol=0.15)


def test_no_epoch_outweighs_others(moving_flow):
    flow = moving_flow([1.0])
    bright = replace(flow, values=flow.values * np.linspace(1, 9, 15)[:, None, None])
    _, odd, *_ = permutations._innovations(correlate(bright), slice(None))
    power = np.sqrt((odd**2).sum(axis=(1, 2)))
    assert power.max() < 2.5 * power.min()


def test_orders_begin_with_the_observed_one():
    rng = np.random.default_rng(2)
    for gaps, number in ([1] * 4, 24), ([1e-3, 1] * 3, 36), ([1] * 9, 1001):
        gaps = np.array(gaps)
        orders = permutations.orders_of(gaps, 1000, rng)
        assert orders.shape == (number, len(gaps))
        assert orders[0].tolist() == list(range(len(gaps)))
        assert (gaps[orders] == gaps).all()


@given(hypothesis.extra.numpy.arrays(float, (7, 3), elements=st.floats(-9, 9)))
def test_the_observed_order_is_one_of_equals(scores):
    """Whichever order is observed, its z is the same: p-values are exact."""
    swapped = permutations.standardised(np.roll(scores, 3, axis=0))
    assert np.allclose(swapped, np.roll(permutations.standardised(scores), 3, axis=0))


def test_speeds_that_are_promised_are_tested():
    years = np.array([0.0, 0.1, 0.3, 0.4, 1.0])
    speed = permutations.speeds_tested(years)
    assert speed[0] == pytest.approx(0.5)
    assert speed[-1] >= 2 / np.quantile(np.diff(years), 0.25)
    pairs = permutations.speeds_tested(np.sort([*years, *(years + 1e-5)]))
    assert pairs == pytest.approx(speed, rel=1e-3)
    assert permutations.speeds_tested(years, 50.0)[-1] == 50.0
    limited = permutations.speeds_tested(years, None, (0.25, 1.0))
    assert 2 / 0.6 <= limited[-1] < speed[-1]
    # No interval between consecutive dates, but one between others.
    assert np.isfinite(permutations.fastest_speed(years, (0.25, 0.35)))


@pytest.mark.parametrize("speed", [0.5, 2.0, -1.0])
def test_motion_is_found_with_its_sign(moving_flow, speed):
    found = p_of(moving_flow([speed]), inward=1.0, n_trials=200)
    assert found.p_global == pytest.approx(1 / 201)
    best = found.speed[found.best[1]]
    assert best == pytest.approx(speed, rel=0.3)
    assert found.p_smallest == 1 / 201
    if speed > 0:
        assert p_of(moving_flow([speed]), inward=0.0, n_trials=99).speed.min() > 0


def test_units_of_time_do_not_matter(moving_flow):
    flow = moving_flow([0.5], n_epochs=8)
    found = p_of(flow, n_trials=99)
    for unit in (1e-8, 1e4):
        other = p_of(replace(flow, years=flow.years * unit), n_trials=99)
        assert other.p_global == found.p_global
        assert np.allclose(other.z, found.z, atol=1e-4)
        assert np.allclose(other.speed * unit, found.speed)


def test_a_single_stream_has_none_beside_it(moving_flow):
    one = p_of(moving_flow([0.4], n_patterns=30), n_trials=200)
    assert one.beside(one.speed[one.best[1]], 0.1)[1] > 0.01
    speed, p = one.beside(0.4, np.inf)
    assert np.isnan(speed)
    assert p == 1.0


def test_static_flows_with_a_memory_do_not_move(moving_flow):
    """A broken null fails here: permuted epochs find motion in half of them."""
    p = [
        p_of(moving_flow([0.0], n_epochs=12, seed=s, memory=0.8), n_trials=99).p_global
        for s in range(100, 140)
    ]
    assert np.sum(np.array(p) <= 0.1) <= 9
    assert np.median(p) > 0.3
