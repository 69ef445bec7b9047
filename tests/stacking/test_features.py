# Licensed under a 3-clause BSD style license - see LICENSE.rst
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.stacking import Sightings, count_features, find_witnesses


def sightings(place, velocity, time, sigma=1.0):
    """Sightings one year apart, at places at their mean dates."""
    n = len(place)
    place, velocity = np.asarray(place, float), np.asarray(velocity, float)
    one = np.ones(n)
    whole = np.arange(n)
    return Sightings(
        v1=velocity[:, 0], v2=velocity[:, 1], s1=sigma * one, s2=sigma * one,
        weight=one, time=np.asarray(time, float), interval=one, middle=place,
        velocity=velocity, sigma=sigma * one,
        first=np.floor(time).astype(int), ssp=whole, match=whole,
    )  # fmt: skip


def wandering(n_features, n_dates, rng, jitter=1.0, apart=40.0):
    """Sightings of features at one speed, with a random walk of their own."""
    place, velocity, time, owner = [], [], [], []
    for feature in range(n_features):
        step = np.array([4.0, 0.0]) + rng.normal(0, jitter, (n_dates, 2))
        path = np.cumsum(step, axis=0) + [0.0, apart * feature]
        for k in range(n_dates - 1):
            place.append(0.5 * (path[k] + path[k + 1]))
            velocity.append(path[k + 1] - path[k])
            time.append(k + 0.5)
            owner.append(feature)
    return sightings(place, velocity, time), np.array(owner)


def test_nothing_near_is_no_feature():
    s = sightings([(0, 0)], [(1, 0)], [0.5])
    assert count_features(s, [0], [False]) == 0
    assert count_features(s, [0], [True]) == 1


@pytest.mark.parametrize("n_features", [1, 2, 3, 7])
def test_a_wandering_feature_is_counted_about_once(n_features):
    for seed in range(10):
        s, _ = wandering(n_features, 10, np.random.default_rng(seed))
        witnesses = find_witnesses(s)
        near = s.near(4.0, 0.0, 1.5)
        counted = count_features(s, witnesses.group, near)
        # The witnesses themselves are many more.
        assert n_features <= counted <= 2 * n_features
        assert len(np.unique(witnesses.group[near])) > counted or n_features == 1


def test_two_scales_of_one_feature_are_one():
    rng = np.random.default_rng(1)
    s, _ = wandering(1, 8, rng, jitter=0.0)
    other = sightings(s.middle + [2.0, 0.5], s.velocity, s.time)
    place = np.concatenate([s.middle, other.middle])
    velocity = np.concatenate([s.velocity, other.velocity])
    both = sightings(place, velocity, np.concatenate([s.time, other.time]))
    group = np.repeat([0, 1], len(s))
    assert count_features(both, group, np.ones(len(both), bool)) == 1


@pytest.mark.parametrize(
    ("place", "velocity", "time", "expected"),
    [
        ([(0, 0), (2.9, 0)], [(5, 0)] * 2, [0.5, 0.5], 1),
        ([(0, 0), (3.1, 0)], [(5, 0)] * 2, [0.5, 0.5], 2),
        # Carried along: five in a year, and half an error more for a gap of one.
        ([(0, 0), (8.4, 0)], [(5, 0)] * 2, [0.5, 1.5], 1),
        ([(0, 0), (8.6, 0)], [(5, 0)] * 2, [0.5, 1.5], 2),
        ([(0, 0), (2, 0)], [(5, 0), (7.4, 0)], [0.5, 0.5], 1),
        ([(0, 0), (2, 0)], [(5, 0), (7.6, 0)], [0.5, 0.5], 2),
        # A walk of two intervals and a half, about the mean velocity.
        ([(0, 0), (10, 3.9)], [(5, 2), (5, -2)], [0.5, 2.5], 1),
        ([(0, 0), (10, 4.1)], [(5, 2), (5, -2)], [0.5, 2.5], 2),
    ],
)
def test_limits(place, velocity, time, expected):
    s = sightings(place, velocity, time)
    assert count_features(s, [0, 1], [True, True]) == expected


@given(
    st.integers(1, 12),
    st.integers(0, 2**32 - 1),
    st.floats(0.1, 10),
)
def test_never_more_than_witnesses_and_free_of_units(n, seed, unit):
    rng = np.random.default_rng(seed)
    place, velocity = rng.uniform(0, 20, (n, 2)), rng.uniform(0, 4, (n, 2))
    time = rng.integers(0, 5, n) + 0.5
    group = rng.integers(0, n, n)
    near = rng.random(n) < 0.7
    counted = count_features(sightings(place, velocity, time), group, near)
    assert (counted > 0) == near.any()
    assert counted <= len(np.unique(group[near]))
    scaled = sightings(unit * place, unit * velocity, time, sigma=unit)
    assert count_features(scaled, group, near) == counted
