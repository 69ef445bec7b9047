# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Candidates for links, and their likelihood: one feature at two epochs, or chance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from astro_scc.correlation import Matches
from astro_scc.decomposition import SSPs
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.images.positions import beam_fwhm, ssp_offsets

#: Distance in beams beyond which features are distinguished from the core.
CORE_RADIUS = 0.5
#: Candidates kept for one SSP and one later epoch, those of highest correlation.
MAX_CANDIDATES = 12
#: Largest distance of neighbours, in units of the sum of their radii.
NEAR = 1.2
#: Log-likelihood that a merge or split must gain, as chance also gains some.
MERGE_COST = 1.0
# These widths were measured for features in simulated jets of two streams.
#: Means of one minus the correlation coefficient, of the same feature and of chance
#: pairs; both distributions are taken as exponential.
DECORRELATION, CHANCE_DECORRELATION = 0.06, 0.15
#: Half width of the Lorentzian distribution of the logarithm of the ratio of two peaks
#: of the same feature.
VARIABILITY = 0.15
#: Cost of an epoch at which the feature is not seen.
MISSING = 2.0
#: Probability that a pattern moves with the larger one in which it lies.
FOLLOW = 0.5


@dataclass(frozen=True, eq=False, repr=False)
class Candidates:
    """
    Pairs of SSPs of one scale that may be the same feature at two dates.

    Attributes
    ----------
    source, target : `~numpy.ndarray` of int, shape (n,)
        Indices in the catalogue of the SSPs of all epochs.
    dy, dx : `~numpy.ndarray`, shape (n,)
        Displacement from maximum to maximum, in pixels.
    interval : `~numpy.ndarray`, shape (n,)
        Time from source to target, positive.
    gap : `~numpy.ndarray` of int, shape (n,)
        Number of epochs between the two, 0 for consecutive ones.
    coefficient : `~numpy.ndarray`, shape (n,)
        Correlation of the source with the target's image at that displacement.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking.likelihood import Candidates
    >>> found = Candidates(
    ...     source=np.array([0, 1]), target=np.array([2, 2]), dy=np.zeros(2),
    ...     dx=np.array([5.0, -3.0]), interval=np.full(2, 0.1), gap=np.zeros(2, int),
    ...     coefficient=np.array([0.95, 0.7]))
    >>> len(found.select(found.coefficient > 0.8))
    1
    """

    source: np.ndarray
    target: np.ndarray
    dy: np.ndarray
    dx: np.ndarray
    interval: np.ndarray
    gap: np.ndarray
    coefficient: np.ndarray

    def __len__(self) -> int:
        return len(self.source)

    @property
    def motion(self) -> np.ndarray:
        """Displacements (y, x), shape (n, 2)."""
        return np.stack([self.dy, self.dx], axis=1)

    def select(self, keep: ArrayLike) -> Candidates:
        """
        Return some of the candidates.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or of int

        Returns
        -------
        `Candidates`
            Or `Links`, if these are links.
        """
        return type(self)(*(getattr(self, f.name)[keep] for f in fields(self)))


def find_candidates(
    matches: Matches, target_ssp: ArrayLike, ssps: SSPs, years: ArrayLike, *,
    max_gap: int = 1, inside: Callable | None = None,
) -> Candidates:  # fmt: skip
    """
    Return the candidates among the correlation peaks.

    A peak is a candidate if it falls on an SSP of the same scale at a later
    epoch.  If several peaks connect the same two SSPs, the highest is used.
    Each SSP keeps its twelve highest candidates for each later epoch.

    Parameters
    ----------
    matches : `~astro_scc.correlation.Matches`
    target_ssp : array_like of int, shape (n_matches,)
        The SSP that each match falls on, or -1, see
        ``target_ssps``.
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    years : array_like, shape (n_epochs,)
        Dates in order, not decreasing.
    max_gap : int, optional
        Most epochs between source and target, 0 or more.
    inside : callable, optional
        Takes `Candidates` and returns which are within the limits of speed.

    Returns
    -------
    `Candidates`
        Ordered by source and target.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.correlation import Correlator, all_pairs
    >>> from astro_scc.correlation.correlate import target_ssps
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.tracking.likelihood import find_candidates
    >>> y, x = np.mgrid[:64, :96]
    >>> def image(x0):
    ...     return np.exp(-((x - x0) ** 2 + (y - 32) ** 2) / 30)
    >>> decompose = Decomposer(scales=[2])
    >>> epochs = [decompose(image(x0)) for x0 in (40, 46, 52)]
    >>> ssps = SSPs.of_epochs(epochs)
    >>> matches = Correlator()(epochs, all_pairs(3), 14)
    >>> found = find_candidates(
    ...     matches, target_ssps(matches, ssps), ssps, [2000.0, 2000.5, 2001.0])
    >>> found.source.tolist(), found.target.tolist(), found.dx.round(1).tolist()
    ([0, 0, 1], [1, 2, 2], [6.0, 12.0, 6.0])
    """
    years = np.asarray(years, dtype=float)
    source, target = matches.ssp.astype(int), np.asarray(target_ssp, dtype=int)
    at, to = ssps.epoch[source], matches.target.astype(int)
    use = np.flatnonzero(
        (target >= 0) & (to > at) & (to - at <= max_gap + 1) & (years[to] > years[at])
    )
    # Keep the highest peak of each pair of SSPs.
    use = use[lowest(-matches.coefficient[use], source[use], target[use])]
    source, target, at, to = source[use], target[use], at[use], to[use]
    found = Candidates(
        source=source,
        target=target,
        dy=ssps.y[target] - ssps.y[source],
        dx=ssps.x[target] - ssps.x[source],
        interval=years[to] - years[at],
        gap=to - at - 1,
        coefficient=matches.coefficient[use].astype(float),
    )
    if inside is not None:
        found = found.select(inside(found))
    best = lowest(-found.coefficient, found.source, found.gap, n=MAX_CANDIDATES)
    return found.select(np.sort(best))


def core_ssps(ssps, cube):
    """
    Return which SSPs are the core of a jet.

    On each scale and at each epoch, the core is the SSP nearest to the reference
    pixel of the cube, if it is within half the width of the beam.  A scale has a
    core only if there is such an SSP in at least half of the epochs, because a
    feature that passes by is no core.
    """
    offset = np.stack(ssp_offsets(ssps, cube), axis=1)
    distance = np.hypot(*offset.T)
    away = np.arctan2(*offset.T)
    axis = np.stack([np.sin(away), np.cos(away)], axis=1)
    distance /= beam_fwhm(cube, ssps.epoch, ssps.scale, axis[:, None])[:, 0]
    nearest = lowest(distance, ssps.scale, ssps.epoch)
    nearest = nearest[distance[nearest] <= CORE_RADIUS]
    _, number, count = np.unique(
        ssps.scale[nearest], return_inverse=True, return_counts=True
    )
    core = np.zeros(len(ssps), bool)
    core[nearest] = 2 * count[number] >= len(cube)
    return core


# -- likelihood --------------------------------------------------------------------


def correlation_term(coefficient: np.ndarray) -> np.ndarray:
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
    a, b = DECORRELATION, CHANCE_DECORRELATION
    return np.log(b / a) - (1 - coefficient) * (1 / a - 1 / b)


def brightness(log_ratio: ArrayLike) -> np.ndarray:
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
    w = VARIABILITY
    return -np.log(np.pi * w * (1 + (log_ratio / w) ** 2))


def similarity(candidates: Candidates, ssps: SSPs) -> np.ndarray:
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
    light = brightness(log_ratio)
    scale = ssps.scale[candidates.source]
    for value in np.unique(scale):
        own = scale == value
        log_peak = np.log(ssps.peak[ssps.scale == value])
        light[own] -= np.log(_chance_brightness(log_ratio[own], log_peak))
    correlation = correlation_term(candidates.coefficient)
    return correlation + light - MISSING * candidates.gap


def _chance_brightness(log_ratio, log_peak):
    """Return the density of ratios of any two peaks, with `VARIABILITY`."""
    step = VARIABILITY / 4
    place = np.rint((log_peak - log_peak.min()) / step).astype(int)
    share = np.bincount(place) / len(place)
    pairs = np.convolve(share, share[::-1])
    shift = np.arange(len(pairs)) - len(share) + 1
    width = brightness(step * np.arange(2 * shift[0], 2 * shift[-1] + 1))
    density = np.convolve(pairs, np.exp(width), mode="valid")
    return np.interp(log_ratio / step, shift, density)


def merged_flux(candidates: Candidates, ssps: SSPs, tolerance: float) -> np.ndarray:
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
    tolerance : float
        Standard deviation of a displacement from steady motion, in pixels on each
        axis.

    Returns
    -------
    `~numpy.ndarray`, shape (n,)
        Not negative.
    """
    gain = np.zeros(len(candidates))
    motion = candidates.motion
    sides = candidates.source, candidates.target
    alone = brightness(np.log(ssps.peak[sides[1]] / ssps.peak[sides[0]]))
    for own, common in (sides, sides[::-1]):
        key = common * (candidates.gap.max(initial=0) + 1) + candidates.gap
        other, one = equal_pairs(key, key)
        near = neighbours(own[one], own[other], ssps)
        near &= moves_alike(motion[one] - motion[other], tolerance)
        one, other = one[near], other[near]
        nearest = lowest(_distance(ssps, own[one], own[other]), one, n=2)
        one, other = one[nearest], other[nearest]
        flux = np.zeros((2, len(gain)))
        flux[rank_in_group(one), one] = ssps.flux[own[other]]
        for more in (flux[0], flux[1], flux[0] + flux[1]):
            has = np.flatnonzero(more > 0)
            total = ssps.flux[own[has]] + more[has]
            light = brightness(np.log(total / ssps.flux[common[has]]))
            gain[has] = np.maximum(gain[has], light - alone[has] - MERGE_COST)
    return gain


def neighbours(one: np.ndarray, other: np.ndarray, ssps: SSPs) -> np.ndarray:
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


def moves_alike(away: np.ndarray, tolerance: float) -> np.ndarray:
    """
    Return whether differences of displacements are within three tolerances.

    Parameters
    ----------
    away : `~numpy.ndarray`, shape (n, 2)
    tolerance : float

    Returns
    -------
    `~numpy.ndarray` of bool, shape (n,)
    """
    return np.hypot(away[:, 0], away[:, 1]) <= 3 * tolerance


def coarse_to_fine(
    candidates: Candidates, coarse: Candidates, parent: np.ndarray,
    width: float, density: np.ndarray,
) -> np.ndarray:  # fmt: skip
    """
    Return the prior from the links of the coarser scale.

    A pattern moves with the larger one in which it lies with the
    probability `FOLLOW`, and then its displacement is normally
    distributed; the term is never below ``ln(1 - FOLLOW)``.

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
    term[own] = np.log(1 - FOLLOW + FOLLOW * ratio)
    return term


def steady_motion(
    motion: np.ndarray, interval: np.ndarray, velocity: np.ndarray,
    weight: np.ndarray, density: np.ndarray, tolerance: float,
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
    tolerance : float

    Returns
    -------
    `~numpy.ndarray`, shape (n,)
    """
    variance = tolerance**2 * (1 + interval**2 / weight)
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


# -- groups ------------------------------------------------------------------------


def rank_in_group(*keys):
    """Return the rank of each entry of sorted keys among the equal ones, from 0."""
    new = np.ones(len(keys[0]), bool)
    new[1:] = np.any([key[1:] != key[:-1] for key in keys], axis=0)
    return np.arange(len(new)) - np.flatnonzero(new)[np.cumsum(new) - 1]


def lowest(value, *keys, n=1):
    """Return the indices of the n lowest values for equal keys, sorted by the keys."""
    order = np.lexsort((value, *keys[::-1]))
    return order[rank_in_group(*(key[order] for key in keys)) < n]


def equal_pairs(one, other):
    """Return all (i, k) with ``one[i] == other[k]``, by k and then by i."""
    order = np.argsort(one, kind="stable")
    first, end = (np.searchsorted(one[order], other, side=s) for s in ("left", "right"))
    k = np.repeat(np.arange(len(other)), end - first)
    return order[first[k] + rank_in_group(k)], k
