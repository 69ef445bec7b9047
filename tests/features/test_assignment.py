# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracks that share no detection, against trying every choice."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.features import assignment
from astro_scc.features.assignment import TOLERANCE, Assignment


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


def hard(n_detections=60, n_tracks=1200):
    """Short tracks that all compete; prices alone do not settle them."""
    rng = np.random.default_rng(0)
    choices = (rng.choice(n_detections, 3, replace=False) for _ in range(n_tracks))
    paths = sorted({tuple(np.sort(path).tolist()) for path in choices})
    return paths, rng.uniform(1, 1.2, len(paths))


problems = st.lists(
    st.tuples(
        st.sets(st.integers(0, 7), min_size=1, max_size=4), st.floats(0.01, 10.0)
    ),
    min_size=1, max_size=12,
)  # fmt: skip


@settings(max_examples=80, deadline=None)
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
    good = found.good(other)
    assert is_packing(paths, good)
    assert (other[good] > 0).all()
    assert other[good].sum() <= best_total(paths, other.tolist()) + 1e-9


def test_prices_alone_do_not_solve_all_pairs(monkeypatch):
    # Of all pairs of five only two are disjoint, but prices cannot exclude 2.5.
    calls = []
    solve = assignment.milp
    monkeypatch.setattr(
        assignment, "milp", lambda *a, **k: calls.append(1) or solve(*a, **k)
    )
    paths = list(combinations(range(5), 2))
    chosen, proven = Assignment(paths, 5).best(np.ones(10))
    assert calls
    assert proven
    assert len(chosen) == 2
    assert is_packing(paths, chosen)


@pytest.mark.parametrize(
    "limits",
    [{"LONGEST": 1e-4}, {"MOST_TRACKS": 40}, {"MOST_TRACKS": 100, "LONGEST": 1e-4}],
)
def test_without_time_or_all_tracks_nothing_is_proven(monkeypatch, limits):
    for name, value in limits.items():
        monkeypatch.setattr(assignment, name, value)
    paths, score = hard()
    chosen, proven = Assignment(paths, 60).best(score)
    assert is_packing(paths, chosen)
    assert len(chosen) > 0
    assert not proven
