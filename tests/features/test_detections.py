# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The core, and shifts of whole epochs."""

import numpy as np
import pytest

N = 20


def with_core(series, shift, seen=None):
    """A core and a feature at 3 mas, both shifted in each epoch."""
    seen = np.ones(N, dtype=bool) if seen is None else seen
    rows = []
    for t, (dx, dy) in enumerate(shift):
        rows += [(t, dx, dy)] if seen[t] else []
        rows += [(t, 3 + 0.1 * t + dx, dy)]
    return series(rows)


@pytest.fixture(scope="module")
def shift():
    # A shift is drawn towards the feature only so far that the core stays nearest.
    return np.clip(np.random.default_rng(1).normal(0, 0.2, (N, 2)), -0.45, 0.45)


def test_numbers_count_within_epochs(series):
    d = series([(0, 1, 1), (0, 2, 1), (2, 1, 1), (2, 1, 2), (2, 1, 3)])
    assert d.number.tolist() == [0, 1, 0, 1, 2]
    assert d.time.tolist() == [2000, 2000, 2002, 2002, 2002]
    some = d.select([False, True, False, False, True])
    assert some.number.tolist() == [1, 2]
    assert len(some) == 2
    assert some.years is d.years
    assert some.beam is d.beam
    by_index = d.select(np.array([4, 1]))
    np.testing.assert_array_equal(by_index.place, [[1, 3], [2, 1]])
    assert len(d.select(np.zeros(5, dtype=bool))) == 0


def test_the_core_is_the_nearest_of_each_epoch(series):
    d = series([(0, 0.2, 0), (0, 0.1, 0), (1, 0.3, 0), (2, 3, 0), (2, 0.0, -0.25)])
    assert d.core(0.25).tolist() == [False, True, False, False, True]
    assert d.core(0.0).tolist() == [False] * 5
    empty = d.select(np.zeros(5, dtype=bool))
    assert empty.core(0.25).shape == (0,)
    assert len(empty.aligned()) == 0


def test_distances_are_in_widths_of_a_turned_beam(series):
    angle = np.radians(30)
    long, short = (np.cos(angle), np.sin(angle)), (-np.sin(angle), np.cos(angle))
    turn = np.array([long, short])
    beam = turn.T @ np.diag([4.0, 0.25]) @ turn / (8 * np.log(2))
    d = series([(0, *long), (0, *short), (0, 1, 0)], beam=beam)
    distance = np.hypot(*d.in_beams.T)
    assert distance[:2] == pytest.approx([0.5, 2])
    assert distance[2] == pytest.approx(np.hypot(np.cos(angle) / 2, np.sin(angle) * 2))
    assert d.fwhm == pytest.approx(1)
    assert d.major == pytest.approx(2)
    # The core is the nearest in beams, not in mas.
    near = series([(0, 0.6 * long[0], 0.6 * long[1]), (0, *np.multiply(0.4, short))],
                  beam=beam)  # fmt: skip
    assert near.core(1.0).tolist() == [True, False]


def test_common_shifts_are_removed(series, shift):
    d = with_core(series, shift).aligned()
    assert len(d) == 2 * N
    np.testing.assert_allclose(d.place[::2], 0, atol=1e-12)
    np.testing.assert_allclose(d.place[1::2, 0], 3 + 0.1 * np.arange(N))
    np.testing.assert_allclose(d.place[1::2, 1], 0, atol=1e-12)
    assert d.aligned() is d


def test_a_core_that_is_often_missing_does_not_align(series, shift):
    seen = np.arange(N) >= 3
    d = with_core(series, shift, seen)
    assert d.aligned() is d


def test_an_epoch_without_a_core_is_left_out(series, shift):
    seen = np.arange(N) != 5
    d = with_core(series, shift, seen).aligned()
    assert set(d.epoch.tolist()) == set(range(N)) - {5}
    assert len(d) == 2 * (N - 1)
    np.testing.assert_allclose(d.place[1::2, 1], 0, atol=1e-12)
    # Numbers within the epoch remain those of all detections.
    assert d.number.tolist() == [0, 1] * (N - 1)
