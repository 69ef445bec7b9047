# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Links of features whose motions are known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from astro_scc.tracking.candidates import Candidates, equal_pairs
from astro_scc.tracking.likelihood import LinkLikelihood
from astro_scc.tracking.linking import Links, assign, chains, link, path_gains


def everything(ssps, *, most=20.0, max_gap=1):
    """All pairs of later epochs within a distance, correlated perfectly."""
    step = ssps.epoch[None, :] - ssps.epoch[:, None]
    dy, dx = (v[None, :] - v[:, None] for v in (ssps.y, ssps.x))
    near = np.hypot(dy, dx) <= most * np.maximum(step, 1)
    same = ssps.scale[None, :] == ssps.scale[:, None]
    i, k = np.nonzero((step > 0) & (step <= max_gap + 1) & near & same)
    gap = step[i, k] - 1
    return Candidates(i, k, dy[i, k], dx[i, k], gap + 1.0, gap, np.full(len(i), 0.97))


def streams(seed=1, n_epochs=6):
    """Two streams that pass through one another."""
    rng = np.random.default_rng(seed)
    rows, feature = [], []
    for k in range(12):
        speed, y = (3.0, 20 + 10 * k) if k < 6 else (15.0, 23 + 10 * (k - 6))
        x, peak = rng.uniform(40, 100), rng.uniform(0.5, 2)
        for t in range(n_epochs):
            jitter = rng.normal(0, 0.4, 2)
            rows.append([t, y + jitter[0], x + speed * t + jitter[1], peak])
            feature.append(k)
    return np.array(rows), np.array(feature)


@pytest.mark.parametrize("seed", range(4))
def test_streams_of_two_speeds_are_distinguished(catalogue, seed):
    rows, feature = streams(seed)
    ssps = catalogue(rows)
    links = link(everything(ssps), ssps)
    assert len(links) == 12 * 5
    assert np.array_equal(feature[links.source], feature[links.target])
    assert np.all(links.gap == 0)
    assert set(links.kind) == {"link"}


@pytest.mark.parametrize(("x", "linked"), [(124, True), (112, False)])
def test_a_track_predicts_more_than_its_last_step(catalogue, x, linked):
    # Steady, but for a last step that is too short; then eight times the interval.
    # The mean velocity leads to 124, the last step to 112.
    rows = [[t, 50, 50 + 4.0 * t, 1] for t in range(12)]
    rows[11][2] -= 1.5
    ssps = catalogue([*rows, [12, 50, x, 1]])
    pairs = everything(ssps, most=60.0, max_gap=0)
    pairs = replace(pairs, interval=np.where(ssps.epoch[pairs.target] == 12, 8.0, 1.0))
    found = link(pairs, ssps, likelihood=LinkLikelihood(tolerance=1.0))
    assert list(found.source) == list(range(12 if linked else 11))


def test_a_feature_that_is_missing_at_a_date_is_taken_up_again(catalogue):
    rows, feature = streams()
    gone = (feature == 3) & (rows[:, 0] == 2)
    ssps = catalogue(rows[~gone])
    links = link(everything(ssps), ssps)
    feature = feature[~gone]
    assert np.array_equal(feature[links.source], feature[links.target])
    own = feature[links.source] == 3
    assert sorted(links.gap[own]) == [0, 0, 0, 1]


def test_one_pattern_follows_the_larger_one_that_it_lies_in(catalogue):
    # Two equal partners: only the larger pattern says which.
    ssps = catalogue(
        [[0, 50, 50, 1], [1, 50, 42, 1], [1, 50, 58, 1],
         [0, 50, 51, 2], [1, 50, 59, 2]],
        scale=[1, 1, 1, 2, 2],
    )  # fmt: skip
    parent = np.array([3, -1, 4, -1, -1])
    likelihood = LinkLikelihood(follow=0.9)
    found = link(everything(ssps), ssps, parent=parent, likelihood=likelihood)
    assert (0, 2) in list(zip(found.source, found.target, strict=True))
    mirrored = everything(ssps)
    away = link(mirrored, ssps, likelihood=likelihood)
    gains = {(i, k): g for i, k, g in zip(away.source, away.target, away.gain,
                                          strict=True)}  # fmt: skip
    assert found.gain[found.source == 0] > gains.get((0, 2), gains.get((0, 1)))


def test_nothing_to_link(catalogue):
    ssps = catalogue([[0, 10, 10, 1], [1, 300, 300, 1]])
    links = link(everything(ssps), ssps)
    assert len(links) == 0
    assert repr(links) == "<Links: 0 links, 0 merges, 0 splits>"
    empty = catalogue([])
    assert len(link(everything(empty), empty)) == 0


def test_a_merge_and_a_split_are_recorded(catalogue):
    # Two neighbours of unequal flux become one of their sum, and part again.
    rows = [[0, 50, 50, 1.0], [0, 50, 54, 0.8], [1, 50, 53, 1.8],
            [2, 50, 54, 1.0], [2, 50, 58, 0.8], [3, 50, 56, 1.0]]  # fmt: skip
    ssps = catalogue(rows)
    links = link(everything(ssps, max_gap=0), ssps)
    kinds = {(int(i), int(k)): str(kind) for i, k, kind in
             zip(links.source, links.target, links.kind, strict=True)}  # fmt: skip
    assert sorted(kinds.get(p, "") for p in ((0, 2), (1, 2))) == ["link", "merge"]
    assert sorted(kinds.get(p, "") for p in ((2, 3), (2, 4))) == ["link", "split"]


# -- paths ---------------------------------------------------------------------------


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
    transitions = equal_pairs(target, source)
    values = rng.normal(0, 1, len(transitions[0]))
    pairs = zip(*(part.tolist() for part in transitions), strict=True)
    between = dict(zip(pairs, values, strict=True))
    zeros = np.zeros(len(pick))
    gains = path_gains(
        Candidates(source, target, zeros, zeros, zeros, zeros, zeros), value,
        transitions, np.stack([values, values]), step, use=use,
    )  # fmt: skip
    assert gains == pytest.approx(slow_gains(source, target, value, between, use))


# -- tracks --------------------------------------------------------------------------


def links_of(pairs, kinds=None):
    source, target = np.array(pairs, dtype=int).reshape(-1, 2).T
    kinds = ["link"] * len(source) if kinds is None else kinds
    zeros = np.zeros((5, len(source)))
    return Links(source, target, *zeros, np.array(kinds, "U5"), zeros[0])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_chains_are_what_links_connect(catalogue, seed, least):
    rng = np.random.default_rng(seed)
    # Fifteen SSPs in five epochs; one-to-one links onwards.
    pairs = [
        (3 * e + i, 3 * (e + 1) + k)
        for e in range(4)
        for i, k in enumerate(rng.permutation(3))
        if rng.random() < 0.6
    ]
    ssps = catalogue([[k // 3, 50, 50 + k, 1] for k in range(15)])
    found = chains(links_of(pairs), ssps, min_epochs=least)
    follower = dict(pairs)
    paths = []
    for start in sorted(set(range(15)) - set(follower.values())):
        path = [start]
        while path[-1] in follower:
            path.append(follower[path[-1]])
        paths.append(path)
    wanted = [path for path in paths if len(path) >= least]
    assert [ssp.tolist() for ssp in found] == wanted


def best_total(row, column, weight):
    """Largest total weight, by trying every choice."""
    if len(row) == 0:
        return 0.0
    rest = list(range(1, len(row)))
    without = best_total(row[rest], column[rest], weight[rest])
    free = [k for k in rest if row[k] != row[0] and column[k] != column[0]]
    with_it = weight[0] + best_total(row[free], column[free], weight[free])
    return max(without, with_it)


pairs = st.lists(
    st.tuples(st.integers(0, 4), st.integers(0, 4), st.integers(-3, 8)), max_size=9
)


@settings(max_examples=60, deadline=None)
@given(pairs)
def test_it_is_the_best_choice_and_one_to_one(found):
    row, column, weight = (np.array(v, dtype=int) for v in zip(*found, strict=True)
                           ) if found else (np.empty(0, int),) * 3  # fmt: skip
    chosen = assign(row, column, weight)
    assert len(set(row[chosen])) == len(set(column[chosen])) == chosen.sum()
    assert weight[chosen].sum() == best_total(row, column, weight)
    assert np.all(weight[chosen] > 0)


@pytest.mark.parametrize("seed", range(3))
def test_large_choices_are_as_good_as_those_of_a_full_table(seed):
    rng = np.random.default_rng(seed)
    row, column = rng.integers(0, 60, (2, 400))
    weight = rng.uniform(0.5, 1, 400)
    table = np.zeros((60, 60))
    np.maximum.at(table, (row, column), weight)
    chosen = assign(row, column, weight)
    assert len(set(row[chosen])) == len(set(column[chosen])) == chosen.sum()
    best = table[linear_sum_assignment(table, maximize=True)].sum()
    assert weight[chosen].sum() == pytest.approx(best)
