# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The mixture of what expands and chance, and a simulated shell without a beam."""

from dataclasses import replace

import astropy.units as u
import numpy as np
import pytest

from astro_scc import StackedCrossCorrelation
from astro_scc.expansion import (
    Samples,
    expansion_speed,
    fit_mixture,
    fit_shell,
    measure_expansion,
    start_of,
)
from astro_scc.simulation import simulate_shell

ORIGIN = np.array([4.0, -3.0])
RATES = np.array([0.02, 0.012])


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


TRUTH = np.concatenate([RATES, ORIGIN])


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
    v = v - RATES[group, None] * (x - ORIGIN) + 0.02 * (x - ORIGIN)
    samples = samples_of(x, v, interval, np.zeros(len(x), dtype=int))
    fit = fitted(samples, np.full(len(x), 1e12), ORIGIN)
    away, weight = x - ORIGIN, interval[:, None] ** 2
    slope = (weight * away * v).sum() / (weight * away**2).sum()
    np.testing.assert_allclose(fit.place[0], slope, rtol=1e-6)
    np.testing.assert_allclose(fit.place[1:], ORIGIN)
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
    keep = np.arctan2(*(samples.x - ORIGIN).T) % (2 * np.pi) < 0.2
    part = samples.select(keep)
    fit = fitted(part, (10 * part.interval) ** 2, ORIGIN)
    assert np.isinf(fit.covariance).all()


# -- rates, centre and sectors of a shell -----------------------------------------


RATE = u.percent / u.yr
CENTRE = [6, -4] * u.arcsec


@pytest.fixture(scope="module")
def shell():
    return simulate_shell(
        n_epochs=5, interval=8 * u.yr, n_knots=50, n_clumps=8, radius=70 * u.arcsec,
        size=200, rng=4,
    )  # fmt: skip


@pytest.fixture(scope="module")
def scc():
    return StackedCrossCorrelation(
        scales=[1], max_speed=150 * u.mas / u.yr, baseline=[7, 33] * u.yr,
        min_error_beams=0.1, detection=7, segmentation=5,
    )  # fmt: skip


@pytest.fixture(scope="module")
def matched(scc, shell):
    return scc.match(shell.cube)


def test_simulation(shell):
    assert shell.cube.beams is None
    assert set(shell.truth["group"]) == {"knots", "ring"}
    # The flux has moved outwards: the mean square distance has grown.
    east, north = shell.cube.offsets()
    square = (east - CENTRE[0]) ** 2 + (north - CENTRE[1]) ** 2
    data = shell.cube.data - 20
    first, last = ((square * data[k]).sum() / data[k].sum() for k in (0, -1))
    assert 1.02 < last / first < 1.1


def test_rate_and_centre(scc, matched, shell):
    fit = fit_shell(scc, matched)
    # At the mean date, 16 years after the first.
    true = 0.11 / (1 + 0.0011 * 16)
    error = fit.rate_err[0].to_value(RATE)
    assert abs(fit.rate[0].to_value(RATE) - true) < 4 * error + 0.002
    away = (fit.centre - CENTRE).to_value(u.arcsec)
    assert np.all(np.abs(away) < 4 * fit.centre_err.to_value(u.arcsec) + 0.2)
    assert np.all(fit.centre_err < 1.5 * u.arcsec)
    assert 50 < fit.radius.to_value(u.arcsec) < 75
    known = fit_shell(scc, matched, centre=CENTRE)
    np.testing.assert_allclose(known.centre.to_value(u.arcsec), CENTRE.value)


@pytest.fixture(scope="module")
def parts(scc, matched):
    """The same matches under two names."""
    return {"knots": matched, "ring": matched}


@pytest.fixture(scope="module")
def sectors(scc, matched):
    """The halves of the shell, with all orders of its five epochs."""
    return measure_expansion(
        scc, matched, CENTRE, 70 * u.arcsec, sectors=[0, 180, 360] * u.deg,
        distance=3.4 * u.kpc, n_trials=119, rng=1,
    )  # fmt: skip


def test_sectors(sectors):
    table = sectors
    assert table["pa_min"].value.tolist() == [0, 180]
    for row in table:
        assert row["p_global"] <= 0.05
        assert row["n_features"] >= 10
        assert abs(row["rate"].to_value(RATE) - 0.108) < 0.005
        assert abs(row["rotation"]) < 0.005 * RATE
    ratio = table["speed"] / expansion_speed(table["rate"], 70 * u.arcsec, 3.4 * u.kpc)
    np.testing.assert_allclose(ratio.value, 1)
    assert np.all(table["p_fdr"] >= table["p_global"])


def test_alignment_moves_the_centre(scc, parts):
    """A drift between two epochs, unknown to this error, is one of the centre."""
    plain = fit_shell(scc, parts)
    known = fit_shell(replace(scc, alignment_error=100 * u.mas), parts)
    np.testing.assert_array_equal(known.centre.value, plain.centre.value)
    more = np.sqrt(known.centre_err**2 - plain.centre_err**2)
    # Of five dates: the error of a straight line through them, over the rate.
    years = np.arange(5) * 8.0
    slope = 100 * u.mas / u.yr / np.sqrt(((years - years.mean()) ** 2).sum())
    mean_rate = plain.rate[0]
    np.testing.assert_allclose((more * mean_rate / slope).to_value(u.one), 1, atol=0.1)
    assert np.all(known.rate_err < 1.5 * plain.rate_err)


def shells(**options):
    return lambda *of: measure_expansion(*of, CENTRE, 70 * u.arcsec, **options)


def none_of(matched):
    return replace(matched, select=np.zeros_like(matched.select))


def later(matched):
    cube = replace(matched.cube, times=matched.cube.times + 1 * u.day)
    return replace(matched, cube=cube)


REFUSED = [
    (shells(sectors=0), "whole number above 0"),
    (shells(sectors=[10, 5] * u.deg), "must increase"),
    (shells(sectors=[0, 200, 400] * u.deg), "more than a turn"),
    (lambda scc, m: shells()(scc, none_of(m)), "nothing to stack"),
    (lambda scc, m: fit_shell(scc, none_of(m)), "nothing to fit a centre to"),
    (lambda scc, m: fit_shell(scc, {"a": m}, {}), "give no groups"),
    (lambda scc, m: fit_shell(scc, {"a": m, "b": none_of(m)}), "or more, b has 0"),
    (lambda scc, m: fit_shell(scc, {"a": m, "b": later(m)}), "of the same dates"),
]


@pytest.mark.parametrize(("call", "words"), REFUSED)
def test_what_makes_no_sense_is_refused(scc, matched, call, words):
    with pytest.raises(ValueError, match=words):
        call(scc, matched)
