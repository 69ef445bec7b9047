# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The error of a velocity from the scatter of its features, against what is known."""

from dataclasses import replace

import numpy as np
import pytest

from astro_scc.stacking import (
    Displacements,
    VelocityGrid,
    component_near,
    consecutive_pairs,
    feature_scatter,
    find_components,
    stack,
)

PAIRS = consecutive_pairs([0.0, 0.5])
INTERVAL = 0.5
#: Standard error of a displacement, and of the velocity that it is.
S = np.array([0.2, 0.3])
KERNEL = S / INTERVAL
V = np.array([1.0, -0.5])
GRID = VelocityGrid.covering(4.0, 0.1)
BOX = (3.0, 4.0)


def matches(velocity, weight=1.0):
    """Matches of two epochs, each of an SSP of its own."""
    n = len(velocity)
    one = np.ones(n)
    return Displacements(
        d1=velocity[:, 0] * INTERVAL,
        d2=velocity[:, 1] * INTERVAL,
        s1=S[0] * one,
        s2=S[1] * one,
        weight=weight * one,
        reference=np.zeros(n, int),
        target=np.ones(n, int),
        ssp=np.arange(n),
        target_ssp=np.full(n, -1),
        n_ssps=np.array([n, n]),
    )


def peak_of(d):
    return component_near(stack(d, PAIRS, GRID), GRID, BOX, *V)


def errors(d, group=None, peak=None):
    group = np.arange(len(d)) if group is None else group
    covariance = feature_scatter(d, PAIRS, group, peak or peak_of(d), GRID)
    np.testing.assert_allclose(covariance, covariance.T)
    return np.sqrt(np.diag(covariance))


def expected(scatter, n):
    """Of the maximum of n Gaussians, an M-estimator with the kernel's weights."""
    a = (scatter / KERNEL) ** 2
    own = (1 + a) ** 2 / (1 + 2 * a)
    return scatter * np.sqrt(own * np.prod(1 + a) / np.sqrt(np.prod(1 + 2 * a)) / n)


@pytest.mark.parametrize("relative", [0.1, 0.5, 1.0])
def test_error_is_that_of_the_maximum_of_n_gaussians(relative):
    rng = np.random.default_rng(0)
    scatter, n = relative * KERNEL, 200
    quoted, found = [], []
    for _ in range(15):
        d = matches(V + rng.normal(size=(n, 2)) * scatter)
        peak = peak_of(d)
        quoted.append(errors(d, peak=peak))
        found.append((peak.v1 - V[0], peak.v2 - V[1]))
    rms = np.sqrt(np.mean(np.square(quoted), axis=0))
    np.testing.assert_allclose(rms, expected(scatter, n), rtol=0.2)
    # And the maxima do scatter as much.
    np.testing.assert_allclose(rms, np.std(found, axis=0), rtol=0.5)


def test_of_little_scatter_it_is_the_error_of_the_mean():
    rng = np.random.default_rng(1)
    scatter = 0.05 * KERNEL
    d = matches(V + rng.normal(size=(200, 2)) * scatter)
    np.testing.assert_allclose(
        errors(d), np.std(d.d1, ddof=1) / INTERVAL * np.ones(2) / np.sqrt(200)
        * (1, np.std(d.d2) / np.std(d.d1)), rtol=0.05,
    )  # fmt: skip


def test_it_is_what_a_bootstrap_of_the_features_gives():
    rng = np.random.default_rng(2)
    n = 60
    true = V + rng.normal(size=(n, 2)) * 0.6 * KERNEL
    d = matches(np.concatenate([true, rng.uniform(-4, 4, (40, 2))]))
    peak = peak_of(d)
    again = []
    for _ in range(300):
        some = peak_of(d.select(rng.integers(len(d), size=len(d))))
        again.append((some.v1, some.v2))
    np.testing.assert_allclose(errors(d, peak=peak), np.std(again, axis=0), rtol=0.3)


def test_errors_along_both_axes_are_correlated_as_the_features_are():
    rng = np.random.default_rng(3)
    a = rng.normal(size=(2, 300))
    v = np.stack([a[0], 0.8 * a[0] + 0.6 * a[1]], axis=1) * 0.3 * KERNEL
    d = matches(V + v)
    covariance = feature_scatter(d, PAIRS, np.arange(300), peak_of(d), GRID)
    correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    assert correlation == pytest.approx(0.8, abs=0.1)


def test_a_feature_seen_again_and_again_tells_no_more():
    rng = np.random.default_rng(4)
    n, times = 40, 9
    v = V + rng.normal(size=(n, 2)) * 0.4 * KERNEL
    once = matches(v)
    often = matches(np.repeat(v, times, axis=0))
    feature = np.repeat(np.arange(n), times)
    assert peak_of(often).v1 == pytest.approx(peak_of(once).v1)
    np.testing.assert_allclose(errors(often, feature), errors(once), rtol=1e-6)
    # Taken for independent they would tell three times as much.
    np.testing.assert_allclose(errors(often), errors(once) / 3, rtol=0.05)


def test_matches_without_a_feature_are_on_their_own():
    rng = np.random.default_rng(5)
    d = matches(V + rng.normal(size=(50, 2)) * 0.4 * KERNEL)
    np.testing.assert_allclose(errors(d, np.full(50, -1)), errors(d))
    mixed = np.where(np.arange(50) < 10, 7, -1)
    assert np.all(errors(d, mixed) > 0)


def test_names_and_order_of_the_features_do_not_matter():
    rng = np.random.default_rng(6)
    d = matches(V + rng.normal(size=(60, 2)) * 0.4 * KERNEL)
    group = rng.integers(20, size=60)
    shuffled = rng.permutation(60)
    np.testing.assert_allclose(
        errors(d.select(shuffled), 1000 - 3 * group[shuffled]), errors(d, group)
    )


def test_it_shrinks_with_the_number_of_features():
    rng = np.random.default_rng(7)
    v = V + rng.normal(size=(640, 2)) * 0.5 * KERNEL
    ratio = errors(matches(v[:40])) / errors(matches(v))
    np.testing.assert_allclose(ratio, 4.0, rtol=0.35)


def test_far_matches_pull_at_nothing():
    rng = np.random.default_rng(8)
    near = V + rng.normal(size=(50, 2)) * 0.3 * KERNEL
    far = np.array([[-3.5, 3.5]]) + rng.normal(size=(30, 2)) * 0.1
    one, both = matches(near), matches(np.concatenate([near, far]))
    np.testing.assert_allclose(errors(both), errors(one), rtol=1e-3)


def test_weights_do_not_matter_if_all_are_the_same():
    rng = np.random.default_rng(9)
    v = V + rng.normal(size=(50, 2)) * 0.3 * KERNEL
    np.testing.assert_allclose(errors(matches(v, 0.01)), errors(matches(v)), rtol=1e-6)


@pytest.mark.slow
def test_the_truth_is_inside_as_often_as_it_should():
    """Of both axes, two thirds of the time."""
    rng = np.random.default_rng(10)
    inside = []
    for _ in range(200):
        true = np.repeat(V + rng.normal(size=(15, 2)) * 0.4 * KERNEL, 4, axis=0)
        true += rng.normal(size=true.shape) * 0.2 * KERNEL
        d = matches(np.concatenate([true, rng.uniform(-4, 4, (40, 2))]))
        feature = np.concatenate([np.repeat(np.arange(15), 4), 100 + np.arange(40)])
        peak = peak_of(d)
        off = np.abs([peak.v1 - V[0], peak.v2 - V[1]])
        inside.append(off <= errors(d, feature, peak))
    assert 0.6 < np.mean(inside) < 0.76


def test_one_feature_has_the_errors_of_its_matches():
    d = matches(V + np.array([[0.0, 0.0], [0.01, 0.0]]))
    np.testing.assert_allclose(errors(d, [3, 3]), KERNEL)


def test_what_is_not_fitted_has_the_errors_of_the_matches_nearby():
    d = matches(np.array([V, V + 0.1, [3.9, 3.9]]))
    d = replace(d, s1=np.array([0.2, 0.2, 2.0]))
    peak = replace(peak_of(d), fitted=False, points=())
    np.testing.assert_allclose(errors(d, peak=peak), KERNEL)


def test_without_a_match_nearby_those_of_all_matches_count():
    d = matches(np.array([[3.9, 3.9], [3.8, 3.9]]))
    peak = component_near(stack(d, PAIRS, GRID), GRID, BOX, -2.0, -2.0)
    assert not peak.fitted
    np.testing.assert_allclose(errors(d, peak=peak), KERNEL)


def test_without_any_match_nothing_is_known():
    d = matches(np.empty((0, 2)))
    peak = component_near(np.zeros(GRID.shape), GRID, BOX, *V)
    assert np.isinf(np.diag(feature_scatter(d, PAIRS, [], peak, GRID))).all()


def test_a_maximum_that_one_feature_holds_has_a_wide_error():
    """Without it the maximum is somewhere in the box, or lost."""
    sides = V + np.array([(1.2, 0.0), (-1.3, 0.2)])
    d = matches(np.concatenate([np.tile(V, (8, 1)), sides]))
    held = errors(d, [0] * 8 + [1, 2])
    assert np.all(held > 0.25 * np.array(BOX))
    assert np.all(held < np.array(BOX))
    assert np.all(held > 5 * errors(d))


def test_two_features_bound_it_by_their_distance():
    apart = np.array([0.3, 0.0])
    d = matches(np.concatenate([np.tile(V, (5, 1)), np.tile(V + apart, (5, 1))]))
    # The jackknife of two: each without the other is where it is.
    np.testing.assert_allclose(errors(d, [0] * 5 + [1] * 5), [0.3 / 2, 0.0], atol=0.02)


def test_pairs_of_other_dates_do_not_enter():
    rng = np.random.default_rng(11)
    d = matches(V + rng.normal(size=(50, 2)) * 0.3 * KERNEL)
    other = replace(d, reference=d.target, target=d.reference, d1=d.d1 + 1)
    both = replace(
        d,
        **{
            name: np.concatenate([getattr(d, name), getattr(other, name)])
            for name in ("d1", "d2", "s1", "s2", "weight", "reference", "target",
                         "ssp", "target_ssp")
        },
    )  # fmt: skip
    (peak,) = find_components(stack(d, PAIRS, GRID), GRID, BOX)
    np.testing.assert_allclose(
        feature_scatter(both, PAIRS, np.arange(100), peak, GRID),
        feature_scatter(d, PAIRS, np.arange(50), peak, GRID),
    )
