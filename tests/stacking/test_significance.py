# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The search in features whose velocities are known."""

import tracemalloc
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from astro_scc.stacking import (
    NULLS,
    DatePairs,
    Displacements,
    NullTest,
    ScrambleNull,
    baseline_pairs,
    consecutive_pairs,
    find_velocities,
    nulls,
)

#: Standard error of a displacement; intervals of about one year.
S = 0.2
V_MAX = (4.0, 4.0)
YEARS = np.arange(8.0)


def matches(rng, velocities, *, years=YEARS, size=(8.0, 3.0), error=0.05, chance=1.0):
    """
    Features that move at given velocities, matched between all epochs.

    Each match has its own error; besides, SSPs have ``chance`` matches with
    unrelated ones, at any displacement.
    """
    velocities = np.asarray(velocities, dtype=float)
    n, n_epochs = len(velocities), len(years)
    start = rng.uniform(0, 1, (n, 2)) * size
    parts = []
    for r, t in np.argwhere(~np.eye(n_epochs, dtype=bool)):
        true = velocities * (years[t] - years[r])
        where = start + velocities * (years[r] - years[0])
        feature = np.arange(n)
        parts.append(
            (r, t, feature, where, true + rng.normal(scale=error, size=(n, 2)))
        )
        lucky = np.repeat(feature, rng.poisson(chance, n))
        motion = rng.uniform(-5, 5, (len(lucky), 2))
        parts.append((r, t, lucky, where[lucky], motion))
    feature, position, motion = (
        np.concatenate([p[k] for p in parts]) for k in (2, 3, 4)
    )
    reference, target = (np.concatenate([np.full(len(p[2]), p[k]) for p in parts])
                         for k in (0, 1))  # fmt: skip
    one = np.ones(len(feature))
    return Displacements(
        d1=motion[:, 0],
        d2=motion[:, 1],
        s1=S * one,
        s2=S * one,
        weight=rng.uniform(0.6, 1.0, len(feature)),
        reference=reference,
        target=target,
        ssp=reference * n + feature,
        target_ssp=target * n + feature,
        n_ssps=np.full(n_epochs, n),
        position=position,
        motion=motion,
    )


def streams(*parts):
    """``(number, v1, v2)`` of each."""
    return np.concatenate([np.tile(v, (n, 1)) for n, *v in parts])


def search(displacements, *, years=YEARS, pairs=None, n_trials=99, seed=0, **kwargs):
    pairs = consecutive_pairs(years) if pairs is None else pairs
    rng = np.random.default_rng(seed)
    return find_velocities(
        displacements, pairs, years, V_MAX, n_trials=n_trials, rng=rng, **kwargs
    )


def assert_found(finding, v1, v2, kind="moving"):
    assert finding.kind == kind
    assert np.hypot(finding.v1 - v1, finding.v2 - v2) < S
    assert finding.p_global <= 0.05


@pytest.fixture(scope="module")
def two():
    """Twelve slow and eight fast features, and ten with a velocity of their own."""
    rng = np.random.default_rng(1)
    own = rng.uniform(-3, 3, (10, 2))
    return matches(rng, [*streams((12, 0.8, 0.0), (8, 3.0, -0.5)), *own])


@pytest.fixture(scope="module")
def found(two):
    return search(two)


def test_two_streams_are_found_the_stronger_first(found):
    assert len(found) == 3
    assert_found(found[0], 0.8, 0.0)
    assert_found(found[1], 3.0, -0.5)
    assert found[2].kind == "uncertain"
    assert found[2].p_global > 0.05


def test_the_order_is_that_of_strength():
    d = matches(np.random.default_rng(2), streams((6, 0.8, 0.0), (14, 3.0, -0.5)))
    first, second = search(d)[:2]
    assert_found(first, 3.0, -0.5)
    assert_found(second, 0.8, 0.0)


@pytest.mark.parametrize("seed", [0, 1])
def test_uneven_dates_and_pairs_of_all_lengths(seed):
    years = np.array([0.0, 0.9, 1.7, 2.8, 4.0, 4.8, 6.1])
    rng = np.random.default_rng(seed)
    d = matches(rng, streams((10, 0.8, 0.0), (8, 2.5, -0.5)), years=years)
    first, second = search(
        d,
        years=years,
        pairs=baseline_pairs(years, 0.7, 1.4),
        n_trials=39,
        max_components=2,
    )
    assert_found(first, 0.8, 0.0)
    assert_found(second, 2.5, -0.5)


def test_what_is_explained_is_gone(two, found):
    n = len(two)
    first, second = found[:2]
    assert len(first.displacements) == n
    assert len(second.displacements) < n
    gone = set(two.ssp) - set(second.displacements.ssp)
    # The SSPs of the slow stream go, and others that had a chance match there.
    slow = set(two.ssp[two.ssp % 30 < 12])
    assert slow <= gone
    assert len(gone) < 1.5 * len(slow)
    # None is taken by halves.
    assert not gone & set(second.displacements.ssp)


def test_members_of_a_witness_are_of_one_feature(two, found):
    group = found[0].group
    assert group.shape == (len(two),)
    consecutive = np.abs(two.reference - two.target) == 1
    inside = np.all(np.abs(two.motion) < 3.9, axis=1)
    np.testing.assert_array_equal(group[consecutive & inside] >= 0, True)
    np.testing.assert_array_equal(group[~consecutive], -1)
    # True matches of a slow feature, both ways, from all epochs: one witness.
    error = two.motion - np.array([0.8, 0.0]) * (two.target - two.reference)[:, None]
    shares = []
    for feature in range(12):
        own = (two.ssp % 30 == feature) & consecutive
        own &= np.hypot(*error.T) < S
        _, counts = np.unique(group[own], return_counts=True)
        shares.append(counts.max() / own.sum())
    # Some features are too close to one another to be told apart.
    assert np.median(shares) > 0.9
    second = found[1]
    assert second.group.shape == (len(second.displacements),)


def test_numbers_of_a_finding(found):
    for finding in found:
        assert set(finding.tests) == {"scramble", "shuffle"}
        tests = finding.tests.values()
        assert finding.p_global == max(t.p_global for t in tests)
        assert finding.p_local == max(t.p_local for t in tests)
        assert finding.p_local <= finding.p_global
        worst = max(tests, key=lambda t: t.p_global)
        assert finding.p_error == worst.error
        assert finding.n_witnesses > 0
    # Each slow feature is a witness, and some chance ones are near.
    assert 12 <= found[0].n_witnesses <= 30


def test_found_velocities_are_told_from_one_another(found):
    for i, one in enumerate(found):
        for other in found[:i]:
            apart = np.hypot(one.v1 - other.v1, one.v2 - other.v2)
            assert apart > 1.5 * S


def test_the_same_seed_gives_the_same_findings(two, found):
    def numbers(findings):
        return [(f.v1, f.v2, f.kind, f.p_local, f.p_global, f.tests) for f in findings]

    assert numbers(search(two)) == numbers(found)
    other = search(two, seed=1)
    assert [f.kind for f in other] == [f.kind for f in found]
    assert [f.v1 for f in other] == [f.v1 for f in found]
    assert other[2].tests != found[2].tests


def test_what_stands_still_is_stationary_and_hides_nothing():
    d = matches(np.random.default_rng(3), streams((12, 0.0, 0.0), (10, 2.0, 0.5)))
    first, second = search(d)[:2]
    assert_found(first, 0.0, 0.0, "stationary")
    # No order of epochs tells what stands still.
    assert first.tests["shuffle"].p_global > 0.05
    assert first.p_global == first.tests["scramble"].p_global
    assert_found(second, 2.0, 0.5)


def test_features_of_many_velocities_have_none_in_common():
    """Each moves, so the shuffle rejects; none is shared, so the scramble cannot."""
    rng = np.random.default_rng(4)
    p, shuffled = [], []
    for _ in range(12):
        d = matches(rng, rng.uniform((0, -1), (4, 1), (20, 2)), chance=0.3)
        finding = search(d, n_trials=49)[0]
        p.append(finding.p_global)
        shuffled.append(finding.tests["shuffle"].p_global)
    assert np.sum(np.less_equal(p, 0.05)) <= 2
    assert np.median(shuffled) <= 0.05


def test_chance_alone_is_no_component():
    rng = np.random.default_rng(5)
    p = []
    for _ in range(12):
        d = matches(rng, np.zeros((15, 2)), chance=2)
        d = d.select(np.hypot(*d.motion.T) > 1)
        p.append(search(d, n_trials=49)[0].p_global)
    assert np.sum(np.less_equal(p, 0.05)) <= 2


def test_a_velocity_beyond_the_limit_is_not_searched(two):
    for finding in find_velocities(
        two, consecutive_pairs(YEARS), YEARS, (2.0, 2.0), n_trials=19,
        rng=np.random.default_rng(0),
    ):  # fmt: skip
        assert abs(finding.v1) <= 2
        assert abs(finding.v2) <= 2


def test_the_search_can_be_short(two):
    assert len(search(two, max_components=1)) == 1
    assert search(two, max_components=0) == []


def test_progress_counts_the_steps(two):
    steps = []
    assert len(search(two, n_trials=19, progress=steps.append)) <= len(steps)
    assert set(steps) == {1}


def test_the_level_decides(two):
    # Nothing is as sure as that, and the search ends at once.
    (only,) = search(two, n_trials=19, level=0.04)
    assert only.kind == "uncertain"
    assert only.p_global >= 0.05


class Verdict:
    """A null hypothesis with a fixed answer."""

    def __init__(self, name, *p):
        self.name, self.p = name, list(p)

    def test(self, scene, n_trials, rng):
        p = self.p.pop(0) if len(self.p) > 1 else self.p[0]
        return NullTest(p, p, n_trials, 1 / (n_trials + 1))


def test_the_largest_of_the_nulls_counts(two):
    wanted = Verdict("one", 0.01), Verdict("other", 0.04, 0.03, 0.2)
    kinds = [(f.kind, f.p_global) for f in search(two, nulls=wanted)]
    assert kinds == [("moving", 0.04), ("moving", 0.03), ("uncertain", 0.2)]


def test_what_the_shuffle_alone_rejects_is_explained_all_the_same(two):
    hidden = Verdict("scramble", 0.01, 0.01, 0.3), Verdict("shuffle", 0.6, 0.01, 0.01)
    kinds = [(f.kind, f.p_global) for f in search(two, nulls=hidden)]
    assert kinds == [("uncertain", 0.6), ("moving", 0.01), ("uncertain", 0.3)]


def empty(n_epochs):
    nothing, none = np.empty(0), np.empty(0, int)
    return Displacements(
        d1=nothing, d2=nothing, s1=nothing, s2=nothing, weight=nothing,
        reference=none, target=none, ssp=none, target_ssp=none,
        n_ssps=np.zeros(n_epochs, int),
        position=np.empty((0, 2)), motion=np.empty((0, 2)),
    )  # fmt: skip


def test_nothing_is_found_in_nothing(two):
    assert search(empty(8)) == []
    no_pairs = DatePairs(*(np.zeros(0, int),) * 2, *(np.zeros(0),) * 2, len(YEARS))
    assert search(two, pairs=no_pairs) == []
    # Matches of epochs that are no pair.
    assert search(two.select(np.abs(two.reference - two.target) > 1)) == []


@pytest.mark.parametrize("n", [1, 2])
def test_one_feature_or_two_have_no_common_velocity(n):
    d = matches(np.random.default_rng(6), [(1.0, 0.0)] * n, chance=0)
    assert search(d) == []


@pytest.mark.parametrize("n_epochs", [2, 3, 4])
def test_few_epochs_get_an_honest_answer(n_epochs):
    """However clear: two of the N! orders are the motion and its reversal."""
    years = np.arange(float(n_epochs))
    d = matches(np.random.default_rng(7), streams((30, 1.0, 0.0)), years=years)
    finding = search(d, years=years)[0]
    smallest = {2: 1.0, 3: 1 / 3, 4: 1 / 12}[n_epochs]
    assert finding.tests["shuffle"].smallest == pytest.approx(smallest)
    assert finding.p_global >= smallest
    assert finding.kind == "uncertain"


def test_without_any_displacement_all_stands_still():
    d = matches(np.random.default_rng(8), np.zeros((30, 2)), error=0.0, chance=0)
    for finding in search(d):
        assert finding.v1 == finding.v2 == 0
        assert finding.kind in ("stationary", "uncertain")
        assert np.isfinite([finding.p_local, finding.p_global, finding.p_error]).all()


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.integers(2, 5))
def test_numbers_are_finite_whatever_the_matches(seed, n, n_epochs):
    rng = np.random.default_rng(seed)
    years = np.cumsum(rng.uniform(0.5, 1.5, n_epochs))
    d = matches(rng, rng.normal(size=(n, 2)), years=years, chance=rng.choice([0, 2]))
    d = replace(d, s1=S * 2 ** rng.normal(size=len(d)))
    for f in search(d, years=years, n_trials=9, max_components=2):
        assert 0 < f.p_local <= f.p_global <= 1
        assert np.isfinite([f.v1, f.v2, f.p_error]).all()
        assert f.kind in ("moving", "stationary", "uncertain")


def test_memory_does_not_grow_with_the_trials(two, monkeypatch):
    monkeypatch.setattr(nulls, "PART_BYTES", 2**20)
    peaks = []
    for n_trials in (200, 600):
        tracemalloc.start()
        search(two, n_trials=n_trials, max_components=1)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + 400 * 2000


def test_the_default_nulls_are_both(found):
    assert [n.name for n in NULLS] == list(found[0].tests)
    assert isinstance(NULLS[0], ScrambleNull)


def wandering(rng, *, jitter, n_scales=3):
    """One feature on several scales, whose steps are not its mean velocity."""
    n_epochs = len(YEARS)
    steps = np.array([1.0, 0.0]) + rng.normal(0, jitter, (n_epochs - 1, 2))
    path = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    aside = rng.normal(0, 0.3, (n_scales, 2))
    parts = []
    for r, t in np.argwhere(~np.eye(n_epochs, dtype=bool)):
        for k in range(n_scales):
            parts.append((r, t, k, path[r] + aside[k], path[t] - path[r]))
    reference, target, scale = (np.array([p[k] for p in parts]) for k in range(3))
    position, motion = (np.array([p[k] for p in parts]) for k in (3, 4))
    motion = motion + rng.normal(0, 0.02, motion.shape)
    one = np.ones(len(parts))
    return Displacements(
        d1=motion[:, 0], d2=motion[:, 1], s1=S * one, s2=S * one, weight=one,
        reference=reference, target=target, ssp=reference * n_scales + scale,
        target_ssp=target * n_scales + scale, n_ssps=np.full(n_epochs, n_scales),
        position=position, motion=motion,
    )  # fmt: skip


@pytest.mark.parametrize("jitter", [0.0, S / 2, S])
def test_one_feature_has_no_common_velocity(jitter):
    """Seen on three scales in seven pairs, wandering or not, it is one feature."""
    for seed in range(6):
        d = wandering(np.random.default_rng(seed), jitter=jitter)
        for finding in search(d):
            assert finding.kind != "moving"
            if finding.kind == "uncertain":
                assert finding.p_global > 0.05


def test_what_one_feature_does_does_not_end_the_search():
    """A bright one outweighs a stream, and no scramble beats it."""
    rng = np.random.default_rng(2)
    stream = matches(rng, streams((12, 1.5, 0.5)), size=(8.0, 3.0))
    n = 10
    one = wandering(rng, jitter=0.0, n_scales=1)
    bright = replace(
        one, d1=-0.7 * one.d1, d2=-0.7 * one.d2, motion=-0.7 * one.motion,
        position=-0.7 * one.position - 20.0, weight=20 * one.weight,
        ssp=one.ssp + 10_000,
    )  # fmt: skip
    names = [f.name for f in fields(stream) if f.name != "n_ssps"]
    both = {k: np.concatenate([getattr(stream, k), getattr(bright, k)]) for k in names}
    found = search(Displacements(**both, n_ssps=stream.n_ssps + n))
    first = found[0]
    assert first.n_features < 3
    assert first.kind == "uncertain"
    assert np.hypot(first.v1 + 0.7, first.v2) < S
    assert any(
        f.kind == "moving" and np.hypot(f.v1 - 1.5, f.v2 - 0.5) < S for f in found
    )


def test_what_was_left_is_a_selection(two, found):
    for finding in found:
        assert finding.everything is two
        assert len(finding.displacements) == finding.left.sum() == len(finding.group)
    assert found[0].left.all()
    assert not (found[1].left & ~found[0].left).any()
