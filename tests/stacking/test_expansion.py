# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Expansion rates and centres of made-up sightings."""

import numpy as np
import pytest

from astro_scc.stacking.expansion import fit_expansion


def shell(rng, rates=(0.01, 0.006), centre=(8.0, -5.0), n=300, noise=0.1, chance=0):
    """VelocitySamples of groups at 60 to 110 from a centre, and chance ones."""
    x, v, group = [], [], []
    for g, rate in enumerate(rates):
        angle = rng.uniform(0, 2 * np.pi, n)
        r = rng.uniform(60, 110, n)[:, None]
        away = r * np.stack([np.sin(angle), np.cos(angle)], axis=1)
        velocity = rate * away + rng.normal(0, noise, (n, 2))
        velocity[:chance] = rng.uniform(-1.5, 1.5, (chance, 2))
        x.append(away + centre)
        v.append(velocity)
        group.append(np.full(n, g))
    x, v, group = (np.concatenate(a) for a in (x, v, group))
    return x, v, np.full(len(x), noise), np.ones(len(x)), group


def test_two_rates_about_one_centre():
    off = []
    rng = np.random.default_rng(1)
    for _ in range(8):
        found = fit_expansion(*shell(rng), max_rate=0.03)
        off.append((found.rate - [0.01, 0.006]) / found.rate_err)
        off.append((found.centre - [8.0, -5.0]) / found.centre_err)
        assert np.all(found.n_used > 200)
    assert np.abs(off).max() < 4
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.6


def test_least_squares_without_chance():
    # With a kernel far wider than the noise the maximum is that of least squares.
    x, v, s, w, group = shell(np.random.default_rng(2), rates=(0.01,), noise=0.01)
    found = fit_expansion(x, v, 20 * s, w, group, max_rate=0.03)
    design = np.zeros((2 * len(x), 3))
    design[:, 0] = x.ravel()
    design[0::2, 1] = design[1::2, 2] = -1
    rate, *product = np.linalg.lstsq(design, v.ravel())[0]
    assert found.rate[0] == pytest.approx(rate, rel=1e-2)
    np.testing.assert_allclose(found.centre, np.array(product) / rate, atol=0.3)


def test_a_third_of_chance_does_not_matter():
    found = fit_expansion(*shell(np.random.default_rng(3), chance=100), max_rate=0.03)
    assert np.all(np.abs(found.rate - [0.01, 0.006]) < 4 * found.rate_err)
    assert np.all(np.abs(found.centre - [8, -5]) < 4 * found.centre_err)


def test_a_given_centre_stays():
    data = shell(np.random.default_rng(4))
    found = fit_expansion(*data, max_rate=0.03, centre=[8.0, -5.0])
    np.testing.assert_array_equal(found.centre, [8.0, -5.0])
    np.testing.assert_allclose(found.centre_err, 0, atol=1e-12)


def test_too_few():
    x, v, s, w, group = shell(np.random.default_rng(5), n=5)
    with pytest.raises(ValueError, match="ten velocity samples of each group"):
        fit_expansion(x, v, s, w, group, max_rate=0.03)
    none = np.zeros((0, 2))
    with pytest.raises(ValueError, match="got 0"):
        fit_expansion(none, none, none[:, 0], none[:, 0], group[:0], max_rate=0.03)


def test_no_error_of_one_side():
    x, v, s, w, group = shell(np.random.default_rng(6), rates=(0.01,), n=1200)
    near = np.arctan2(*(x - [8.0, -5.0]).T) % (2 * np.pi) < 0.2
    part = [column[near] for column in (x, v, s, w, group)]
    found = fit_expansion(*part, max_rate=0.03, centre=[8.0, -5.0])
    assert np.isinf(found.rate_err).all()
