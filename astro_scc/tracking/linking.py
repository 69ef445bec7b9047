# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Links: candidates and their likelihood, the choice among them, and tracks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.csgraph import min_weight_full_bipartite_matching as full_matching
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
#: Rounds in which candidates are evaluated, given the links of the previous round.
ROUNDS = 5


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
    >>> from astro_scc.tracking.linking import Candidates
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
    >>> from astro_scc.tracking.linking import find_candidates
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
    use = (target >= 0) & (to - at <= max_gap + 1) & (years[to] > years[at])
    use = np.flatnonzero(use)
    # Keep the highest peak of each pair of SSPs.
    use = use[lowest(-matches.coefficient[use], source[use], target[use])]
    source, target, at, to = source[use], target[use], at[use], to[use]
    found = Candidates(
        source=source, target=target, dy=ssps.y[target] - ssps.y[source],
        dx=ssps.x[target] - ssps.x[source], interval=years[to] - years[at],
        gap=to - at - 1, coefficient=matches.coefficient[use].astype(float),
    )  # fmt: skip
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
    offset = ssp_offsets(ssps, cube)
    distance, away = np.hypot(*offset), np.arctan2(*offset)
    axis = np.stack([np.sin(away), np.cos(away)], axis=1)
    distance /= beam_fwhm(cube, ssps.epoch, ssps.scale, axis[:, None])[:, 0]
    nearest = lowest(distance, ssps.scale, ssps.epoch)
    nearest = nearest[distance[nearest] <= CORE_RADIUS]
    _, number = np.unique(ssps.scale[nearest], return_inverse=True)
    core = np.zeros(len(ssps), bool)
    core[nearest] = 2 * np.bincount(number)[number] >= len(cube)
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


# -- links ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class Links(Candidates):
    """
    The candidates that are links: pairs of SSPs that are one feature.

    Attributes
    ----------
    source, target : `~numpy.ndarray` of int, shape (n,)
        Indices in the catalogue of the SSPs of all epochs.  No SSP is the
        source, or the target, of more than one link of kind "link".
    dy, dx, interval, gap, coefficient : `~numpy.ndarray`, shape (n,)
        As in `Candidates`.
    kind : `~numpy.ndarray` of str, shape (n,)
        "link"; "merge" if the target has another source; "split" if the source
        has another target.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import FeatureTracker
    >>> cube = simulate_two_fluid(n_epochs=3, rng=1).cube
    >>> decompositions = [Decomposer(scales=[2])(image) for image in cube.data]
    >>> tracker = FeatureTracker(max_speed=36 * u.mas / u.yr)
    >>> links = tracker.link(cube, decompositions)
    >>> set(links.kind.tolist()) <= {"link", "merge", "split"}
    True
    >>> bool((links.interval > 0).all())
    True
    """

    kind: np.ndarray

    def __repr__(self):
        counts = [f"{np.sum(self.kind == k)} {k}s" for k in ("link", "merge", "split")]
        return f"<Links: {', '.join(counts)}>"


def link(
    candidates: Candidates, ssps: SSPs, *, parent: ArrayLike | None = None,
    tolerance: float = 2.0,
) -> Links:  # fmt: skip
    """
    Choose links among candidates.

    Scales are linked one after the other, from the coarsest.  Each candidate
    is evaluated by what it adds to the best paths through several epochs, and
    for each pair of epochs, consecutive ones first, the candidates with the
    largest total are chosen (`assign`).  Candidates are then evaluated again,
    given the chosen links before and after them and their mean velocity, until
    nothing changes, in at most five rounds.  SSPs without a partner may merge
    or split.

    Parameters
    ----------
    candidates : `Candidates`
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    parent : array_like of int, shape (n_ssps,), optional
        The SSP of the next coarser scale in which each SSP lies, or -1.  Its
        motion is the prior for the smaller SSPs in it.
    tolerance : float, optional
        Standard deviation of a displacement from steady motion, in pixels on each
        axis.

    Returns
    -------
    `Links`
        Ordered by source.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.correlation import Correlator, all_pairs
    >>> from astro_scc.correlation.correlate import target_ssps
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.tracking.linking import find_candidates, link
    >>> y, x = np.mgrid[:64, :96]
    >>> def image(x0):
    ...     return np.exp(-((x - x0) ** 2 + (y - 32) ** 2) / 30)
    >>> decompose = Decomposer(scales=[2])
    >>> epochs = [decompose(image(x0)) for x0 in (40, 46, 52)]
    >>> ssps = SSPs.of_epochs(epochs)
    >>> matches = Correlator()(epochs, all_pairs(3), 14)
    >>> links = link(find_candidates(
    ...     matches, target_ssps(matches, ssps), ssps, [2000.0, 2000.5, 2001.0]), ssps)
    >>> links.source.tolist(), links.target.tolist()
    ([0, 1], [1, 2])
    """
    step, density = ssps.epoch, chance_density(ssps)
    alone = similarity(candidates, ssps)
    kind = np.full(len(candidates), "", "U5")
    coarse = width = None
    for scale in sorted(np.unique(ssps.scale), reverse=True):
        own = np.flatnonzero(ssps.scale[candidates.source] == scale)
        part = candidates.select(own)
        worth = alone[own] + merged_flux(part, ssps, tolerance)
        if coarse is not None and parent is not None:
            worth += coarse_to_fine(part, coarse, parent, width, density)
        chosen = _link_scale(part, worth, step, density, tolerance)
        kind[own] = _merges_and_splits(part, chosen, ssps, tolerance)
        coarse, width = part.select(chosen), scale_size(scale)
    order = np.lexsort((candidates.target, candidates.source))
    order = order[kind[order] != ""]
    return Links(**vars(candidates.select(order)), kind=kind[order])


def _link_scale(part, worth, step, density, tolerance):
    """Return which candidates of a scale are chosen."""
    transitions = equal_pairs(part.target, part.source)
    use, chosen = np.ones(len(part), bool), np.zeros(len(part), bool)
    for _ in range(ROUNDS):
        between = _steady_motion(part, chosen, transitions, step, density, tolerance)
        gain = path_gains(part, worth, transitions, between, step, use)
        now = _choose(part, gain)
        if np.array_equal(now, chosen):
            break
        use = chosen = now
    return chosen


def _steady_motion(part, chosen, transitions, step, density, tolerance):
    """Return the term of each transition, given the track before and the one after."""
    motion, interval = part.motion, part.interval
    own = np.flatnonzero(chosen)
    # Order the links by track, and by time within each track.
    source = part.source[own]
    track = connected(source, part.target[own], len(step))[source]
    order = np.lexsort((step[source], track))
    between = []
    for way, (one, other), end in (
        (1, transitions, part.target),
        (-1, transitions[::-1], part.source),
    ):
        sums = np.column_stack([interval**2, motion * interval[:, None]])
        links, rank = own[order[::way]], rank_in_group(track[order[::way]])
        # Running sums within each track.
        total, first = np.cumsum(sums[links], axis=0), np.arange(len(links)) - rank
        sums[links] = total - (total[first] - sums[links[first]])
        velocity, weight = sums[one, 1:] / sums[one, :1], sums[one, 0]
        to = motion[other], interval[other], velocity, weight, density[end[other]]
        between.append(steady_motion(*to, tolerance))
    return between


def _choose(part, gain):
    """Return the best links of each pair of epochs, the nearest epochs first."""
    source, target, chosen = part.source, part.target, np.zeros(len(part), bool)
    for gap in np.unique(part.gap):
        taken = np.isin(source, source[chosen]) | np.isin(target, target[chosen])
        # Pairs of epochs with the same gap can be solved together, as no SSP is
        # the source, or the target, in two of them.
        own = np.flatnonzero((part.gap == gap) & ~taken)
        chosen[own[assign(source[own], target[own], gain[own])]] = True
    return chosen


def path_gains(part, worth, transitions, between, step, use):
    """
    Return what each candidate adds to the best paths that it connects.

    The value of a path is the sum of the worth of its candidates and of the
    values of the transitions between them; a path may begin and end anywhere.
    Two passes, forward and backward in time, give the best path through each
    candidate.  The gain of the candidate is the value of this path minus the
    values of the best path that ends at its source and of the best path that
    begins at its target.  The work is linear in the number of transitions.

    ``transitions`` are pairs of candidates, the earlier and the later one, that
    meet in an SSP; ``between`` are their values forward and backward in time,
    shape (2, n_transitions); ``step`` is the place in time of each SSP.  Only
    candidates of ``use`` come before or after another one.
    """
    source, target = part.source, part.target
    way = source, target, worth, transitions, between[0], step, use
    forward, ending = _best_paths(*way)
    way = target, source, worth, transitions[::-1], between[1], -step, use
    back, beginning = _best_paths(*way)
    return forward + back - worth - ending[source] - beginning[target]


def _best_paths(source, target, worth, transitions, between, step, use):
    """Return the value of the best path that ends with each candidate or SSP."""
    best = worth.copy()
    before, after = transitions
    order = np.lexsort((after, step[source[after]]))
    order = order[use[before[order]]]
    before, after, between = before[order], after[order], between[order]
    first = np.flatnonzero(rank_in_group(step[source[after]]) == 0)
    for own in np.split(np.arange(len(order)), first[1:]):
        head = np.flatnonzero(rank_in_group(after[own]) == 0)
        gain = np.maximum.reduceat(best[before[own]] + between[own], head)
        best[after[own[head]]] += np.maximum(gain, 0.0)
    ending = np.zeros(len(step))
    np.maximum.at(ending, target[use], best[use])
    return best, ending


def _merges_and_splits(part, chosen, ssps, tolerance):
    """
    Link SSPs without a partner to the partner of a neighbour.

    A source without a target may share the target of a neighbour (a merge); a
    target without a source may share the source of a neighbour (a split); up to
    three SSPs can share one.  The candidate must have the displacement of the
    neighbour's link, and the sum of fluxes must explain the flux on the other
    side better than the neighbour alone.  The gain is that of the brightness,
    plus the term of the candidate's correlation if negative, minus one.  `assign`
    chooses, merges first.  Returned is the kind of each candidate, "" if it is no link.
    """
    kind = np.where(chosen, "link", "").astype("U5")
    motion, flux = part.motion, ssps.flux
    for name, free, shared in (
        ("merge", part.source, part.target),
        ("split", part.target, part.source),
    ):
        # The link that each shared SSP already has.
        sitting = np.full(len(ssps), -1)
        sitting[shared[chosen]] = np.flatnonzero(chosen)
        host = sitting[shared]
        own = np.flatnonzero((host >= 0) & ~np.isin(free, free[kind != ""]))
        own = own[part.gap[own] == part.gap[host[own]]]
        alike = moves_alike(motion[own] - motion[host[own]], tolerance)
        own = own[alike & neighbours(free[own], free[host[own]], ssps)]
        beside, other = flux[free[host[own]]], flux[shared[own]]
        value = brightness(np.log((flux[free[own]] + beside) / other))
        value -= brightness(np.log(beside / other))
        value += np.minimum(correlation_term(part.coefficient[own]), 0.0)
        value -= MERGE_COST
        # Two more SSPs can share each; the first place is always preferred.
        seats = np.concatenate([shared[own], len(ssps) + shared[own]])
        values = np.concatenate([value, value - 1e-9])
        taken = assign(np.tile(free[own], 2), seats, values)
        taken = taken[: len(own)] | taken[len(own) :]
        kind[own[taken]] = name
    return kind


def chains(links, ssps, min_epochs=1):
    """
    Return the tracks of one-to-one links, each the SSPs of one in order of time.

    Tracks are in the order of their first SSPs; shorter ones than ``min_epochs`` are
    left out.
    """
    own = links.kind == "link"
    track = connected(links.source[own], links.target[own], len(ssps))
    order = np.lexsort((ssps.epoch, track))
    each = np.split(order, np.flatnonzero(np.diff(track[order])) + 1)
    return [ssp for ssp in each if len(ssp) >= min_epochs]


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


# -- optimal assignment ------------------------------------------------------------


def assign(row: ArrayLike, column: ArrayLike, weight: ArrayLike) -> np.ndarray:
    """
    Choose the pairs of largest total weight that use each row and column once.

    Rows and columns may stay without a partner, so only pairs of positive
    weight are chosen.  The solution is exact and takes polynomial time, see
    `scipy.sparse.csgraph.min_weight_full_bipartite_matching`.

    Parameters
    ----------
    row, column : array_like of int, shape (n,)
        Not negative; rows and columns are numbered independently.
    weight : array_like, shape (n,)

    Returns
    -------
    `~numpy.ndarray` of bool, shape (n,)

    Examples
    --------
    Two rows prefer the same column, but their total is larger otherwise:

    >>> from astro_scc.tracking.linking import assign
    >>> assign([0, 0, 1], [0, 1, 0], [3.0, 2.5, 2.5]).tolist()
    [False, True, True]
    """
    row, column = np.asarray(row, dtype=int), np.asarray(column, dtype=int)
    weight = np.asarray(weight, dtype=float)
    chosen = np.zeros(len(row), bool)
    # If a pair is given twice, the larger weight counts.
    own = lowest(-weight, row, column)
    own = own[weight[own] > 0]
    if len(own) == 0:
        return chosen
    rows, r = np.unique(row[own], return_inverse=True)
    columns, c = np.unique(column[own], return_inverse=True)
    n, m = len(rows), len(columns)
    # A column of its own for each row makes a full matching possible.  Weights
    # must not be zero, and shifting all of them alike changes nothing.
    cost = np.concatenate([-weight[own], np.zeros(n)]) - weight[own].max() - 1.0
    seats = np.concatenate([r, np.arange(n)]), np.concatenate([c, m + np.arange(n)])
    graph = coo_array((cost, seats), shape=(n, m + n)).tocsr()
    # The rows of the matching are all rows, in order.
    chosen[own] = full_matching(graph)[1][r] == c
    return chosen


def connected(one, other, n):
    """Return the number of each node's group, for n nodes connected in pairs."""
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(n, n))
    return connected_components(graph, directed=False)[1]
