# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Exclusive mixture: each SSP has one true match in an image, of one stream or none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from astro_scc.stacking.velocities import VelocitySamples
from astro_scc.streams.diagram import Rays

#: Motions in beams between which shares and widths are the same.
BINS = np.array([0.0, 0.35, 0.7, 1.2, 1.7, 2.5])
#: Smallest and largest standard deviation of displacements in beams, and the first.
WIDTHS, FIRST_WIDTH = (0.12, 0.4), 0.25
#: Smallest and largest share of SSPs with a true match, and the first.
SHARES, FIRST_SHARE = (0.02, 0.8), 0.4
#: Displacements across the axis that are considered, in beams.
ACROSS = 0.6
#: Motions in beams that affect a speed, whatever the interval.
NEAR = 1.2
#: Steps, and relative change of the speeds at which they end.
STEPS, TOLERANCE = 40, 1e-4


@dataclass(frozen=True, eq=False, repr=False)
class Mixture:
    """
    Streams, one at rest and unrelated matches, fitted to all matches together.

    Attributes
    ----------
    speed : `~numpy.ndarray`, shape (k,)
        Of each stream, in beams/yr.
    match : `~numpy.ndarray` of int, shape (n,)
        Indices of the matches that are considered.
    membership : `~numpy.ndarray`, shape (k, n)
        Probability of each match to be a true one of each stream; zero where a match
        is no measure of the stream's speed.
    width : `~numpy.ndarray`, shape (k, n)
        Standard deviation of the displacements in beams.
    """

    speed: np.ndarray
    match: np.ndarray
    membership: np.ndarray
    width: np.ndarray


def fit_mixture(samples: VelocitySamples, speeds: ArrayLike, rays: Rays) -> Mixture:
    r"""
    Fit the speeds of streams to matches, of which most are chance.

    Of the matches of an SSP in an image at most one is true, and it belongs to one
    stream, or to what is at rest.  The odds of a match with displacement d over the
    interval t to be a true one of stream k are

    .. math:: \frac{\pi_k}{1 - \pi_k} \left(\frac{c}{\bar c}\right)^2
              \frac{\mathcal N_2(d - v_k t,\ s_k^2)}{\lambda},

    where c is its correlation coefficient and lambda the density of unrelated matches;
    over all streams and matches of the SSP in that image, and none, they are normalised
    to one.  Shares pi and widths s, which depend on the motion, and speeds v are
    found by expectation maximisation (Dempster et al. 1977, J. R. Stat. Soc. B 39, 1).

    Parameters
    ----------
    samples : ``VelocitySamples``
        Along one axis, in beams.
    speeds : sequence of float
        From which the fit starts, in beams/yr.
    rays : ``Rays``

    Returns
    -------
    `Mixture`
    """
    d, radius = samples, rays.radius
    interval = np.abs(d.interval)
    speeds = np.atleast_1d(np.asarray(speeds, dtype=float))
    slowest = np.abs(speeds).min()
    use = (np.abs(d.d2) <= ACROSS) & (np.abs(d.d1) <= radius) & (interval > 0)
    use &= (interval >= rays.intervals[0]) & (interval <= rays.intervals[1])
    # Where every stream has left the search radius, nothing is learnt.
    use &= (slowest * interval <= radius) | (interval <= rays.short)
    match = np.flatnonzero(use)
    sense = np.sign(d.interval[match])
    x, y, dt = d.d1[match] * sense, d.d2[match] * sense, interval[match]
    if len(match) == 0:
        none = np.zeros((len(speeds), 0))
        return Mixture(speeds, match, none, none)
    # One source of matches for each SSP and image.
    key = d.ssp[match].astype(np.int64) * len(d.years) + d.target[match]
    _, source = np.unique(key, return_inverse=True)
    n = int(source.max()) + 1
    density = len(match) / n / (4 * radius * ACROSS)
    quality = (d.weight[match] / d.weight[match].mean()) ** 2
    y_square, dt_square, x_dt = y**2, dt**2, x * dt
    v = np.array([*speeds, 0.0])
    k, n_bins = len(v), len(BINS)
    share, width = np.full((k, n_bins), FIRST_SHARE), np.full((k, n_bins), FIRST_WIDTH)
    for _ in range(STEPS):
        motion = v[:, None] * dt
        bins = np.digitize(np.abs(motion), BINS) - 1
        inside = np.abs(motion) <= radius
        s = np.take_along_axis(width, bins, axis=1)
        pi = np.where(inside, np.take_along_axis(share, bins, axis=1), 0.0)
        away = (x - motion) ** 2 + y_square
        odds = pi / (1 - pi) * quality * np.exp(-0.5 * away / s**2)
        odds /= 2 * np.pi * s**2 * density
        member = odds / (1 + np.bincount(source, odds.sum(axis=0), n))[source]
        tells = (np.abs(motion) <= NEAR) | ((dt <= rays.short) & inside)
        weight = np.where(tells, member, 0.0) / s**2
        moments = weight @ dt_square
        new = np.divide(weight @ x_dt, moments, out=v.copy(), where=moments > 0)
        new[-1] = 0.0
        for row in range(k):
            # Sources of each bin, sums of memberships and of squares.
            own = bins[row]
            seen = np.zeros(n_bins * n, dtype=bool)
            seen[own * n + source] = True
            number = np.count_nonzero(seen.reshape(n_bins, n), axis=1)
            total = np.bincount(own, member[row], n_bins)
            square = np.bincount(own, member[row] * away[row], n_bins)
            some = total > 1
            share[row, some] = np.clip(total[some] / number[some], *SHARES)
            spread = np.sqrt(square[some] / total[some] / 2)
            width[row, some] = np.clip(spread, *WIDTHS)
        change = np.abs(new - v)[:-1]
        done = (change <= TOLERANCE * np.abs(v[:-1])).all()
        v = new
        if done:
            break
    return Mixture(v[:-1], match, np.where(tells, member, 0.0)[:-1], s[:-1])
