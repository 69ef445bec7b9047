# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Witnesses: the sightings that belong to one feature count once."""

import heapq
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.spatial import cKDTree

__all__ = ["Witnesses", "find_witnesses"]

#: Power of the number of dates in the weight of a witness...
WEIGHT_POWER = 1.5
#: ...and of the number of its sightings a date.
SIGHTINGS_POWER = 0.5
#: More dates than these weigh no more: what stands still in all of a hundred
#: epochs is one witness, and not to outweigh all that moves.
MOST_DATES = 9
#: Sightings link if their places, carried to one date, are this close, in
#: standard errors of a displacement...
LINK_PLACE = 1.25
#: ...and this much more for each interval that lies between them...
LINK_GROWTH = 0.25
#: ...and their velocities differ by less than this.
LINK_VELOCITY = 0.85
#: Sightings further apart in time than this many intervals do not link.
LINK_INTERVALS = 10.0
#: Above so many combinations, trees find links faster than a table does.
FOR_TREES = 8000


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
        Mean coefficient times ``n_dates ** 1.5``, for at most 9 dates, and
        times the root of the sightings a date.
    n_dates : `~numpy.ndarray` of int, shape (n,)
        Number of different dates at which the feature was seen to set off.
    group : `~numpy.ndarray` of int, shape (n_sightings,)
        The witness of each sighting.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import Sightings
    >>> from astro_scc.stacking import find_witnesses
    >>> rng = np.random.default_rng(1)
    >>> years, n, one = np.array([0.0, 1.0, 2.0]), 40, np.ones(40)
    >>> first = np.repeat([0, 1], 20)
    >>> d = Displacements(
    ...     d1=3 + rng.normal(0, 0.2, n), d2=rng.normal(0, 0.2, n), s1=0.3 * one,
    ...     s2=0.3 * one, weight=0.8 * one, reference=first, target=first + 1,
    ...     ssp=np.arange(n), target_ssp=np.full(n, -1), n_ssps=np.full(3, 20),
    ...     position=rng.uniform(0, 50, (n, 2)), motion=np.tile([3.0, 0.0], (n, 1)))
    >>> pairs = consecutive_pairs(years)
    >>> seen = Sightings.of(d, pairs, years, (9.0, 9.0))
    >>> witnesses = find_witnesses(seen)
    >>> len(witnesses) <= len(seen), bool((witnesses.n_dates >= 1).all())
    (True, True)
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
    time, interval = slots.T
    # Sightings by the mean date of their pair, one pair after another.
    order = np.argsort(slot, kind="stable")
    count = np.bincount(slot, minlength=len(slots))
    start = np.cumsum(count) - count
    sigma = np.median(sightings.sigma)
    rows, columns = [], []
    for a in range(len(slots)):
        i = order[start[a] : start[a] + count[a]]
        gap = time[a:] - time[a]
        mean = np.sqrt(interval[a] * interval[a:])
        place = sigma * (LINK_PLACE + LINK_GROWTH * gap / mean)
        speed = LINK_VELOCITY * sigma / mean
        use = gap <= LINK_INTERVALS * mean
        large = count[a] * count[a:] > FOR_TREES
        for k in np.flatnonzero(use & large):
            j = order[start[a + k] : start[a + k] + count[a + k]]
            p, q = _near_by_trees(sightings, i, j, gap[k], place[k], speed[k])
            rows.append(p)
            columns.append(q)
        some = np.repeat(use & ~large, count[a:])
        j = order[start[a] :][some]
        limits = (np.repeat(x, count[a:])[some] for x in (gap, place, speed))
        p, q = _near_by_table(sightings, i, j, *limits)
        rows.append(p)
        columns.append(q)
    rows, columns = np.concatenate(rows), np.concatenate(columns)
    other = rows != columns
    rows, columns = rows[other], columns[other]
    both = np.concatenate([rows, columns]), np.concatenate([columns, rows])
    return coo_matrix((np.ones(2 * len(rows), bool), both), shape=(n, n)).tocsr()


def _near_by_trees(sightings, i, j, gap, place, speed):
    """Pairs that link, of the sightings of two pairs of dates."""
    # Each is carried by its own velocity over half the gap.
    here = _carried(sightings, i, 0.5 * gap, place, speed)
    there = _carried(sightings, j, -0.5 * gap, place, speed)
    pairs = cKDTree(here).sparse_distance_matrix(
        cKDTree(there), np.sqrt(2.0), output_type="ndarray"
    )
    p, q = pairs["i"], pairs["j"]
    apart = (here[p] - there[q]) ** 2
    near = (apart[:, :2].sum(axis=1) <= 1) & (apart[:, 2:].sum(axis=1) <= 1)
    return i[p[near]], j[q[near]]


def _carried(sightings, index, delay, place, speed):
    velocity = sightings.velocity[index]
    middle = sightings.middle[index] + velocity * delay
    return np.concatenate([middle / place, velocity / speed], axis=1)


def _near_by_table(sightings, i, j, gap, place, speed):
    """Pairs that link, limits and gap being those of each of the latter."""
    (vx, vy), (wx, wy) = sightings.velocity[i].T, sightings.velocity[j].T
    apart = (vx[:, None] - wx) ** 2
    apart += (vy[:, None] - wy) ** 2
    p, q = np.nonzero(apart <= speed**2)
    delay = 0.5 * gap[q, None]
    i, j = i[p], j[q]
    here = sightings.middle[i] + delay * sightings.velocity[i]
    there = sightings.middle[j] - delay * sightings.velocity[j]
    near = ((here - there) ** 2).sum(axis=1) <= place[q] ** 2
    return i[near], j[near]


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
    The weight is ``q n^1.5 (m / n)^0.5``, q the mean coefficient, n the
    number of different dates and m that of sightings: chance links of
    unrelated SSPs are seldom seen at two dates and almost never at three,
    and seldom on several scales and in both directions.  Limits and weight
    were chosen by power on simulated two-fluid jets that no calibration uses.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import Sightings, find_witnesses
    >>> rng = np.random.default_rng(1)
    >>> years = np.arange(6.0)
    >>> epoch, feature = (k.ravel() for k in np.indices((5, 20)))
    >>> v = rng.uniform(-6, 6, (20, 2))[feature]
    >>> v[feature < 12] = 3.0, 0.0
    >>> start = rng.uniform(0, 90, (20, 2))[feature]
    >>> moved, one = v + rng.normal(0, 0.1, v.shape), np.ones(100)
    >>> d = Displacements(
    ...     d1=moved[:, 0], d2=moved[:, 1], s1=0.3 * one, s2=0.3 * one, weight=one,
    ...     reference=epoch, target=epoch + 1, ssp=20 * epoch + feature,
    ...     target_ssp=20 * epoch + 20 + feature, n_ssps=np.full(6, 20),
    ...     position=start + v * epoch[:, None], motion=moved)
    >>> pairs = consecutive_pairs(years)
    >>> witnesses = find_witnesses(Sightings.of(d, pairs, years, (9.0, 9.0)))
    >>> len(d), len(witnesses)
    (100, 22)
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
        weight=total
        / count
        * np.minimum(n_dates, MOST_DATES) ** WEIGHT_POWER
        * (count / n_dates) ** SIGHTINGS_POWER,
        n_dates=n_dates,
        group=group,
    )
