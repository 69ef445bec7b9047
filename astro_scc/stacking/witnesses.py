# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Witnesses: the sightings that belong to one feature count once."""

import heapq
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.spatial import cKDTree

__all__ = ["Witnesses", "find_witnesses"]

#: Power of the number of dates in the weight of a witness.
WEIGHT_POWER = 1.5
#: Sightings link if their places, carried to one date, are this close, in
#: standard errors of a displacement...
LINK_PLACE = 1.25
#: ...and this much more for each interval that lies between them...
LINK_GROWTH = 0.25
#: ...and their velocities differ by less than this.
LINK_VELOCITY = 0.85
#: Sightings further apart in time than this many intervals do not link.
LINK_INTERVALS = 10.0


@dataclass(frozen=True, eq=False, repr=False)
class Witnesses:
    """
    Groups of sightings that may all be of one moving feature.

    Attributes
    ----------
    v1, v2 : `~numpy.ndarray`, shape (n,)
        Mean velocity, weighted.
    s1, s2 : `~numpy.ndarray`, shape (n,)
        Standard error of the velocity of one sighting, mean of the group.
    weight : `~numpy.ndarray`, shape (n,)
        Mean coefficient times ``n_dates ** 1.5``.
    n_dates : `~numpy.ndarray` of int, shape (n,)
        Number of different dates at which the feature was seen to set off.
    group : `~numpy.ndarray` of int, shape (n_sightings,)
        The witness of each sighting.
    """

    v1: np.ndarray
    v2: np.ndarray
    s1: np.ndarray
    s2: np.ndarray
    weight: np.ndarray
    n_dates: np.ndarray
    group: np.ndarray

    def __len__(self):
        return len(self.v1)


def _links(sightings):
    """Which sightings agree in place and velocity, as a sparse matrix."""
    n = len(sightings)
    slots, slot = np.unique(
        np.stack([sightings.time, sightings.interval], axis=1), axis=0,
        return_inverse=True,
    )  # fmt: skip
    slot = slot.reshape(-1)
    members = [np.flatnonzero(slot == k) for k in range(len(slots))]
    sigma = np.median(sightings.sigma)
    rows, columns = [], []
    for a, (time_a, interval_a) in enumerate(slots):
        for b in range(a, len(slots)):
            time_b, interval_b = slots[b]
            interval = np.sqrt(interval_a * interval_b)
            gap = time_b - time_a
            if gap > LINK_INTERVALS * interval:
                continue
            place = sigma * (LINK_PLACE + LINK_GROWTH * gap / interval)
            speed = LINK_VELOCITY * sigma / interval
            i, j = members[a], members[b]
            # Each is carried by its own velocity over half the gap.
            here = _carried(sightings, i, 0.5 * gap, place, speed)
            there = _carried(sightings, j, -0.5 * gap, place, speed)
            pairs = cKDTree(here).sparse_distance_matrix(
                cKDTree(there), np.sqrt(2.0), output_type="ndarray"
            )
            p, q = pairs["i"], pairs["j"]
            apart = (here[p] - there[q]) ** 2
            near = (apart[:, :2].sum(axis=1) <= 1) & (apart[:, 2:].sum(axis=1) <= 1)
            p, q = i[p[near]], j[q[near]]
            if a == b:
                other = p != q
                p, q = p[other], q[other]
                rows.append(p)
                columns.append(q)
            else:
                rows += [p, q]
                columns += [q, p]
    rows, columns = np.concatenate(rows), np.concatenate(columns)
    ones = np.ones(len(rows), dtype=np.int8)
    return coo_matrix((ones, (rows, columns)), shape=(n, n)).tocsr()


def _carried(sightings, index, delay, place, speed):
    velocity = sightings.velocity[index]
    middle = sightings.middle[index] + velocity * delay
    return np.concatenate([middle / place, velocity / speed], axis=1)


def _greedy_groups(links):
    """The sighting with most free neighbours takes them; no chains."""
    n = links.shape[0]
    indices, starts = links.indices, links.indptr
    group = np.full(n, -1)
    heap = [(-int(count), i) for i, count in enumerate(np.diff(starts))]
    heapq.heapify(heap)
    number = 0
    while heap:
        count, i = heapq.heappop(heap)
        if group[i] >= 0:
            continue
        around = indices[starts[i] : starts[i + 1]]
        around = around[group[around] < 0]
        if len(around) < -count:
            heapq.heappush(heap, (-len(around), i))
            continue
        group[around] = number
        group[i] = number
        number += 1
    return group, number


def find_witnesses(sightings):
    """
    Group the sightings that may be of one moving feature.

    The same feature on three scales, or in nine pairs of epochs, is one
    witness of a velocity, not twenty-seven.  Two sightings link if their
    places, carried along by their velocities to the date midway, and their
    velocities agree within limits set by the displacement error.  The
    sighting with most links takes all it links to, and so on; groups do not
    chain.

    Parameters
    ----------
    sightings : `~astro_scc.stacking.Sightings`

    Returns
    -------
    `Witnesses`

    Notes
    -----
    The weight is ``q n^1.5``, q the mean coefficient and n the number of
    different dates: chance links of unrelated SSPs are seldom seen at two
    dates and almost never at three.  Limits and weight were chosen by power
    on simulated two-fluid jets that no calibration uses.
    """
    if len(sightings) == 0:
        empty = np.empty(0)
        whole = np.empty(0, dtype=int)
        return Witnesses(empty, empty, empty, empty, empty, whole, whole)
    group, n = _greedy_groups(_links(sightings))
    q = sightings.weight
    total = np.bincount(group, q, n)
    count = np.bincount(group, minlength=n)

    def mean(values):
        return np.bincount(group, q * values, n) / total

    seen = np.unique(np.stack([group, sightings.first], axis=1), axis=0)
    n_dates = np.bincount(seen[:, 0], minlength=n)
    return Witnesses(
        v1=mean(sightings.v1),
        v2=mean(sightings.v2),
        s1=mean(sightings.s1),
        s2=mean(sightings.s2),
        weight=total / count * n_dates**WEIGHT_POWER,
        n_dates=n_dates,
        group=group,
    )
