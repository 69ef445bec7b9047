# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Likelihood of links: the same feature at two epochs, or a chance pair."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from astro_scc.decomposition import SSPs
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.tracking.candidates import Candidates, equal_pairs, lowest, rank_in_group

#: Largest distance of neighbours, in units of the sum of their radii.
NEAR = 1.2
#: Log-likelihood that a merge or split must gain, as chance also gains some.
MERGE_COST = 1.0


@dataclass(frozen=True)
class LinkLikelihood:
    """
    Log-likelihood ratios of candidates: the same feature, or a chance pair.

    The terms are the `similarity` of a candidate alone, its `merged_flux` with
    its neighbours, `coarse_to_fine` given the links of the coarser scale, and
    `steady_motion` given the track that it continues.  The widths were measured
    for features in simulated jets of two streams.  The distributions of chance
    pairs are measured on the SSPs themselves, except for the correlation.

    Parameters
    ----------
    tolerance : float, optional
        Standard deviation of a displacement from steady motion, in pixels on
        each axis.
    decorrelation, chance_decorrelation : float, optional
        Means of one minus the correlation coefficient of the same feature and
        of chance pairs; both distributions are taken as exponential.
    variability : float, optional
        Half width of the Lorentzian distribution of the logarithm of the ratio
        of two peaks of the same feature.
    missing : float, optional
        Cost of an epoch at which the feature is not seen.
    follow : float, optional
        Probability that a pattern moves with the larger one in which it lies.

    Raises
    ------
    ValueError
        If a width is not positive, ``follow`` is not a probability below 1, or
        ``missing`` is negative.

    Examples
    --------
    >>> from astro_scc.tracking.likelihood import LinkLikelihood
    >>> likelihood = LinkLikelihood(variability=0.3)
    >>> likelihood.variability > LinkLikelihood().variability
    True
    >>> bool(likelihood.brightness(0.0) > likelihood.brightness(1.0))
    True
    """

    tolerance: float = 2.0
    decorrelation: float = 0.06
    chance_decorrelation: float = 0.15
    variability: float = 0.15
    missing: float = 2.0
    follow: float = 0.5

    def __post_init__(self):
        for name in ("tolerance", "decorrelation", "chance_decorrelation",
                     "variability"):  # fmt: skip
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, got {getattr(self, name)}")
        if not 0 <= self.follow < 1:
            raise ValueError(f"follow must be 0 or more, below 1, got {self.follow}")
        if not self.missing >= 0:
            raise ValueError(f"missing must be 0 or more, got {self.missing}")

    def correlation(self, coefficient: np.ndarray) -> np.ndarray:
        """
        Return the term of the correlation, the log ratio of two exponentials.

        With means a and b of ``1 - c``, it is ``ln(b/a) - (1 - c)(1/a - 1/b)``.

        Parameters
        ----------
        coefficient : `~numpy.ndarray`

        Returns
        -------
        `~numpy.ndarray`
        """
        a, b = self.decorrelation, self.chance_decorrelation
        return np.log(b / a) - (1 - coefficient) * (1 / a - 1 / b)

    def brightness(self, log_ratio: ArrayLike) -> np.ndarray:
        """
        Return the log-likelihood of a change of brightness of one feature.

        Parameters
        ----------
        log_ratio : array_like
            Natural logarithm of the ratio of two brightnesses.

        Returns
        -------
        `~numpy.ndarray`
        """
        w = self.variability
        return -np.log(np.pi * w * (1 + (log_ratio / w) ** 2))

    def similarity(self, candidates: Candidates, ssps: SSPs) -> np.ndarray:
        """
        Return the terms of correlation and brightness, minus the cost of gaps.

        The term of brightness is `brightness` minus the logarithm of the
        density of the same ratio between any two SSPs of the scale, so that a
        core and a feature a hundred times fainter are an unlikely pair.

        Parameters
        ----------
        candidates : `Candidates`
        ssps : `~astro_scc.decomposition.SSPs`

        Returns
        -------
        `~numpy.ndarray`, shape (n,)
        """
        log_ratio = np.log(ssps.peak[candidates.target] / ssps.peak[candidates.source])
        light = self.brightness(log_ratio)
        scale = ssps.scale[candidates.source]
        for value in np.unique(scale):
            own = scale == value
            log_peak = np.log(ssps.peak[ssps.scale == value])
            light[own] -= np.log(self._chance_brightness(log_ratio[own], log_peak))
        correlation = self.correlation(candidates.coefficient)
        return correlation + light - self.missing * candidates.gap

    def _chance_brightness(self, log_ratio, log_peak):
        """Return the density of ratios of any two peaks, with ``variability``."""
        step = self.variability / 4
        place = np.rint((log_peak - log_peak.min()) / step).astype(int)
        share = np.bincount(place) / len(place)
        pairs = np.convolve(share, share[::-1])
        shift = np.arange(len(pairs)) - len(share) + 1
        width = self.brightness(step * np.arange(2 * shift[0], 2 * shift[-1] + 1))
        density = np.convolve(pairs, np.exp(width), mode="valid")
        return np.interp(log_ratio / step, shift, density)

    def merged_flux(self, candidates: Candidates, ssps: SSPs) -> np.ndarray:
        """
        Return what a candidate gains by a merge or split with its neighbours.

        For a merge, neighbours of the source that may go to the same target,
        with displacements equal within three tolerances, are combined with the
        source: the nearest, the second nearest, and both.  If the sum of fluxes
        explains the flux of the target better than the source's peak explains
        the target's peak, the gain is the difference in `brightness` minus one.
        Splits, of targets that may come from one source, are treated likewise.

        Parameters
        ----------
        candidates : `Candidates`
            Of one scale.
        ssps : `~astro_scc.decomposition.SSPs`
            Of all epochs.

        Returns
        -------
        `~numpy.ndarray`, shape (n,)
            Not negative.
        """
        gain = np.zeros(len(candidates))
        motion = candidates.motion
        sides = candidates.source, candidates.target
        alone = self.brightness(np.log(ssps.peak[sides[1]] / ssps.peak[sides[0]]))
        for own, common in (sides, sides[::-1]):
            key = common * (candidates.gap.max(initial=0) + 1) + candidates.gap
            other, one = equal_pairs(key, key)
            near = self.neighbours(own[one], own[other], ssps)
            near &= self.moves_alike(motion[one] - motion[other])
            one, other = one[near], other[near]
            nearest = lowest(_distance(ssps, own[one], own[other]), one, n=2)
            one, other = one[nearest], other[nearest]
            flux = np.zeros((2, len(gain)))
            flux[rank_in_group(one), one] = ssps.flux[own[other]]
            for more in (flux[0], flux[1], flux[0] + flux[1]):
                has = np.flatnonzero(more > 0)
                total = ssps.flux[own[has]] + more[has]
                light = self.brightness(np.log(total / ssps.flux[common[has]]))
                gain[has] = np.maximum(gain[has], light - alone[has] - MERGE_COST)
        return gain

    def neighbours(self, one: np.ndarray, other: np.ndarray, ssps: SSPs) -> np.ndarray:
        """
        Return whether two SSPs differ and almost touch.

        Parameters
        ----------
        one, other : `~numpy.ndarray` of int, shape (n,)
        ssps : `~astro_scc.decomposition.SSPs`

        Returns
        -------
        `~numpy.ndarray` of bool, shape (n,)
        """
        radius = np.sqrt(ssps.n_pixels / np.pi)
        near = _distance(ssps, one, other) <= NEAR * (radius[one] + radius[other])
        return (one != other) & near

    def moves_alike(self, away: np.ndarray) -> np.ndarray:
        """
        Return whether differences of displacements are within three tolerances.

        Parameters
        ----------
        away : `~numpy.ndarray`, shape (n, 2)

        Returns
        -------
        `~numpy.ndarray` of bool, shape (n,)
        """
        return np.hypot(away[:, 0], away[:, 1]) <= 3 * self.tolerance

    def coarse_to_fine(
        self, candidates: Candidates, coarse: Candidates, parent: np.ndarray,
        width: float, density: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """
        Return the prior from the links of the coarser scale.

        A pattern moves with the larger one in which it lies with the
        probability ``follow``, and then its displacement is normally
        distributed; the term is never below ``ln(1 - follow)``.

        Parameters
        ----------
        candidates : `Candidates`
            Of one scale.
        coarse : `Candidates`
            The links of the next coarser scale, one at most from each SSP.
        parent : `~numpy.ndarray` of int, shape (n_ssps,)
            See ``coarser_ssps``.
        width : float
            Standard deviation in pixels: about the size of the coarser scale.
        density : `~numpy.ndarray`, shape (n_ssps,)
            See ``chance_density``.

        Returns
        -------
        `~numpy.ndarray`, shape (n,)
        """
        term = np.zeros(len(candidates))
        # The link of each SSP; the last entry is for SSPs without a parent.
        link = np.full(len(parent) + 1, -1)
        link[coarse.source] = np.arange(len(coarse))
        link = link[parent[candidates.source]]
        own = np.flatnonzero(link >= 0)
        own = own[coarse.gap[link[own]] == candidates.gap[own]]
        away = candidates.motion[own] - coarse.motion[link[own]]
        near = np.exp(-0.5 * np.sum(away**2, axis=1) / width**2)
        ratio = near / (2 * np.pi * width**2 * density[candidates.target[own]])
        term[own] = np.log(1 - self.follow + self.follow * ratio)
        return term

    def steady_motion(
        self, motion: np.ndarray, interval: np.ndarray, velocity: np.ndarray,
        weight: np.ndarray, density: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """
        Return the term of displacements, given the mean velocity of their tracks.

        It is the log ratio of two densities: a two-dimensional normal
        distribution around the displacement that the mean velocity predicts,
        and chance targets.  Each displacement has the standard deviation
        ``tolerance``, whatever its interval t.  The mean velocity therefore
        weights displacements by ``t^2``, and its variance is ``tolerance^2``
        over the sum of these weights.

        Parameters
        ----------
        motion : `~numpy.ndarray`, shape (n, 2)
            Displacements (y, x).
        interval : `~numpy.ndarray`, shape (n,)
            Intervals of the displacements.
        velocity : `~numpy.ndarray`, shape (n, 2)
            Mean velocities of the tracks that the displacements continue.
        weight : `~numpy.ndarray`, shape (n,)
            Sums of the squared intervals of these tracks.
        density : `~numpy.ndarray`, shape (n,)
            SSPs per square pixel where the displacements end.

        Returns
        -------
        `~numpy.ndarray`, shape (n,)
        """
        variance = self.tolerance**2 * (1 + interval**2 / weight)
        away = np.sum((motion - interval[:, None] * velocity) ** 2, axis=1)
        return -0.5 * away / variance - np.log(2 * np.pi * variance * density)


def _distance(ssps, one, other):
    return np.hypot(ssps.y[one] - ssps.y[other], ssps.x[one] - ssps.x[other])


def chance_density(ssps):
    """
    Return the density of SSPs of the same scale and epoch for each SSP.

    It is k per area of the circle whose radius is the median distance to the
    k-th neighbour over the SSPs of the scale and epoch, with k = 3 or as many
    as there are, in 1/pixel^2.  It is at least one SSP in a circle with a radius
    of ten scales, also for an SSP alone.
    """
    density = np.empty(len(ssps))
    for scale, epoch in np.unique(np.stack([ssps.scale, ssps.epoch]), axis=1).T:
        own = np.flatnonzero((ssps.scale == scale) & (ssps.epoch == epoch))
        density[own] = 1 / (np.pi * (10 * scale_size(scale)) ** 2)
        k = min(3, len(own) - 1)
        if k > 0:
            at = np.stack([ssps.y[own], ssps.x[own]], axis=1)
            distance = cKDTree(at).query(at, k + 1)[0][:, k]
            found = k / (np.pi * np.median(distance) ** 2)
            density[own] = np.maximum(found, density[own])
    return density


def coarser_ssps(ssps, width):
    """
    Return the SSP of the next coarser scale that holds each SSP's maximum.

    It belongs to the same epoch; -1 means that there is none.  ``width`` is the
    number of pixels in a row of the images.
    """
    n_pixels, n_epochs = (int(v.max(initial=0)) + 1 for v in (ssps.pixels, ssps.epoch))
    at = np.rint(ssps.y).astype(np.int64) * width + np.rint(ssps.x).astype(np.int64)
    level = np.unique(ssps.scale, return_inverse=True)[1].astype(np.int64)
    # Pixels are numbered through all epochs of a scale, then through all scales.
    image = (level * n_epochs + ssps.epoch) * n_pixels
    owner = np.repeat(np.arange(len(ssps)), ssps.n_pixels)
    key = image[owner] + ssps.pixels
    wanted = np.where(at < n_pixels, image + n_epochs * n_pixels + at, -1)
    pixel, ssp = equal_pairs(key, wanted)
    found = np.full(len(ssps), -1)
    found[ssp] = owner[pixel]
    return found
