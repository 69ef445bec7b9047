# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The mixture of what expands and chance."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.expansion import fit_shell
from astro_scc.expansion.centre import Samples, fit_mixture, kernel_maximum
from astro_scc.simulation import simulate_shell

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
    start = kernel_maximum(samples, weight, max_rate=0.1, centre=centre)
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


def test_errors_are_the_scatter_of_many():
    """Deviations over errors have the variance of a Gaussian, for every parameter."""
    pulls = []
    for seed in range(100, 110):
        fit = fitted_truth(seed)
        pulls.append((fit.place - TRUTH) / np.sqrt(np.diag(fit.covariance)))
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    assert np.all((rms > 0.5) & (rms < 1.6))
    assert np.all(np.abs(np.mean(pulls, axis=0)) < 1)


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


@pytest.fixture(scope="module")
def shell():
    return simulate_shell(
        n_epochs=4, interval=8 * u.yr, n_knots=40, n_clumps=10, radius=60 * u.arcsec,
        size=176, rng=7,
    )  # fmt: skip


@pytest.fixture(scope="module")
def scc():
    return StackedCrossCorrelation(
        scales=[1.5, 4], max_speed=150 * u.mas / u.yr, baseline=[7, 25] * u.yr,
        min_error_beams=0.1, detection=7, segmentation=5,
    )  # fmt: skip


@pytest.fixture(scope="module")
def parts(scc, shell):
    fine, coarse = replace(scc, scales=(1.5,)), replace(scc, scales=(3,), detection=5)
    return {"knots": fine.match(shell.cube), "ring": coarse.match(shell.cube)}


@pytest.mark.slow
def test_groups_of_several_matches(scc, parts, shell):
    fit = fit_shell(scc, parts)
    assert fit.groups == ("knots", "ring")
    true = np.array([0.11, 0.07]) / (1 + 12 * np.array([0.0011, 0.0007]))
    off = fit.rate.to_value(u.percent / u.yr) - true
    assert np.all(np.abs(off) < 4 * fit.rate_err.to_value(u.percent / u.yr))
    away = (fit.centre - shell.centre) / fit.centre_err
    assert np.all(np.abs(away) < 4)


def test_alignment_moves_the_centre(scc, parts):
    """A drift between two epochs, unknown to this error, is one of the centre."""
    plain = fit_shell(scc, parts)
    known = fit_shell(replace(scc, alignment_error=100 * u.mas), parts)
    np.testing.assert_array_equal(known.centre.value, plain.centre.value)
    more = np.sqrt(known.centre_err**2 - plain.centre_err**2)
    # Of four dates: the error of a straight line through them, over the rate.
    years = np.arange(4) * 8.0
    slope = 100 * u.mas / u.yr / np.sqrt(((years - years.mean()) ** 2).sum())
    mean_rate = plain.rate[0]
    np.testing.assert_allclose((more * mean_rate / slope).to_value(u.one), 1, atol=0.1)
    assert np.all(known.rate_err < 1.5 * plain.rate_err)


def test_refused(scc, parts, shell):
    with pytest.raises(ValueError, match="give no groups"):
        fit_shell(scc, parts, {})
    later = replace(shell.cube, times=shell.cube.times + 1 * u.day)
    few = replace(parts["ring"], select=np.zeros_like(parts["ring"].select))
    with pytest.raises(ValueError, match="each group or more, ring has 0"):
        fit_shell(scc, {**parts, "ring": few})
    other = {**parts, "ring": replace(parts["ring"], cube=later)}
    with pytest.raises(ValueError, match="of the same dates"):
        fit_shell(scc, other)
