# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Link candidates, scale by scale from the coarsest, and chain links to tracks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import (
    connected_components,
    min_weight_full_bipartite_matching,
)

from astro_scc.decomposition import SSPs
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.tracking import likelihood

#: Rounds in which candidates are evaluated, given the links of the previous round.
ROUNDS = 5


@dataclass(frozen=True, eq=False, repr=False)
class Links(likelihood.Candidates):
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
    candidates: likelihood.Candidates, ssps: SSPs, *, parent: ArrayLike | None = None,
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
    >>> from astro_scc.tracking.likelihood import find_candidates
    >>> from astro_scc.tracking.linking import link
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
    step, density = ssps.epoch, likelihood.chance_density(ssps)
    alone = likelihood.similarity(candidates, ssps)
    kind = np.full(len(candidates), "", "U5")
    coarse = width = None
    for scale in sorted(np.unique(ssps.scale), reverse=True):
        own = np.flatnonzero(ssps.scale[candidates.source] == scale)
        part = candidates.select(own)
        worth = alone[own] + likelihood.merged_flux(part, ssps, tolerance)
        if coarse is not None and parent is not None:
            worth += likelihood.coarse_to_fine(part, coarse, parent, width, density)
        chosen = _link_scale(part, worth, step, density, tolerance)
        kind[own] = _merges_and_splits(part, chosen, ssps, tolerance)
        coarse, width = part.select(chosen), scale_size(scale)
    order = np.lexsort((candidates.target, candidates.source))
    order = order[kind[order] != ""]
    return Links(**vars(candidates.select(order)), kind=kind[order])


def _link_scale(part, worth, step, density, tolerance):
    """Return which candidates of a scale are chosen."""
    transitions = likelihood.equal_pairs(part.target, part.source)
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
        links, rank = own[order[::way]], likelihood.rank_in_group(track[order[::way]])
        # Running sums within each track.
        total, first = np.cumsum(sums[links], axis=0), np.arange(len(links)) - rank
        sums[links] = total - (total[first] - sums[links[first]])
        between.append(
            likelihood.steady_motion(
                motion[other], interval[other],
                sums[one, 1:] / sums[one, :1], sums[one, 0], density[end[other]],
                tolerance,
            )
        )  # fmt: skip
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
    forward, ending = _best_paths(
        source, target, worth, transitions, between[0], step, use
    )
    back, beginning = _best_paths(
        target, source, worth, transitions[::-1], between[1], -step, use
    )
    return forward + back - worth - ending[source] - beginning[target]


def _best_paths(source, target, worth, transitions, between, step, use):
    """Return the value of the best path that ends with each candidate or SSP."""
    best = worth.copy()
    before, after = transitions
    order = np.lexsort((after, step[source[after]]))
    order = order[use[before[order]]]
    before, after, between = before[order], after[order], between[order]
    first = np.flatnonzero(likelihood.rank_in_group(step[source[after]]) == 0)
    for own in np.split(np.arange(len(order)), first[1:]):
        head = np.flatnonzero(likelihood.rank_in_group(after[own]) == 0)
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
        alike = likelihood.moves_alike(motion[own] - motion[host[own]], tolerance)
        own = own[alike & likelihood.neighbours(free[own], free[host[own]], ssps)]
        beside, other = flux[free[host[own]]], flux[shared[own]]
        value = likelihood.brightness(np.log((flux[free[own]] + beside) / other))
        value -= likelihood.brightness(np.log(beside / other))
        value += np.minimum(likelihood.correlation_term(part.coefficient[own]), 0.0)
        value -= likelihood.MERGE_COST
        # Two more SSPs can share each; the first place is always preferred.
        seats = np.concatenate([shared[own], len(ssps) + shared[own]])
        values = np.concatenate([value, value - 1e-9])
        taken = assign(np.tile(free[own], 2), seats, values)
        taken = taken[: len(own)] | taken[len(own) :]
        kind[own[taken]] = name
    return kind


def chains(links, ssps, *, min_epochs=1):
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
    own = likelihood.lowest(-weight, row, column)
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
    chosen[own] = min_weight_full_bipartite_matching(graph)[1][r] == c
    return chosen


def connected(one, other, n):
    """Return the number of each node's group, for n nodes connected in pairs."""
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(n, n))
    return connected_components(graph, directed=False)[1]
