# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Assignment of detections to tracks: each detection to one track at most."""

import numpy as np
from scipy import sparse
from scipy.optimize import Bounds, LinearConstraint, milp

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
