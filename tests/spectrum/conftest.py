# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Flows of random patterns, as arrays."""

import numpy as np
import pytest

from astro_scc.spectrum.diagram import SampledPlanes

STEP = 0.125


@pytest.fixture(name="moving_flow", scope="session")
def fixture_moving_flow():
    """Return a function that makes flow planes of patterns with given speeds."""

    def make(speeds, *, n_epochs=15, seed=1, memory=np.inf, n_patterns=14, noise=0.02):
        rng = np.random.default_rng(seed)
        years = np.cumsum(rng.uniform(0.1, 0.3, n_epochs))
        years -= years[0]
        along = np.arange(0, 20, STEP)
        across = np.arange(-1.5, 1.5 + STEP / 2, STEP)
        span = years[-1]
        images = rng.normal(scale=noise, size=(n_epochs, len(along), len(across)))
        for speed in speeds:
            low, high = min(0, -speed * span), 20 + max(0, -speed * span)
            number = round(n_patterns / len(speeds) * (high - low) / 20)
            for start, place in zip(
                rng.uniform(low, high, number), rng.uniform(-1, 1, number), strict=True
            ):
                flux = rng.lognormal(sigma=0.4)
                if np.isfinite(memory):
                    decay = np.exp(-np.abs(years[:, None] - years) / memory)
                    walk = np.linalg.cholesky(decay) @ rng.normal(size=n_epochs)
                    flux = flux * np.exp(0.5 * walk)[:, None, None]
                x = along[:, None] - start - speed * years[:, None, None]
                images += flux * np.exp(-2.77 * (x**2 + (across - place) ** 2))
        valid = np.ones(images.shape, dtype=bool)
        return SampledPlanes(
            images[None], valid, np.ones(images.shape[1:], bool), np.array([noise]),
            along, across, np.ones((len(along), 1)), years, scales=(1,), sizes=(2.0,),
        ).changes()  # fmt: skip

    return make
