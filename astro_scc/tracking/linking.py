# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Links: candidates and their likelihood, the choice among them, and tracks."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching as full_matching
from scipy.spatial import cKDTree

from astro_scc.correlation import Matches
from astro_scc.decomposition import SSPs
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.features.detections import rank_in_group
from astro_scc.features.tracks import connected, lowest
from astro_scc.images.positions import beam_fwhm, ssp_offsets

#: Distance in beams beyond which features are distinguished from the core.
CORE_RADIUS = 0.5
# These widths were measured for features in simulated jets of two streams.
#: Means of one minus the correlation coefficient, of the same feature and of chance
#: pairs; both distributions are taken as exponential.
DECORRELATION, CHANCE_DECORRELATION = 0.06, 0.15
#: Half width of the Lorentzian distribution of the logarithm of the ratio of two peaks
#: of the same feature.
VARIABILITY = 0.15
#: Cost of an epoch at which the feature is not seen.
MISSING = 2.0
#: Rounds in which candidates are evaluated, given the links of the previous round.
ROUNDS = 5


@dataclass(frozen=True, eq=False, repr=False)
class Links:
    """
    Pairs of SSPs of one scale that are, or may be, the same feature at two dates.

    Attributes
    ----------
    source, target : `~numpy.ndarray` of int, shape (n,)
        Indices in the catalogue of the SSPs of all epochs.
    motion : `~numpy.ndarray`, shape (n, 2)
        Displacement (y, x) from maximum to maximum, in pixels.
    interval : `~numpy.ndarray`, shape (n,)
        Time from source to target, positive.
    gap : `~numpy.ndarray` of int, shape (n,)
        Number of epochs between the two, 0 for consecutive ones.
    coefficient : `~numpy.ndarray`, shape (n,)
        Correlation of the source with the target's image at that displacement.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking.linking import Links
    >>> found = Links(
    ...     source=np.array([0, 1]), target=np.array([2, 2]),
    ...     motion=np.array([[0.0, 5.0], [0.0, -3.0]]), interval=np.full(2, 0.1),
    ...     gap=np.zeros(2, int), coefficient=np.array([0.95, 0.7]))
    >>> len(found.select(found.coefficient > 0.8))
    1
    """

    source: np.ndarray
    target: np.ndarray
    motion: np.ndarray
    interval: np.ndarray
    gap: np.ndarray
    coefficient: np.ndarray

    def __len__(self) -> int:
        return len(self.source)

    def select(self, keep: ArrayLike) -> Links:
        """
        Return some of the pairs.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or of int

        Returns
        -------
        `Links`
        """
        return Links(*(getattr(self, f.name)[keep] for f in fields(self)))


def find_candidates(
    matches: Matches, target_ssp: ArrayLike, ssps: SSPs, years: ArrayLike,
    max_gap: int = 1,
) -> Links:  # fmt: skip
    """
    Return the candidates for links among the correlation peaks.

    A peak is a candidate if it falls on an SSP of the same scale at a later
    epoch.  If several peaks connect the same two SSPs, the highest is used.

    Parameters
    ----------
    matches : `~astro_scc.correlation.Matches`
    target_ssp : array_like of int, shape (n_matches,)
        The SSP that each match falls on, or -1, see ``target_ssps``.
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    years : array_like, shape (n_epochs,)
        Dates in order, not decreasing.
    max_gap : int, optional
        Most epochs between source and target, 0 or more.

    Returns
    -------
    `Links`
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
    >>> found.source, found.target, found.motion[:, 1].round(1)
    (array([0, 0, 1]), array([1, 2, 2]), array([ 6., 12.,  6.]))
    """
    years = np.asarray(years, dtype=float)
    source, target = matches.ssp.astype(int), np.asarray(target_ssp, dtype=int)
    at, to = ssps.epoch[source], matches.target.astype(int)
    use = (target >= 0) & (to - at <= max_gap + 1) & (years[to] > years[at])
    use = np.flatnonzero(use)
    # Keep the highest peak of each pair of SSPs.
    use = use[lowest(-matches.coefficient[use], source[use], target[use])]
    source, target, at, to = source[use], target[use], at[use], to[use]
    place = np.stack([ssps.y, ssps.x], axis=1)
    return Links(
        source=source, target=target, motion=place[target] - place[source],
        interval=years[to] - years[at], gap=to - at - 1,
        coefficient=matches.coefficient[use].astype(float),
    )  # fmt: skip


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


def similarity(candidates: Links, ssps: SSPs) -> np.ndarray:
    """
    Return the terms of correlation and brightness, minus the cost of gaps.

    The term of brightness is `brightness` minus the logarithm of the
    density of the same ratio between any two SSPs of the scale, so that a
    core and a feature a hundred times fainter are an unlikely pair.

    Parameters
    ----------
    candidates : `Links`
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
    # With means a and b of 1 - c, the ratio of two exponentials.
    a, b = DECORRELATION, CHANCE_DECORRELATION
    correlation = np.log(b / a) - (1 - candidates.coefficient) * (1 / a - 1 / b)
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


# -- links ---------------------------------------------------------------------------


def link(candidates: Links, ssps: SSPs, tolerance: float = 2.0) -> Links:
    """
    Choose links among candidates.

    Each candidate is evaluated by what it adds to the best paths through several
    epochs, and for each pair of epochs, consecutive ones first, the candidates with
    the largest total are chosen (`assign`).  Candidates are then evaluated again,
    given the chosen links before and after them and their mean velocity, until
    nothing changes, in at most five rounds.

    Parameters
    ----------
    candidates : `Links`
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    tolerance : float, optional
        Standard deviation of a displacement from steady motion, in pixels on each
        axis.

    Returns
    -------
    `Links`
        No SSP is the source, or the target, of more than one.

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
    worth = similarity(candidates, ssps)
    transitions = equal_pairs(candidates.target, candidates.source)
    use, chosen = np.ones(len(worth), bool), np.zeros(len(worth), bool)
    for _ in range(ROUNDS):
        to = chosen, transitions, step, density, tolerance
        between = _steady_motion(candidates, *to)
        gain = path_gains(candidates, worth, transitions, between, step, use)
        now = _choose(candidates, gain)
        if np.array_equal(now, chosen):
            break
        use = chosen = now
    return candidates.select(chosen)


def _steady_motion(candidates, chosen, transitions, step, density, tolerance):
    """Return the term of each transition, given the track before and the one after."""
    motion, interval = candidates.motion, candidates.interval
    own = np.flatnonzero(chosen)
    # Order the links by track, and by time within each track.
    source = candidates.source[own]
    track = connected(source, candidates.target[own], len(step))[source]
    order = np.lexsort((step[source], track))
    between = []
    for way, (one, other), end in (
        (1, transitions, candidates.target),
        (-1, transitions[::-1], candidates.source),
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


def _choose(candidates, gain):
    """Return the best links of each pair of epochs, the nearest epochs first."""
    source, target = candidates.source, candidates.target
    chosen = np.zeros(len(gain), bool)
    for gap in np.unique(candidates.gap):
        taken = np.isin(source, source[chosen]) | np.isin(target, target[chosen])
        # Pairs of epochs with the same gap can be solved together, as no SSP is
        # the source, or the target, in two of them.
        own = np.flatnonzero((candidates.gap == gap) & ~taken)
        chosen[own[assign(source[own], target[own], gain[own])]] = True
    return chosen


def path_gains(candidates, worth, transitions, between, step, use):
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
    source, target = candidates.source, candidates.target
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
        No pair may be given twice; rows and columns are numbered independently.
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
    own = np.flatnonzero(weight > 0)
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
