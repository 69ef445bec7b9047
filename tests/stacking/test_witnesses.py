# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Witnesses against groups made slowly, and of features that are known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from astro_scc.stacking import Sightings, find_witnesses, witnesses

SIGMA = 0.2


def sightings(middle, velocity, time, interval, *, weight=None, sigma=SIGMA):
    """Sightings of which the frame is Cartesian."""
    middle, velocity = np.atleast_2d(middle), np.atleast_2d(velocity)
    n = len(middle)
    one = np.ones(n)
    time, interval = time * one, interval * one
    return Sightings(
        v1=velocity[:, 0],
        v2=velocity[:, 1],
        s1=sigma / interval,
        s2=sigma / interval,
        weight=one if weight is None else np.asarray(weight),
        time=time,
        interval=interval,
        middle=middle,
        velocity=velocity,
        sigma=sigma * one,
        first=np.unique(time - interval / 2, return_inverse=True)[1].reshape(-1),
        ssp=np.arange(n),
        match=np.arange(n),
    )


def joined(*parts):
    """Sightings of several features; the dates of all of them count."""
    one = {
        name: np.concatenate([getattr(p, name) for p in parts])
        for name in parts[0].__dataclass_fields__
    }
    start = one["time"] - one["interval"] / 2
    one["first"] = np.unique(start.round(9), return_inverse=True)[1].reshape(-1)
    return Sightings(**one)


def of_feature(rng, start, velocity, times, interval=1.0, *, n=1, scatter=0.05):
    """A feature seen ``n`` times at each date, with errors."""
    times = np.repeat(np.asarray(times, dtype=float), n)
    start, velocity = np.asarray(start, dtype=float), np.asarray(velocity, dtype=float)
    error = rng.normal(scale=scatter, size=(2, len(times), 2))
    return sightings(
        start + velocity * times[:, None] + error[0],
        velocity + error[1],
        times,
        interval,
        weight=rng.uniform(0.6, 1.0, len(times)),
    )


def random_sightings(rng, n):
    """Sightings at five dates and of three intervals, many of them close."""
    slots = [(t, dt) for t in (0.0, 0.9, 2.0, 2.8, 4.1) for dt in (0.8, 1.0, 2.0)]
    slot = rng.integers(len(slots), size=n)
    time, interval = np.array(slots)[slot].T
    return sightings(
        rng.uniform(0, 1.2, (n, 2)),
        rng.normal(0.5, 0.12, (n, 2)),
        time,
        interval,
        weight=rng.uniform(0.6, 1.0, n),
        sigma=SIGMA,
    )


def slow_links(s):
    """Which sightings agree, one pair after another."""
    n = len(s)
    sigma = np.median(s.sigma)
    links = np.zeros((n, n), dtype=bool)
    for i in range(n):
        for j in range(n):
            gap = abs(s.time[j] - s.time[i])
            interval = np.sqrt(s.interval[i] * s.interval[j])
            if i == j or gap > 10 * interval:
                continue
            a, b = (i, j) if s.time[i] <= s.time[j] else (j, i)
            here = s.middle[a] + s.velocity[a] * gap / 2
            there = s.middle[b] - s.velocity[b] * gap / 2
            place = sigma * (1.25 + 0.25 * gap / interval)
            links[i, j] = np.hypot(*(here - there)) <= place and (
                np.hypot(*(s.velocity[a] - s.velocity[b])) <= 0.85 * sigma / interval
            )
    return links


def slow_groups(links):
    """The one with most free neighbours takes them, until none is free."""
    free = np.ones(len(links), dtype=bool)
    group = np.full(len(links), -1)
    number = 0
    while free.any():
        count = np.where(free, (links & free).sum(axis=1), -1)
        taken = links[count.argmax()] & free
        taken[count.argmax()] = True
        group[taken] = number
        free &= ~taken
        number += 1
    return group


def partition(group):
    return {frozenset(np.flatnonzero(group == g)) for g in set(group)}


@pytest.mark.parametrize("for_trees", [0, 300, 10**9])
@pytest.mark.parametrize(("n", "seed"), [(100, 0), (150, 1), (300, 2)])
def test_groups_are_those_of_the_slow_loops(n, seed, for_trees, monkeypatch):
    monkeypatch.setattr(witnesses, "FOR_TREES", for_trees)
    s = random_sightings(np.random.default_rng(seed), n)
    links = slow_links(s)
    assert n / 2 < links.sum() < n**2 / 8
    w = find_witnesses(s)
    np.testing.assert_array_equal(w.group, slow_groups(links))
    assert len(w) == w.group.max() + 1 < n


def test_sums_are_those_of_the_groups():
    s = random_sightings(np.random.default_rng(3), 200)
    s = replace(s, s1=s.s1 * 1.5, s2=s.s2 * np.linspace(1, 2, 200))
    w = find_witnesses(s)
    for g in range(len(w)):
        own = s.select(w.group == g)
        q = own.weight
        n_dates = len(set(own.first))
        assert w.n_dates[g] == n_dates
        assert w.weight[g] == pytest.approx(
            q.mean() * min(n_dates, 9) ** 1.5 * (len(own) / n_dates) ** 0.5
        )
        for name in ("v1", "v2", "s1", "s2"):
            mean = np.average(getattr(own, name), weights=q)
            assert getattr(w, name)[g] == pytest.approx(mean)


def test_one_feature_on_three_scales_in_nine_pairs_is_one_witness():
    rng = np.random.default_rng(0)
    # Both directions of each pair.
    s = of_feature(rng, (0, 0), (2.0, 0.3), np.arange(9), n=6)
    w = find_witnesses(s)
    assert len(w) == 1
    assert w.n_dates[0] == 9
    assert w.weight[0] == pytest.approx(27 * 6**0.5 * s.weight.mean())
    assert w.v1[0] == pytest.approx(2.0, abs=0.05)


def test_more_than_nine_dates_weigh_no_more():
    rng = np.random.default_rng(8)
    for n_dates, weight in ((4, 8), (9, 27), (25, 27)):
        s = of_feature(rng, (0, 0), (1.0, 0.0), np.arange(n_dates) / 3, scatter=0.01)
        w = find_witnesses(s)
        assert w.n_dates.tolist() == [n_dates]
        assert w.weight[0] == pytest.approx(weight * s.weight.mean())


def test_pairs_of_all_lengths_and_uneven_dates_are_one_witness():
    rng = np.random.default_rng(1)
    years = np.array([0.0, 0.7, 1.9, 2.4, 3.6, 4.5])
    first, second = np.triu_indices(6, 1)
    time, interval = 0.5 * (years[first] + years[second]), years[second] - years[first]
    error = rng.normal(scale=0.04, size=(2, 15, 2))
    velocity = np.array([1.0, -0.4])
    s = sightings(
        velocity * time[:, None] + error[0],
        velocity + error[1] / interval[:, None],
        time,
        interval,
    )
    s = replace(s, first=first)
    w = find_witnesses(s)
    assert len(w) == 1
    assert w.n_dates[0] == 5


offsets = st.floats(-3, 3)


@given(
    st.tuples(offsets, offsets),
    st.tuples(offsets, offsets),
    st.integers(0, 1000),
    st.sampled_from([0.5, 1.0, 2.0]),
)
def test_features_apart_in_place_or_velocity_never_merge(where, speed, seed, interval):
    times = np.arange(5) * interval
    # Twice the limits, so that errors do not bring them together.
    apart = np.hypot(*speed) > 2 * 0.85 * SIGMA / interval
    if not apart:
        # However far one velocity carries them.
        nearest = np.hypot(*where) - np.hypot(*speed) * times[-1]
        assume(nearest > 2 * SIGMA * (1.25 + 0.25 * 4))
    rng = np.random.default_rng(seed)
    one = of_feature(rng, (0, 0), (1, 0), times, interval, n=3, scatter=0.01)
    other = of_feature(
        rng, where, np.add((1, 0), speed), times, interval, n=3, scatter=0.01
    )
    group = find_witnesses(joined(one, other)).group
    assert not set(group[:15]) & set(group[15:])


def test_features_that_cross_are_two():
    rng = np.random.default_rng(2)
    one = of_feature(rng, (-4, 0), (2, 0), np.arange(5), n=3)
    other = of_feature(rng, (4, 0.1), (-2, 0), np.arange(5), n=3)
    w = find_witnesses(joined(one, other))
    assert len(w) == 2
    np.testing.assert_allclose(np.sort(w.v1), [-2, 2], atol=0.1)


def test_groups_do_not_chain():
    """A row of features, each close to the next, is not one."""
    places = np.stack([np.arange(30) * SIGMA, np.zeros(30)], axis=1)
    s = sightings(places, np.tile((1.0, 0.0), (30, 1)), 0.0, 1.0)
    group = find_witnesses(s).group
    for g in set(group):
        assert np.ptp(places[group == g, 0]) <= 2 * 1.25 * SIGMA + 1e-9
    assert len(set(group)) >= 10


def test_sightings_far_apart_in_time_do_not_link():
    rng = np.random.default_rng(4)
    for gap, n in ((9.9, 1), (10.1, 2)):
        s = of_feature(rng, (0, 0), (1, 0), [0.0, gap], scatter=0.0)
        assert len(find_witnesses(s)) == n


@pytest.mark.parametrize("gap", [0.0, 1.0, 3.0])
def test_limits_of_place_and_velocity(gap):
    """Both directions of the limits, which grow with the gap or do not."""
    place = SIGMA * (1.25 + 0.25 * gap / 2)
    speed = 0.85 * SIGMA / 2
    for shift, change, n in (
        (0.99 * place, 0.0, 1),
        (1.01 * place, 0.0, 2),
        (0.0, 0.99 * speed, 1),
        (0.0, 1.01 * speed, 2),
    ):
        velocity = np.array([(1.0, 0.0), (1.0, change)])
        meeting = 0.5 * gap * velocity * [[1], [-1]]
        s = sightings([(0, 0), (0, shift)] - meeting, velocity, [0.0, gap], 2.0)
        assert len(find_witnesses(s)) == n


@pytest.mark.parametrize("length", [1e-3, 1e3])
@pytest.mark.parametrize("duration", [1e-2, 1e2])
def test_units_do_not_matter(length, duration):
    s = random_sightings(np.random.default_rng(5), 150)
    speed = length / duration
    other = replace(
        s,
        v1=s.v1 * speed,
        v2=s.v2 * speed,
        s1=s.s1 * speed,
        s2=s.s2 * speed,
        time=s.time * duration,
        interval=s.interval * duration,
        middle=s.middle * length,
        velocity=s.velocity * speed,
        sigma=s.sigma * length,
    )
    w, scaled = find_witnesses(s), find_witnesses(other)
    assert partition(w.group) == partition(scaled.group)
    np.testing.assert_allclose(scaled.v1, w.v1 * speed)
    np.testing.assert_allclose(scaled.weight, w.weight)


def test_one_sighting_is_one_witness_and_none_are_none():
    s = random_sightings(np.random.default_rng(6), 3)
    one = find_witnesses(s.select([1]))
    assert len(one) == 1
    assert one.weight[0] == pytest.approx(s.weight[1])
    assert one.v1[0] == pytest.approx(s.v1[1])
    none = find_witnesses(s.select([]))
    assert len(none) == len(none.group) == 0
