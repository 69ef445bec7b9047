# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Rates and centres at the maximum of a kernel, of made-up velocity samples."""

import numpy as np
import pytest

from astro_scc.expansion.centre import Samples, kernel_maximum


def shell(rng, rates=(0.01, 0.006), centre=(8.0, -5.0), n=300, noise=0.1, chance=0):
    """Velocity samples of groups at 60 to 110 from a centre, and chance ones."""
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
    one = np.ones(len(x))
    return Samples(x, v, one, noise * one, group, group)


def maximum(samples, **options):
    return kernel_maximum(samples, np.ones(len(samples.x)), max_rate=0.03, **options)


def test_least_squares_without_chance():
    # With a kernel far wider than the noise the maximum is that of least squares.
    data = shell(np.random.default_rng(2), rates=(0.01,), noise=0.01)
    x, v = data.x, data.v
    found = maximum(Samples(x, v, data.interval, 20 * data.error, *[data.group] * 2))
    design = np.zeros((2 * len(x), 3))
    design[:, 0] = x.ravel()
    design[0::2, 1] = design[1::2, 2] = -1
    rate, *product = np.linalg.lstsq(design, v.ravel())[0]
    assert found[0] == pytest.approx(rate, rel=1e-2)
    np.testing.assert_allclose(found[1:], np.array(product) / rate, atol=0.3)


def test_a_third_of_chance_does_not_matter():
    found = maximum(shell(np.random.default_rng(3), chance=100))
    np.testing.assert_allclose(found[:2], [0.01, 0.006], rtol=0.05)
    np.testing.assert_allclose(found[2:], [8, -5], atol=3)


def test_a_given_centre_stays():
    found = maximum(shell(np.random.default_rng(4)), centre=[8.0, -5.0])
    np.testing.assert_array_equal(found[2:], [8.0, -5.0])
