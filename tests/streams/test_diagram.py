# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The displacement-interval diagram and its rays against loops over the matches."""

from dataclasses import replace
from itertools import combinations, permutations

import numpy as np
import pytest

from astro_scc.stacking.velocities import VelocitySamples
from astro_scc.streams import SearchSettings
from astro_scc.streams.diagram import (
    SPEED_STEP,
    Diagram,
    IntervalBins,
    Rays,
    pair_densities,
)
from astro_scc.streams.permutations import EpochPermutations

SEARCH = SearchSettings()
YEARS = np.array([2000.0, 2000.4, 2001.3, 2001.9, 2003.2])


def random_matches(rng, years=YEARS, n=120, reach=1.8):
    """Matches between random epochs at random displacements."""
    n_epochs, each = len(years), 4
    reference = rng.integers(n_epochs, size=n)
    target = (reference + rng.integers(1, n_epochs, size=n)) % n_epochs
    return VelocitySamples(
        rng.uniform(-reach, reach, n), rng.uniform(-0.6, 0.6, n),
        weight=rng.uniform(0.5, 1.0, n), reference=reference, target=target,
        ssp=each * reference + rng.integers(each, size=n),
        target_ssp=np.where(rng.random(n) < 0.2, -1, each * target),
        position=rng.uniform(0, 9, (each * n_epochs, 2)),
        epoch=np.repeat(np.arange(n_epochs), each), scale=np.ones(each * n_epochs),
        years=np.asarray(years, dtype=float),
    )  # fmt: skip


@pytest.fixture(scope="module")
def d():
    return random_matches(np.random.default_rng(1))


@pytest.fixture(scope="module")
def rays():
    return Rays.of(YEARS, 1.5, SEARCH)


def density_by_loop(d, a, b, grid):
    """Of the displacements from image a to image b, matched from either side."""
    total = np.zeros(len(grid))
    for k in range(len(d)):
        if abs(d.d2[k]) > SEARCH.across or abs(d.d1[k]) > 1.5:
            continue
        for first, second, along in (
            (d.reference[k], d.target[k], d.d1[k]),
            (d.target[k], d.reference[k], -d.d1[k]),
        ):
            if (first, second) == (a, b):
                x = (grid - along) / SEARCH.blur
                total += d.weight[k] * np.exp(-0.5 * x**2)
    return total


def mean_by_loop(d, grid):
    n = len(d.years)
    pairs = list(permutations(range(n), 2))
    return sum(density_by_loop(d, a, b, grid) for a, b in pairs) / len(pairs)


# Matches are shared between two grid points: of each, at most 1% of its height is
# lost, which is (step / blur)^2 / 8 between the two.
SHARED = 0.01


def test_matches_on_the_grid_are_exact(d, rays):
    grid, _, _ = pair_densities(d, rays)
    assert (grid[0], grid[-1]) == (-1.5, pytest.approx(1.5))
    assert (grid[1] - grid[0]) ** 2 / (8 * SEARCH.blur**2) <= SHARED
    on = replace(d, d1=np.random.default_rng(2).choice(grid, len(d)))
    _, pairs, mean = pair_densities(on, rays)
    wanted = density_by_loop(on, 1, 3, grid)
    np.testing.assert_allclose(pairs[5 * 1 + 3], wanted, atol=1e-12)
    np.testing.assert_allclose(mean, mean_by_loop(on, grid), atol=1e-12)


def bins_by_loop(years, intervals=(0, np.inf)):
    pairs = [
        (i, j)
        for i, j in combinations(range(len(years)), 2)
        if years[j] > years[i] and intervals[0] <= years[j] - years[i] <= intervals[1]
    ]
    shortest = min(years[j] - years[i] for i, j in pairs)
    bins = {}
    for i, j in pairs:
        number = np.floor(np.log((years[j] - years[i]) / shortest) / 0.08 + 1e-9)
        bins.setdefault(number, []).append((i, j))
    return [bins[number] for number in sorted(bins)]


@pytest.mark.parametrize("intervals", [(0, np.inf), (0.5, 2.0)])
def test_every_pair_is_in_the_bin_of_its_interval(intervals):
    years = np.array([0.0, 0.5, 0.51, 0.51, 1.0, 1.52, 3.0, 4.4])
    bins = IntervalBins(years, 0.08, intervals)
    wanted = bins_by_loop(years, intervals)
    assert bins.number.tolist() == [len(pairs) for pairs in wanted]
    for k, pairs in enumerate(wanted):
        here = bins.bin == k
        assert set(zip(bins.first[here], bins.second[here], strict=True)) == set(pairs)
        interval = [years[j] - years[i] for i, j in pairs]
        assert bins.mean[k] == pytest.approx(np.mean(interval))


class TestDiagram:
    def test_the_excess_is_what_its_definition_says(self, d, rays):
        found = Diagram.of(d, rays)
        grid, mean = found.displacement, mean_by_loop(d, found.displacement)
        for row, pairs in enumerate(bins_by_loop(YEARS)):
            observed = sum(density_by_loop(d, i, j, grid) for i, j in pairs)
            tolerance = SHARED * (observed.max() + len(pairs) * mean.max())
            np.testing.assert_allclose(
                found.excess[row], observed - len(pairs) * mean, atol=tolerance
            )
            assert found.n_pairs[row] == len(pairs)
        assert found.n_pairs.sum() == 10
        np.testing.assert_array_equal(found.interval, rays.bins.mean)


def test_without_ssps_nothing_from_or_to_them_is_left(d):
    taken = np.isin(np.arange(20), [0, 5, 19])
    ends = [{s, t} - {-1} for s, t in zip(d.ssp, d.target_ssp, strict=True)]
    # A match on no SSP is not one on the last of them.
    keep = [not any(taken[k] for k in pair) for pair in ends]
    np.testing.assert_array_equal(d.without_ssps(taken).d1, d.d1[keep])


class TestRays:
    @pytest.mark.parametrize(
        ("years", "limits", "slowest", "fastest"),
        [
            (YEARS, {}, SEARCH.slowest / 3.2, 1.5 / np.quantile(np.diff(YEARS), 0.25)),
            # Few epochs still have a range of speeds.
            ([0.0, 1.0], {}, 0.375, 1.5),
            (YEARS, {"fastest": 0.9}, 0.225, 0.9),
            # 0.6 and 0.9 yr are the gaps that are used.
            (YEARS, {"intervals": (0.5, 1.0)}, 0.25 * 1.5 / 0.675, 1.5 / 0.675),
            # Two epochs half a year apart among others two years apart.
            ([0, 0.5, 2, 4, 6, 8, 10], {"intervals": (0.0, 1.0)}, 0.75, 3.0),
            # No gap is used: the shortest interval counts.
            (np.arange(5.0), {"intervals": (1.5, 2.5)}, 0.1875, 0.75),
            # Epochs of one date are no interval.
            ([0.0, 0.0, 1.0, 2.0, 3.0], {}, SEARCH.slowest / 3, 1.5),
        ],
    )
    def test_slowest_and_fastest(self, years, limits, slowest, fastest):
        speed = Rays.of(np.array(years), 1.5, SEARCH, **limits).speed
        forth = speed[speed > 0]
        assert forth[[0, -1]] == pytest.approx([slowest, fastest])
        np.testing.assert_array_equal(forth, -speed[speed < 0][::-1])
        steps = np.diff(np.log(forth))
        np.testing.assert_allclose(steps, steps[0])
        assert steps[0] <= SPEED_STEP

    def test_intervals_limit_the_bins_and_weights(self):
        some = Rays.of(YEARS, 1.5, SEARCH, intervals=(0.5, 1.0))
        np.testing.assert_allclose(some.bins.mean, [0.6, 0.9])
        assert not some.weight(0.5, np.array([0.4, 1.3])).any()
        assert some.weight(0.5, np.array([0.5, 0.9, 1.0])).all()

    @pytest.mark.parametrize("limits", [(4, 9), (0, 0.1)])
    def test_no_two_epochs_so_far_apart(self, limits):
        words = f"no two epochs are {limits[0]} to {limits[1]} yr apart"
        with pytest.raises(ValueError, match=words):
            Rays.of(YEARS, 1.5, SEARCH, intervals=limits)

    @pytest.mark.parametrize(
        ("motion", "weight"),
        [(0.15, 0), (0.2, 0.5), (0.25, 1), (0.9, 1), (1.0, 0.5), (1.1, 0)],
    )
    def test_the_ends_are_soft(self, rays, motion, weight):
        assert rays.weight([motion, -motion], 10.0) == pytest.approx([weight] * 2)
        # In short intervals, up to the radius.
        inside = min(weight + (motion > 0.5), 1)
        assert rays.weight([motion, 1.5, 1.51], rays.short) == pytest.approx(
            [inside, 1, 0]
        )


def permute(d, rays, *, n_trials=119):
    rng = np.random.default_rng(0)
    return EpochPermutations.of([(d,)], rays, n_trials, rng)


class TestEpochPermutations:
    def test_z_is_of_all_orders_by_a_loop(self, d, rays):
        test, excess = permute(d, rays), Diagram.of(d, rays)
        sums, grid = [], excess.displacement
        for order in permutations(range(5)):
            # The images in another order at the same dates.
            place = np.argsort(order)
            other = replace(d, reference=place[d.reference], target=place[d.target])
            found = Diagram.of(other, rays)
            total = np.zeros(len(rays.speed))
            for interval, row in zip(found.interval, found.excess, strict=True):
                motion = rays.speed * interval
                weight = rays.weight(motion, np.full(motion.shape, interval))
                total += weight * np.interp(motion, grid, row)
            sums.append(total)
        sums = np.array(sums)
        np.testing.assert_allclose(sums.mean(axis=0), 0, atol=1e-10)
        motion = np.abs(rays.speed) * np.ptp(YEARS)
        drift = np.sqrt(np.minimum(motion / SEARCH.drift, 1))
        z = drift * sums / sums.std(axis=0)
        np.testing.assert_allclose(test.z[0], z[0], atol=1e-8)
        np.testing.assert_allclose(test.permuted[:, 0], z[1:], atol=1e-5)
        np.testing.assert_allclose(test.maxima, np.sort(z[1:].max(axis=1)), atol=1e-5)

    def test_p_values_are_by_definition(self):
        """Of seven epochs, whose orders are more than the trials."""
        years = np.cumsum([0.0, 0.4, 0.9, 0.6, 1.3, 0.5, 0.8])
        rays = Rays.of(years, 1.5, SEARCH)
        some = random_matches(np.random.default_rng(7), years)
        test = permute(some, rays, n_trials=99)
        assert test.permuted.shape == (99, 1, len(rays.speed))
        for k, speed in enumerate(rays.speed):
            p_local, p_global = test.p_values(0, speed)
            z = test.z[0, k]
            local = sum(order[0, k] >= z - 1e-6 for order in test.permuted)
            anywhere = sum(order.max() >= z - 1e-6 for order in test.permuted)
            assert p_local == (local + 1) / 100
            assert p_global == (anywhere + 1) / 100
            assert p_local <= p_global

    def test_beyond_the_speeds_nothing_is_significant(self, d, rays):
        test = permute(d, rays)
        slow, fast = rays.speed[rays.speed > 0].min(), rays.speed.max()
        outside = [0.0, 0.99 * slow, -0.5 * slow, 1.01 * fast, -2 * fast]
        assert np.all(test.significance(0, outside) == -np.inf)
        for speed in outside:
            assert test.p_values(0, speed) == (1.0, 1.0)
        assert len(test.significance(0, [])) == 0
        between = 0.5 * (rays.speed[3] + rays.speed[4])
        assert test.significance(0, between) == pytest.approx(test.z[0, 3:5].mean())

    @pytest.mark.parametrize(
        ("n_epochs", "n_trials", "smallest"),
        [(2, 99, 1), (3, 99, 1 / 3), (5, 999, 1 / 60), (6, 99, 1 / 360), (7, 99, 0.01)],
    )
    def test_the_smallest_p_that_the_orders_allow(self, n_epochs, n_trials, smallest):
        years = np.arange(float(n_epochs))
        some = random_matches(np.random.default_rng(5), years)
        test = permute(some, Rays.of(years, 1.5, SEARCH), n_trials=n_trials)
        assert test.smallest_p == pytest.approx(smallest)
        assert test.p_values(*test.largest())[1] >= 1 / (1 + len(test.permuted))

    def test_the_largest_of_several_axes(self, lines, axis_matches):
        years = np.arange(6.0)
        rays = Rays.of(years, 1.5, SEARCH)
        d = axis_matches(*lines([0.5] * 5, 3.0 * np.arange(5), years), years)
        weak = random_matches(np.random.default_rng(6), years)
        test = EpochPermutations.of([(weak,), (d,)], rays, 99, np.random.default_rng(0))
        axis, speed = test.largest()
        assert axis == 1
        # Half a blur in the shortest interval, of one year.
        assert speed == pytest.approx(0.5, abs=0.5 * SEARCH.blur)
        assert test.z.shape == (2, len(rays.speed))
        # The maximum of each permutation is over both axes.
        np.testing.assert_array_equal(
            test.maxima, np.sort([order.max() for order in test.permuted])
        )

    def test_matches_and_detections_count_alike(self, d, rays):
        """By the mean of both in standard deviations, whatever their numbers."""
        alone, none = permute(d, rays), d.select(np.zeros(len(d), dtype=bool))
        noise = random_matches(np.random.default_rng(6), d.years)
        other = permute(noise, rays)
        for second, wanted in (
            (none, alone.z),
            (d, alone.z),
            (replace(d, weight=7 * d.weight), alone.z),
            (noise, (alone.z + other.z) / np.sqrt(2)),
        ):
            rng = np.random.default_rng(0)
            test = EpochPermutations.of([(d, second)], rays, 119, rng)
            # Two that are unrelated have a variance of two only on average.
            some = 1e-4 if second is not noise else 0.5 * np.abs(wanted).max()
            np.testing.assert_allclose(test.z, wanted, atol=some)

    def test_z_of_an_axis_with_few_matches(self, d, rays):
        """Its standard deviation is at least 0.3 of that of the others."""
        few = d.select(np.arange(5))
        alone, other = (permute(k, rays) for k in (few, d))
        sums, std = [], []
        for axis, test in ((few, alone), (d, other)):
            excess = Diagram.of(axis, rays)
            matrix = rays.matrix(rays.speed, excess.displacement)
            sums.append(matrix @ excess.excess.ravel())
            # Of all 120 orders, from a z that no other axis limits.
            seen = test.z[0] != 0
            std.append(np.zeros(len(seen)))
            std[-1][seen] = sums[-1][seen] / test.z[0, seen]
        assert np.any(std[0] < 0.3 * std[1])
        both = EpochPermutations.of([(few,), (d,)], rays, 119, np.random.default_rng(0))
        wanted = np.array(sums) / np.maximum(std, 0.3 * np.max(std, axis=0))
        np.testing.assert_allclose(both.z, wanted, atol=1e-4)

    @pytest.mark.parametrize("true", [0.61, -0.61, -2, -0.25, 0.25, 2, "two equal"])
    def test_the_largest_is_that_of_a_parabola(self, true):
        """In the logarithm of speed; at the ends of a direction the point itself."""
        speed = np.geomspace(0.25, 2, 30)
        speed = np.concatenate([-speed[::-1], speed])
        if true == "two equal":
            z, true = np.isin(np.arange(60), [40, 41]), np.sqrt(speed[40] * speed[41])
        else:
            z = 5 - 9 * np.log(np.abs(speed / true)) ** 2
            z[speed * true < 0] = 0
        nothing = np.zeros((1, 1, 60))
        test = EpochPermutations(speed, np.ones(60), 1.0 * z[None], nothing, 0.5)
        assert test.largest() == (0, pytest.approx(true, rel=1e-9))

    def test_epochs_that_are_all_the_same_show_nothing(self, lines, axis_matches):
        """Noiseless standing features, or no matches."""
        years = np.cumsum(np.geomspace(0.3, 2, 8))
        d = axis_matches(*lines([0.0] * 5, 3.0 * np.arange(5), years), years)
        for some in (d, d.select(d.ssp < 0)):
            test = permute(some, Rays.of(years, 1.5, SEARCH), n_trials=99)
            assert np.abs(test.z).max() < 1e-6
            assert test.p_values(*test.largest()) == (1.0, 1.0)
