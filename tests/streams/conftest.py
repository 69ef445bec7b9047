# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matches of features whose motions are known."""

import numpy as np
import pytest

from astro_scc.stacking.velocities import VelocitySamples


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
