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


def lines(speeds, starts, years, *, across=0.0, scatter=0.0, rng=None):
    """
    Positions and epochs of features on straight lines, seen in every epoch.

    Ordered by epoch, so that SSP ``epoch * n + k`` is that of feature k.
    """
    speeds, starts, years = (
        np.asarray(k, dtype=float) for k in (speeds, starts, years)
    )
    along = starts + speeds * (years[:, None] - years[0])
    position = np.stack([along, np.broadcast_to(across, along.shape)], axis=-1)
    position = position.reshape(-1, 2)
    if scatter:
        position = position + rng.normal(scale=scatter, size=position.shape)
    return position, np.repeat(np.arange(len(years)), len(speeds))


def axis_matches(position, epoch, years, *, scale=None, reach=(1.5, 0.5)):
    """Every two SSPs of one scale and different epochs match if they are close."""
    position, epoch = np.asarray(position, dtype=float), np.asarray(epoch)
    scale = np.ones(len(epoch)) if scale is None else np.asarray(scale)
    away = position - position[:, None]
    match = (epoch[:, None] != epoch) & (scale[:, None] == scale)
    ssp, to = np.nonzero(match & np.all(np.abs(away) <= reach, axis=-1))
    along, across = away[ssp, to].T
    return VelocitySamples(
        d1=along,
        d2=across,
        weight=np.ones(len(ssp)),
        reference=epoch[ssp],
        target=epoch[to],
        ssp=ssp,
        target_ssp=to,
        position=position,
        epoch=epoch,
        scale=scale,
        years=np.asarray(years, dtype=float),
    )


@pytest.fixture(scope="session", name="lines")
def _lines():
    return lines


@pytest.fixture(scope="session", name="axis_matches")
def _axis_matches():
    return axis_matches


def jet(rng, years, streams=(), *, still=0, chance=0, length=8.0, seen=1.0):
    """
    Matches of features that move, of some that do not, and of chance.

    Streams are ``(number, speed, dispersion)``, the dispersion relative.
    Every position has an error of 0.04, every feature is missing in some
    epochs.  Chance SSPs are others in every epoch, so that without streams
    the epochs are exchangeable.
    """
    speeds = [
        v * np.exp(rng.normal(0, tau, n)) for n, v, tau in (*streams, (still, 0, 0))
    ]
    speeds = np.concatenate(speeds)
    starts = rng.uniform(0, length, len(speeds))
    position, epoch = lines(speeds, starts, years, scatter=0.04, rng=rng)
    there = rng.random(len(epoch)) <= seen
    others = np.stack(
        [
            rng.uniform(0, length, chance * len(years)),
            rng.uniform(-0.5, 0.5, chance * len(years)),
        ],
        axis=1,
    )
    position = np.concatenate([position[there], others])
    epoch = np.concatenate([epoch[there], np.repeat(np.arange(len(years)), chance)])
    return axis_matches(position, epoch, years)


@pytest.fixture(scope="session", name="jet")
def _jet():
    return jet
