# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speed, acceleration and lags of flows that are made up, without images."""

import numpy as np
import pytest
from scipy.stats import binom

from astro_scc.stacking import Sightings, fit_acceleration, flow_speed, lag_test
from astro_scc.stacking.acceleration import flow_blocks

LENGTH, YEARS = 10.0, 12.0


def sightings(x, v, time, interval, sigma=0.15, ssp=None, across=0.0):
    n = len(x)
    one = np.ones(n)
    return Sightings(
        v1=v, v2=across * one, s1=sigma / interval, s2=sigma / interval, weight=one,
        time=time, interval=interval, middle=np.stack([x, 0 * x], axis=1),
        velocity=np.stack([v, 0 * v], axis=1), sigma=sigma * one,
        first=one.astype(int), ssp=np.arange(n) if ssp is None else ssp,
        match=np.arange(n),
    )  # fmt: skip


def flow(rng, speed=2.0, acceleration=0.0, own=0.0, n=40, noise=0.15):
    """Features ejected at random times, each seen wherever it is at 30 dates."""
    dates = np.sort(rng.uniform(0, YEARS, 30))
    x, v, time, interval = [], [], [], []
    for start in rng.uniform(-LENGTH / 2, YEARS, n):
        factor = 1 + own * rng.normal()
        place, at = 0.5, start
        track = []
        while place < LENGTH and len(track) < 2000:
            here = factor * flow_speed(place, speed, acceleration, LENGTH / 2)
            track.append((at, place))
            place, at = place + 0.02 * max(here, 0.1), at + 0.02
        at, place = np.array(track).T
        seen = np.flatnonzero((dates > at[0]) & (dates < at[-1]))
        for a, b in zip(seen[:-1], seen[1:], strict=True):
            lag = dates[b] - dates[a]
            d = np.diff(np.interp(dates[[a, b]], at, place))[0]
            x.append(np.interp(dates[[a, b]].mean(), at, place))
            v.append((d + rng.normal(0, noise)) / lag)
            time.append(dates[[a, b]].mean())
            interval.append(lag)
    return sightings(*map(np.array, (x, v, time, interval)))


def place(seen):
    return seen.middle[:, 0]


def test_flow_speed():
    # From rest, v^2 = 2 a x.
    np.testing.assert_allclose(flow_speed(np.array([0, 2, 8]), 0, 1.0, 0), [0, 2, 4])
    assert flow_speed(-5.0, 1.0, 1.0, 0.0) == 0


def test_stack_against_a_double_loop():
    rng = np.random.default_rng(2)
    seen = flow(rng, n=6)
    found = fit_acceleration(seen, place(seen), 4.0, a_max=0.3, centre=5.0)
    weight = seen.weight * seen.interval**2
    for row, column in ((3, 10), (10, 20), (17, 5)):
        model = flow_speed(
            place(seen), found.speeds[column], found.accelerations[row], 5.0
        )
        z = (seen.v1 - model) / (4 * seen.s1)
        expected = np.sum(weight * np.exp(-0.5 * z**2))
        assert found.stack[row, column] == pytest.approx(
            expected / weight.sum(), rel=0.03, abs=1e-4
        )


def test_a_known_acceleration_within_its_error():
    rng = np.random.default_rng(5)
    off = []
    for true in (-0.1, 0.0, 0.15, 0.25):
        seen = flow(rng, acceleration=true)
        found = fit_acceleration(seen, place(seen), 4.0, centre=5.0)
        error = np.sqrt(np.diag(found.covariance))
        off.append(([found.speed, found.acceleration] - np.array([2.0, true])) / error)
        assert found.n_blocks > 10
        assert error[1] < 0.1
        if true == 0.25:
            assert found.p_value < 0.01
            assert found.coefficient > 1.05
    assert np.abs(off).max() < 4
    assert np.sqrt(np.mean(np.square(off))) < 2


def false_alarms(n, own, rng):
    p = []
    for _ in range(n):
        seen = flow(rng, own=own, n=25)
        p.append(fit_acceleration(seen, place(seen), 4.0).p_value)
    return np.array(p)


@pytest.mark.parametrize("own", [0.0, 0.1])
def test_no_acceleration_of_features_with_speeds_of_their_own(own):
    p = false_alarms(12, own, np.random.default_rng(11))
    # Nominal 5%: seldom more than three of twelve.
    assert np.sum(p <= 0.05) <= binom.ppf(0.995, 12, 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("own", [0.0, 0.1, 0.2])
def test_calibration_of_the_probability(own):
    n = 200
    p = false_alarms(n, own, np.random.default_rng(12))
    for level in (0.05, 0.2):
        assert np.sum(p <= level) <= binom.ppf(0.999, n, 1.5 * level)


def test_too_few():
    x = np.linspace(1, 2, 5)
    with pytest.raises(ValueError, match="ten sightings at different distances"):
        fit_acceleration(sightings(x, x, x, x), x, 3.0)
    same = np.ones(20)
    with pytest.raises(ValueError, match="at different distances"):
        fit_acceleration(sightings(same, same, same, same), same, 3.0)


def test_no_error_without_blocks():
    rng = np.random.default_rng(1)
    n = 50
    x = rng.uniform(0, 1, n)
    seen = sightings(x, np.full(n, 1.0), x, np.full(n, 0.5))
    found = fit_acceleration(seen, x, 3.0)
    assert found.p_value == 1
    assert np.isinf(found.covariance).all()


def test_blocks_follow_the_flow():
    time = np.linspace(0, 5, 20)
    x = 1.0 + 2.0 * time
    seen = sightings(x, np.full(20, 2.0), time, np.ones(20))
    assert len(np.unique(flow_blocks(seen, x, 2.0))) == 1
    assert len(np.unique(flow_blocks(seen, x, 0.0))) > 4


def many_lags(rng, displacement, n=800):
    """Sightings of 40 features at lags of 0.4 to 2 years."""
    lag = rng.uniform(0.4, 2.0, n)
    when = rng.uniform(0, 15, n)
    d = displacement(lag) + rng.normal(0, 0.1, n)
    x = rng.uniform(0, 10, n)
    return sightings(x, d / lag, when, lag)


def test_motion_grows_with_the_lag():
    seen = many_lags(np.random.default_rng(4), lambda lag: 1.5 * lag)
    test = lag_test(seen, 1.5, 0.0, n_groups=4)
    np.testing.assert_allclose(test.displacement, 1.5 * test.lag, atol=0.06)
    assert abs(test.speed - 1.5) < 4 * test.speed_err
    assert abs(test.offset) < 3 * test.offset_err
    assert test.p_offset > 0.01
    assert np.all(test.coefficient > 0.5)
    assert test.n_sightings.sum() > 600


def test_an_alias_does_not():
    seen = many_lags(np.random.default_rng(4), lambda lag: 1.5 + 0 * lag)
    test = lag_test(seen, 1.5, 0.0, n_groups=4)
    assert test.p_offset < 1e-4
    assert test.offset == pytest.approx(1.5, abs=0.2)


def test_lags_of_too_little():
    rng = np.random.default_rng(4)
    seen = many_lags(rng, lambda lag: 1.5 * lag)
    with pytest.raises(ValueError, match="stands still"):
        lag_test(seen, 0.0, 0.0)
    with pytest.raises(ValueError, match="got none"):
        lag_test(seen.select(np.zeros(len(seen), bool)), 1.0, 0.0)
    # Nothing is seen at another velocity, and nothing is said of it.
    nowhere = lag_test(seen, 0.0, 30.0)
    assert np.isnan(nowhere.displacement).all()
    assert np.isnan(nowhere.p_offset)
    # One group has no line.
    single = lag_test(seen, 1.5, 0.0, edges=[0.5, 1.0])
    assert np.isnan(single.offset)
    outside = lag_test(seen, 1.5, 0.0, edges=[0.5, 1.0, 5.0, 6.0])
    assert np.isnan(outside.lag[2])
