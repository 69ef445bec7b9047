# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""VelocitySamples of features whose motion is known."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from astro_scc.stacking.velocities import (
    VelocitySamples,
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
    one = np.ones(len(feature))
    return VelocitySamples(
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
        position=(start + velocity * (years - 2000)[:, None, None]).reshape(-1, 2),
        motion=motion,
        years=years,
    )


numbers = st.floats(-5, 5).map(lambda x: round(x, 3))


@given(st.tuples(numbers, numbers), st.tuples(numbers, numbers))
def test_a_feature_is_seen_where_and_as_it_moves_from_both_sides(start, velocity):
    s = every_pair(start, velocity).within(baseline_pairs(YEARS, 0.0, 5.0), FAR)
    assert len(s) == 20
    np.testing.assert_allclose(s.velocity, np.tile(velocity, (20, 1)), atol=1e-9)
    time = 0.5 * (YEARS[s.reference] + YEARS[s.target]) - 2000
    middle = np.array(start) + np.outer(time, velocity)
    np.testing.assert_allclose(s.middle, middle, atol=1e-9)
    np.testing.assert_allclose(s.sigma, np.sqrt(0.1 * 0.2))


def test_only_the_pairs_of_the_stack_are_seen():
    d = every_pair([(0, 0), (2, 0)], [(1, 0), (1, 0)])
    assert len(d.within(consecutive_pairs(YEARS), FAR)) == 2 * 2 * 4
    pairs = baseline_pairs(YEARS, 1.1, 1.5)
    s = d.within(pairs, FAR)
    assert len(s) == 2 * 2 * len(pairs)
    assert np.all((np.abs(s.interval) >= 1.1) & (np.abs(s.interval) <= 1.5))
    none = d.select(np.zeros(len(d), bool))
    assert len(none.within(pairs, FAR)) == 0


def test_limits_are_included_and_hold_for_each_axis():
    years = np.arange(5) / 2
    pairs = consecutive_pairs(years)
    d = every_pair(np.zeros((3, 2)), [(2.0, 0.5), (-2.0, 0.5), (0.5, -1.0)], years)

    def seen(*limit):
        s = d.within(pairs, limit)
        return {(round(float(a), 6), round(float(b), 6)) for a, b in s.velocity}

    assert seen(2.0, 1.0) == {(2.0, 0.5), (-2.0, 0.5), (0.5, -1.0)}
    assert seen(1.99, 1.0) == {(0.5, -1.0)}
    assert seen(2.0, 0.99) == {(2.0, 0.5), (-2.0, 0.5)}
    assert seen(0.1, 0.1) == set()


def test_a_selection_selects_every_column():
    d = every_pair((0, 0), (1, 2))
    keep = d.reference == 2
    some = d.select(keep)
    assert len(some) == 4
    for name in ("d1", "s2", "motion", "target", "ssp", "target_ssp", "weight"):
        np.testing.assert_array_equal(getattr(some, name), getattr(d, name)[keep])
    assert some.n_epochs == 5
    assert some.position is d.position
