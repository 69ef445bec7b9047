# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Links of features whose motions are known."""

from dataclasses import replace

import numpy as np
import pytest

from astro_scc.tracking import Candidates, Evidence, link


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
def test_streams_of_two_speeds_are_told_apart(catalogue, seed):
    rows, feature = streams(seed)
    ssps = catalogue(rows)
    links = link(everything(ssps), ssps)
    assert len(links) == 12 * 5
    assert np.array_equal(feature[links.source], feature[links.target])
    assert np.all(links.gap == 0)
    assert set(links.kind) == {"link"}


@pytest.mark.parametrize(("x", "linked"), [(124, True), (112, False)])
def test_a_track_foretells_more_than_its_last_step(catalogue, x, linked):
    # Steady, but for a last step that is too short; then eight times the interval.
    # The mean velocity leads to 124, the last step to 112.
    rows = [[t, 50, 50 + 4.0 * t, 1] for t in range(12)]
    rows[11][2] -= 1.5
    ssps = catalogue([*rows, [12, 50, x, 1]])
    pairs = everything(ssps, most=60.0, max_gap=0)
    pairs = replace(pairs, interval=np.where(ssps.epoch[pairs.target] == 12, 8.0, 1.0))
    found = link(pairs, ssps, evidence=Evidence(tolerance=1.0))
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


def test_images_in_another_order(catalogue):
    rows, feature = streams()
    place = np.array([3, 0, 5, 1, 4, 2])
    shuffled = rows.copy()
    shuffled[:, 0] = np.argsort(place)[rows[:, 0].astype(int)]
    ssps = catalogue(shuffled)
    plain = everything(catalogue(rows))
    links = link(plain, ssps, place=place)
    assert np.array_equal(feature[links.source], feature[links.target])
    assert len(links) == 60


def test_one_pattern_follows_the_larger_one_that_it_lies_in(catalogue):
    # Two equal partners: only the larger pattern says which.
    ssps = catalogue(
        [[0, 50, 50, 1], [1, 50, 42, 1], [1, 50, 58, 1],
         [0, 50, 51, 2], [1, 50, 59, 2]],
        scale=[1, 1, 1, 2, 2],
    )  # fmt: skip
    parent = np.array([3, -1, 4, -1, -1])
    found = link(everything(ssps), ssps, parent=parent, evidence=Evidence(follow=0.9))
    assert (0, 2) in list(zip(found.source, found.target, strict=True))
    mirrored = everything(ssps)
    away = link(mirrored, ssps, evidence=Evidence(follow=0.9))
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


def test_three_go_into_one_but_not_four(catalogue):
    peaks = [1.0, 0.7, 0.7, 0.2]
    rows = [[0, 50, 50 + 4 * k, p] for k, p in enumerate(peaks)]
    ssps = catalogue([*rows, [1, 50, 54, sum(peaks)]])
    links = link(
        everything(ssps, max_gap=0),
        ssps,
        evidence=Evidence(variability=1.0, tolerance=5),
    )
    assert len(links) <= 3
    assert np.sum(links.kind == "link") == 1


def test_what_is_far_away_does_not_merge(catalogue):
    rows = [[0, 50, 50, 1.0], [0, 50, 90, 0.8], [1, 50, 53, 1.8]]
    ssps = catalogue(rows)
    links = link(everything(ssps, most=100, max_gap=0), ssps)
    assert not np.isin(links.kind, ["merge", "split"]).any()
