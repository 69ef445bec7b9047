# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Samples of features whose motion is known."""

from dataclasses import replace

import numpy as np

from astro_scc.stacking.velocities import VelocitySamples, consecutive_pairs

YEARS = np.array([2000.0, 2000.3, 2001.5, 2001.7, 2003.0])


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


def test_limits_are_included_and_hold_for_each_axis():
    years = np.arange(5) / 2
    pairs = consecutive_pairs(years)
    d = every_pair(np.zeros((3, 2)), [(2.0, 0.5), (-2.0, 0.5), (0.5, -1.0)], years)

    def seen(*limit):
        s = d.within(pairs, limit)
        return set(map(tuple, (s.motion / s.interval[:, None]).round(6).tolist()))

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
    some = replace(d, epoch=np.arange(5)).of_ssps(np.arange(5) == 2)
    np.testing.assert_array_equal(some.ssp, d.ssp[keep])
    assert some.n_ssps.tolist() == [0, 0, 1, 0, 0]
    # Within a range of epochs, SSPs and epochs have new numbers.
    d = replace(d, epoch=np.arange(5), scale=np.ones(5))
    part, alone = d.of_epochs(slice(1, 4)), every_pair((0, 0), (1, 2), YEARS[1:4])
    for name in ("d1", "reference", "target", "ssp", "target_ssp", "years", "n_ssps"):
        np.testing.assert_array_equal(getattr(part, name), getattr(alone, name))
