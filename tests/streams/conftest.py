# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matches of features whose motions are known."""

import numpy as np
import pytest

from astro_scc.stacking.velocities import VelocitySamples


def make_lines(speeds, starts, years, *, scatter=0.0, rng=None):
    """
    Positions and epochs of features on straight lines, seen in every epoch.

    Ordered by epoch, so that SSP ``epoch * n + k`` is that of feature k.
    """
    years = np.asarray(years, dtype=float)
    along = np.asarray(starts) + np.asarray(speeds) * (years[:, None] - years[0])
    position = np.stack([along, 0 * along], axis=-1).reshape(-1, 2)
    if scatter:
        position = position + rng.normal(scale=scatter, size=position.shape)
    return position, np.repeat(np.arange(len(years)), len(speeds))


def make_matches(position, epoch, years, *, scale=None):
    """Every two SSPs of one scale and different epochs match if they are close."""
    scale = np.ones(len(epoch)) if scale is None else np.asarray(scale)
    away = position - position[:, None]
    match = (epoch[:, None] != epoch) & (scale[:, None] == scale)
    ssp, to = np.nonzero(match & np.all(np.abs(away) <= (1.5, 0.5), axis=-1))
    return VelocitySamples(
        *away[ssp, to].T, weight=np.ones(len(ssp)), reference=epoch[ssp],
        target=epoch[to], ssp=ssp, target_ssp=to, position=position, epoch=epoch,
        scale=scale, years=np.asarray(years, dtype=float),
    )  # fmt: skip


def make_jet(rng, years, streams=(), *, still=0, chance=0, length=8.0, seen=1.0):
    """
    Matches of features that move, of some that do not, and of chance.

    Streams are ``(number, speed, dispersion)``, the dispersion relative.
    Every position has an error of 0.04, every feature is missing in some
    epochs.  Chance SSPs are others in every epoch, so that without streams
    the epochs are exchangeable.
    """
    speeds = np.concatenate(
        [v * np.exp(rng.normal(0, tau, n)) for n, v, tau in (*streams, (still, 0, 0))]
    )
    starts = rng.uniform(0, length, len(speeds))
    position, epoch = make_lines(speeds, starts, years, scatter=0.04, rng=rng)
    there, n = rng.random(len(epoch)) <= seen, chance * len(years)
    others = np.stack([rng.uniform(0, length, n), rng.uniform(-0.5, 0.5, n)], axis=1)
    position = np.concatenate([position[there], others])
    epoch = np.concatenate([epoch[there], np.repeat(np.arange(len(years)), chance)])
    return make_matches(position, epoch, years)


@pytest.fixture(scope="session")
def lines():
    return make_lines


@pytest.fixture(scope="session")
def axis_matches():
    return make_matches


@pytest.fixture(scope="session")
def jet():
    return make_jet
