# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The mixture of what expands and chance."""

from dataclasses import replace

import numpy as np

from astro_scc.expansion import Samples, fit_mixture, start_of

CENTRE = np.array([4.0, -3.0])
RATES = np.array([0.02, 0.012])


def made_up(seed, n=240, chance=0.6, scatter=(0.1, 0.3)):
    """Features of two groups seen three times each, and chance."""
    rng = np.random.default_rng(seed)
    group = np.repeat([0, 1], n)
    x = CENTRE + np.repeat(rng.normal(0, 60, (2 * n // 3, 2)), 3, axis=0)
    interval = rng.choice([1.0, 2.0, 4.0], 2 * n)
    d = RATES[group, None] * (x - CENTRE) * interval[:, None]
    d += rng.normal(0, 1, d.shape) * np.array(scatter)[group, None]
    lost = rng.uniform(size=2 * n) < chance
    half = 5 * interval[:, None]
    d[lost] = rng.uniform(-half, half, d.shape)[lost]
    return x, d / interval[:, None], interval, group


def samples_of(x, v, interval, group, kind=None):
    kind = group if kind is None else kind
    return Samples(x, v, interval, np.full(len(x), 0.6), group, kind)


def fitted(samples, area, centre=None):
    weight = np.ones(len(area))
    start = start_of(samples, weight, max_rate=0.1, centre=centre)
    return fit_mixture(samples, start, area, fixed=centre is not None)


def fitted_truth(seed, **kwargs):
    samples = samples_of(*made_up(seed, **kwargs))
    return fitted(samples, (10 * samples.interval) ** 2)


TRUTH = np.concatenate([RATES, CENTRE])


def test_known_truth():
    fit = fitted_truth(1)
    np.testing.assert_allclose(fit.scatter, [0.1, 0.3], rtol=0.2)
    np.testing.assert_allclose(fit.share, 0.4, atol=0.08)
    error = np.sqrt(np.diag(fit.covariance))
    assert np.all(np.abs(fit.place - TRUTH) < 4 * error)
    assert np.all(error[:2] < 0.03 * RATES)


def test_equals_weighted_least_squares_without_chance():
    """One rate about a known centre: the slope of displacements in closed form."""
    x, v, interval, group = made_up(2, chance=0.0, scatter=(0.1, 0.1))
    v = v - RATES[group, None] * (x - CENTRE) + 0.02 * (x - CENTRE)
    samples = samples_of(x, v, interval, np.zeros(len(x), dtype=int))
    fit = fitted(samples, np.full(len(x), 1e12), CENTRE)
    away, weight = x - CENTRE, interval[:, None] ** 2
    slope = (weight * away * v).sum() / (weight * away**2).sum()
    np.testing.assert_allclose(fit.place[0], slope, rtol=1e-6)
    np.testing.assert_allclose(fit.place[1:], CENTRE)
    assert np.all(np.diag(fit.covariance)[1:] == 0)


def test_response_is_the_derivative():
    """Moved velocities move the fit as the response says."""
    samples = samples_of(*made_up(3, chance=0.0))
    area = np.full(len(samples.x), 1e12)
    fit = fitted(samples, area)
    moved = np.zeros_like(samples.v)
    moved[::3, 0] = 1e-3
    again = fit_mixture(replace(samples, v=samples.v + moved), fit.place, area)
    expected = np.einsum("ia,iaj->j", moved, fit.response)
    np.testing.assert_allclose(again.place - fit.place, expected, rtol=0.05, atol=2e-5)


def test_a_side_alone_has_no_error():
    samples = samples_of(*made_up(6, n=1200))
    keep = np.arctan2(*(samples.x - CENTRE).T) % (2 * np.pi) < 0.2
    part = samples.select(keep)
    fit = fitted(part, (10 * part.interval) ** 2, CENTRE)
    assert np.isinf(fit.covariance).all()
