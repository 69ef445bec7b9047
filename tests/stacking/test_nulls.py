# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Null hypotheses: valid where they hold, rejected where they do not."""

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom

from astro_scc.stacking import (
    NULLS,
    AllOrders,
    Contrast,
    Displacements,
    NullTest,
    ScrambleNull,
    ShuffleNull,
    WithoutSuccessors,
    Witnesses,
    baseline_pairs,
    consecutive_pairs,
    nulls,
    stack,
)
from astro_scc.stacking.nulls import Scene

S = 0.3
V_MAX = (3.0, 3.0)


def scene_of(v1, v2, *, s=S, weight=1.0, displacements=None, pairs=None, at=None):
    """A scene whose velocity is the one of the largest contrast, or the next to at."""
    v1, v2, s, weight = (
        np.array(a, dtype=float) for a in np.broadcast_arrays(v1, v2, s, weight)
    )
    n = len(v1)
    w = Witnesses(v1, v2, s, s.copy(), weight, np.ones(n, int), np.arange(n))
    contrast = Contrast.of(w, V_MAX)
    observed = contrast.maps(v1[None], v2[None], weight, range(4))[:, 0]
    grid = contrast.grid
    if at is None:
        least = observed.min(axis=0)
        row, column = np.unravel_index(least.argmax(), least.shape)
    else:
        row, column = np.abs(grid.v2 - at[1]).argmin(), np.abs(grid.v1 - at[0]).argmin()
    return Scene(
        displacements=displacements,
        pairs=pairs,
        witnesses=w,
        contrast=contrast,
        observed=observed,
        row=int(row),
        column=int(column),
        free=np.ones(grid.shape, dtype=bool),
    )


def poisson(rng, density=1.0, reach=6.0):
    """Velocities of no preference, ``density`` of them a square standard error."""
    n = rng.poisson(density * (2 * reach / S / 10) ** 2)
    return rng.uniform(-reach, reach, (2, max(n, 3)))


# The scramble.


def scramble_p(rng, n_scenes, n_trials, density=1.0):
    return np.array(
        [
            ScrambleNull()
            .test(scene_of(*poisson(rng, density)), n_trials, rng)
            .p_global
            for _ in range(n_scenes)
        ]
    )


def assert_valid(p, levels):
    """No more of them below a level than chance allows, once in a thousand runs."""
    for level in levels:
        assert (p <= level).sum() <= binom.ppf(0.999, len(p), level)


def test_scramble_of_witnesses_of_no_preference_is_valid():
    p = scramble_p(np.random.default_rng(0), 60, 39)
    assert_valid(p, (0.05, 0.1, 0.25, 0.5))
    assert p.min() < 0.7


@pytest.mark.slow
@pytest.mark.parametrize("density", [0.3, 1.0, 4.0])
def test_scramble_is_valid_whatever_the_density(density):
    p = scramble_p(np.random.default_rng(1), 200, 99, density)
    assert_valid(p, (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5))


def background(rng, n=100):
    return rng.uniform(-5, 5, (2, n))


def test_scramble_finds_a_clump():
    rng = np.random.default_rng(2)
    v = np.concatenate(
        [background(rng), rng.normal([[1.0], [0.5]], 0.5 * S, (2, 40))], axis=1
    )
    scene = scene_of(*v)
    assert np.hypot(scene.velocity[0] - 1, scene.velocity[1] - 0.5) < S
    test = ScrambleNull().test(scene, 99, rng)
    assert test.p_global == test.p_local == test.smallest == 1 / 100
    assert test.n_trials == 99


@pytest.mark.parametrize("angle", [0, 45, 90, 135, 20])
def test_a_ridge_is_no_clump(angle):
    """Velocities that differ in one direction only, as along a jet."""
    rng = np.random.default_rng(3)
    along = rng.uniform(-5, 5, 150)
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    across = rng.normal(scale=0.5 * S, size=150)
    scene = scene_of(along * c - across * s, along * s + across * c)
    assert ScrambleNull().test(scene, 99, rng).p_global > 0.1


def test_a_clump_on_a_ridge_is_found():
    rng = np.random.default_rng(4)
    along = np.concatenate([rng.uniform(-5, 5, 100), rng.normal(1.5, 0.7 * S, 30)])
    scene = scene_of(along, rng.normal(scale=0.5 * S, size=130))
    assert abs(scene.velocity[0] - 1.5) < S
    assert ScrambleNull().test(scene, 99, rng).p_global <= 0.02


def test_counts_are_those_of_the_trials_one_after_another():
    """``(b + 1) / (n + 1)`` of each direction, the largest of them."""
    rng = np.random.default_rng(5)
    v = np.concatenate([background(rng, 60), rng.normal(1, S, (2, 6))], axis=1)
    scene = scene_of(*v)
    test = ScrambleNull().test(scene, 120, np.random.default_rng(6))
    observed = scene.observed[:, scene.row, scene.column]
    again = np.random.default_rng(6)
    w, slow = scene.witnesses, []
    for u, (e1, e2) in enumerate(
        [(1, 0), (0, 1), (0.5**0.5, 0.5**0.5), (0.5**0.5, -(0.5**0.5))]
    ):
        above = above_here = n = 0
        while n < 120 and above < 30:
            for _ in range(min(50, 120 - n)):
                shift = again.uniform(-4, 4, len(w))
                t = scene.contrast.maps(
                    (w.v1 + shift * S * e1)[None], (w.v2 + shift * S * e2)[None],
                    w.weight, [u],
                )[0, 0]  # fmt: skip
                above += t.max() >= observed[u]
                above_here += t[scene.row, scene.column] >= observed[u]
                n += 1
        slow.append(((above + 1) / (n + 1), (above_here + 1) / (n + 1), n))
    assert test.p_global == pytest.approx(max(p for p, _, _ in slow))
    assert test.p_local == pytest.approx(max(p for _, p, _ in slow))
    assert test.n_trials == max(slow)[2]
    assert 1 / 121 < test.p_global < 1


def test_what_is_nothing_ends_early():
    rng = np.random.default_rng(7)
    scene = scene_of(*background(rng))
    test = ScrambleNull().test(scene, 10_000, rng)
    assert test.n_trials <= 500
    assert test.n_trials % 50 == 0
    assert test.p_global >= 31 / (test.n_trials + 1)
    assert test.smallest == 1 / 10_001


def test_only_free_velocities_are_compared():
    rng = np.random.default_rng(8)
    strong = rng.normal([[-1.5], [0.0]], 0.3 * S, (2, 40))
    weak = rng.normal([[1.5], [0.0]], 0.3 * S, (2, 12))
    scene = scene_of(
        *np.concatenate([background(rng), strong, weak], axis=1), at=(1.5, 0.0)
    )
    assert ScrambleNull().test(scene, 49, rng).p_global > 0.1
    grid = scene.grid
    away = np.hypot(grid.v1 + 1.5, grid.v2[:, None]) > 5 * S
    free = replace(scene, free=away)
    assert ScrambleNull().test(free, 49, rng).p_global <= 0.04


# The shuffle.


def jet(rng, n_epochs, velocity, *, n=15, years=None, error=0.05, chance=1):
    """Features of one velocity matched between all epochs, and chance matches."""
    years = np.arange(n_epochs, dtype=float) if years is None else np.asarray(years)
    reference, target = np.nonzero(~np.eye(n_epochs, dtype=bool))
    parts = []
    for r, t in zip(reference, target, strict=True):
        true = np.array(velocity) * (years[t] - years[r])
        parts.append((r, t, true + rng.normal(scale=error, size=(n, 2))))
        parts += [(r, t, rng.uniform(-4, 4, (n, 2))) for _ in range(chance)]
    d = np.concatenate([p[2] for p in parts])
    reference, target = (np.repeat([p[k] for p in parts], n) for k in (0, 1))
    feature = np.tile(np.arange(n), len(parts))
    return Displacements(
        d1=d[:, 0],
        d2=d[:, 1],
        s1=np.full(len(d), S),
        s2=np.full(len(d), S),
        weight=rng.uniform(0.6, 1, len(d)),
        reference=reference,
        target=target,
        ssp=reference * n + feature,
        target_ssp=target * n + feature,
        n_ssps=np.full(n_epochs, n) + np.arange(n_epochs),
    )


def shuffle_scene(displacements, years, *, at, pairs=None):
    """What a shuffle needs: the grid and its errors come from some witnesses."""
    rng = np.random.default_rng(0)
    pairs = consecutive_pairs(years) if pairs is None else pairs
    return scene_of(
        *background(rng, 30), displacements=displacements, pairs=pairs, at=at
    )


EVEN = np.arange(5.0)
UNEVEN = np.array([0.0, 0.7, 1.9, 2.8, 4.0])


def slow_shuffle(scene, orders):
    """Excess at the velocity, and the largest, one stack after another."""
    grid = scene.grid
    orders = [np.arange(scene.pairs.n_dates), *orders]
    d = scene.displacements.both_ways()
    stacks = np.array([stack(d, scene.pairs, grid, order=o) for o in orders])
    excess = stacks - stacks.mean(axis=0)
    here = excess[:, scene.row, scene.column]
    moving = (grid.v1 / S) ** 2 + (grid.v2[:, None] / S) ** 2 > 0.75**2
    largest = excess[:, moving & scene.free].max(axis=1)
    return here, np.maximum(largest, here), stacks.max()


@pytest.mark.parametrize(
    ("years", "pairs"),
    [
        (EVEN, None),
        (UNEVEN, None),
        (UNEVEN, baseline_pairs(UNEVEN, 0.8, 2.2)),
        (np.arange(7.0), None),
    ],
)
@pytest.mark.parametrize("at", [(0.6, 0.1), (0.0, 0.0), (-1.4, 2.0)])
def test_p_is_that_of_the_stacks_of_all_orders(years, pairs, at):
    n_epochs = len(years)
    # Few matches, or every p is the smallest.
    d = jet(np.random.default_rng(1), n_epochs, (0.6, 0.1), n=2, years=years, error=0.3)
    scene = shuffle_scene(d, years, at=at, pairs=pairs)
    test = ShuffleNull().test(scene, 119, np.random.default_rng(2))
    orders = AllOrders().draw(n_epochs, 119, np.random.default_rng(2))
    here, largest, height = slow_shuffle(scene, orders)
    assert test.n_trials == len(orders) == 119
    # A map of a pair stands for its matches to within 1e-3 of the maximum.
    for margin, compare in ((-2e-3, np.less_equal), (2e-3, np.greater_equal)):
        threshold = here[0] + margin * height
        p_global = ((largest[1:] >= threshold).sum() + 1) / 120
        p_local = ((here[1:] >= threshold).sum() + 1) / 120
        assert compare(test.p_global, max(p_global, test.smallest))
        assert compare(test.p_local, max(p_local, test.smallest))


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_no_p_is_below_two_of_all_orders(n):
    """However clear the motion: reversed in time it is motion as well."""
    d = jet(np.random.default_rng(3), n, (1.0, 0.0), chance=0)
    scene = shuffle_scene(d, np.arange(float(n)), at=(1.0, 0.0))
    test = ShuffleNull().test(scene, 1000, np.random.default_rng(0))
    assert test.smallest == pytest.approx(2 / math.factorial(n))
    assert test.p_global == pytest.approx(test.smallest)
    assert test.p_local == pytest.approx(test.smallest)
    assert test.n_trials == math.factorial(n) - 1
    assert test.exhaustive
    assert test.error == 0.0


@pytest.mark.parametrize("seed", range(8))
def test_orders_and_their_reversals_tie(seed):
    """With even dates the largest excess of both is the same: they come in twos."""
    d = jet(np.random.default_rng(seed), 5, (0.5, 0.0), n=2, error=0.5)
    d = replace(d, n_ssps=np.full(5, 2))
    scene = shuffle_scene(d, EVEN, at=(0.5, 0.0))
    p = ShuffleNull().test(scene, 119, np.random.default_rng(0)).p_global
    assert round(p * 120) % 2 == 0


def test_with_fewer_trials_than_orders_p_is_bounded_by_the_trials():
    d = jet(np.random.default_rng(4), 7, (1.0, 0.0))
    scene = shuffle_scene(d, np.arange(7.0), at=(1.0, 0.0))
    test = ShuffleNull().test(scene, 99, np.random.default_rng(0))
    assert test.smallest == test.p_global == 1 / 100
    assert not test.exhaustive


def test_what_stands_still_has_no_order():
    d = jet(np.random.default_rng(5), 6, (0.0, 0.0))
    scene = shuffle_scene(d, np.arange(6.0), at=(0.0, 0.0))
    test = ShuffleNull().test(scene, 99, np.random.default_rng(0))
    assert test.p_global > 0.1
    assert test.p_local > 0.1


@pytest.mark.parametrize("years", [np.arange(6.0), [0.0, 0.4, 1.9, 2.5, 4.0, 4.6]])
def test_what_moves_has_an_order(years):
    d = jet(np.random.default_rng(6), 6, (0.8, -0.4), years=years)
    scene = shuffle_scene(d, years, at=(0.8, -0.4))
    test = ShuffleNull().test(scene, 199, np.random.default_rng(0))
    assert test.p_global <= 0.01


def test_unrelated_epochs_are_valid():
    rng = np.random.default_rng(7)
    p = []
    for _ in range(40):
        d = jet(rng, 5, (0, 0), n=1, chance=4, error=4)
        at = rng.uniform(-2, 2, 2)
        p.append(ShuffleNull().test(shuffle_scene(d, EVEN, at=at), 119, rng).p_global)
    assert_valid(np.array(p), (0.05, 0.1, 0.25, 0.5))


def test_free_velocities_alone_are_compared_in_the_shuffle():
    rng = np.random.default_rng(8)
    slow, fast = jet(rng, 6, (0.5, 0.0), n=4), jet(rng, 6, (2.0, 0.0), chance=0)
    both = replace(
        slow,
        **{
            name: np.concatenate([getattr(slow, name), getattr(fast, name)])
            for name in ("d1", "d2", "s1", "s2", "weight", "reference", "target",
                         "ssp", "target_ssp")
        },
    )  # fmt: skip
    scene = shuffle_scene(both, np.arange(6.0), at=(0.5, 0.0))
    rng = np.random.default_rng
    assert ShuffleNull().test(scene, 99, rng(0)).p_global > 0.1
    free = np.abs(scene.grid.v1) + 0 * scene.grid.v2[:, None] < 1.0
    alone = ShuffleNull().test(replace(scene, free=free), 99, rng(0))
    assert alone.p_global < 0.05


def test_without_matches_or_other_orders_p_is_one():
    d = jet(np.random.default_rng(9), 5, (1.0, 0.0))
    none = d.select(np.zeros(len(d), bool))
    scene = shuffle_scene(none, EVEN, at=(1, 0))
    test = ShuffleNull().test(scene, 99, np.random.default_rng(0))
    assert (test.p_local, test.p_global, test.smallest) == (1.0, 1.0, 1.0)
    two = jet(np.random.default_rng(9), 2, (1.0, 0.0))
    scene = shuffle_scene(two, [0.0, 1.0], at=(1, 0))
    test = ShuffleNull().test(scene, 99, np.random.default_rng(0))
    assert (test.p_local, test.p_global, test.n_trials) == (1.0, 1.0, 1)


@pytest.mark.parametrize("part_bytes", [1, 20_000, 300_000])
def test_parts_of_the_grid_give_the_same_numbers(part_bytes, monkeypatch):
    d = jet(np.random.default_rng(10), 6, (0.5, 0.2), n=2, error=0.4)
    scene = shuffle_scene(d, np.arange(6.0), at=(0.5, 0.2))
    whole = ShuffleNull().test(scene, 99, np.random.default_rng(0))
    monkeypatch.setattr(nulls, "PART_BYTES", part_bytes)
    assert ShuffleNull().test(scene, 99, np.random.default_rng(0)) == whole


def peak_memory(null, scene, n_trials):
    tracemalloc.start()
    null.test(scene, n_trials, np.random.default_rng(0))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


@pytest.mark.parametrize("null", NULLS)
def test_memory_does_not_grow_with_the_trials(null, monkeypatch):
    monkeypatch.setattr(nulls, "PART_BYTES", 2**20)
    d = jet(np.random.default_rng(11), 6, (1.0, 0.0), n=5)
    clump = np.full(40, 1.0), np.zeros(40)
    scene = scene_of(*clump, displacements=d, pairs=consecutive_pairs(np.arange(6.0)))
    few, many = (peak_memory(null, scene, n) for n in (150, 600))
    # Of a trial only its order is kept, and how often an image pair occurs.
    assert many < few + 600 * 2000
    assert many < 2**23


def test_the_nulls_of_the_search():
    assert [null.name for null in NULLS] == ["scramble", "shuffle"]
    assert ShuffleNull(WithoutSuccessors()).name == "paper"


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.sampled_from(NULLS))
def test_p_of_one_velocity_is_at_most_that_of_any(seed, null):
    rng = np.random.default_rng(seed)
    d = jet(rng, 4, rng.uniform(-1, 1, 2), n=2, error=0.5)
    scene = scene_of(
        *background(rng, 20),
        displacements=d,
        pairs=consecutive_pairs(np.arange(4.0)),
        at=rng.choice([0.0, 0.1, 1.0], 2),
    )
    test = null.test(scene, 23, rng)
    assert 0 < test.smallest <= test.p_local <= test.p_global <= 1


def test_error_is_that_of_a_share():
    assert NullTest(0.1, 0.2, 99, 0.01).error == pytest.approx(np.sqrt(0.2 * 0.8 / 100))
    assert NullTest(1.0, 1.0, 99, 0.01).error == 0.0
    # Of all orders there is no other draw.
    assert NullTest(0.1, 0.2, 119, 0.01, exhaustive=True).error == 0.0
