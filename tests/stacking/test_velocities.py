# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Grids, pairs of dates, and samples of features whose motion is known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from astro_scc.stacking.velocities import (
    VelocityGrid,
    VelocitySamples,
    baseline_pairs,
    consecutive_pairs,
)

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


speed = st.floats(0.01, 100.0)


@given(speed, speed, st.floats(0.02, 3.0), st.floats(0.02, 3.0))
def test_covers_what_is_asked_symmetrically_with_a_point_at_zero(v1, v2, n1, n2):
    step = v1 / n1 / 20, v2 / n2 / 20
    grid = VelocityGrid.covering((v1, v2), step)
    assert grid.v_max == pytest.approx((v1, v2))
    assert grid.shape == (len(grid.v2), len(grid.v1))
    for axis, largest, found in zip((grid.v1, grid.v2), step, grid.step, strict=True):
        assert 0 in axis
        np.testing.assert_allclose(axis, -axis[::-1])
        np.testing.assert_allclose(np.diff(axis), found)
        assert found <= largest * (1 + 1e-6)


def test_small_and_large_grids():
    # One speed and one step hold for both axes.
    grid = VelocityGrid.covering(2.0, 0.5)
    assert (grid.shape, grid.step) == ((9, 9), (0.5, 0.5))
    # The spacing grows where there would be too many points.
    grid = VelocityGrid.covering((10.0, 1.0), 1e-6)
    assert (grid.shape, grid.v_max) == ((601, 601), (10.0, 1.0))
    # A step beyond the largest velocity leaves three.
    assert VelocityGrid.covering(1.0, 5.0).v1.tolist() == [-1.0, 0.0, 1.0]


dates = st.lists(
    st.integers(0, 4000).map(lambda day: day / 365.25), min_size=1, max_size=12
).map(sorted)


@given(dates)
def test_consecutive_pairs_are_neighbours_of_different_date(years):
    pairs = consecutive_pairs(years)
    expected = [i for i in range(len(years) - 1) if years[i + 1] > years[i]]
    assert pairs.first.tolist() == expected
    assert pairs.second.tolist() == [i + 1 for i in expected]
    assert np.all(pairs.interval > 0)
    np.testing.assert_array_equal(pairs.weight, 1.0)
    assert pairs.n_dates == len(years)
    assert len(pairs) == len(expected)


@example([0.0, 0.0, 1.0], 0.0, 2.0)
@given(dates, st.floats(0, 5), st.floats(0.01, 5))
def test_baseline_pairs_are_all_whose_separation_lies_inside(years, shortest, width):
    longest = shortest + width
    pairs = baseline_pairs(years, shortest, longest)
    found = set(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True))
    for i, j in np.ndindex(len(years), len(years)):
        separation = years[j] - years[i]
        if separation <= 0:
            assert (i, j) not in found
        elif shortest <= separation <= longest:
            assert (i, j) in found
        elif not shortest - 2e-3 <= separation <= longest + 2e-3:
            assert (i, j) not in found
    years = np.asarray(years)
    interval = years[pairs.second] - years[pairs.first]
    np.testing.assert_array_equal(pairs.interval, interval)
    if len(pairs):
        assert pairs.weight.mean() == pytest.approx(1.0)
        # Inverse variances: a displacement error over the interval is one of velocity.
        ratio = pairs.weight / pairs.interval**2
        np.testing.assert_allclose(ratio, ratio[0])


def test_edges_of_a_baseline_are_inside():
    years = np.array([0.0, 0.25, 0.75, 1.75])
    pairs = baseline_pairs(years, 0.5, 1.0)
    assert list(zip(pairs.first, pairs.second, strict=True)) == [(0, 2), (1, 2), (2, 3)]
    # Limits given in rounded days must not lose the pair that they mean.
    month = 30 / 365.25
    assert len(baseline_pairs([0.0, month], 0.082, 0.082)) == 1
    assert len(baseline_pairs([0.0, month], 0.084, 1.0)) == 0
    minute = 1 / (365.25 * 1440)
    for limits in ((minute, 3 * minute), (1.9e-6, 5.7e-6)):
        assert len(baseline_pairs(np.arange(10) * minute, *limits)) == 9 + 8 + 7
