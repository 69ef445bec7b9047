# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Sightings of features whose motion is known."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.stacking import (
    DatePairs,
    Displacements,
    Sightings,
    baseline_pairs,
    consecutive_pairs,
)

YEARS = np.array([2000.0, 2000.3, 2001.5, 2001.7, 2003.0])
FAR = (np.inf, np.inf)


def every_pair(start, velocity, years=YEARS, s=(0.1, 0.2)):
    """Matches of features that move uniformly, between all epochs, both ways."""
    start, velocity = np.atleast_2d(start), np.atleast_2d(velocity)
    n, n_epochs = len(start), len(years)
    reference, target = np.nonzero(~np.eye(n_epochs, dtype=bool))
    feature = np.tile(np.arange(n), len(reference))
    reference, target = np.repeat(reference, n), np.repeat(target, n)
    elapsed = years[target] - years[reference]
    motion = velocity[feature] * elapsed[:, None]
    position = start[feature] + velocity[feature] * (years[reference] - 2000)[:, None]
    one = np.ones(len(feature))
    return Displacements(
        d1=motion[:, 0],
        d2=motion[:, 1],
        s1=s[0] * one,
        s2=s[1] * one,
        weight=0.9 * one,
        reference=reference,
        target=target,
        ssp=reference * n + feature,
        target_ssp=target * n + feature,
        n_ssps=np.full(n_epochs, n),
        position=position,
        motion=motion,
    )


def assert_same(some, others, but=("ssp", "match")):
    for f in fields(Sightings):
        if f.name not in but:
            np.testing.assert_allclose(
                getattr(some, f.name),
                getattr(others, f.name),
                atol=1e-12,
                err_msg=f.name,
            )


numbers = st.floats(-5, 5).map(lambda x: round(x, 3))


@given(st.tuples(numbers, numbers), st.tuples(numbers, numbers))
def test_both_directions_of_a_pair_say_the_same(start, velocity):
    d = every_pair(start, velocity)
    pairs = baseline_pairs(YEARS, 0.0, 5.0)
    ahead = Sightings.of(d.select(d.reference < d.target), pairs, YEARS, FAR)
    back = d.select(d.reference > d.target)
    # In the order of the pairs seen from the other side.
    back = back.select(np.lexsort((back.reference, back.target)))
    assert_same(ahead, Sightings.of(back, pairs, YEARS, FAR))


def test_a_feature_is_seen_where_and_as_it_moves():
    start, velocity = np.array([3.0, -1.0]), np.array([0.8, -0.4])
    s = Sightings.of(
        every_pair(start, velocity), baseline_pairs(YEARS, 0.0, 5.0), YEARS, FAR
    )
    assert len(s) == 20
    np.testing.assert_allclose(s.v1, 0.8)
    np.testing.assert_allclose(s.v2, -0.4)
    np.testing.assert_allclose(s.velocity, np.tile(velocity, (20, 1)))
    np.testing.assert_allclose(s.middle, start + velocity * (s.time - 2000)[:, None])


def test_errors_are_those_of_the_displacement_over_the_interval():
    s = Sightings.of(every_pair((0, 0), (1, 1)), consecutive_pairs(YEARS), YEARS, FAR)
    np.testing.assert_allclose(s.s1, 0.1 / s.interval)
    np.testing.assert_allclose(s.s2, 0.2 / s.interval)
    np.testing.assert_allclose(s.sigma, np.sqrt(0.1 * 0.2))
    assert np.all(s.s1 > 0)


def test_dates_are_those_of_the_pair():
    d = every_pair((0, 0), (1, 0))
    s = Sightings.of(d, consecutive_pairs(YEARS), YEARS, FAR)
    assert sorted(set(s.first)) == [0, 1, 2, 3]
    np.testing.assert_allclose(s.interval, np.diff(YEARS)[s.first])
    np.testing.assert_allclose(s.time, (0.5 * (YEARS[1:] + YEARS[:-1]))[s.first])


def test_only_the_pairs_of_the_stack_are_seen():
    d = every_pair([(0, 0), (2, 0)], [(1, 0), (1, 0)])
    assert len(Sightings.of(d, consecutive_pairs(YEARS), YEARS, FAR)) == 2 * 2 * 4
    pairs = baseline_pairs(YEARS, 1.1, 1.5)
    s = Sightings.of(d, pairs, YEARS, FAR)
    assert len(s) == 2 * 2 * len(pairs)
    assert np.all((s.interval >= 1.1) & (s.interval <= 1.5))


def test_limits_are_included_and_hold_for_each_axis():
    years = np.arange(5) / 2
    pairs = consecutive_pairs(years)
    d = every_pair(np.zeros((3, 2)), [(2.0, 0.5), (-2.0, 0.5), (0.5, -1.0)], years)

    def seen(*limit):
        s = Sightings.of(d, pairs, years, limit)
        return {(round(float(a), 6), round(float(b), 6)) for a, b in s.velocity}

    assert seen(2.0, 1.0) == {(2.0, 0.5), (-2.0, 0.5), (0.5, -1.0)}
    assert seen(1.99, 1.0) == {(0.5, -1.0)}
    assert seen(2.0, 0.99) == {(2.0, 0.5), (-2.0, 0.5)}
    assert seen(0.1, 0.1) == set()


def test_the_axes_of_the_frame_need_not_be_those_of_the_places():
    """Away from and around a point; places stay Cartesian."""
    d = every_pair((3, 4), (0.6, 0.8))
    elapsed = YEARS[d.target] - YEARS[d.reference]
    d = replace(d, d1=elapsed, d2=np.zeros(len(d)))
    s = Sightings.of(d, consecutive_pairs(YEARS), YEARS, FAR)
    np.testing.assert_allclose(s.v1, 1.0)
    np.testing.assert_allclose(s.v2, 0.0)
    np.testing.assert_allclose(s.velocity, np.tile((0.6, 0.8), (len(s), 1)))


def test_match_and_ssp_lead_back_to_the_displacements(random_displacements):
    d = random_displacements(np.random.default_rng(0), 5, 200)
    d = replace(d, position=np.zeros((200, 2)), motion=np.stack([d.d1, d.d2], axis=1))
    s = Sightings.of(d, baseline_pairs(YEARS, 0.0, 1.5), YEARS, (4.0, 4.0))
    assert 0 < len(s) < 200
    np.testing.assert_array_equal(s.ssp, d.ssp[s.match])
    np.testing.assert_array_equal(s.weight, d.weight[s.match])
    np.testing.assert_allclose(np.abs(s.v1) * s.interval, np.abs(d.d1[s.match]))
    np.testing.assert_array_equal(s.first, np.minimum(d.reference, d.target)[s.match])


def test_a_selection_selects_every_column():
    s = Sightings.of(every_pair((0, 0), (1, 2)), consecutive_pairs(YEARS), YEARS, FAR)
    keep = s.first == 2
    some = s.select(keep)
    assert len(some) == 2
    assert_same(some, s.select(np.flatnonzero(keep)), but=())
    np.testing.assert_array_equal(some.first, 2)
    np.testing.assert_array_equal(some.match, s.match[keep])


def test_near_counts_the_errors_of_each_sighting():
    s = Sightings.of(every_pair((0, 0), (1, 2)), consecutive_pairs(YEARS), YEARS, FAR)
    # Two standard errors along the first axis, of the pairs 1.2 yr apart.
    v1 = 1 + 2 * 0.1 / 1.2
    wide = np.isclose(s.interval, 1.2) | (s.interval < 1.2)
    np.testing.assert_array_equal(s.near(v1, 2.0, 2.0 + 1e-9), wide)
    assert not s.near(v1, 2.0, 0.3).any()
    assert s.near(1.0, 2.0, 0.01).all()
    # Errors along both axes add in squares.
    one = s.select([0])
    at = 1 + 0.6 * one.s1[0], 2 - 0.8 * one.s2[0]
    assert one.near(*at, 1 + 1e-9).all()
    assert not one.near(*at, 1 - 1e-9).any()


def test_without_matches_or_without_pairs_nothing_is_seen():
    d = every_pair((0, 0), (1, 0))
    no_pairs = DatePairs(*(np.zeros(0, int),) * 2, *(np.zeros(0),) * 2, len(YEARS))
    assert len(Sightings.of(d, no_pairs, YEARS, FAR)) == 0
    none = d.select(np.zeros(len(d), bool))
    assert len(Sightings.of(none, consecutive_pairs(YEARS), YEARS, FAR)) == 0


@pytest.mark.parametrize("missing", ["position", "motion"])
def test_needs_positions(missing):
    d = replace(every_pair((0, 0), (1, 0)), **{missing: None})
    with pytest.raises(ValueError, match="sightings need .* position and motion"):
        Sightings.of(d, consecutive_pairs(YEARS), YEARS, FAR)
