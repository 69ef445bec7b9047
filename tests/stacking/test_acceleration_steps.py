# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speed and acceleration against a general minimiser and a jackknife by hand."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import t

from astro_scc.stacking import Sightings, fit_acceleration, flow_speed
from astro_scc.stacking.acceleration import flow_blocks


def sightings(v, x, time, interval, *, sigma=0.2, across=0.0, weight=1.0):
    n = len(x)
    one, zero = np.ones(n), np.zeros((n, 2))
    return Sightings(
        v1=v, v2=across * one, s1=sigma / interval, s2=sigma / interval,
        weight=weight * one, time=time, interval=interval, middle=zero,
        velocity=zero, sigma=sigma * one, first=one.astype(int), ssp=np.arange(n),
        match=np.arange(n),
    )  # fmt: skip


@pytest.fixture
def flow():
    rng = np.random.default_rng(3)
    n = 240
    x, time = rng.uniform(2, 10, n), rng.uniform(0, 9, n)
    interval = rng.uniform(0.5, 1.5, n)
    v = flow_speed(x, 2.0, 0.15, 6.0) + rng.normal(0, 0.2 / interval)
    across = rng.normal(0, 0.25, n)
    weight = rng.uniform(0.5, 1.0, n)
    return sightings(v, x, time, interval, across=across, weight=weight), x


def highest(seen, x, centre, start, keep):
    """The maximum of the stack of some sightings, by a general minimiser."""
    w = seen.weight * seen.interval**2 * np.exp(-0.5 * (seen.v2 / seen.s2) ** 2)
    w = np.where((np.abs(seen.v2) <= 5 * seen.s2) & keep, w, 0.0)

    def lost(place):
        z = (seen.v1 - flow_speed(x, *place, centre)) / (4 * seen.s1)
        return -np.sum(w * np.exp(-0.5 * z**2))

    options = {"xatol": 1e-8, "fatol": 1e-12, "maxiter": 2000}
    return minimize(lost, start, method="Nelder-Mead", options=options).x


def test_maximum_and_jackknife(flow):
    seen, x = flow
    found = fit_acceleration(seen, x, 4.0, centre=6.0)
    everything = np.ones(len(x), bool)
    best = highest(seen, x, 6.0, [2.0, 0.1], everything)
    assert found.speed == pytest.approx(best[0], abs=1e-4)
    assert found.acceleration == pytest.approx(best[1], abs=1e-4)
    blocks = flow_blocks(seen, x, found.speed)
    others = np.array(
        [highest(seen, x, 6.0, best, blocks != k) for k in np.unique(blocks)]
    )
    n = len(others)
    assert found.n_blocks == n
    covariance = (n - 1) * np.cov(others.T, bias=True)
    np.testing.assert_allclose(found.covariance, covariance, rtol=0.02, atol=1e-7)
    sigma = np.sqrt(covariance[1, 1])
    p = 2 * t.sf(abs(best[1]) / sigma, n - 2)
    assert found.p_value == pytest.approx(p, rel=0.05)


def test_the_grid_is_fine_enough(flow):
    seen, x = flow
    found = fit_acceleration(seen, x, 4.0)
    weight = seen.weight * seen.interval**2
    assert found.centre == pytest.approx(np.average(x, weights=weight))
    error, reach = np.median(seen.s1), np.abs(x - found.centre).max()
    assert found.speeds[0] == 0
    assert found.speeds[-1] == 4.0
    assert 0.2 * error < np.diff(found.speeds).max() <= 0.25 * error * (1 + 1e-9)
    # From rest at the centre to 0.7 of the largest speed at the end.
    largest = found.accelerations.max()
    assert flow_speed(reach, 0, largest, 0) == pytest.approx(4.0 / np.sqrt(2))
    np.testing.assert_allclose(found.accelerations, -found.accelerations[::-1])
    step = np.diff(found.accelerations).max() * reach / (0.5 * 4.0)
    assert 0.2 * error < step <= 0.25 * error * (1 + 1e-9)
    assert found.stack.shape == (len(found.accelerations), len(found.speeds))
    given = fit_acceleration(seen, x, 4.0, a_max=0.3)
    assert given.accelerations.max() == pytest.approx(0.3)
    # Never fewer than ten steps on either side.
    assert len(fit_acceleration(seen, x, 4.0, a_max=1e-4).accelerations) == 21


def test_the_coefficient_is_what_acceleration_gains(flow):
    seen, x = flow
    found = fit_acceleration(seen, x, 4.0, centre=6.0)
    still = found.stack[np.abs(found.accelerations).argmin()].max()
    assert found.coefficient == pytest.approx(found.stack.max() / still)
    assert found.coefficient > 1
    none = fit_acceleration(seen, x, 4.0, a_max=1e-6, centre=6.0)
    assert none.coefficient == pytest.approx(1, abs=1e-3)


def test_the_stack_is_that_of_every_sighting(flow):
    seen, x = flow
    found = fit_acceleration(seen, x, 4.0, a_max=0.4, centre=6.0)
    weight = seen.weight * seen.interval**2
    own = weight * np.exp(-0.5 * (seen.v2 / seen.s2) ** 2)
    own = np.where(np.abs(seen.v2) <= 5 * seen.s2, own, 0)
    for row in (2, len(found.accelerations) // 2, -4):
        for column in (8, 20, 40):
            model = flow_speed(x, found.speeds[column], found.accelerations[row], 6.0)
            z = (seen.v1 - model) / (4 * seen.s1)
            expected = np.sum(own * np.exp(-0.5 * z**2)) / weight.sum()
            assert found.stack[row, column] == pytest.approx(expected, rel=0.01)


def test_a_maximum_at_the_edge_has_no_error(flow):
    seen, x = flow
    found = fit_acceleration(seen, x, 4.0, a_max=0.02, centre=6.0)
    assert found.n_blocks > 4
    assert np.isinf(found.covariance).all()
    assert found.p_value == 1


@pytest.mark.parametrize("speed", [0.0, 1.7])
def test_blocks_are_two_beams_long(speed):
    rng = np.random.default_rng(5)
    time, start = rng.uniform(0, 5, 300), rng.uniform(0, 12, 300)
    seen = sightings(start, start + speed * time, time, np.ones(300))
    blocks = flow_blocks(seen, start + speed * time, speed)
    order = np.argsort(start)
    assert np.all(np.diff(blocks[order]) >= 0)
    lengths = [np.ptp(start[blocks == k]) for k in np.unique(blocks)]
    # Ten standard errors of a displacement.
    assert max(lengths) <= 2.0 + 1e-9
    assert len(lengths) in (6, 7)
