# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Orders of the epochs, the stack against the paper's sums, and its components."""

from dataclasses import replace
from math import exp

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.stats import chisquare

from astro_scc.paper import (
    Displacements,
    baseline_pairs,
    consecutive_pairs,
    draw_orders,
    image_pairs,
    stack_patterns,
)
from astro_scc.paper.stack import stack_matches, velocity_axes

COARSE = velocity_axes((4.0, 3.0), (0.5, 0.6))
EVEN = np.arange(12.0) / 2


def random_displacements(rng, n_epochs=4, n=60, *, reach=3.0, s=(0.2, 0.6)):
    """Matches between random epochs, of SSPs that exist, some landing on none."""
    n_ssps = rng.integers(1, 9, n_epochs)
    first = np.cumsum(n_ssps) - n_ssps
    reference = rng.integers(n_epochs, size=n)
    target = (reference + rng.integers(1, n_epochs, size=n)) % n_epochs
    landed = first[target] + rng.integers(n_ssps[target])
    columns = *rng.uniform(-reach, reach, (2, n)), *rng.uniform(*s, (2, n))
    return Displacements(
        *columns, weight=rng.uniform(0.5, 1.0, n), reference=reference, target=target,
        ssp=first[reference] + rng.integers(n_ssps[reference]), n_ssps=n_ssps,
        target_ssp=np.where(rng.random(n) < 0.2, -1, landed),
    )  # fmt: skip


def flows(rng, speeds, years=EVEN, *, n=4, length=40.0, noise=0.1):
    """All matches within 3.5 of features that move, new ones coming in."""
    time = years - years[0]
    places, epochs = [], []
    for speed in speeds:
        start = rng.uniform(-abs(speed) * time[-1], length, n * 3)
        for epoch, t in enumerate(time):
            x = start + speed * t
            x = x[(x > 0) & (x < length)]
            y = rng.normal(scale=0.3, size=len(x))
            places.append(np.stack([x, y], axis=1) + rng.normal(0, noise, (len(x), 2)))
            epochs.append(np.full(len(x), epoch))
    place, epoch = np.concatenate(places), np.concatenate(epochs)
    away = place - place[:, None]
    near = (np.abs(away) < 3.5).all(axis=2) & (epoch[:, None] != epoch)
    i, j = np.nonzero(near)
    s = np.full(len(i), 0.2)
    return Displacements(
        *away[i, j].T, s, s, np.full(len(i), 0.9), epoch[i], epoch[j], i, j,
        np.bincount(epoch, minlength=len(years)),
    )  # fmt: skip


def measure(d, pairs, n_trials=60, *, seed=0, **options):
    rng = np.random.default_rng(seed)
    orders = draw_orders(pairs, n_trials, rng)
    options = {"fwhm": 1.0, "max_speed": 5.0, "rng": rng} | options
    return stack_patterns(d, pairs, orders, **options)


def literal(d, pairs, axes, order, shift=(0.0, 0.0)):
    """Sum over pairs of dates, SSPs and peaks, over the number of SSPs."""
    owner = np.repeat(np.arange(len(d.n_ssps)), d.n_ssps)
    total, number = np.zeros([len(axis) for axis in axes[::-1]]), 0.0
    for a, b, interval, weight in zip(
        pairs.first, pairs.second, pairs.interval, pairs.weight, strict=True
    ):
        reference, target = order[a], order[b]
        for ssp in np.flatnonzero(owner == reference):
            number += weight
            for p in np.flatnonzero((d.ssp == ssp) & (d.target == target)):
                assert d.reference[p] == reference
                d1, d2 = d.d1[p] + shift[0], d.d2[p] + shift[1]
                for row, v2 in enumerate(axes[1]):
                    for column, v1 in enumerate(axes[0]):
                        u1 = (v1 - d1 / interval) / (d.s1[p] / interval)
                        u2 = (v2 - d2 / interval) / (d.s2[p] / interval)
                        g = exp(-0.5 * (u1 * u1 + u2 * u2))
                        total[row, column] += weight * d.weight[p] * g
    return total / number


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
def test_is_the_papers_equation(seed, every_pair, shuffled):
    rng = np.random.default_rng(seed)
    d = random_displacements(rng, n_epochs=4, n=25)
    years = np.cumsum(rng.uniform(0.3, 1.5, 4))
    pairs = baseline_pairs(years, 0.0, 9.0) if every_pair else consecutive_pairs(years)
    order = rng.permutation(4) if shuffled else np.arange(4)
    shift = tuple(rng.uniform(-0.5, 0.5, 2))
    given_order = order if shuffled else None
    found = stack_matches(d, pairs, COARSE, order=given_order, shift=shift)
    # Gaussians further than five sigma from the grid are left out.
    expected = literal(d, pairs, COARSE, order, shift)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    how = {"order": order, "shift": shift, "kind": np.float32}
    found = stack_matches(d, pairs, COARSE, **how)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_without_matches_or_ssps_it_is_zero():
    pairs = consecutive_pairs([0.0, 0.4, 1.0, 1.1])
    d = random_displacements(np.random.default_rng(4), n=0)
    for own in (d, replace(d, n_ssps=np.zeros(4, dtype=int))):
        velocities, _, components = measure(own, pairs, 5)
        np.testing.assert_array_equal(velocities.coefficient, 0.0)
        np.testing.assert_array_equal(velocities.z_score, 0.0)
        assert components == []


@pytest.mark.parametrize("shift", [0.0, 0.2])
def test_z_scores_are_among_all_other_stacks(shift):
    """Each trial against the others and the observed order; shifts in turn."""
    rng = np.random.default_rng(7)
    d, years = random_displacements(rng, 5, 300), np.array([0.0, 0.4, 1.2, 1.5, 2.6])
    pairs, done = consecutive_pairs(years), []
    orders = draw_orders(pairs, 12, rng)
    velocities, trial_z, components = stack_patterns(
        d, pairs, orders, fwhm=(1.0, 2.0), max_speed=(4.0, 3.0), rng=rng,
        shift_beams=shift, progress=done.append,
    )  # fmt: skip
    assert sum(done) == 12
    axes = velocities.v1, velocities.v2
    assert [axis[-1] for axis in axes] == pytest.approx([4.0, 3.0])
    moves = [(shift, 0), (-shift, 0), (0, 2 * shift), (0, -2 * shift)]
    stacks = [stack_matches(d, pairs, axes)]
    for k, order in enumerate(orders):
        shifted = stack_matches(d, pairs, axes, order=order, shift=moves[k % 4])
        stacks.append(shifted)
    stacks = np.array(stacks)
    floor = 0.3 * stacks.std(axis=0, ddof=1).max()
    for k, stack in enumerate(stacks):
        others = np.delete(stacks, k, axis=0)
        std = others.std(axis=0, ddof=1)
        z = (stack - others.mean(axis=0)) / np.maximum(std, floor)
        if k:
            assert trial_z[k - 1] == pytest.approx(z.max(), rel=1e-3)
        else:
            assert (std < floor).any()
            np.testing.assert_allclose(velocities.z_score, z, atol=2e-3)
    for c in components:
        larger = np.count_nonzero(trial_z >= c["z_score"])
        assert c["p_global"] == (1 + larger) / 13


def test_p_global_is_uniform_where_epochs_are_unrelated():
    """Also of few epochs, whose orders repeat, and where groups are exchanged."""
    p = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(3, 9))
        d = random_displacements(rng, n, 40 * n)
        pairs = consecutive_pairs(np.cumsum(rng.uniform(0.5, 1.0, n)))
        most = 5000 if seed % 2 else 10
        orders = draw_orders(pairs, 19, rng, most_pairs=most)
        given = {"fwhm": 1.0, "max_speed": 3.0, "rng": rng}
        velocities, trial_z, components = stack_patterns(d, pairs, orders, **given)
        highest = velocities.z_score.max() * (1 - 1e-6)
        p.append((1 + np.sum(trial_z >= highest)) / 20)
        # A component is at most as significant as the map is anywhere.
        assert min(c["p_global"] for c in components) >= p[-1]
    for level in (0.05, 0.1, 0.25, 0.5):
        share = np.mean(np.array(p) <= level + 1e-9)
        assert share <= level + 3 * np.sqrt(level / 60)
    assert np.mean(np.array(p) <= 0.5) > 0.3


def test_two_flows_are_two_significant_components():
    d = flows(np.random.default_rng(1), (1.0, 4.0))
    *_, components = measure(d, consecutive_pairs(EVEN), 200)
    own = [c for c in components if c["p_global"] <= 0.01]
    assert len(own) == 2
    assert sorted(c["velocity"][0] for c in own) == pytest.approx([1.0, 4.0], abs=0.15)
    for c in own:
        velocity, error = c["velocity"], np.sqrt(np.diag(c["covariance"]))
        assert abs(velocity[1]) < 3 * error[1]
        assert 0.01 < error[0] < 0.3
        assert abs(c["offset1"]) < 0.5 * error[0]
        assert (c["found"], c["p_global"]) == (1.0, 1 / 201)
        assert c["n_pairs"] == 11
        assert 10 < c["n_ssp"] <= d.n_ssps[:-1].sum()
        assert abs(c["covariance"][0, 1]) < 0.5 * np.prod(error)
    z = [c["z_score"] for c in components]
    assert z == sorted(z, reverse=True)


def test_turned_axes_and_other_units_change_nothing_else():
    d = flows(np.random.default_rng(3), (1.0, 4.0))
    pairs = consecutive_pairs(EVEN)
    found = measure(d, pairs)
    turned = measure(replace(d, d1=-d.d2, d2=d.d1, s1=d.s2, s2=d.s1), pairs)
    hundred = {name: 100 * getattr(d, name) for name in ("d1", "d2", "s1", "s2")}
    large = measure(replace(d, **hundred), pairs, fwhm=100.0, max_speed=500.0)
    fast = consecutive_pairs(EVEN / 10)
    fast = measure(d, fast, max_speed=50.0)
    # Pairs of dates of any weights in common.
    heavy = measure(d, replace(pairs, weight=7 * pairs.weight))
    first = found[-1][0]
    v1, v2 = first["velocity"]
    for other, expected in (
        (turned, (-v2, v1)),
        (large, (100 * v1, 100 * v2)),
        (fast, (10 * v1, 10 * v2)),
        (heavy, (v1, v2)),
    ):
        c = other[-1][0]
        tolerance = 2e-3 * abs(sum(expected))
        assert c["velocity"] == pytest.approx(expected, abs=tolerance)
        assert c["z_score"] == pytest.approx(first["z_score"], rel=1e-3)
        assert c["coefficient"] == pytest.approx(first["coefficient"], rel=1e-6)
        assert c["p_global"] == first["p_global"]


@pytest.mark.parametrize(
    "orders", [[[0, 1, 2]] * 2, [[0, 1, 2, 2]] * 2, [[0, 1, 2, 3]]]
)
def test_orders_that_are_no_permutations_are_refused(orders):
    d, rng = random_displacements(np.random.default_rng(0)), np.random.default_rng(0)
    pairs = consecutive_pairs(np.arange(4.0))
    with pytest.raises(ValueError, match="^orders must be two or more permutations of"):
        stack_patterns(d, pairs, orders, fwhm=1.0, max_speed=2.0, rng=rng)


speed = st.floats(0.01, 100.0)


@given(speed, speed, st.floats(0.02, 3.0), st.floats(0.02, 3.0))
def test_covers_what_is_asked_symmetrically_with_a_point_at_zero(v1, v2, n1, n2):
    step = v1 / n1 / 20, v2 / n2 / 20
    axes = velocity_axes((v1, v2), step)
    assert [axis[-1] for axis in axes] == pytest.approx([v1, v2])
    for axis, largest in zip(axes, step, strict=True):
        assert 0 in axis
        np.testing.assert_allclose(axis, -axis[::-1])
        np.testing.assert_allclose(np.diff(axis), axis[1] - axis[0])
        assert axis[1] - axis[0] <= largest * (1 + 1e-6)


dates = st.lists(
    st.integers(0, 4000).map(lambda day: day / 365.25), min_size=1, max_size=12
).map(sorted)


@example([0.0, 0.0, 1.0], 0.0, 2.0)
@given(dates, st.floats(0, 5), st.floats(0.01, 5))
def test_baseline_pairs_are_all_whose_separation_lies_inside(years, shortest, width):
    longest = shortest + width
    pairs = baseline_pairs(years, shortest, longest)
    found = set(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True))
    for i, j in np.ndindex(len(years), len(years)):
        separation = years[j] - years[i]
        if separation <= 0:
            assert (i, j) not in found
        elif shortest <= separation <= longest:
            assert (i, j) in found
        elif not shortest - 2e-3 <= separation <= longest + 2e-3:
            assert (i, j) not in found
    years = np.asarray(years)
    interval = years[pairs.second] - years[pairs.first]
    np.testing.assert_array_equal(pairs.interval, interval)
    if len(pairs):
        assert pairs.weight.mean() == pytest.approx(1.0)
        # Inverse variances: a displacement error over the interval is one of velocity.
        ratio = pairs.weight / pairs.interval**2
        np.testing.assert_allclose(ratio, ratio[0])


def test_all_orders_of_a_short_series_are_equally_likely():
    pairs = consecutive_pairs(np.arange(4.0))
    orders = draw_orders(pairs, 6000, np.random.default_rng(0))
    assert orders.shape == (6000, 4)
    kinds, counts = np.unique(orders, axis=0, return_counts=True)
    assert len(kinds) == 24
    assert [0, 1, 2, 3] in kinds.tolist()
    assert chisquare(counts).pvalue > 1e-3


@pytest.mark.parametrize(
    ("n", "most"), [(60, 5000), (87, 5000), (180, 5000), (20, 100)]
)
def test_long_series_need_few_ordered_pairs(n, most):
    """Every order is a permutation; epochs are exchanged within groups alone."""
    pairs = consecutive_pairs(np.arange(float(n)))
    orders = draw_orders(pairs, 3000, np.random.default_rng(1), most_pairs=most)
    np.testing.assert_array_equal(np.sort(orders, axis=1), [range(n)] * 3000)
    partners = [set(orders[:, date].tolist()) for date in range(n)]
    # Whom an epoch is exchanged with are the same for all of its group.
    assert all(partners[other] == some for some in partners for other in some)
    sizes = [len(some) for some in partners]
    assert min(sizes) >= min(5, n)
    needed = image_pairs(pairs, orders)
    assert len(needed) <= max(1.5 * most, 1.5 * 25 * len(pairs))
    # Many different orders all the same.
    assert len(np.unique(orders, axis=0)) == 3000


def test_ordered_pairs_are_those_of_all_orders_and_of_the_observed_one():
    rng = np.random.default_rng(2)
    pairs = baseline_pairs(np.arange(6.0), 1.0, 2.0)
    orders = draw_orders(pairs, 3, rng)
    expected = set()
    for order in [range(6), *orders.tolist()]:
        dates = zip(pairs.first, pairs.second, strict=True)
        expected |= {(order[a], order[b]) for a, b in dates}
    assert list(map(tuple, image_pairs(pairs, orders).tolist())) == sorted(expected)
