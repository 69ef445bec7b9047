# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Hypotheses: tracks that detections may form, and the choice among them."""

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.special import gammaln

#: A detection may lower the logarithmic likelihood ratio of a track by this much.
LOWEST_GAIN = -4.0


def log_t(square, variance, freedom, n_axes):
    """Return the logarithm of the density of Student's t distribution."""
    half = (freedom + n_axes) / 2
    norm = gammaln(half) - gammaln(freedom / 2)
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


class _Filter:
    """Kalman filter of position and velocity, equal on both axes, in one direction."""

    def __init__(self, d, o, way):
        self.d, self.o, self.way = d, o, way
        self.u, self.time = d.in_beams, d.time
        self.scatter = position_scatter(d, o)
        self.light = np.log(d.flux)
        width = self.light.std() + 0.3
        self.light_density = -0.5 * ((self.light - self.light.mean()) / width) ** 2
        self.light_density -= np.log(width * np.sqrt(2 * np.pi))
        step = np.median(np.diff(np.unique(self.time)))
        self.speed = o.speed / max(step, 1e-3)
        self.entry = np.log(o.detected / o.density)
        # Each node is a detection after another node; hypotheses share them.
        self.detection, self.parent, self.n_nodes = [], [], 0

    def _nodes(self, detection, parent):
        self.detection.append(detection)
        self.parent.append(parent)
        first = self.n_nodes
        self.n_nodes += len(detection)
        return np.arange(first, self.n_nodes)

    def start(self, own):
        """Return a new track from each detection of an epoch."""
        n = len(own)
        variance = np.zeros((n, 3))
        variance[:, 0], variance[:, 2] = self.scatter[own] ** 2, self.speed**2
        score = np.full(n, self.entry)
        return {
            "x": self.u[own],
            "v": np.zeros((n, 2)),
            "variance": variance,
            "time": self.time[own],
            "light": self.light[own],
            "score": score,
            "best": score,
            "root": own,
            "missed": np.zeros(n, dtype=int),
            "length": np.ones(n, dtype=int),
            "node": self._nodes(own, np.full(n, -1)),
        }

    def continued(self, h, own):
        """Return tracks continued by the most likely detections of an epoch."""
        o = self.o
        dt = np.abs(self.time[own[0]] - h["time"])
        p0, p1, p2 = h["variance"].T
        p0 = p0 + 2 * dt * p1 + dt**2 * p2 + o.wander * dt**3 / 3
        p1 = p1 + dt * p2 + o.wander * dt**2 / 2
        p2 = p2 + o.wander * dt
        x = h["x"] + dt[:, None] * h["v"]
        off = self.u[own] - x[:, None]
        square = (off**2).sum(axis=-1)
        variance = p0[:, None] + self.scatter[own] ** 2
        gain = self.entry + log_t(square, variance, o.freedom, 2)
        change = (self.light[own] - h["light"][:, None]) ** 2
        gain += log_t(change, o.flux_step**2, o.freedom, 1) - self.light_density[own]
        gain[square > o.gate**2 * variance] = -np.inf
        n = min(o.branches, len(own))
        k = np.argsort(-gain, axis=1, kind="stable")[:, :n].ravel()
        i = np.repeat(np.arange(len(x)), n)
        use = gain[i, k] > LOWEST_GAIN
        i, k = i[use], k[use]
        # An outlier affects the state less.
        s = variance[i, k]
        weight = 1 / np.maximum(1, square[i, k] / (o.freedom * s)) / s
        by_place, by_speed = weight * p0[i], weight * p1[i]
        parts = (1 - by_place) * p0[i], (1 - by_place) * p1[i], p2[i] - by_speed * p1[i]
        score = h["score"][i] + gain[i, k]
        return {
            "x": x[i] + by_place[:, None] * off[i, k],
            "v": h["v"][i] + by_speed[:, None] * off[i, k],
            "variance": np.stack(parts, axis=1),
            "time": self.time[own[k]],
            "light": 0.5 * (h["light"][i] + self.light[own[k]]),
            "score": score,
            "best": score,
            "root": h["root"][i],
            "missed": np.zeros(len(i), dtype=int),
            "length": h["length"][i] + 1,
            "node": self._nodes(own[k], h["node"][i]),
        }

    def paths(self, node):
        """Return the detections of each track, -1 after its end, last one first."""
        detection, parent = np.concatenate(self.detection), np.concatenate(self.parent)
        steps = []
        while (node >= 0).any():
            steps.append(np.where(node >= 0, detection[node], -1))
            node = np.where(node >= 0, parent[node], -1)
        return np.stack(steps, axis=1)


def _select(tracks, keep):
    return {name: values[keep] for name, values in tracks.items()}


def _one_way(d, o, way):
    """Yield the best tracks of each first and each last detection, and scores."""
    tracks_of = _Filter(d, o, way)
    epochs = np.arange(d.epoch[0], d.epoch[-1] + 1)[::way]
    live, ended = None, []
    for epoch in epochs.tolist():
        own = np.arange(*np.searchsorted(d.epoch, (epoch, epoch + 1)))
        start = tracks_of.start(own)
        if live is None:
            live = start
            continue
        longer = tracks_of.continued(live, own) if len(own) else start
        lost = live["missed"] >= o.most_missed
        ended.append(_select(live, lost & (live["length"] >= o.least_epochs)))
        live = _select(live, ~lost)
        live["missed"] = live["missed"] + 1
        live["score"] = live["score"] + np.log(1 - o.detected)
        live = {k: np.concatenate([longer[k], live[k]]) for k in live}
        rank = _rank(-live["score"], live["root"])
        live = _select(live, np.flatnonzero(rank < o.hypotheses))
        live = {k: np.concatenate([live[k], start[k]]) for k in live}
    ended.append(_select(live, live["length"] >= o.least_epochs))
    node, best, root = (
        np.concatenate([part[k] for part in ended]) for k in ("node", "best", "root")
    )
    # A track that then only misses epochs ends with its last detection.
    node, first = np.unique(node, return_index=True)
    best, root = best[first], root[first]
    last = np.concatenate(tracks_of.detection)[node]
    keep = (_rank(-best, root) < o.kept) | (_rank(-best, last) < o.kept)
    keep &= best > 0
    if keep.any():
        paths = tracks_of.paths(node[keep])
        for row, score in zip(paths.tolist(), best[keep].tolist(), strict=True):
            path = [k for k in row if k >= 0]
            yield tuple(path[::-way]), score


def _rank(value, group):
    """Return the rank of each value within its group, from 0."""
    order = np.lexsort((value, group))
    ordered = group[order]
    rank = np.empty(len(order), dtype=int)
    rank[order] = np.arange(len(order)) - np.searchsorted(ordered, ordered)
    return rank


#: Iterations of the prices, without and with prices to start from.
ITERATIONS, ITERATIONS_AGAIN = 150, 60
#: Iterations between two assignments by prices.
BETWEEN = 15
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
        length = np.array([len(path) for path in paths])
        detection = np.concatenate([np.array(path) for path in paths])
        track = np.repeat(np.arange(len(paths)), length)
        one = np.ones(len(track))
        shape = len(paths), n_detections
        self.uses = sparse.csr_array((one, (track, detection)), shape=shape)
        self.used_by = self.uses.T.tocsr()
        self._entries = detection, track, length
        self._paths = paths
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
        detection, track, length = self._entries
        first = np.zeros_like(self.price)
        np.maximum.at(first, detection, (score / length)[track])
        self.price, chosen, bound = self._priced(score, first / 2, ITERATIONS)
        total = score[chosen].sum()
        if bound - total <= TOLERANCE * total:
            return chosen, True
        value = score - self.uses @ self.price
        # Others cannot be part of a better assignment.
        keep = np.flatnonzero(value >= total - bound)
        proven = len(keep) <= MOST_TRACKS
        keep = np.sort(keep[np.argsort(-value[keep], kind="stable")][:MOST_TRACKS])
        uses = self.used_by[:, keep]
        uses = uses[np.diff(uses.indptr) > 0]
        found = milp(
            -score[keep],
            constraints=LinearConstraint(uses, -np.inf, 1),
            integrality=np.ones(len(keep)),
            bounds=Bounds(0, 1),
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
        return self._priced(score, self.price, ITERATIONS_AGAIN)[1]

    def _priced(self, score, price, iterations):
        """Return the best prices, the best assignment by prices, and the bound."""
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
            if k % BETWEEN == 0 or k == iterations:
                other = self._greedy(value, score)
                if score[other].sum() > total:
                    chosen, total = other, score[other].sum()
            slope = 1.0 - self._times_used(np.flatnonzero(value > 0))
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

    def _times_used(self, tracks):
        """Return how many of some tracks have each detection."""
        # Few tracks are taken: a product with the whole matrix takes longer.
        detection, _, length = self._entries
        n = length[tracks]
        shift = self.uses.indptr[tracks] - np.cumsum(n) + n
        entry = np.arange(n.sum()) + np.repeat(shift, n)
        return np.bincount(detection[entry], minlength=len(self.price))
