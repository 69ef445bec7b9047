# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracks: detections of one feature, what they may be, and the choice among them."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
    one = np.concatenate([path[:-1] for path in paths])
    other = np.concatenate([path[1:] for path in paths])
    owner = np.repeat(np.arange(len(paths)), [len(path) - 1 for path in paths])
    links, which = np.unique(one * len(d) + other, return_inverse=True)
    for trial in range(settings.solutions):
        normal = _normal(d, *np.divmod(links, len(d)), seed, trial)
        noise = settings.disturbance * normal[which]
        disturbed = score + np.bincount(owner, noise, len(paths))
        solutions.append(assignment.good(disturbed))
    share = np.zeros(len(links))
    for chosen in solutions:
        used = np.bincount(which[np.isin(owner, chosen)], minlength=len(links))
        share += used / len(solutions)
    links = np.divmod(links[share > settings.agreed], len(d))
    return [
        Track(chain, _same_speed(d, chain, paths, solutions), proven)
        for chain in chains(*links, len(d))
        if len(chain) >= settings.least_epochs
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


#: State of a track: its last detection as a node, its first one, position and velocity
#: with their variances and covariance, and likelihood.
STATE = [("node", int), ("root", int), ("x", float, 2), ("v", float, 2),
         ("variance", float, 3), ("time", float), ("light", float), ("score", float),
         ("best", float), ("length", int), ("missed", int)]  # fmt: skip


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
        # Each node is a detection after another node; hypotheses share them.
        self.detection, self.parent, self.n_nodes = [], [], 0

    def _tracks(self, here, parent, **state):
        """Return tracks that end with some detections after the ``parent`` nodes."""
        self.detection.append(here)
        self.parent.append(np.broadcast_to(parent, here.shape))
        tracks = np.zeros(len(here), dtype=STATE)
        tracks["node"] = self.n_nodes + np.arange(len(here))
        self.n_nodes += len(here)
        for name, values in state.items():
            tracks[name] = values
        tracks["time"], tracks["best"] = self.time[here], tracks["score"]
        return tracks

    def start(self, here):
        """Return a new track from each detection of an epoch."""
        state = {"x": self.u[here], "light": self.light[here], "score": self.entry}
        tracks = self._tracks(here, -1, root=here, length=1, **state)
        tracks["variance"][:, 0] = self.scatter[here] ** 2
        tracks["variance"][:, 2] = self.o.speed**2
        return tracks

    def continued(self, h, here):
        """Return tracks continued by the most likely detections of an epoch."""
        o = self.o
        dt = np.abs(self.time[here[0]] - h["time"])
        p0, p1, p2 = h["variance"].T
        p0 = p0 + 2 * dt * p1 + dt**2 * p2 + o.wander * dt**3 / 3
        p1 = p1 + dt * p2 + o.wander * dt**2 / 2
        p2 = p2 + o.wander * dt
        x = h["x"] + dt[:, None] * h["v"]
        off = self.u[here] - x[:, None]
        square = (off**2).sum(axis=-1)
        variance = p0[:, None] + self.scatter[here] ** 2
        gain = self.entry + log_t(square, variance, o.freedom, 2)
        change = (self.light[here] - h["light"][:, None]) ** 2
        gain += log_t(change, o.flux_step**2, o.freedom, 1) - self.light_density[here]
        gain[square > o.gate**2 * variance] = -np.inf
        n = min(o.branches, len(here))
        k = np.argsort(-gain, axis=1, kind="stable")[:, :n].ravel()
        i = np.repeat(np.arange(len(x)), n)
        use = gain[i, k] > LOWEST_GAIN
        i, k = i[use], k[use]
        # An outlier affects the state less.
        s = variance[i, k]
        weight = 1 / np.maximum(1, square[i, k] / (o.freedom * s)) / s
        by_place, by_speed = weight * p0[i], weight * p1[i]
        parts = (1 - by_place) * p0[i], (1 - by_place) * p1[i], p2[i] - by_speed * p1[i]
        return self._tracks(
            here[k], h["node"][i], root=h["root"][i], length=h["length"][i] + 1,
            x=x[i] + by_place[:, None] * off[i, k],
            v=h["v"][i] + by_speed[:, None] * off[i, k],
            variance=np.stack(parts, axis=1), score=h["score"][i] + gain[i, k],
            light=0.5 * (h["light"][i] + self.light[here[k]]),
        )  # fmt: skip

    def paths(self, node):
        """Return the detections of each track, -1 after its end, last one first."""
        detection, parent = np.concatenate(self.detection), np.concatenate(self.parent)
        steps = []
        while (node >= 0).any():
            steps.append(np.where(node >= 0, detection[node], -1))
            node = np.where(node >= 0, parent[node], -1)
        return np.stack(steps, axis=1)


def _one_way(d, o, way):
    """Yield the best tracks of each first and each last detection, and scores."""
    tracks_of = _Filter(d, o)
    epochs = np.arange(d.epoch[0], d.epoch[-1] + 1)[::way]
    live, ended = None, []
    for epoch in epochs.tolist():
        here = np.arange(*np.searchsorted(d.epoch, (epoch, epoch + 1)))
        start = tracks_of.start(here)
        if live is None:
            live = start
            continue
        longer = tracks_of.continued(live, here) if len(here) else start
        lost = live["missed"] >= o.most_missed
        ended.append(live[lost])
        live = live[~lost]
        live["missed"] += 1
        live["score"] += np.log(1 - o.detected)
        live = np.concatenate([longer, live])
        kept = lowest(-live["score"], live["root"], n=o.hypotheses)
        live = np.concatenate([live[np.sort(kept)], start])
    ended = np.concatenate([*ended, live])
    ended = ended[ended["length"] >= o.least_epochs]
    # A track that then only misses epochs ends with its last detection.
    node, first = np.unique(ended["node"], return_index=True)
    best, root = ended["best"][first], ended["root"][first]
    last = np.concatenate(tracks_of.detection)[node]
    kept = [lowest(-best, group, n=o.kept) for group in (root, last)]
    keep = np.union1d(*kept)
    keep = keep[best[keep] > 0]
    if len(keep):
        paths = tracks_of.paths(node[keep])
        for row, score in zip(paths.tolist(), best[keep].tolist(), strict=True):
            path = [k for k in row if k >= 0]
            yield tuple(path[::-way]), score


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
        self._paths, self._detections = paths, [np.array(path) for path in paths]
        start = np.cumsum([0, *map(len, paths)])
        entries = np.ones(start[-1]), np.concatenate(self._detections), start
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
            taken = [self._detections[k] for k in np.flatnonzero(value > 0).tolist()]
            taken = np.concatenate([np.empty(0, dtype=int), *taken])
            slope = 1.0 - np.bincount(taken, minlength=len(price))
            slope[(price <= 0) & (slope > 0)] = 0
            length = slope @ slope
            if length == 0 or lowest - total <= 1e-6 * total:
                break
            price = np.maximum(price - step * (lowest - total) / length * slope, 0)
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
