# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""From candidates to links, scale by scale, the coarsest first."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from astro_scc.decomposition import scale_size
from astro_scc.tracking.assignment import assign
from astro_scc.tracking.evidence import Evidence, chance_density
from astro_scc.tracking.paths import Transitions, link_gains
from astro_scc.tracking.sharing import company_gain, shared_seats

__all__ = ["Links", "link"]

#: Rounds in which candidates are judged by the links of the round before.
ROUNDS = 5


@dataclass(frozen=True, eq=False, repr=False)
class Links:
    """
    Which SSP is which other one, later.

    Attributes
    ----------
    source, target : `~numpy.ndarray` of int, shape (n,)
        Indices in the catalogue of the SSPs of all epochs.  Of links of kind
        "link" no SSP has more than one before it and one after it.
    kind : `~numpy.ndarray` of str, shape (n,)
        "link"; "merge", the source goes into a target that has another
        source; "split", the target comes out of a source that has another
        target.
    gap : `~numpy.ndarray` of int, shape (n,)
        Epochs between the two at which the feature is not seen.
    interval : `~numpy.ndarray`, shape (n,)
    coefficient : `~numpy.ndarray`, shape (n,)
        Correlation of source and target.
    gain : `~numpy.ndarray`, shape (n,)
        Log-likelihood by which the link betters the tracks that it joins.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import FeatureTracker
    >>> cube = simulate_two_fluid(n_epochs=3, rng=1).cube
    >>> decompositions = [Decomposer(scales=[2])(image) for image in cube.data]
    >>> tracker = FeatureTracker(max_speed=36 * u.mas / u.yr)
    >>> tracking = tracker(cube, decompositions)
    >>> links = tracking.links
    >>> set(links.kind.tolist()) <= {"link", "merge", "split"}
    True
    >>> bool((links.interval > 0).all())
    True
    """

    source: np.ndarray
    target: np.ndarray
    kind: np.ndarray
    gap: np.ndarray
    interval: np.ndarray
    coefficient: np.ndarray
    gain: np.ndarray

    def __len__(self):
        return len(self.source)

    def __repr__(self):
        counts = [f"{np.sum(self.kind == k)} {k}s" for k in ("link", "merge", "split")]
        return f"<Links: {', '.join(counts)}>"


def link(candidates, ssps, *, parent=None, place=None, evidence=None):
    """
    Choose links among candidates.

    On each scale, the coarsest first, all candidates are judged by what they
    add to the best paths through several epochs (`link_gains`), and the
    choice of the largest sum is made for each pair of epochs (`assign`),
    consecutive ones first.  Then candidates are judged anew, each by the
    links that were chosen and their mean velocity, before it and after it,
    until nothing changes or five times.
    What is left without a partner may merge or split (`shared_seats`).

    Parameters
    ----------
    candidates : `Candidates`
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    parent : array_like of int, shape (n_ssps,), optional
        The larger SSP that each lies in, see `parents`: its motion is then
        the first guess for the smaller ones in it.
    place : array_like of int, shape (n_epochs,), optional
        Place in time of each image, as for `find_candidates`.
    evidence : `Evidence`, optional

    Returns
    -------
    `Links`
        By source.

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
    evidence = Evidence() if evidence is None else evidence
    n_epochs = int(ssps.epoch.max(initial=-1)) + 1
    place = np.arange(n_epochs) if place is None else np.asarray(place)
    step = place[ssps.epoch]
    density = chance_density(ssps)
    looks = evidence.looks(candidates, ssps)
    scale = ssps.scale[candidates.source]
    coarser, parts = None, []
    for value in sorted(np.unique(ssps.scale), reverse=True):
        own = np.flatnonzero(scale == value)
        part = candidates.select(own)
        worth = looks[own] + company_gain(part, ssps, evidence)
        if coarser is not None and parent is not None:
            worth = worth + _guidance(part, *coarser, density, evidence)
        chosen, gain = _link_scale(part, worth, step, density, evidence)
        kind, extra = shared_seats(part, chosen, ssps, evidence)
        gain = np.where(chosen, gain, extra)
        parts.append((part, kind, gain))
        coarser = chosen, part, parent, value
    return _joined(parts)


def _link_scale(part, worth, step, density, evidence):
    n_nodes = len(step)
    transitions = Transitions.of(part.source, part.target, n_nodes)
    use, chosen, gain = None, np.zeros(len(part), bool), np.zeros(len(part))
    for _ in range(ROUNDS):
        between = _steadiness(part, chosen, transitions, step, density, evidence)
        gain = link_gains(
            part.source, part.target, worth, transitions, between, step, n_nodes,
            use=use,
        )  # fmt: skip
        now = _choose(part, gain, step, n_nodes)
        if np.array_equal(now, chosen):
            break
        use = chosen = now
    return chosen, gain


def _steadiness(part, chosen, transitions, step, density, evidence):
    """Each transition by the track before it, and by the track after it."""
    motion = np.stack([part.dy, part.dx], axis=1)
    weight = part.interval**2
    total = motion * part.interval[:, None]
    own = np.flatnonzero(chosen)
    # The links of one track after another, each in time order.
    ends = part.source[own], part.target[own]
    graph = coo_array((np.ones(len(own)), ends), shape=(len(step),) * 2)
    track = connected_components(graph, directed=False)[1][ends[0]]
    order = np.lexsort((step[ends[0]], track))
    own, track = own[order], track[order]
    between = []
    for one, other, end, way in (
        (transitions.before, transitions.after, part.target, slice(None)),
        (transitions.after, transitions.before, part.source, slice(None, None, -1)),
    ):
        sums = np.column_stack([weight, total])
        sums[own[way]] = _running_sums(sums[own[way]], track[way])
        between.append(
            evidence.steadiness(
                motion[other], part.interval[other],
                sums[one, 1:] / sums[one, :1], sums[one, 0], density[end[other]],
            )
        )  # fmt: skip
    return np.stack(between)


def _running_sums(values, group):
    """Sums of the rows up to each one, within its group."""
    sums = np.cumsum(values, axis=0)
    first = np.flatnonzero(np.diff(group, prepend=-1))
    size = np.diff([*first, len(group)])
    return sums - np.repeat(sums[first] - values[first], size, axis=0)


def _choose(part, gain, step, n_nodes):
    """The best links of each pair of epochs, the nearest epochs first."""
    chosen = np.zeros(len(part), bool)
    for gap in np.unique(part.gap):
        gone = np.zeros((2, n_nodes), bool)
        gone[0, part.source[chosen]] = True
        gone[1, part.target[chosen]] = True
        # The pairs of epochs have no SSPs in common: one call for all of them.
        own = np.flatnonzero(
            (part.gap == gap) & ~gone[0, part.source] & ~gone[1, part.target]
        )
        chosen[own[assign(part.source[own], part.target[own], gain[own])]] = True
    return chosen


def _guidance(part, chosen, coarse, parent, scale, density, evidence):
    """What the links of the coarser scale say of the candidates of the finer."""
    worth = np.zeros(len(part))
    larger = parent[part.source]
    for gap in np.unique(part.gap):
        of_gap = chosen & (coarse.gap == gap)
        motion = np.full((len(parent), 2), np.nan)
        motion[coarse.source[of_gap], 0] = coarse.dy[of_gap]
        motion[coarse.source[of_gap], 1] = coarse.dx[of_gap]
        own = np.flatnonzero((part.gap == gap) & (larger >= 0))
        own = own[np.isfinite(motion[larger[own], 0])]
        away = np.stack([part.dy[own], part.dx[own]], axis=1) - motion[larger[own]]
        worth[own] = evidence.guidance(
            away, scale_size(scale), density[part.target[own]]
        )
    return worth


def _joined(parts):
    def join(name):
        return np.concatenate(
            [np.empty(0), *(getattr(p, name)[k != ""] for p, k, _ in parts)]
        )

    kind = np.concatenate([np.empty(0, "U5"), *(k[k != ""] for _, k, _ in parts)])
    gain = np.concatenate([np.empty(0), *(g[k != ""] for _, k, g in parts)])
    source, target = join("source").astype(int), join("target").astype(int)
    order = np.lexsort((target, source))
    return Links(
        source=source[order],
        target=target[order],
        kind=kind[order],
        gap=join("gap").astype(int)[order],
        interval=join("interval")[order],
        coefficient=join("coefficient")[order],
        gain=gain[order],
    )
