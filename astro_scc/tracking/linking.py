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

from astro_scc.decomposition import SSPs, scale_size
from astro_scc.tracking.candidates import Candidates, equal_pairs, rank_in_group
from astro_scc.tracking.likelihood import MERGE_COST, LinkLikelihood, chance_density

#: Rounds in which candidates are evaluated, given the links of the previous round.
ROUNDS = 5


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
    gain : `~numpy.ndarray`, shape (n,)
        Log-likelihood that the link adds to the tracks that it joins.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import FeatureTracker
    >>> cube = simulate_two_fluid(n_epochs=3, rng=1).cube
    >>> decompositions = [Decomposer(scales=[2])(image) for image in cube.data]
    >>> tracker = FeatureTracker(max_speed=36 * u.mas / u.yr)
    >>> links = tracker(cube, decompositions).links
    >>> set(links.kind.tolist()) <= {"link", "merge", "split"}
    True
    >>> bool((links.interval > 0).all())
    True
    """

    kind: np.ndarray
    gain: np.ndarray

    def __repr__(self):
        counts = [f"{np.sum(self.kind == k)} {k}s" for k in ("link", "merge", "split")]
        return f"<Links: {', '.join(counts)}>"


def link(
    candidates: Candidates, ssps: SSPs, *, parent: ArrayLike | None = None,
    place: ArrayLike | None = None, likelihood: LinkLikelihood | None = None,
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
    place : array_like of int, shape (n_epochs,), optional
        Place in time of each image, see `find_candidates`.
    likelihood : `LinkLikelihood`, optional

    Returns
    -------
    `Links`
        Ordered by source.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.correlation import Correlator, all_pairs, target_ssps
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.tracking import find_candidates, link
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
    likelihood = LinkLikelihood() if likelihood is None else likelihood
    place = np.arange(ssps.epoch.max(initial=-1) + 1) if place is None else place
    step = np.asarray(place)[ssps.epoch]
    density = chance_density(ssps)
    similarity = likelihood.similarity(candidates, ssps)
    scale = ssps.scale[candidates.source]
    chosen, kinds, gains = [], [np.empty(0, "U5")], [np.empty(0)]
    coarse = width = None
    for value in sorted(np.unique(ssps.scale), reverse=True):
        own = np.flatnonzero(scale == value)
        part = candidates.select(own)
        worth = similarity[own] + likelihood.merged_flux(part, ssps)
        if coarse is not None and parent is not None:
            worth = worth + likelihood.coarse_to_fine(
                part, coarse, parent, width, density
            )
        best, gain = _link_scale(part, worth, step, density, likelihood)
        kind, seat_gain = _merges_and_splits(part, best, ssps, likelihood)
        coarse, width = part.select(best), scale_size(value)
        chosen.append(own[kind != ""])
        kinds.append(kind[kind != ""])
        gains.append(np.where(best, gain, seat_gain)[kind != ""])
    links = candidates.select(np.concatenate([np.empty(0, int), *chosen]))
    order = np.lexsort((links.target, links.source))
    return Links(
        **vars(links.select(order)),
        kind=np.concatenate(kinds)[order],
        gain=np.concatenate(gains)[order],
    )


def _link_scale(part, worth, step, density, likelihood):
    """Return which candidates of a scale are chosen, and the gains of all."""
    transitions = equal_pairs(part.target, part.source)
    use, chosen, gain = None, np.zeros(len(part), bool), np.zeros(len(part))
    for _ in range(ROUNDS):
        between = _steady_motion(part, chosen, transitions, step, density, likelihood)
        gain = path_gains(part, worth, transitions, between, step, use=use)
        now = _choose(part, gain, len(step))
        if np.array_equal(now, chosen):
            break
        use = chosen = now
    return chosen, gain


def _steady_motion(part, chosen, transitions, step, density, likelihood):
    """Return the term of each transition, given the track before and the one after."""
    motion = part.motion
    weight = part.interval**2
    total = motion * part.interval[:, None]
    own = np.flatnonzero(chosen)
    # Order the links by track, and by time within each track.
    source = part.source[own]
    track = connected(source, part.target[own], len(step))[source]
    order = np.lexsort((step[source], track))
    own, track = own[order], track[order]
    before, after = transitions
    between = []
    for one, other, end, way in (
        (before, after, part.target, slice(None)),
        (after, before, part.source, slice(None, None, -1)),
    ):
        sums = np.column_stack([weight, total])
        sums[own[way]] = _running_sums(sums[own[way]], track[way])
        between.append(
            likelihood.steady_motion(
                motion[other], part.interval[other],
                sums[one, 1:] / sums[one, :1], sums[one, 0], density[end[other]],
            )
        )  # fmt: skip
    return np.stack(between)


def _running_sums(values, group):
    """Return the cumulative sums of rows within each group."""
    sums = np.cumsum(values, axis=0)
    first = np.arange(len(group)) - rank_in_group(group)
    return sums - (sums[first] - values[first])


def _choose(part, gain, n_ssps):
    """Return the best links of each pair of epochs, the nearest epochs first."""
    chosen = np.zeros(len(part), bool)
    for gap in np.unique(part.gap):
        taken = np.zeros((2, n_ssps), bool)
        taken[0, part.source[chosen]] = True
        taken[1, part.target[chosen]] = True
        # Pairs of epochs with the same gap can be solved together, as no SSP is
        # the source, or the target, in two of them.
        own = np.flatnonzero(
            (part.gap == gap) & ~taken[0, part.source] & ~taken[1, part.target]
        )
        chosen[own[assign(part.source[own], part.target[own], gain[own])]] = True
    return chosen


def path_gains(part, worth, transitions, between, step, *, use=None):
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
    candidates of ``use``, all by default, come before or after another one.
    """
    use = np.ones(len(part), bool) if use is None else use
    before, after = transitions
    into, onto = use[before], use[after]
    forward, ending = _best_paths(
        part.source, part.target, worth, before[into], after[into], between[0, into],
        step, use,
    )  # fmt: skip
    back, beginning = _best_paths(
        part.target, part.source, worth, after[onto], before[onto], between[1, onto],
        -step, use,
    )  # fmt: skip
    return forward + back - worth - ending[part.source] - beginning[part.target]


def _best_paths(source, target, worth, before, after, between, step, use):
    """Return the value of the best path that ends with each candidate or SSP."""
    best = worth.astype(float).copy()
    at = step[source]
    order = np.lexsort((after, at[after]))
    before, after, between = before[order], after[order], between[order]
    first = np.flatnonzero(rank_in_group(at[after]) == 0)
    for start, stop in zip(first, [*first[1:], len(after)][: len(first)], strict=True):
        own = slice(start, stop)
        head = np.flatnonzero(rank_in_group(after[own]) == 0)
        gain = np.maximum.reduceat(best[before[own]] + between[own], head)
        best[after[own][head]] += np.maximum(gain, 0.0)
    ending = np.zeros(len(step))
    np.maximum.at(ending, target[use], best[use])
    return best, ending


def _merges_and_splits(part, chosen, ssps, likelihood):
    """
    Link SSPs without a partner to the partner of a neighbour.

    A source without a target may share the target of a neighbour (a merge); a
    target without a source may share the source of a neighbour (a split); up to
    three SSPs can share one.  The candidate must have the displacement of the
    neighbour's link, and the sum of fluxes must explain the flux on the other
    side better than the neighbour alone.  The gain is that of the brightness,
    plus the term of the candidate's correlation if negative, minus one.
    `assign` chooses, merges first.  Returned are the kind of each candidate, ""
    if it is no link, and the gains.
    """
    kind = np.where(chosen, "link", "").astype("U5")
    gain = np.zeros(len(part))
    motion, flux = part.motion, ssps.flux
    for name, free, shared in (
        ("merge", part.source, part.target),
        ("split", part.target, part.source),
    ):
        # The link that each shared SSP already has.
        sitting = np.full(len(ssps), -1)
        sitting[shared[chosen]] = np.flatnonzero(chosen)
        host = sitting[shared]
        busy = np.zeros(len(ssps), bool)
        busy[free[kind != ""]] = True
        own = np.flatnonzero((host >= 0) & ~busy[free])
        own = own[part.gap[own] == part.gap[host[own]]]
        alike = likelihood.moves_alike(motion[own] - motion[host[own]])
        own = own[alike & likelihood.neighbours(free[own], free[host[own]], ssps)]
        if len(own) == 0:
            continue
        beside, other = free[host[own]], shared[own]
        together = likelihood.brightness(
            np.log((flux[free[own]] + flux[beside]) / flux[other])
        )
        better = together - likelihood.brightness(np.log(flux[beside] / flux[other]))
        correlation = likelihood.correlation(part.coefficient[own])
        value = better + np.minimum(correlation, 0.0) - MERGE_COST
        # Two more SSPs can share each; the first place is always preferred.
        seats = np.concatenate([other, len(ssps) + other])
        values = np.concatenate([value, value - 1e-9])
        taken = assign(np.tile(free[own], 2), seats, values)
        taken = taken[: len(own)] | taken[len(own) :]
        kind[own[taken]] = name
        gain[own[taken]] = value[taken]
    return kind, gain


def chain(links, n_ssps, *, min_epochs=1, core=None):
    """
    Return the number of each SSP's track, a chain of one-to-one links, or -1.

    Tracks are numbered in the order of their first SSPs; chains of fewer than
    ``min_epochs`` SSPs are not tracks.  SSPs with the same number of ``core``,
    if it is not negative, are one feature: all of them that have a link make
    one track, however long the core is not seen.
    """
    own = links.kind == "link"
    source, target = links.source[own], links.target[own]
    n = n_ssps
    if core is not None:
        # Each core is an additional node that connects its SSPs.
        linked = np.union1d(source, target)
        linked = linked[core[linked] >= 0]
        source, target = np.r_[source, linked], np.r_[target, n_ssps + core[linked]]
        n += core.max(initial=-1) + 1
    label = connected(source, target, n)[:n_ssps]
    _, first, group, size = np.unique(
        label, return_index=True, return_inverse=True, return_counts=True
    )
    number = np.full(len(first), -1)
    long = np.flatnonzero(size >= min_epochs)
    number[long[np.argsort(first[long])]] = np.arange(len(long))
    return number[group]


# -- optimal assignment ------------------------------------------------------------


def assign(row: ArrayLike, column: ArrayLike, weight: ArrayLike) -> np.ndarray:
    """
    Choose the pairs of largest total weight that use each row and column once.

    Rows and columns may stay without a partner, so only pairs of positive
    weight are chosen.  The solution is exact and takes polynomial time: pairs
    that outweigh the best others of their row and column together are certain;
    `scipy.sparse.csgraph.min_weight_full_bipartite_matching` solves the rest.

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

    >>> from astro_scc.tracking import assign
    >>> assign([0, 0, 1], [0, 1, 0], [3.0, 2.5, 2.5]).tolist()
    [False, True, True]
    """
    row, column = np.asarray(row, dtype=int), np.asarray(column, dtype=int)
    weight = np.asarray(weight, dtype=float)
    chosen = np.zeros(len(row), bool)
    left = np.flatnonzero(weight > 0)
    while len(left):
        certain = _certain(row[left], column[left], weight[left])
        if not certain.any():
            break
        won = left[certain]
        chosen[won] = True
        taken = np.isin(row[left], row[won]) | np.isin(column[left], column[won])
        left = left[~taken]
    chosen[left[_solve(row[left], column[left], weight[left])]] = True
    return chosen


def _certain(row, column, weight):
    """Return the pairs that outweigh the best others of their row and column."""
    total = weight - _best_other(row, weight) - _best_other(column, weight)
    certain = np.flatnonzero(total >= 0)
    # If equal pairs share a row or column, keep the first.
    keep = np.zeros(len(row), bool)
    first = np.intersect1d(
        np.unique(row[certain], return_index=True)[1],
        np.unique(column[certain], return_index=True)[1],
    )
    keep[certain[first]] = True
    return keep


def _best_other(key, weight):
    """Return the largest weight of the other entries with the same key, or 0."""
    order = np.lexsort((-weight, key))
    weight, rank = weight[order], rank_in_group(key[order])
    best = weight[np.arange(len(order)) - rank]
    second = np.append(np.where(rank == 1, weight, 0.0), 0.0)[1:]
    other = np.empty(len(key))
    other[order] = np.where(rank == 0, second, best)
    return other


def _solve(row, column, weight):
    """Return the indices of the chosen pairs."""
    # If a pair is given twice, keep the larger weight.
    order = np.lexsort((-weight, column, row))
    order = order[rank_in_group(row[order], column[order]) == 0]
    rows, r = np.unique(row[order], return_inverse=True)
    columns, c = np.unique(column[order], return_inverse=True)
    n, m = len(rows), len(columns)
    if n == 0:
        return order
    # A column of its own for each row makes a full matching possible.  Weights
    # must not be zero, and shifting all of them alike changes nothing.
    cost = np.concatenate([-weight[order], np.zeros(n)]) - weight.max() - 1.0
    seats = np.concatenate([r, np.arange(n)]), np.concatenate([c, m + np.arange(n)])
    graph = coo_array((cost, seats), shape=(n, m + n)).tocsr()
    at, seat = min_weight_full_bipartite_matching(graph)
    # The pairs are ordered by row and column.
    place = np.searchsorted(r * (m + n) + c, (at * (m + n) + seat)[seat < m])
    return order[place]


def connected(one, other, n):
    """Return the number of each node's group, for n nodes connected in pairs."""
    graph = coo_array((np.ones(len(one)), (one, other)), shape=(n, n))
    return connected_components(graph, directed=False)[1]
