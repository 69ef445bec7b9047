# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The mixture of what expands and chance, and a simulated shell without a beam."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation, expansion
from astro_scc.simulation import simulate_shell

ORIGIN = np.array([4.0, -3.0])
RATES = np.array([0.02, 0.012])
RATE = u.percent / u.yr
CENTRE = [6, -4] * u.arcsec


def made_up(seed, n=240, chance=0.6, scatter=(0.1, 0.3)):
    """Features of two groups seen three times each, and chance."""
    rng = np.random.default_rng(seed)
    group = np.repeat([0, 1], n)
    x = ORIGIN + np.repeat(rng.normal(0, 60, (2 * n // 3, 2)), 3, axis=0)
    interval = rng.choice([1.0, 2.0, 4.0], 2 * n)
    d = RATES[group, None] * (x - ORIGIN) * interval[:, None]
    d += rng.normal(0, 1, d.shape) * np.array(scatter)[group, None]
    lost = rng.uniform(size=2 * n) < chance
    half = 5 * interval[:, None]
    d[lost] = rng.uniform(-half, half, d.shape)[lost]
    v = d / interval[:, None]
    columns = [x, v, interval, np.full(len(x), 0.6), group, group]
    return np.rec.fromarrays(columns, dtype=expansion.SAMPLE)


def fitted(samples, area=None, centre=None):
    area = (10 * samples.interval) ** 2 if area is None else area
    start = expansion.start_of(samples, np.ones(len(area)), max_rate=0.1, centre=centre)
    return expansion.fit_mixture(samples, start, area, fixed=centre is not None)


@pytest.mark.parametrize("n", [0, 480])
def test_known_truth_also_with_stars_that_stand_still(n):
    stars = made_up(2)[:n]
    stars.v *= 0.05 / np.hypot(*stars.v.T)[:, None]
    samples = np.concatenate([made_up(1), stars]).view(np.recarray)
    place, covariance, _, scatter, share = fitted(samples)
    if n == 0:
        np.testing.assert_allclose(scatter, [0.1, 0.3], rtol=0.2)
        np.testing.assert_allclose(share, [[0.4, 0.4], [0, 0]], atol=0.08)
    error = np.sqrt(np.diag(covariance))
    assert np.all(np.abs(place - [*RATES, *ORIGIN]) < 4 * error)


def test_equals_weighted_least_squares_without_chance():
    """One rate about a known centre: the slope of displacements in closed form."""
    two = made_up(2, chance=0.0, scatter=(0.1, 0.1))
    away = two.x - ORIGIN
    v, samples = two.v + (0.02 - RATES[two.group, None]) * away, two.copy()
    samples.v, samples.group, samples.kind = v, 0, 0
    place, covariance, *_ = fitted(samples, np.full(len(v), 1e12), ORIGIN)
    weight = two.interval[:, None] ** 2
    slope = (weight * away * v).sum() / (weight * away**2).sum()
    np.testing.assert_allclose(place, [slope, *ORIGIN], rtol=1e-6)
    assert np.all(np.diag(covariance)[1:] == 0)
    # A side alone has no error.
    side = np.arctan2(*away.T) % (2 * np.pi) < 0.2
    assert np.isinf(fitted(samples[side], centre=ORIGIN)[1]).all()


@pytest.fixture(scope="module")
def scc():
    return StackedCrossCorrelation(
        scales=[1], max_speed=150 * u.mas / u.yr, baseline=[7, 33] * u.yr,
        min_error_beams=0.1, detection=7, segmentation=5,
    )  # fmt: skip


@pytest.fixture(scope="module")
def matched(scc):
    how = {"n_knots": 50, "n_clumps": 8, "radius": 70 * u.arcsec, "size": 200}
    return scc.match(simulate_shell(n_epochs=5, interval=8 * u.yr, **how, rng=4).cube)


def test_rate_and_centre_and_what_alignment_adds(scc, matched):
    fit = expansion.fit_shell(scc, {"knots": matched, "ring": matched})
    assert fit.groups == ("knots", "ring")
    # At the mean date, 16 years after the first.
    true = 0.11 / (1 + 0.0011 * 16)
    error = fit.rate_err[0].to_value(RATE)
    assert abs(fit.rate[0].to_value(RATE) - true) < 4 * error + 0.002
    away = (fit.centre - CENTRE).to_value(u.arcsec)
    assert np.all(np.abs(away) < 4 * fit.centre_err.to_value(u.arcsec) + 0.2)
    assert np.all(fit.centre_err < 1.5 * u.arcsec)
    assert 50 < fit.radius.to_value(u.arcsec) < 75
    # A drift between two epochs, unknown to this error, is one of the centre.
    drifts = expansion.fit_shell(replace(scc, alignment_error=100 * u.mas), matched)
    plain = expansion.fit_shell(scc, matched)
    np.testing.assert_array_equal(drifts.centre.value, plain.centre.value)
    more = np.sqrt(drifts.centre_err**2 - plain.centre_err**2)
    # Of five dates: the error of a straight line through them, over the rate.
    years = np.arange(5) * 8.0
    slope = 100 * u.mas / u.yr / np.sqrt(((years - years.mean()) ** 2).sum())
    np.testing.assert_allclose((more * plain.rate[0] / slope).to_value(u.one), 1, 0.1)
    assert np.all(drifts.rate_err < 1.5 * plain.rate_err)


@pytest.mark.slow
def test_sectors():
    """Patterns that move by more than their size."""
    shell = simulate_shell(
        n_epochs=8, interval=3 * u.yr, n_clumps=0, n_knots=40, radius=50 * u.arcsec,
        size=180, knot_rate=0.8 * RATE, rng=4,
    )  # fmt: skip
    scc = StackedCrossCorrelation(
        scales=[1], max_speed=1000 * u.mas / u.yr, detection=7, segmentation=5
    )
    decomposed = scc.decompose(shell.cube)
    table = expansion.measure_expansion(
        scc, decomposed, shell.centre, shell.radius, sectors=2, n_trials=199, rng=1
    )
    assert set(table["pa_min"].value) == {0, 180}
    moving = table[table["kind"] == "moving"]
    assert len(moving) == 2
    # At the mean date, 10.5 years after the first.
    true = 0.8 / (1 + 0.008 * 10.5)
    for row in moving:
        assert row["p_global"] <= 0.01
        error = row["rate_err"].to_value(RATE)
        assert abs(row["rate"].to_value(RATE) - true) < min(error, 0.3 * true)
        assert abs(row["rotation"]) < 3 * row["rotation_err"]
    assert np.all(moving["p_fdr"] >= moving["p_global"])


def test_what_makes_no_sense_is_refused(scc, matched):
    none = replace(matched, select=np.zeros_like(matched.select))
    cube = replace(matched.cube, times=matched.cube.times + 1 * u.day)
    later = {"a": matched, "b": replace(matched, cube=cube)}
    where = CENTRE, 70 * u.arcsec
    with pytest.raises(ValueError, match="sectors = 0 must be"):
        expansion.measure_expansion(scc, matched, *where, sectors=0)
    with pytest.raises(ValueError, match="nothing to measure"):
        expansion.measure_expansion(scc, none, *where)
    for groups, words in ((none, "or more, all has 0"), (later, "of the same dates")):
        with pytest.raises(ValueError, match=words):
            expansion.fit_shell(scc, groups)
