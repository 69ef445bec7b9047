# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracks: detections of one feature, what they may be, and the choice among them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
import scipy

from astro_scc.features.detections import Detections, rank_in_group
from astro_scc.intervals import median_interval


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


def find_tracks(
    detections: Detections, settings: TrackSettings | None = None, *, seed: int = 0
) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
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
    tracks : tuple of `~numpy.ndarray` of int
        Detections of each feature, one per epoch, in the order of the epochs; tracks
        are in the order of their first epochs.
    same_speed : `~numpy.ndarray`, shape (n_tracks,)
        Share of the disturbed assignments with a track of these detections, at the
        same dates, that has the same velocity.
    proven : `~numpy.ndarray` of bool, shape (n_tracks,)
        Whether the assignment was solved to the end.

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
    >>> tracks, same_speed, proven = find_tracks(d)
    >>> [track.tolist() for track in tracks]
    [[0, 2, 4, 6, 8, 10], [1, 3, 5, 7, 9, 11]]
    """
    settings = TrackSettings() if settings is None else settings
    free, found = np.ones(len(detections), dtype=bool), []
    for turn in range(settings.rounds):
        left = np.flatnonzero(free)
        new = _agreed(detections.select(left), settings, seed + turn)
        if not new:
            break
        for track, same_speed, proven in new:
            found.append((left[track], same_speed, proven))
            free[left[track]] = False
    order = np.lexsort((detections.number, detections.epoch))
    rank = np.argsort(order)
    found.sort(key=lambda one: rank[one[0][0]])
    tracks = tuple(track for track, *_ in found)
    same_speed = np.array([share for _, share, _ in found], dtype=float)
    return tracks, same_speed, np.array([proven for *_, proven in found], dtype=bool)


def _agreed(d, settings, seed):
    """
    Return tracks of the links that most assignments agree upon.

    Each is with the share of the assignments in which it has the same speed, and
    whether the best one is proven.
    """
    paths, score = steady_hypotheses(d, settings)
    if not paths:
        return []
    assignment = Assignment(paths, len(d))
    chosen, proven = assignment.best(score)
    detection, ends = assignment.uses.indices.astype(int), assignment.uses.indptr[1:]
    before = np.delete(np.arange(len(detection)), ends - 1)
    links = detection[before] * len(d) + detection[before + 1]
    links, which = np.unique(links, return_inverse=True)
    start = np.concatenate([[0], ends - np.arange(1, len(ends) + 1)])
    has = scipy.sparse.csr_array((np.ones(len(which)), which, start))
    pairs = np.divmod(links, len(d))
    noise = [_normal(d, *pairs, seed, trial) for trial in range(settings.solutions)]
    disturbed = settings.disturbance * (has @ np.stack(noise, axis=1))
    solutions = [chosen, *assignment.good(score[:, None] + disturbed)]
    used = np.bincount(np.concatenate(solutions), minlength=len(paths))
    share = used @ has / len(solutions)
    links = np.divmod(links[share > settings.agreed], len(d))
    return [
        (track, _same_speed(d, track, paths, solutions), proven)
        for track in chains(*links, len(d))
        if len(track) >= settings.least_epochs
    ]


def _same_speed(d, track, paths, solutions, *, least=0.5, off=0.2):
    """
    Return the share of the assignments in which a track has the same velocity.

    There a track is the same if it has at ``least`` such a share of its detections, and
    the velocity if it is ``off`` by at most such a part.
    """
    time, n_same = d.time, 0
    first, last = time[track[[0, -1]]]
    members, velocity = set(track.tolist()), d.velocity(track)[0]
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


#: Rows of the state of a track: place, velocity, their variances and covariance, the
#: logarithm of its flux, and its last date.
X, V, VARIANCE, LIGHT, TIME = slice(0, 2), slice(2, 4), slice(4, 7), 7, 8


class _Filter:
    """Kalman filter of position and velocity, equal on both axes, in one direction."""

    def __init__(self, d, o):
        # Times are in median intervals.
        step = median_interval(d.time)
        self.o, self.u, self.time = o, d.in_beams.T, (d.time - d.time.min()) / step
        self.square = position_scatter(d, o) ** 2
        self.light = np.log(d.flux)
        width = self.light.std() + 0.3
        self.light_density = -0.5 * ((self.light - self.light.mean()) / width) ** 2
        self.light_density -= np.log(width * np.sqrt(2 * np.pi))
        self.entry = np.log(o.detected / o.density)

    def start(self, here):
        """Return the states of new tracks, one from each detection of an epoch."""
        state = np.zeros((9, len(here)))
        state[X], state[LIGHT], state[TIME] = (
            self.u[:, here], self.light[here], self.time[here]
        )  # fmt: skip
        state[4], state[6] = self.square[here], self.o.speed**2
        return state

    def predicted(self, state, time):
        """Return the states of tracks at a date."""
        (p0, p1, p2), found = state[VARIANCE], state.copy()
        dt = np.abs(time - state[TIME])
        found[X] += dt * state[V]
        found[4] = p0 + 2 * dt * p1 + dt**2 * p2 + self.o.wander * dt**3 / 3
        found[5] = p1 + dt * p2 + self.o.wander * dt**2 / 2
        found[6] += self.o.wander * dt
        found[TIME] = time
        return found

    def branches(self, state, here):
        """Return the most likely detections of an epoch for each state, and gains."""
        o = self.o
        y, x = self.u[:, here, None] - state[X, None]
        square, variance = y**2 + x**2, state[4] + self.square[here, None]
        i, k = np.nonzero(np.ascontiguousarray((square <= o.gate**2 * variance).T))
        gain = self.entry + log_t(square[k, i], variance[k, i], o.freedom, 2)
        k = here[k]
        change = (self.light[k] - state[LIGHT, i]) ** 2
        gain += log_t(change, o.flux_step**2, o.freedom, 1) - self.light_density[k]
        use = np.flatnonzero(gain > LOWEST_GAIN)
        if len(here) > o.branches:
            use = use[lowest(-gain[use], i[use], n=o.branches)]
        return i[use], k[use], gain[use]

    def continued(self, state, here):
        """Return states, each continued by a detection."""
        (p0, p1, p2), off = state[VARIANCE], self.u[:, here] - state[X]
        s = p0 + self.square[here]
        # An outlier affects the state less.
        weight = 1 / np.maximum(1, (off**2).sum(axis=0) / (self.o.freedom * s)) / s
        by_place, by_speed = weight * p0, weight * p1
        light = 0.5 * (state[LIGHT] + self.light[here])
        return np.stack([
            *(state[X] + by_place * off), *(state[V] + by_speed * off),
            (1 - by_place) * p0, (1 - by_place) * p1, p2 - by_speed * p1,
            light, state[TIME],
        ])  # fmt: skip


def _one_way(d, o, way):
    """Return the best tracks of each first and each last detection, and scores."""
    kalman, lost_score = _Filter(d, o), np.log(1 - o.detected)
    epochs = np.arange(d.epoch[0], d.epoch[-1] + 1)[::way]
    # A track that ends with a detection is a node, after the node of the one before.
    # Their columns: detection, parent, root, length; and the score.
    nodes, scores, n_nodes = [], [], 0
    live = missed = root = length = np.empty(0, dtype=int)
    state, score, ended = np.empty((9, 0)), np.empty(0), []
    for epoch in epochs.tolist():
        here = np.arange(*np.searchsorted(d.epoch, (epoch, epoch + 1)))
        then = kalman.predicted(state, kalman.time[here[0]]) if len(here) else state
        one, detection, gain = kalman.branches(then, here)
        lost = missed >= o.most_missed
        ended.append(live[lost])
        left = np.flatnonzero(~lost)
        score = np.concatenate([score[one] + gain, score[left] + lost_score])
        root = root[np.concatenate([one, left])]
        kept = np.sort(lowest(-score, root, n=o.hypotheses))
        n_new = np.searchsorted(kept, len(one))
        one, detection = one[kept[:n_new]], detection[kept[:n_new]]
        left = left[kept[n_new:] - len(gain)]
        states = kalman.continued(then[:, one], detection), state[:, left]
        state = np.concatenate([*states, kalman.start(here)], axis=1)
        score = np.concatenate([score[kept], np.full(len(here), kalman.entry)])
        root = np.concatenate([root[kept], here])
        length = np.concatenate([length[one] + 1, length[left], 1 + 0 * here])
        missed = np.concatenate([0 * one, missed[left] + 1, 0 * here])
        detection = np.concatenate([detection, here])
        parent = np.concatenate([live[one], np.full(len(here), -1)])
        added = np.r_[: len(one), len(kept) : len(kept) + len(here)]
        nodes.append(np.stack([detection, parent, root[added], length[added]]))
        scores.append(score[added])
        new = n_nodes + np.arange(len(detection))
        live = np.concatenate([new[: len(one)], live[left], new[len(one) :]])
        n_nodes += len(new)
    # A track that then only misses epochs ends with its last detection.
    ends = np.unique(np.concatenate([*ended, live]))
    nodes, scores = np.concatenate(nodes, axis=1), np.concatenate(scores)
    return _paths_to(ends, nodes, scores, o, way)


def _paths_to(node, nodes, best, o, way):
    """Return the detections of the tracks to the best of some nodes, and scores."""
    detection, parent, root, length = nodes
    node = node[length[node] >= o.least_epochs]
    kept = [lowest(-best[node], end[node], n=o.kept) for end in (root, detection)]
    node = node[np.union1d(*kept)]
    node = node[best[node] > 0]
    totals, limits = best[node].tolist(), np.cumsum(length[node])[:-1]
    steps = []
    while (node >= 0).any():
        steps.append(np.where(node >= 0, detection[node], -1))
        node = np.where(node >= 0, parent[node], -1)
    if not steps:
        return []
    steps = np.stack(steps, axis=1)[:, ::-way]
    paths = np.split(steps[steps >= 0], limits)
    return zip((tuple(path.tolist()) for path in paths), totals, strict=True)


def lowest(value, key, *, n):
    """Return the indices of the n lowest values for equal keys, sorted by the key."""
    # Short integers are sorted in a time that is linear in their number.
    short = key if key.max(initial=0) >= 2**15 else key.astype(np.int16)
    order = np.lexsort((value, short))
    return order[rank_in_group(key[order]) < n]


def chains(before, after, n):
    """Return the chains of n nodes, of which some come before others, each in order."""
    links = scipy.sparse.coo_array(
        (np.ones(len(before)), (before, after)), shape=(n, n)
    )
    _, group = scipy.sparse.csgraph.connected_components(links, directed=False)
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
        self._paths, self.length = paths, np.array([len(path) for path in paths])
        start = np.append(0, np.cumsum(self.length)).astype(np.int32)
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
        first, each = np.zeros_like(self.price), score / self.length
        np.maximum.at(first, self.uses.indices, np.repeat(each, self.length))
        price, (chosen,), (bound,) = self._priced(score[:, None], first[None] / 2, 150)
        self.price, total = price[0], score[chosen].sum()
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

    def good(self, scores):
        """
        Return the tracks of good assignments for other scores, by prices alone.

        Parameters
        ----------
        scores : `~numpy.ndarray`, shape (n_tracks, n)

        Returns
        -------
        list of `~numpy.ndarray` of int
        """
        price = np.repeat(self.price[None], scores.shape[1], axis=0)
        return self._priced(scores, price, 60)[1]

    def _priced(self, scores, price, iterations, between=15):
        """
        Return the best prices, the best assignments by prices, and the bounds.

        There is one of each for each column of the scores.  Assignments are made
        whenever so many iterations are ``between``.
        """
        (n, n_detections), best_price = price.shape, price.copy()
        lowest, total, chosen = np.full(n, np.inf), np.full(n, -1.0), [[]] * n
        step, in_vain, active = np.ones(n), np.zeros(n, dtype=int), np.arange(n)
        for k in range(iterations + 1):
            value = scores[:, active] - self.uses @ price[active].T
            column, taken = _positive(value)
            ends = np.searchsorted(column, np.arange(1, len(active)))
            gains = np.split(value[taken, column], ends)
            bound = price[active].sum(axis=1) + [gain.sum() for gain in gains]
            lower = bound < lowest[active] - 1e-9
            better = active[lower]
            lowest[better], best_price[better] = bound[lower], price[better]
            in_vain[active] += 1
            in_vain[better] = 0
            again = in_vain[active] >= 8
            if again.any():
                which = active[again]
                step[which] *= 0.6
                in_vain[which], price[which] = 0, best_price[which]
                value[:, again] = scores[:, which] - self.uses @ price[which].T
                column, taken = _positive(value)
            if k % between == 0 or k == iterations:
                for one, values in zip(active.tolist(), value.T, strict=True):
                    other = self._greedy(values, scores[:, one])
                    if (reached := scores[other, one].sum()) > total[one]:
                        chosen[one], total[one] = other, reached
            # Few tracks are taken: a product with the whole matrix takes longer.
            used = np.repeat(column * n_detections, self.length[taken])
            used += self._detections(taken)
            number = np.bincount(used, minlength=len(active) * n_detections)
            slope = 1.0 - number.reshape(len(active), n_detections)
            slope[(price[active] <= 0) & (slope > 0)] = 0
            square, gap = (slope**2).sum(axis=1), (lowest - total)[active]
            go_on = (square > 0) & (gap > 1e-6 * total[active])
            if not go_on.any():
                break
            active = active[go_on]
            size = step[active] * gap[go_on] / square[go_on]
            price[active] = np.maximum(price[active] - size[:, None] * slope[go_on], 0)
        return best_price, [np.array(tracks, dtype=int) for tracks in chosen], lowest

    def _detections(self, tracks):
        """Return the detections of some tracks, one track after the other."""
        start, length = self.uses.indptr[tracks], self.length[tracks]
        start = np.repeat(start - np.cumsum(length) + length, length)
        return self.uses.indices[start + np.arange(len(start))]

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


def _positive(value):
    """Return the columns, in their order, and the rows of the positive values."""
    taken, column = np.divmod(np.flatnonzero(value > 0), value.shape[1])
    order = np.argsort(column, kind="stable")
    return column[order], taken[order]
