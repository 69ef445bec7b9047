# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Shares, chains and names, against counting."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.tracking import (
    Links,
    chain,
    linked_counts,
    linked_share,
    shuffled_orders,
    track_names,
)


def links_of(pairs, kinds=None):
    source, target = np.array(pairs, dtype=int).reshape(-1, 2).T
    kinds = ["link"] * len(source) if kinds is None else kinds
    zeros = np.zeros(len(source))
    return Links(source, target, np.array(kinds, "U5"), zeros.astype(int), zeros, zeros,
                 zeros)  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_chains_are_what_links_connect(seed, least):
    rng = np.random.default_rng(seed)
    # Fifteen SSPs in five epochs; one-to-one links onwards.
    pairs = [
        (3 * e + i, 3 * (e + 1) + k)
        for e in range(4)
        for i, k in enumerate(rng.permutation(3))
        if rng.random() < 0.6
    ]
    track = chain(links_of(pairs), 15, min_epochs=least)
    follower = dict(pairs)
    paths = []
    for start in sorted(set(range(15)) - set(follower.values())):
        path = [start]
        while path[-1] in follower:
            path.append(follower[path[-1]])
        paths.append(path)
    wanted = np.full(15, -1)
    for number, path in enumerate(p for p in paths if len(p) >= least):
        wanted[path] = number
    assert track.tolist() == wanted.tolist()


def test_merges_and_splits_make_no_chains():
    links = links_of(
        [(0, 2), (1, 2), (2, 3), (2, 4)], ["link", "merge", "link", "split"]
    )
    assert chain(links, 5).tolist() == [0, 1, 0, 0, 2]


def test_names_do_not_change_when_epochs_are_added(catalogue):
    rows = [[0, 50, 50, 1], [1, 50, 53, 1], [1, 80, 20, 1], [2, 80, 25, 1]]
    dates = ["2000-01-01", "2000-06-01", "2001-01-01", "2002-01-01"]

    def names(rows, track):
        ssps = catalogue(rows)
        offsets = (ssps.x - 60) * -0.1, (ssps.y - 60) * 0.1
        return track_names(track, ssps, dates, offsets, decimals=1)

    before = names(rows, [0, 0, 1, 1])
    assert before == ["20000101_s1_+1.0-1.0", "20000601_s1_+4.0+2.0"]
    more = [*rows, [2, 50, 56, 1], [3, 50, 59, 1], [3, 10, 10, 1]]
    assert names(more, [0, 0, 1, 1, 0, 0, 2])[:2] == before


def test_names_are_different_where_places_round_to_one(catalogue):
    ssps = catalogue([[0, 50, 50, 1], [0, 50, 51, 1]])
    found = track_names([0, 1], ssps, ["2000"], ([0.01, 0.02], [0, 0]), decimals=1)
    assert found == ["2000_s1_+0.0+0.0", "2000_s1_+0.0+0.0.2"]


def test_counts_are_those_of_loops(catalogue):
    rng = np.random.default_rng(1)
    rows = np.column_stack([rng.integers(0, 4, 40), rng.uniform(5, 90, (40, 2)),
                            np.ones(40)])  # fmt: skip
    ssps = catalogue(rows, scale=rng.integers(1, 3, 40))
    links = links_of([(i, i) for i in rng.permutation(40)[:20]])
    track = rng.integers(-1, 2, 40)
    select = rng.random(40) < 0.7
    place = np.array([2, 0, 3, 1])
    found = linked_counts(
        links, ssps, [1.0, 2.0], 4, track=track, select=select, place=place
    )
    assert found.shape == (2, 2, 3)
    for k, scale in enumerate((1, 2)):
        for at in range(3):
            own = [i for i in range(40) if select[i] and ssps.scale[i] == scale
                   and place[ssps.epoch[i]] == at]  # fmt: skip
            linked = [i for i in own if i in links.source and track[i] >= 0]
            assert found[:, k, at].tolist() == [len(linked), len(own)]


def test_the_error_is_that_of_resampled_epochs():
    rng = np.random.default_rng(2)
    total = np.full((1, 30), 20)
    linked = rng.binomial(20, 0.6, (1, 30))
    share = linked_share(np.stack([linked, total]), [], [1.0], rng=3)[0]
    assert share.share == pytest.approx(linked.sum() / 600)
    assert share.share_err == pytest.approx(np.sqrt(0.24 / 600), rel=0.3)
    assert np.isnan(share.shuffled)
    assert np.isnan(share.p_value)


def test_shuffled_orders_are_counted():
    counts = np.array([[[4, 4]], [[8, 8]]])
    trials = [np.array([[[n, n]], [[8, 8]]]) for n in (1, 2, 4)]
    every, one = linked_share(counts, trials, [2.0], rng=1)
    assert every.scale is None
    assert one.scale == 2.0
    assert one.shuffled == pytest.approx(7 / 24)
    assert one.p_value == pytest.approx(2 / 4)


def test_nothing_to_count():
    share = linked_share(np.zeros((2, 1, 3), int), [], [1.0], rng=1)[0]
    assert (share.share, share.share_err, share.n_ssps) == (0.0, 0.0, 0)


def test_orders_are_permutations():
    orders = shuffled_orders(7, 5, rng=1)
    assert np.all(np.sort(orders, axis=1) == np.arange(7))
    assert np.array_equal(orders, shuffled_orders(7, 5, rng=1))
    assert shuffled_orders(7, 0).shape == (0, 7)
