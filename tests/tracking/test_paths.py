# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Gains of links, against all paths written out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.tracking import Transitions, link_gains


def all_paths(source, target, use, start):
    """All paths of candidates that begin with one."""
    yield (start,)
    for k in np.flatnonzero((source == target[start]) & use):
        for rest in all_paths(source, target, use, k):
            yield (start, *rest)


def slow_gains(source, target, value, between, use):
    n = len(source)
    paths = [
        p for e in range(n) for p in all_paths(source, target, np.ones(n, bool), e)
    ]

    def worth(path):
        steps = zip(path[:-1], path[1:], strict=True)
        return value[list(path)].sum() + sum(between[pair] for pair in steps)

    gains = []
    for e in range(n):
        through = max(
            worth(p) for p in paths if e in p and all(use[k] or k == e for k in p)
        )
        used = [p for p in paths if all(use[k] for k in p)]
        ends = [worth(p) for p in used if target[p[-1]] == source[e]]
        begins = [worth(p) for p in used if source[p[0]] == target[e]]
        gains.append(through - max([0, *ends]) - max([0, *begins]))
    return gains


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_gains_are_those_of_all_paths(seed):
    rng = np.random.default_rng(seed)
    step = np.array([0, 0, 1, 1, 2, 2, 3])
    every = [(i, k) for i in range(7) for k in range(7) if 0 < step[k] - step[i] <= 2]
    pick = rng.permutation(len(every))[:8]
    source, target = np.array(every)[pick].T
    value = rng.normal(0.5, 1, len(pick))
    use = rng.random(len(pick)) < 0.7
    transitions = Transitions.of(source, target, 7)
    values = rng.normal(0, 1, len(transitions.before))
    between = dict(
        zip(zip(transitions.before.tolist(), transitions.after.tolist(), strict=True),
            values, strict=True)
    )  # fmt: skip
    gains = link_gains(
        source, target, value, transitions, np.stack([values, values]), step, 7, use=use
    )
    assert gains == pytest.approx(slow_gains(source, target, value, between, use))


def test_transitions_are_all_pairs_that_meet():
    rng = np.random.default_rng(1)
    source, target = rng.integers(0, 6, 20), rng.integers(0, 6, 20)
    found = Transitions.of(source, target, 6)
    wanted = {(a, b) for a in range(20) for b in range(20) if target[a] == source[b]}
    assert set(zip(found.before.tolist(), found.after.tolist(), strict=True)) == wanted


def test_no_candidates_no_gains():
    none = np.empty(0, dtype=int)
    found = Transitions.of(none, none, 3)
    assert len(found.before) == 0
    between = np.empty((2, 0))
    gains = link_gains(none, none, np.empty(0), found, between, np.arange(3), 3)
    assert len(gains) == 0
