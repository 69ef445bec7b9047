# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracks of detections whose features are known, and what holds for all tracks."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.features import TrackSettings
from astro_scc.features.tracks import find_tracks

#: Turns and mirrors of the sky.
TURNS = {
    "turned": np.array([[np.cos(1.0), np.sin(1.0)], [-np.sin(1.0), np.cos(1.0)]]),
    "mirrored": np.diag([-1.0, 1.0]),
    "exchanged": np.array([[0.0, 1.0], [1.0, 0.0]]),
}


def found(d, **options):
    return [track.detection.tolist() for track in find_tracks(d, **options)]


def random_series(series, seed):
    rng = np.random.default_rng(seed)
    n_epochs = int(rng.integers(3, 8))
    rows = [
        (t, *rng.uniform(0, 3, 2), rng.lognormal())
        for t in range(n_epochs)
        for _ in range(rng.integers(0, 5))
    ]
    # Two features among what is unrelated.
    rows += [
        (t, k + 0.3 * t, k, 1.0)
        for t in range(n_epochs)
        for k in range(2)
        if rng.random() < 0.8
    ]
    return series(rows, n_epochs=n_epochs)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_what_holds_for_all_tracks(series, seed):
    d = random_series(series, seed)
    tracks = find_tracks(d)
    every = np.concatenate([np.empty(0, int), *(track.detection for track in tracks)])
    assert len(every) == len(set(every.tolist()))
    firsts = []
    for track in tracks:
        epoch = d.epoch[track.detection]
        assert len(track) >= TrackSettings().least_epochs
        assert (np.diff(epoch) > 0).all()
        assert len(track.agreement) == len(track) - 1
        assert (track.agreement > TrackSettings().agreed).all()
        assert (track.agreement <= 1 + 1e-9).all()
        assert 0 <= track.same_speed <= 1
        firsts.append((epoch[0], d.number[track.detection[0]]))
    assert firsts == sorted(firsts)
    assert found(d) == [track.detection.tolist() for track in tracks]


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(sorted(TURNS)))
def test_the_sky_may_be_turned_and_mirrored(series, seed, name):
    turn = TURNS[name]
    d = random_series(series, seed)
    long = np.diag([2.0, 0.5]) @ d.beam
    d = replace(d, beam=long)
    other = replace(d, place=d.place @ turn.T, beam=turn @ long @ turn.T)
    assert found(other) == found(d)


def test_crossing_features_keep_their_identity(crossing):
    tracks = find_tracks(crossing)
    assert sorted(track.detection.tolist() for track in tracks) == [
        list(range(0, 16, 2)),
        list(range(1, 16, 2)),
    ]
    for track in tracks:
        assert track.proven
        assert track.agreement.min() > 0.75
        assert track.same_speed > 0.9


def test_one_epoch_more_or_less(separated):
    whole = found(separated)
    for left_out in range(8):
        index = np.flatnonzero(separated.epoch != left_out)
        part = separated.select(index)
        later = (part.epoch > left_out).astype(int)
        years = np.delete(separated.years, left_out)
        part = replace(part, epoch=part.epoch - later, years=years)
        expected = [[k for k in own if k // 4 != left_out] for own in whole]
        assert [index[own].tolist() for own in found(part)] == expected


def test_the_order_within_an_epoch_is_free(separated):
    order = np.lexsort((-separated.number, separated.epoch))
    turned = replace(separated.select(order), number=separated.number)
    sets = {frozenset(order[own].tolist()) for own in found(turned)}
    assert sets == {frozenset(own) for own in found(separated)}
    # Numbers alone only change the disturbances and the order of the tracks.
    other = replace(separated, number=3 - separated.number)
    assert sorted(found(other)) == sorted(found(separated))


def test_the_seed_decides(series):
    rng = np.random.default_rng(1)
    d = series([(t, *rng.uniform(0, 2, 2)) for t in range(10) for _ in range(6)])
    one, again = (find_tracks(d, seed=4) for _ in range(2))
    assert len(one) == len(again)
    for a, b in zip(one, again, strict=True):
        np.testing.assert_array_equal(a.detection, b.detection)
        np.testing.assert_array_equal(a.agreement, b.agreement)
        assert (a.same_speed, a.proven) == (b.same_speed, b.proven)
    other = find_tracks(d, seed=5)
    assert [t.agreement.tolist() for t in one] != [t.agreement.tolist() for t in other]


def test_rounds_take_up_what_is_left(series, separated):
    for rounds, n in ((0, 0), (1, 4), (6, 4)):
        assert len(found(separated, settings=TrackSettings(rounds=rounds))) == n


def test_the_speed_of_what_is_ambiguous_is_not_the_same(series):
    # A row of equal features that stands, or moves by one place at each epoch.
    d = series([(t, 0.5 * k, 0.0) for t in range(8) for k in range(1, 12)])
    clear = series([(t, 0.3 * t, 0.0) for t in range(8)])
    same = [track.same_speed for track in find_tracks(d)]
    assert find_tracks(clear)[0].same_speed == pytest.approx(1)
    assert np.mean(same) < 1
