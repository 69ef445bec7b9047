# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Permutation tests: of epochs along the rays of the diagram, and of persistence."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from astro_scc.stacking.stack import MOST, number_of_permutations, random_permutations
from astro_scc.stacking.velocities import VelocitySamples
from astro_scc.streams.diagram import DEFAULT, Rays, SearchSettings, pair_densities

#: Standard deviations of the permutations are at least this fraction of the largest one
#: of any axis at the same speed: single matches across the flow are not significant.
LEAST_STD = 0.3
#: Up to this number of epochs all permutations are used: the variance of a small sample
#: would be inaccurate.
ALL_ORDERS_OF = 6
#: Bytes of permuted diagrams that are made at once.
BYTES = 2**22


def permutations_of_epochs(n_epochs, n_trials, rng):
    """
    Draw permutations of the epochs, each as likely as the observed order.

    Parameters
    ----------
    n_epochs, n_trials : int
    rng : `~numpy.random.Generator`

    Returns
    -------
    `~numpy.ndarray` of int, shape (n, n_epochs)
        All except the observed one for up to six epochs, or if these are at
        most ``n_trials``; otherwise random ones.
    """
    few = n_epochs <= ALL_ORDERS_OF
    if few or math.factorial(min(n_epochs, MOST)) <= n_trials + 1:
        return np.array(list(itertools.permutations(range(n_epochs))))[1:]
    return random_permutations(n_epochs, n_trials, rng)


@dataclass(frozen=True, eq=False, repr=False)
class EpochPermutations:
    """
    The permutation test along the rays of the diagram.

    Attributes
    ----------
    speed : `~numpy.ndarray`, shape (n_v,)
        In beams/yr, in both directions.
    weight : `~numpy.ndarray`, shape (n_v,)
        Up to 1, less for slow speeds: blends of features whose fluxes vary drift.
    z : `~numpy.ndarray`, shape (n_axes, n_v)
        ``weight E(v) / std E(v)``, where E is the sum of the excess along a ray and
        the standard deviation is over all orders, including the observed one.  With
        pairs of detections, E is the mean of those of both in standard deviations.
    permuted : `~numpy.ndarray`, shape (n_orders - 1, n_axes, n_v)
        The same for each permutation.
    smallest_p : float
        Smallest probability that the number of orders allows.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.streams import SearchSettings
    >>> from astro_scc.streams.diagram import Rays
    >>> from astro_scc.streams.permutations import EpochPermutations
    >>> from astro_scc.stacking.velocities import VelocitySamples
    >>> years = np.arange(6.0)
    >>> ssp, to = (k[~np.eye(6, dtype=bool)] for k in np.indices((6, 6)))
    >>> d = VelocitySamples(
    ...     d1=0.5 * (to - ssp), d2=np.zeros(30), weight=np.ones(30),
    ...     reference=ssp, target=to, ssp=ssp, target_ssp=to,
    ...     position=np.zeros((6, 2)), epoch=np.arange(6), scale=np.ones(6),
    ...     years=years)
    >>> rays = Rays.of(years, 1.5, SearchSettings())
    >>> test = EpochPermutations.of([(d,)], rays, 99, np.random.default_rng(1))
    >>> axis, speed = test.largest()
    >>> axis, abs(speed - 0.5) < 0.1, test.p_values(axis, speed)[1] < 0.05
    (0, True, True)
    """

    speed: np.ndarray
    weight: np.ndarray
    z: np.ndarray
    permuted: np.ndarray
    smallest_p: float

    @classmethod
    def of(
        cls, axes: Sequence[Sequence[VelocitySamples]], rays: Rays, n_trials: int,
        rng: np.random.Generator, *, outward: bool = False, one_way: bool = False,
    ) -> EpochPermutations:  # fmt: skip
        """
        Permute the epochs.

        Parameters
        ----------
        axes : sequence of sequences of ``VelocitySamples``
            For each axis that is searched the matches along it and, if there are any,
            the pairs of detections.  Of both, the mean in standard deviations counts
            (Stouffer et al. 1949, The American Soldier I).
        rays : `Rays`
        n_trials : int
            Number of random permutations; for few epochs all are used.
        rng : `~numpy.random.Generator`
        outward : bool, optional
            Search positive speeds only.
        one_way : bool, optional
            Subtract from the excess at each speed that at the opposite one.  Fluxes
            that vary slowly make both, as what is the same after their reversal in
            time; motion makes one.

        Returns
        -------
        `EpochPermutations`
        """
        years, speed = axes[0][0].years, rays.speed
        orders = permutations_of_epochs(len(years), n_trials, rng)
        orders = np.concatenate([np.arange(len(years))[None], orders])
        each = []
        for kind in zip(*axes, strict=True):
            if any(map(len, kind)) or not each:
                axes_of = [_ray_sums(a, rays, orders, one_way) for a in kind]
                sums, chance = zip(*axes_of, strict=True)
                size = max((*chance, 1e-294))
                each.append(_in_deviations(np.stack(sums, axis=1), size))
        z = each[0] if len(each) == 1 else _in_deviations(sum(each), 1.0)
        # Slow drifts of blends are no motion, and permutations have none.
        span = min(years[-1] - years[0], rays.intervals[1])
        drift = np.sqrt(np.minimum(np.abs(speed) * span / rays.settings.drift, 1.0))
        use = speed > (0 if outward else -np.inf)
        z = (drift * z)[..., use]
        smallest_p = max(1 / len(orders), 1 / number_of_permutations(len(years)))
        permuted = z[1:].astype(np.float32)
        return cls(speed[use], drift[use], z[0], permuted, smallest_p)

    @cached_property
    def maxima(self) -> np.ndarray:
        """Largest z of each permutation over axes and speeds, ascending."""
        return np.sort(self.permuted.max(axis=(1, 2)))

    def largest(self, other: ArrayLike | None = None) -> tuple[int, float]:
        """
        Return the axis and speed with the largest z.

        Parameters
        ----------
        other : array_like of bool, shape (n_v,), optional
            Speeds to consider; of these only maxima count, not slopes of others.

        Returns
        -------
        axis : int
        speed : float
            Interpolated between grid points by a parabola in the logarithm.
        """
        z = self.z
        if other is not None:
            sides = np.pad(z, ((0, 0), (1, 1)), constant_values=-np.inf)
            top = (z >= sides[:, :-2]) & (z >= sides[:, 2:])
            z = np.where(other & top, z, -np.inf)
        axis, k = np.unravel_index(z.argmax(), z.shape)
        speed = self.speed[k]
        if np.count_nonzero(self.speed[max(k - 1, 0) : k + 2] * speed > 0) == 3:
            below, here, above = self.z[axis, k - 1 : k + 2]
            if (curvature := below - 2 * here + above) < 0:
                shift = 0.5 * (below - above) / curvature
                speed *= np.exp(shift * np.log(abs(self.speed[k + 1] / speed)))
        return int(axis), float(speed)

    def significance(self, axis: int, speed: ArrayLike) -> np.ndarray:
        """
        Return z at speeds, interpolated between grid points.

        Parameters
        ----------
        axis : int
        speed : array_like

        Returns
        -------
        `~numpy.ndarray`
            Minus infinity beyond the speeds that were searched.
        """
        found = np.interp(speed, self.speed, self.z[axis], left=-np.inf, right=-np.inf)
        slow = self.speed[self.speed > 0].min()
        return np.where(np.abs(speed) < slow, -np.inf, found)

    def p_values(self, axis: int, speed: float) -> tuple[float, float]:
        """
        Return the probabilities of as large a z at this speed, and at any speed.

        Parameters
        ----------
        axis : int
        speed : float

        Returns
        -------
        p_local, p_global : float
            ``(b + 1) / (n + 1)``, where b of the n permutations have a z at
            this speed, or a largest z over all axes and speeds, of at least
            the observed one.
        """
        z = float(self.significance(axis, speed))
        if not np.isfinite(z):
            return 1.0, 1.0
        here = self.permuted[:, axis, np.abs(self.speed - speed).argmin()]
        n = len(self.permuted) + 1
        p_local = ((here >= z - 1e-6).sum() + 1) / n
        return float(p_local), float(((self.maxima >= z - 1e-6).sum() + 1) / n)


def _ray_sums(samples, rays, orders, one_way):
    """Return the excess along each ray in each order, (n_orders, n_v), and its mean."""
    grid, pairs, mean = pair_densities(samples, rays)
    bins, matrix = rays.bins, rays.matrix(rays.speed, grid)
    chance = matrix @ (bins.number[:, None] * mean).ravel()
    largest = chance.max()
    if one_way:
        # Displacements of both signs at once, which have the same mean.
        middle, chance = len(grid) // 2, 0.0
        pairs = pairs[:, middle:] - pairs[:, middle::-1]
        matrix = rays.matrix(rays.speed[rays.speed > 0], grid[middle:])
    size = max(1, int(BYTES // (8 * len(bins.mean) * pairs.shape[1])))
    parts = [
        matrix @ bins.sums(pairs, some).reshape(len(some), -1).T
        for some in np.split(orders, np.arange(size, len(orders), size))
    ]
    sums = np.concatenate(parts, axis=1).T - chance
    return np.concatenate([-sums[:, ::-1], sums], axis=1) if one_way else sums, largest


def _in_deviations(sums, size):
    """Return sums in their standard deviations, (n_orders, n_axes, n_v)."""
    std = sums.std(axis=0)
    # The floor keeps rounding errors of identical epochs from counting.
    floor = LEAST_STD * std.max(axis=0) + 1e-6 * size
    return sums / np.maximum(std, floor)


#: Mean number of SSPs of an epoch and a scale: dense flows have more than eight, the
#: sources of MOJAVE whose features are chains two or three.
LEAST_SSPS = 5


def persistence(
    samples: VelocitySamples, speed: float, settings: SearchSettings = DEFAULT
) -> float:
    r"""
    Return the probability that SSPs seem to keep a speed by chance alone.

    Where features have a new speed at every epoch, many of them move at any one speed
    between two epochs, which permuted epochs do not show, but it does not depend on
    how an SSP came whether it goes on.  SSP i has x links at this speed with earlier
    epochs and y with later ones, each a match of one of the two SSPs, at most twice
    ``blur`` from the line.  Their covariance within the N SSPs of an epoch and a scale,
    summed over all of these, is compared with that of y in random order,

    .. math:: z = \sum S_{xy} \left(\frac{n + 1}{2}
                  \sum \frac{S_{xx} S_{yy}}{N - 1}\right)^{-1/2}, \quad
              S_{xy} = \sum_i (x_i - \bar x)(y_i - \bar y)

    (Hoeffding 1951, Ann. Math. Stat. 22, 558).  The same feature has SSPs on several of
    the n scales, whose covariances have a correlation of about 0.5: without a common
    speed, z has a mean of 0.2 and a standard deviation of 1.0 to 1.1 over all speeds.

    Parameters
    ----------
    samples : ``VelocitySamples``
        Along the direction of the flow, in beams.
    speed : float
        In beams/yr.
    settings : `~astro_scc.streams.SearchSettings`, optional

    Returns
    -------
    float
        NaN where fewer than five SSPs share an epoch and a scale, which seldom show it,
        or half of all come at this speed, which is then common.

    Examples
    --------
    Two features that move, and four that stand still:

    >>> import numpy as np
    >>> from astro_scc.stacking.velocities import VelocitySamples
    >>> from astro_scc.streams.permutations import persistence
    >>> epoch, feature = (k.ravel() for k in np.indices((6, 6)))
    >>> same = (feature[:, None] == feature) & (abs(epoch[:, None] - epoch) == 1)
    >>> ssp, to = np.nonzero(same)
    >>> d = VelocitySamples(
    ...     d1=np.where(feature[ssp] < 2, 0.5, 0) * (epoch[to] - epoch[ssp]),
    ...     d2=0.0 * ssp, weight=0.0 * ssp, reference=epoch[ssp], target=epoch[to],
    ...     ssp=ssp, target_ssp=to, epoch=epoch, scale=np.ones(36),
    ...     years=np.arange(6.0))
    >>> persistence(d, 0.5) < 1e-3
    True
    """
    epoch, scale = np.asarray(samples.epoch), np.asarray(samples.scale)
    off = samples.d1 - speed * samples.interval
    near = (np.abs(off) <= 2 * settings.blur) & (np.abs(samples.d2) <= settings.across)
    links = _links(samples.select(near))
    n = len(epoch)
    before, after = (
        np.bincount(links[0, links[2] == way], minlength=n) for way in (-1, 1)
    )
    # Those with an earlier and a later epoch.
    used = np.isin(np.arange(n), samples.ssp)
    ends = np.unique(epoch[used])[[0, -1]] if used.any() else (0, 0)
    used &= (epoch > ends[0]) & (epoch < ends[1])
    kind = np.stack([epoch, scale])[:, used]
    group = np.unique(kind, axis=1, return_inverse=True)[1].ravel()
    number = np.bincount(group)

    def moment(one, other):
        mean = np.bincount(group, one) / number
        return np.bincount(group, (one - mean[group]) * other)

    x, y = before[used], after[used]
    if len(x) < LEAST_SSPS * len(number) or np.count_nonzero(x) >= len(x) / 2:
        return np.nan
    variance = np.sum(moment(x, x) * moment(y, y) / np.maximum(number - 1, 1))
    variance *= (len(np.unique(kind[1])) + 1) / 2
    return float(ndtr(-moment(x, y).sum() / np.sqrt(variance))) if variance else np.nan


def _links(d):
    """Return SSP, what it is linked with, and 1 if that is later, -1 if earlier."""
    way = np.sign(d.interval).astype(int)
    # A match on no SSP is a link with the image.
    lone = d.target_ssp < 0
    links = np.stack([d.ssp, np.where(lone, -1 - d.target, d.target_ssp), way])
    turned = links[[1, 0, 2], :][:, ~lone] * [[1], [1], [-1]]
    return np.unique(np.concatenate([links, turned], axis=1), axis=1)
