# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matches as displacements: random ones, clumps and features that move together."""

import numpy as np
import pytest

from astro_scc.stacking.velocities import VelocitySamples


def random_displacements(rng, n_epochs=4, n=60, *, reach=3.0, s1=(0.2, 0.6), s2=None):
    """Matches between random epochs, of SSPs that exist, some landing on none."""
    n_ssps = rng.integers(1, 9, n_epochs)
    first = np.cumsum(n_ssps) - n_ssps
    reference = rng.integers(n_epochs, size=n)
    target = (reference + rng.integers(1, n_epochs, size=n)) % n_epochs
    landed = first[target] + rng.integers(n_ssps[target])
    return VelocitySamples(
        d1=rng.uniform(-reach, reach, n),
        d2=rng.uniform(-reach, reach, n),
        s1=rng.uniform(*s1, n),
        s2=rng.uniform(*(s2 or s1), n),
        weight=rng.uniform(0.5, 1.0, n),
        reference=reference,
        target=target,
        ssp=first[reference] + rng.integers(n_ssps[reference]),
        target_ssp=np.where(rng.random(n) < 0.2, -1, landed),
        n_ssps=n_ssps,
    )


def clump(n, *, velocity=(1.0, -0.5), interval=0.5, s=(0.2, 0.2), shared=False):
    """Matches of two epochs with one displacement, each of an SSP of its own."""
    one = np.ones(n)
    return VelocitySamples(
        d1=velocity[0] * interval * one,
        d2=velocity[1] * interval * one,
        s1=s[0] * one,
        s2=s[1] * one,
        weight=one,
        reference=np.zeros(n, dtype=int),
        target=np.ones(n, dtype=int),
        ssp=np.zeros(n, dtype=int) if shared else np.arange(n),
        target_ssp=np.full(n, -1),
        n_ssps=np.array([n, n]),
    )


@pytest.fixture(scope="session", name="random_displacements")
def _random_displacements():
    return random_displacements


@pytest.fixture(scope="session", name="clump")
def _clump():
    return clump
