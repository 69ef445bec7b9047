# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracks: detections of one feature, what they may be, and the choice among them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain, pairwise

import numpy as np
import scipy

from astro_scc.features.detections import Detections, rank_in_group


@dataclass(frozen=True, kw_only=True)
class TrackSettings:
    """
    Constants of the assignment of detections to tracks; lengths are in beams.

    They were chosen on the development sources of ``benchmarks/features.py`` and on
    simulated jets.

    Parameters
    ----------
    scatter : float
        Scatter of a position about steady motion: 68% of the positions of the
        features of MOJAVE (Lister et al. 2021) are within 0.085.
    size_scatter, far_scatter : float
        The same per beam of a feature's size, and per beam of its distance from
        the core.
    far : float
        Distance from the core from which the scatter grows no more.
    wander : float
        Variance of the velocity per median interval, in beams per median interval:
        features bend.
    speed : float
        Standard deviation of the prior of the speed, in beams per median interval.
    freedom : float
        Degrees of freedom of Student's t distribution of positions and fluxes.
    flux_step : float
        Scatter of the logarithm of the ratio of successive fluxes.
    detected : float
        Probability that a feature is detected in an epoch.
    density : float
        Other detections per square beam and epoch.
    most_missed : int
        Largest number of epochs in succession without a detection.
    gate : float
        Largest deviation of a detection from its prediction, in standard
        deviations.
    hypotheses, branches, kept : int
        Tracks that are kept from each first detection, ways in which each can
        continue, and tracks that are kept of each first and last detection.
    least_epochs : int
        Fewest epochs of a track.
    core : float
        Distance from the origin within which the nearest detection is the core.
    solutions : int
        Number of disturbed assignments.
    disturbance : float
        Standard deviation of the logarithmic likelihood of a link in them.
    agreed : float
        Share of the assignments that a link of a feature is part of.
    rounds : int
        Largest number of times that what is left is assigned again.

    Examples
    --------
    >>> from astro_scc.features import TrackSettings
    >>> TrackSettings().least_epochs
    4
    """

    scatter: float = 0.05
    size_scatter: float = 0.08
    far_scatter: float = 0.02
    far: float = 5.0
    wander: float = 5e-5
    speed: float = 0.6
    freedom: float = 4.0
    flux_step: float = 0.35
    detected: float = 0.75
    density: float = 0.2
    most_missed: int = 3
    gate: float = 5.0
    hypotheses: int = 12
    branches: int = 4
    kept: int = 8
    least_epochs: int = 4
    core: float = 0.25
    solutions: int = 16
    disturbance: float = 2.0
    agreed: float = 0.6
    rounds: int = 6


@dataclass(frozen=True, eq=False)
class Track:
    """
    Detections of one feature, one per epoch.

    Attributes
    ----------
    detection : `~numpy.ndarray` of int, shape (n,)
        In the order of the epochs.
    same_speed : float
        Share of the disturbed assignments with a track of these detections, at the
        same dates, that has the same velocity.
    proven : bool
        Whether the assignment was solved to the end.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.features.tracks import Track
    >>> len(Track(np.array([0, 2, 3, 5]), 1.0, True))
    4
    """

    detection: np.ndarray
    same_speed: float
    proven: bool

    def __len__(self) -> int:
        return len(self.detection)


def find_tracks(
    detections: Detections, settings: TrackSettings | None = None, *, seed: int = 0
) -> list[Track]:
    """
    Assign detections to tracks, each to one track at most.

    All tracks of nearly steady motion compete for the detections, and the
    assignment with the largest likelihood is searched, together with others whose
    links have disturbed likelihoods.  Tracks are made of the links that most
    assignments agree upon.  What is left is assigned again, until nothing more is
    found.

    Parameters
    ----------
    detections : `Detections`
        Without the core.
    settings : `TrackSettings`, optional
    seed : int, optional
        Seed of the disturbances.

    Returns
    -------
    list of `Track`
        In the order of their first epochs.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.features.detections import Detections
    >>> from astro_scc.features.tracks import find_tracks
    >>> epoch = np.repeat(np.arange(6), 2)
    >>> place = np.stack([0.3 * epoch + [1, 4] * 6, 0.0 * epoch], axis=1)
    >>> d = Detections(
    ...     epoch=epoch, place=place, place_error=np.full((12, 2), 0.01),
    ...     flux=np.array([1.0, 0.2] * 6), size=np.zeros(12), beam=np.eye(2) / 5.545,
    ...     years=2000.0 + np.arange(6), number=np.tile([0, 1], 6),
    ...     group=np.zeros(12, dtype=int))
    >>> [track.detection.tolist() for track in find_tracks(d)]
    [[0, 2, 4, 6, 8, 10], [1, 3, 5, 7, 9, 11]]
    """
    settings = TrackSettings() if settings is None else settings
    free, found = np.ones(len(detections), dtype=bool), []
    for turn in range(settings.rounds):
        left = np.flatnonzero(free)
        new = _agreed(detections.select(left), settings, seed + turn)
        if not new:
            break
        for track in new:
            found.append(replace(track, detection=left[track.detection]))
            free[found[-1].detection] = False

    order = np.lexsort((detections.number, detections.epoch))
    rank = np.argsort(order)
    return sorted(found, key=lambda track: rank[track.detection[0]])


def _agreed(d, settings, seed):
    """Return tracks of the links that most assignments agree upon."""
    paths, score = steady_hypotheses(d, settings)
    if not paths:
        return []
    assignment = Assignment(paths, len(d))
    chosen, proven = assignment.best(score)
    solutions = [chosen]
    detection, ends = assignment.uses.indices.astype(int), assignment.uses.indptr[1:]
    before = np.delete(np.arange(len(detection)), ends - 1)
    owner = np.searchsorted(ends, before, side="right")
    links = detection[before] * len(d) + detection[before + 1]
    links, which = np.unique(links, return_inverse=True)
    for trial in range(settings.solutions):
        normal = _normal(d, *np.divmod(links, len(d)), seed, trial)
        noise = settings.disturbance * normal[which]
        disturbed = score + np.bincount(owner, noise, len(paths))
        solutions.append(assignment.good(disturbed))
    used = np.bincount(np.concatenate(solutions), minlength=len(paths))
    share = np.bincount(which, used[owner]) / len(solutions)
    links = np.divmod(links[share > settings.agreed], len(d))
    return [
        Track(detection, _same_speed(d, detection, paths, solutions), proven)
        for detection in chains(*links, len(d))
        if len(detection) >= settings.least_epochs
    ]


def _same_speed(d, detection, paths, solutions, *, least=0.5, off=0.2):
    """
    Return the share of the assignments in which a track has the same velocity.

    There a track is the same if it has at ``least`` such a share of its detections, and
    the velocity if it is ``off`` by at most such a part.
    """
    time, n_same = d.time, 0
    first, last = time[detection[[0, -1]]]
    members, velocity = set(detection.tolist()), d.velocity(detection)[0]
    for chosen in solutions:
        common, best = max(
            ((len(members.intersection(paths[k])), k) for k in chosen.tolist()),
            default=(0, 0),
        )
        if common < least * len(members):
            continue
        same = np.array(paths[best])
        same = same[(time[same] >= first) & (time[same] <= last)]
        if len(same) > 2:
            change = np.hypot(*(d.velocity(same)[0] - velocity))
            n_same += change <= off * np.hypot(*velocity)
    return n_same / len(solutions)


def _normal(d, one, other, seed, trial):
    """
    Return a normally distributed number for each link.

    It depends on the epochs and numbers of the two detections alone, so that more
    epochs leave it as it is (mixing of bits: Steele, Lea & Flood 2014).
    """
    parts = d.epoch[one], d.number[one], d.epoch[other], d.number[other], seed, trial
    bits = np.zeros(len(one), dtype=np.uint64)
    for part in parts:
        bits += np.asarray(part).astype(np.uint64) + np.uint64(0x9E3779B97F4A7C15)
        bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        bits ^= bits >> np.uint64(31)
    return scipy.special.ndtri(
        (bits >> np.uint64(11)).astype(float) / 2.0**53 + 2.0**-54
    )


# -- tracks that steady motion allows ---------------------------------------------

#: A detection may lower the logarithmic likelihood ratio of a track by this much.
LOWEST_GAIN = -4.0


def log_t(square, variance, freedom, n_axes):
    """Return the logarithm of the density of Student's t distribution."""
    half = (freedom + n_axes) / 2
    norm = scipy.special.gammaln(half) - scipy.special.gammaln(freedom / 2)
    norm = norm - n_axes / 2 * np.log(freedom * np.pi * variance)
    return norm - half * np.log1p(square / (freedom * variance))


def position_scatter(detections, settings):
    """Return the standard deviation of each position from steady motion, in beams."""
    d, o = detections, settings
    formal = d.place_error.mean(axis=1) / d.major
    wide = o.size_scatter * d.size / d.major
    far = o.far_scatter * np.minimum(np.hypot(*d.in_beams.T), o.far)
    return np.sqrt(o.scatter**2 + wide**2 + far**2 + formal**2)


def steady_hypotheses(detections, settings):
    r"""
    Return the tracks that a Kalman filter of nearly steady motion allows.

    From each detection, forward and backward in time, a track is continued by the
    most likely detections of each next epoch, or misses that epoch.  Its score is
    the logarithm of the likelihood ratio of one feature to as many unrelated
    detections (multiple hypothesis tracking, Reid 1979): each detection adds

    .. math:: \ln\frac{P_D}{\lambda} + \ln t_\nu(\Delta x)
              + \ln\frac{t_\nu(\Delta\ln S)}{p(\ln S)}

    with the probability of detection :math:`P_D`, the density :math:`\lambda` of
    other detections, and Student's distribution of the deviations of place and
    flux S from their predictions; each epoch without one adds
    :math:`\ln(1 - P_D)`.

    Parameters
    ----------
    detections : ``Detections``
    settings : `~astro_scc.features.TrackSettings`

    Returns
    -------
    paths : list of tuple of int
        Detections of each track, in the order of time.
    score : `~numpy.ndarray`, shape (n,)
        Positive.
    """
    found = {}
    if len(np.unique(detections.epoch)) >= settings.least_epochs:
        for way in (1, -1):
            for path, score in _one_way(detections, settings, way):
                found[path] = max(score, found.get(path, 0.0))
    # The order of equal scores must not depend on the direction.
    paths = sorted(found, key=lambda path: (-found[path], path))
    return paths, np.array([found[path] for path in paths])


#: A track that ends with a detection: a node, after the node of the detection before.
NODE = [("detection", int), ("parent", int), ("root", int), ("x", float, 2),
        ("v", float, 2), ("variance", float, 3), ("light", float), ("score", float),
        ("length", int)]  # fmt: skip


class _Filter:
    """Kalman filter of position and velocity, equal on both axes, in one direction."""

    def __init__(self, d, o):
        # Times are in median intervals.
        step = np.median(np.diff(np.unique(d.time)))
        self.o, self.u, self.time = o, d.in_beams, (d.time - d.time.min()) / step
        self.scatter = position_scatter(d, o)
        self.light = np.log(d.flux)
        width = self.light.std() + 0.3
        self.light_density = -0.5 * ((self.light - self.light.mean()) / width) ** 2
        self.light_density -= np.log(width * np.sqrt(2 * np.pi))
        self.entry = np.log(o.detected / o.density)
        # Longer than the nodes that there are, n_nodes.
        self.nodes, self.n_nodes = np.empty(1024, dtype=NODE), 0

    def _added(self, here, **state):
        """Return the nodes of new tracks, which end with some detections."""
        new = np.arange(self.n_nodes, self.n_nodes + len(here))
        self.n_nodes += len(here)
        while self.n_nodes > len(self.nodes):
            self.nodes = np.concatenate([self.nodes, np.empty_like(self.nodes)])
        rows = self.nodes[self.n_nodes - len(here) : self.n_nodes]
        rows["detection"] = here
        for name, values in state.items():
            rows[name] = values
        return new

    def start(self, here):
        """Return a new track from each detection of an epoch."""
        zero = np.zeros(len(here))
        variance = np.stack([self.scatter[here] ** 2, zero, zero + self.o.speed**2], 1)
        return self._added(
            here, parent=-1, root=here, length=1, x=self.u[here], v=0.0,
            variance=variance, light=self.light[here], score=self.entry,
        )  # fmt: skip

    def _predicted(self, h, here):
        """Return the places of tracks at the dates of detections, and variances."""
        dt = np.abs(self.time[here] - self.time[h["detection"]])
        p0, p1, p2 = h["variance"].T
        p0 = p0 + 2 * dt * p1 + dt**2 * p2 + self.o.wander * dt**3 / 3
        p1 = p1 + dt * p2 + self.o.wander * dt**2 / 2
        return h["x"] + dt[:, None] * h["v"], p0, p1, p2 + self.o.wander * dt

    def branches(self, node, here):
        """Return the most likely detections of an epoch for each track, and gains."""
        o, h = self.o, self.nodes[node]
        if len(here) == 0:
            return here, here, np.empty(0)
        x, p0, *_ = self._predicted(h, here[0])
        off = self.u[here].T[:, None] - x.T[..., None]
        square, variance = (off**2).sum(axis=0), p0[:, None] + self.scatter[here] ** 2
        i, k = np.nonzero(square <= o.gate**2 * variance)
        gain = self.entry + log_t(square[i, k], variance[i, k], o.freedom, 2)
        change = log_t(
            (self.light[here][k] - h["light"][i]) ** 2, o.flux_step**2, o.freedom, 1
        )
        gain += change - self.light_density[here][k]
        use = np.flatnonzero(gain > LOWEST_GAIN)
        use = use[lowest(-gain[use], i[use], n=o.branches)]
        return i[use], here[k[use]], gain[use]

    def continued(self, node, here, score):
        """Return tracks, each continued by a detection."""
        h = self.nodes[node]
        x, p0, p1, p2 = self._predicted(h, here)
        off, s = self.u[here] - x, p0 + self.scatter[here] ** 2
        # An outlier affects the state less.
        weight = 1 / np.maximum(1, (off**2).sum(axis=1) / (self.o.freedom * s)) / s
        by_place, by_speed = weight * p0, weight * p1
        variance = (1 - by_place) * p0, (1 - by_place) * p1, p2 - by_speed * p1
        return self._added(
            here, parent=node, root=h["root"], length=h["length"] + 1, score=score,
            x=x + by_place[:, None] * off, v=h["v"] + by_speed[:, None] * off,
            variance=np.stack(variance, axis=1),
            light=0.5 * (h["light"] + self.light[here]),
        )  # fmt: skip

    def paths(self, node):
        """Return the detections of each track, -1 after its end, last one first."""
        steps = []
        while (node >= 0).any():
            steps.append(np.where(node >= 0, self.nodes["detection"][node], -1))
            node = np.where(node >= 0, self.nodes["parent"][node], -1)
        return np.stack(steps, axis=1)


def _one_way(d, o, way):
    """Yield the best tracks of each first and each last detection, and scores."""
    tree, lost_score = _Filter(d, o), np.log(1 - o.detected)
    epochs = np.arange(d.epoch[0], d.epoch[-1] + 1)[::way]
    live = missed = np.empty(0, dtype=int)
    score, ended = np.empty(0), []
    for epoch in epochs.tolist():
        here = np.arange(*np.searchsorted(d.epoch, (epoch, epoch + 1)))
        one, detection, gain = tree.branches(live, here)
        lost = missed >= o.most_missed
        ended.append(live[lost])
        left = np.flatnonzero(~lost)
        score = np.concatenate([score[one] + gain, score[left] + lost_score])
        root = tree.nodes["root"][live[np.concatenate([one, left])]]
        kept = np.sort(lowest(-score, root, n=o.hypotheses))
        new, left = kept[kept < len(one)], left[kept[kept >= len(one)] - len(one)]
        start = tree.start(here)
        longer = tree.continued(live[one[new]], detection[new], score[new])
        live, missed, score = (
            np.concatenate([longer, live[left], start]),
            np.concatenate([0 * longer, missed[left] + 1, 0 * start]),
            np.concatenate([score[kept], tree.nodes["score"][start]]),
        )
    # A track that then only misses epochs ends with its last detection.
    node = np.unique(np.concatenate([*ended, live]))
    node = node[tree.nodes["length"][node] >= o.least_epochs]
    ended = tree.nodes[node]
    best = ended["score"]
    kept = [lowest(-best, ended[end], n=o.kept) for end in ("root", "detection")]
    keep = np.union1d(*kept)
    keep = keep[best[keep] > 0]
    if len(keep):
        steps = tree.paths(node[keep])[:, ::-way]
        ends = np.cumsum((steps >= 0).sum(axis=1)).tolist()
        steps = steps[steps >= 0].tolist()
        limits = pairwise([0, *ends])
        for (low, high), total in zip(limits, best[keep].tolist(), strict=True):
            yield tuple(steps[low:high]), total


# -- groups and chains -------------------------------------------------------------


def lowest(value, *keys, n=1):
    """Return the indices of the n lowest values for equal keys, sorted by the keys."""
    order = np.lexsort((value, *keys[::-1]))
    return order[rank_in_group(*(key[order] for key in keys)) < n]


def connected(one, other, n):
    """Return the number of each node's group, for n nodes connected in pairs."""
    graph = scipy.sparse.coo_array((np.ones(len(one)), (one, other)), shape=(n, n))
    return scipy.sparse.csgraph.connected_components(graph, directed=False)[1]


def chains(before, after, n):
    """Return the chains of n nodes, of which some come before others, each in order."""
    group = connected(before, after, n)
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)


# -- the choice among tracks -------------------------------------------------------

#: Tracks that enter the integer program, the most valuable ones by their prices: on
#: the sources of ``benchmarks/features.py`` more tracks change nothing.
MOST_TRACKS = 1500
#: Longest time of the integer program in seconds, and its relative tolerance.
LONGEST, TOLERANCE = 5.0, 1e-3


class Assignment:
    """
    Choose tracks with the largest sum of scores that share no detection.

    This is set packing.  Prices of the detections, found by subgradients of the
    Lagrangian dual (Poore & Rijavec 1993), bound the sum from above.  The tracks
    that are worth most by these prices enter an integer program.

    Parameters
    ----------
    paths : list of tuple of int
        Detections of each track.
    n_detections : int
    """

    def __init__(self, paths, n_detections):
        self._paths = paths
        start = np.cumsum([0, *map(len, paths)], dtype=np.int32)
        detection = np.fromiter(chain.from_iterable(paths), np.int32, start[-1])
        entries = np.ones(len(detection)), detection, start
        self.uses = scipy.sparse.csr_array(entries, shape=(len(paths), n_detections))
        self.price = np.zeros(n_detections)

    def best(self, score):
        """
        Return the tracks of the best assignment.

        Parameters
        ----------
        score : `~numpy.ndarray`, shape (n_tracks,)

        Returns
        -------
        chosen : `~numpy.ndarray` of int
        proven : bool
            Whether no other is better by more than the tolerance; False if the
            integer program ran out of time.
        """
        first, length = np.zeros_like(self.price), np.diff(self.uses.indptr)
        np.maximum.at(first, self.uses.indices, np.repeat(score / length, length))
        self.price, chosen, bound = self._priced(score, first / 2, 150)
        total = score[chosen].sum()
        if bound - total <= TOLERANCE * total:
            return chosen, True
        value = score - self.uses @ self.price
        # Others cannot be part of a better assignment.
        keep = np.flatnonzero(value >= total - bound)
        proven = len(keep) <= MOST_TRACKS
        keep = np.sort(keep[np.argsort(-value[keep], kind="stable")][:MOST_TRACKS])
        uses = self.uses[keep].T.tocsr()
        uses = uses[np.diff(uses.indptr) > 0]
        found = scipy.optimize.milp(
            -score[keep],
            constraints=scipy.optimize.LinearConstraint(uses, -np.inf, 1),
            integrality=np.ones(len(keep)),
            bounds=scipy.optimize.Bounds(0, 1),
            options={"time_limit": LONGEST, "mip_rel_gap": TOLERANCE},
        )
        if found.x is not None and -found.fun > total:
            chosen = keep[found.x > 0.5]
        return chosen, proven and found.status == 0

    def good(self, score):
        """
        Return the tracks of a good assignment for other scores, by prices alone.

        Parameters
        ----------
        score : `~numpy.ndarray`, shape (n_tracks,)

        Returns
        -------
        `~numpy.ndarray` of int
        """
        return self._priced(score, self.price, 60)[1]

    def _priced(self, score, price, iterations, between=15):
        """
        Return the best prices, the best assignment by prices, and the bound.

        An assignment is made whenever so many iterations are ``between``.
        """
        lowest, best_price, total, chosen = np.inf, price, -1.0, np.empty(0, dtype=int)
        length = np.diff(self.uses.indptr)
        step, in_vain = 1.0, 0
        for k in range(iterations + 1):
            value = score - self.uses @ price
            bound = price.sum() + value[value > 0].sum()
            if bound < lowest - 1e-9:
                lowest, best_price, in_vain = bound, price, 0
            else:
                in_vain += 1
            if in_vain >= 8:
                step, in_vain, price = 0.6 * step, 0, best_price
                value = score - self.uses @ price
            if k % between == 0 or k == iterations:
                other = self._greedy(value, score)
                if score[other].sum() > total:
                    chosen, total = other, score[other].sum()
            # Few tracks are taken: a product with the whole matrix takes longer.
            taken = np.flatnonzero(value > 0)
            first, number = self.uses.indptr[taken], length[taken]
            places = np.repeat(first - np.cumsum(number) + number, number)
            places += np.arange(len(places))
            used = self.uses.indices[places]
            slope = 1.0 - np.bincount(used, minlength=len(price))
            slope[(price <= 0) & (slope > 0)] = 0
            square = slope @ slope
            if square == 0 or lowest - total <= 1e-6 * total:
                break
            price = np.maximum(price - step * (lowest - total) / square * slope, 0)
        return best_price, chosen, lowest

    def _greedy(self, value, score):
        """Return the tracks in the order of their values that share no detection."""
        order = np.flatnonzero((value > -3) & (score > 0))
        order = order[np.argsort(-value[order], kind="stable")]
        used, chosen = set(), []
        for track in order.tolist():
            if used.isdisjoint(self._paths[track]):
                used.update(self._paths[track])
                chosen.append(track)
        return np.array(chosen, dtype=int)
