# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The part of an error that misaligned epochs make, against arithmetic and trials."""

from dataclasses import replace

import numpy as np
import pytest

from astro_scc.stacking import (
    Displacements,
    VelocityGrid,
    alignment_scatter,
    baseline_pairs,
    component_near,
    consecutive_pairs,
    epoch_scatter,
    stack,
)

S, V = 0.2, np.array([1.0, -0.5])
GRID = VelocityGrid.covering(2.0, 0.05)
BOX = (2.0, 2.0)


def jet(years, pairs, rng, n=12, scatter=0.02, shift=None):
    """Features of one velocity, in every pair, with epochs that are off."""
    k = len(pairs)
    reference = np.repeat(pairs.first, n)
    target = np.repeat(pairs.second, n)
    motion = V * np.repeat(pairs.interval, n)[:, None]
    motion = motion + rng.normal(0, scatter, (k * n, 2))
    if shift is not None:
        motion += shift[target] - shift[reference]
    one = np.ones(k * n)
    return Displacements(
        d1=motion[:, 0], d2=motion[:, 1], s1=S * one, s2=S * one, weight=one,
        reference=reference, target=target, ssp=np.arange(k * n),
        target_ssp=np.full(k * n, -1), n_ssps=np.full(len(years), n),
    )  # fmt: skip


def peak_of(d, pairs):
    return component_near(stack(d, pairs, GRID), GRID, BOX, *V)


def errors(d, pairs, sigma):
    sigma = np.broadcast_to(sigma, (d.n_epochs, 2))
    return alignment_scatter(d, pairs, peak_of(d, pairs), GRID, sigma)


def test_errors_of_consecutive_epochs_undo_one_another():
    years = np.arange(6.0)
    pairs = consecutive_pairs(years)
    d = jet(years, pairs, np.random.default_rng(0))
    covariance = errors(d, pairs, (0.03, 0.05))
    expected = np.sqrt(2) * np.array([0.03, 0.05]) / years[-1]
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), expected, rtol=0.03)
    assert abs(covariance[0, 1]) < 0.05 * np.sqrt(np.prod(np.diag(covariance)))


@pytest.mark.parametrize("uneven", [False, True])
def test_it_is_what_misaligned_epochs_do(uneven):
    years = np.array([0, 0.7, 2.1, 2.9, 4.5]) if uneven else np.arange(5.0)
    pairs = baseline_pairs(years, 0.5, 2.3)
    rng = np.random.default_rng(1)
    found = []
    for _ in range(150):
        d = jet(years, pairs, rng, shift=rng.normal(0, 0.06, (5, 2)))
        peak = peak_of(d, pairs)
        found.append((peak.v1, peak.v2))
    quoted = np.sqrt(np.diag(errors(jet(years, pairs, rng), pairs, 0.06)))
    np.testing.assert_allclose(np.std(found, axis=0), quoted, rtol=0.2)


def test_one_bad_epoch_counts_alone():
    years = np.arange(4.0)
    pairs = consecutive_pairs(years)
    d = jet(years, pairs, np.random.default_rng(2))
    sigma = np.zeros((4, 2))
    sigma[0] = 0.06
    covariance = errors(d, pairs, sigma)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), 0.06 / 3, rtol=0.03)
    # In the middle of the series it is no error of the mean at all.
    sigma = np.roll(sigma, 1, axis=0)
    assert np.all(np.sqrt(np.diag(errors(d, pairs, sigma))) < 0.06 / 30)


def test_without_errors_or_a_fit_it_is_nought():
    years = np.arange(3.0)
    pairs = consecutive_pairs(years)
    d = jet(years, pairs, np.random.default_rng(3))
    np.testing.assert_array_equal(errors(d, pairs, 0.0), 0.0)
    peak = replace(peak_of(d, pairs), fitted=False)
    none = alignment_scatter(d, pairs, peak, GRID, np.ones((3, 2)))
    np.testing.assert_array_equal(none, 0.0)
    nothing = d.select(np.zeros(len(d), bool))
    none = alignment_scatter(nothing, pairs, peak_of(d, pairs), GRID, np.ones((3, 2)))
    np.testing.assert_array_equal(none, 0.0)


def test_where_no_maximum_is_left_the_mean_answers():
    """Two points hold no Gaussian: the response is that of the weighted mean."""
    years = np.arange(2.0)
    pairs = consecutive_pairs(years)
    d = jet(years, pairs, np.random.default_rng(4))
    peak = peak_of(d, pairs)
    columns, rows, used = peak.points
    peak = replace(peak, points=(columns, rows, np.zeros_like(used)))
    covariance = alignment_scatter(d, pairs, peak, GRID, np.full((2, 2), 0.03))
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), 0.03 * np.sqrt(2))


def test_leaving_out_epochs_sees_what_they_do():
    years = np.arange(12.0)
    pairs = baseline_pairs(years, 0.5, 3.5)
    rng = np.random.default_rng(5)
    found, quoted = [], []
    for _ in range(40):
        d = jet(years, pairs, rng, shift=rng.normal(0, 0.06, (12, 2)))
        peak = peak_of(d, pairs)
        found.append((peak.v1, peak.v2))
        quoted.append(np.diag(epoch_scatter(d, pairs, peak, GRID)))
    ratio = np.sqrt(np.mean(quoted, axis=0)) / np.std(found, axis=0)
    assert np.all((ratio > 0.8) & (ratio < 2.0))


def test_too_few_epochs_to_leave_one_out():
    years = np.arange(2.0)
    pairs = consecutive_pairs(years)
    d = jet(years, pairs, np.random.default_rng(6))
    peak = peak_of(d, pairs)
    assert np.isinf(np.diag(epoch_scatter(d, pairs, peak, GRID))).all()
    peak = replace(peak, fitted=False)
    assert np.isinf(np.diag(epoch_scatter(d, pairs, peak, GRID))).all()
