# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracks of known features, those that may be, and the choice among them."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

import astro_scc.features.tracks as module
from astro_scc.features import TrackSettings
from astro_scc.features.tracks import (
    TOLERANCE,
    Assignment,
    find_tracks,
    log_t,
    steady_hypotheses,
)


def found(d, **options):
    return [track.tolist() for track in find_tracks(d, **options)[0]]


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


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10**6))
def test_what_holds_for_all_tracks(series, seed):
    d = random_series(series, seed)
    tracks, same_speed, proven = find_tracks(d)
    every = np.concatenate([np.empty(0, int), *tracks])
    assert len(every) == len(set(every.tolist()))
    assert len(same_speed) == len(proven) == len(tracks)
    assert ((same_speed >= 0) & (same_speed <= 1)).all()
    firsts = []
    for track in tracks:
        epoch = d.epoch[track]
        assert len(track) >= TrackSettings().least_epochs
        assert (np.diff(epoch) > 0).all()
        firsts.append((epoch[0], d.number[track[0]]))
    assert firsts == sorted(firsts)
    assert found(d) == [track.tolist() for track in tracks]


@pytest.mark.parametrize("days", [(0,), (0, 0.007), (0, 1, 5, 6)])
def test_crossing_features_keep_their_identity(series, days):
    """Two features that meet between two epochs, pairs or campaigns."""
    years, rows = np.add.outer(np.arange(8.0), np.array(days) / 365).ravel(), []
    for k, t in enumerate(years):
        rows += [(k, 0.4 * t, 0.3 * t - 1.05, 1.0), (k, 0.4 * t, 1.05 - 0.3 * t, 0.3)]
    tracks, same_speed, proven = find_tracks(series(rows, years=2000 + years), seed=1)
    each = sorted(track.tolist() for track in tracks)
    assert each == [list(range(k, 2 * len(years), 2)) for k in range(2)]
    assert proven.all()
    assert (same_speed > 0.9).all()


@pytest.mark.parametrize("left_out", [0, 3])
def test_one_epoch_more_or_less(separated, left_out):
    index = np.flatnonzero(separated.epoch != left_out)
    years = np.delete(separated.years, left_out)
    part = replace(separated.select(index), years=years)
    part = replace(part, epoch=part.epoch - (part.epoch > left_out))
    expected = [[k for k in own if k // 4 != left_out] for own in found(separated)]
    assert [index[own].tolist() for own in found(part)] == expected


def test_the_order_within_an_epoch_is_free(separated):
    order = np.lexsort((-separated.number, separated.epoch))
    turned = replace(separated.select(order), number=separated.number)
    sets = {frozenset(order[own].tolist()) for own in found(turned)}
    assert sets == {frozenset(own) for own in found(separated)}


SETTINGS = TrackSettings()


def reversed_in_time(d):
    """The same detections, last one first."""
    last = len(d.years) - 1
    each = ("place", "place_error", "flux", "size")
    turned = {name: getattr(d, name)[::-1] for name in each}
    return replace(
        d, epoch=(last - d.epoch)[::-1], years=-d.years[::-1], number=None, **turned
    )


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6))
def test_time_may_run_backwards(series, seed):
    d = random_series(series, seed)
    paths, score = steady_hypotheses(d, SETTINGS)
    turned, other = steady_hypotheses(reversed_in_time(d), SETTINGS)
    back = {tuple(len(d) - 1 - k for k in path[::-1]): s
            for path, s in zip(turned, other, strict=True)}  # fmt: skip
    assert dict(zip(paths, score, strict=True)) == pytest.approx(back)


#: Turns and mirrors of the sky, and units of length.
FORMS = {
    "turned": np.array([[np.cos(1.0), np.sin(1.0)], [-np.sin(1.0), np.cos(1.0)]]),
    "mirrored": np.diag([-1.0, 1.0]),
    "exchanged": np.array([[0.0, 1.0], [1.0, 0.0]]),
    "smaller": 1e-3 * np.eye(2),
    "larger": 1e6 * np.eye(2),
}


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(sorted(FORMS)))
def test_axes_units_and_the_first_date_are_free(series, seed, name):
    d, turn = random_series(series, seed), FORMS[name]
    d = replace(d, beam=np.diag([2.0, 0.5]) @ d.beam, size=np.linspace(0, 1, len(d)))
    factor = np.hypot(*turn[0])
    other = replace(
        d, place=d.place @ turn.T, place_error=factor * d.place_error,
        size=factor * d.size, beam=turn @ d.beam @ turn.T, years=d.years + 64,
        flux=3 * d.flux,
    )  # fmt: skip
    one, other = (steady_hypotheses(some, SETTINGS) for some in (d, other))
    found = dict(zip(*one, strict=True))
    assert found == pytest.approx(dict(zip(*other, strict=True)))


@pytest.mark.parametrize("n_axes", [1, 2])
def test_students_density(n_axes):
    off = np.array([0.3, -2.0])[:n_axes]
    true = stats.multivariate_t(shape=0.7 * np.eye(n_axes), df=4).logpdf(off)
    assert log_t(off @ off, 0.7, 4.0, n_axes) == pytest.approx(true)


def best_total(paths, score):
    """Largest sum of scores of disjoint paths, by trying every choice."""
    if not paths:
        return 0.0
    free = [k for k in range(1, len(paths)) if not set(paths[k]) & set(paths[0])]
    own = score[0] + best_total([paths[k] for k in free], [score[k] for k in free])
    return max(own, best_total(paths[1:], score[1:]))


def is_packing(paths, chosen):
    """Whether chosen paths are different and share no detection."""
    used = [k for track in chosen for k in paths[track]]
    return len(used) == len(set(used)) and len(chosen) == len(set(chosen.tolist()))


problems = st.lists(
    st.tuples(
        st.sets(st.integers(0, 7), min_size=1, max_size=4), st.floats(0.01, 10.0)
    ),
    min_size=1, max_size=12,
)  # fmt: skip


@settings(max_examples=50, deadline=None)
@given(problems, st.integers(0, 99))
def test_it_is_the_best_choice_and_others_are_valid(problem, seed):
    paths = [tuple(sorted(path)) for path, _ in problem]
    score = np.array([value for _, value in problem])
    found = Assignment(paths, 8)
    chosen, proven = found.best(score)
    best = best_total(paths, score.tolist())
    assert proven
    assert is_packing(paths, chosen)
    assert score[chosen].sum() >= (1 - 2 * TOLERANCE) * best
    assert score[chosen].sum() <= best + 1e-9
    # Disturbed scores may be negative; such tracks are not used.
    other = score + np.random.default_rng(seed).normal(0, 3, len(score))
    (good,) = found.good(other[:, None])
    assert is_packing(paths, good)
    assert (other[good] > 0).all()
    assert other[good].sum() <= best_total(paths, other.tolist()) + 1e-9


def test_prices_alone_do_not_solve_all_pairs():
    # Of all pairs of five only two are disjoint, but prices cannot exclude 2.5.
    paths = list(combinations(range(5), 2))
    chosen, proven = Assignment(paths, 5).best(np.ones(10))
    assert (len(chosen), proven) == (2, True)
    assert is_packing(paths, chosen)


@pytest.mark.parametrize(
    "limits",
    [{"LONGEST": 1e-4}, {"MOST_TRACKS": 40}, {"MOST_TRACKS": 100, "LONGEST": 1e-4}],
)
def test_without_time_or_all_tracks_nothing_is_proven(monkeypatch, limits):
    for name, value in limits.items():
        monkeypatch.setattr(module, name, value)
    # Short tracks that all compete; prices alone do not settle them.
    rng = np.random.default_rng(0)
    choices = (rng.choice(60, 3, replace=False) for _ in range(1200))
    paths = sorted({tuple(np.sort(path).tolist()) for path in choices})
    score = rng.uniform(1, 1.2, len(paths))
    chosen, proven = Assignment(paths, 60).best(score)
    assert is_packing(paths, chosen)
    assert not proven
