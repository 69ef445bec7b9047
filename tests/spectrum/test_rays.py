# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The speed across the flow, and errors by the deletion of epochs."""

import numpy as np
import pytest
from astropy.stats import jackknife_stats
from numpy.testing import assert_equal

from astro_scc.spectrum.diagram import FlowPlanes, correlate_aside
from astro_scc.spectrum.rays import deletion_error, transverse_speed, without_each

STEP, N = 0.2, (60, 40)


def flow_of(speed, across, *, n_epochs=10, seed=1):
    """Gaussians of a beam that move along and across a periodic grid."""
    rng = np.random.default_rng(seed)
    years = np.sort(rng.uniform(0, 1, n_epochs))
    x, y = (STEP * np.fft.fftfreq(n, 1 / n) for n in N)
    spot = np.exp(-2.77 * (x[:, None] ** 2 + y**2))
    noise = np.fft.fft2(rng.normal(size=N)) * np.fft.fft2(spot)
    ways = (np.fft.fftfreq(n, STEP) for n in N)
    kx, ky = np.meshgrid(*ways, indexing="ij")
    turned = [np.exp(-2j * np.pi * t * (kx * speed + ky * across)) for t in years]
    values = np.fft.ifft2(noise * turned).real
    values -= values.mean(axis=0)
    grid, mask = (STEP * np.arange(n) for n in N), np.ones(N, bool)
    return FlowPlanes(values[None].astype("f4"), mask, *grid, years, (1,), 3.0)


@pytest.mark.parametrize("across", [-0.4, 0.0, 0.4])
def test_the_speed_across_is_found(across):
    found = []
    for seed in range(6):
        flow = flow_of(2.0, across, seed=seed)
        found.append(transverse_speed(correlate_aside(flow, [2]), 2 * STEP, 2.0))
    assert np.mean(found, axis=0)[0] == pytest.approx(across, abs=0.15)
    assert all(0 < error < 2.0 for _, error in found)
    assert transverse_speed([], 0.4, 2.0)[0] == 0
    assert_equal(transverse_speed(correlate_aside(flow, [2]), 0.4, 1e-3), [0, np.nan])


def test_errors_are_those_of_the_jackknife():
    rng = np.random.default_rng(4)
    pairs, data = rng.normal(size=(5, 5)), rng.normal(size=9)
    left = [np.delete(np.delete(pairs, k, 0), k, 1).sum() for k in range(5)]
    assert without_each(pairs) == pytest.approx([pairs.sum(), *left])
    means = np.array([data.mean(), *(np.delete(data, k).mean() for k in range(9))])
    assert deletion_error(means) == pytest.approx(jackknife_stats(data, np.mean)[2])
