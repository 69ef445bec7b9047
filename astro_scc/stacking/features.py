# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features: how many different things the sightings of a velocity are at least."""

import numpy as np

__all__ = ["count_features"]

#: Tracks this close at the date midway may be of one feature, in standard
#: errors of a displacement...
PLACE = 3.0
#: ...and this much more for each interval that lies between them...
GROWTH = 0.5
#: ...if their velocities differ by less than this: three standard errors of
#: a difference, less what one feature wanders in an interval.
VELOCITY = 2.5
#: Carried along by the velocity of all, they may be of one feature if they
#: are this close, times the root of half an interval and those between: a
#: feature that wanders takes a random walk about its mean motion.
WANDER = 2.5


def count_features(sightings, group, near):
    """
    Number of features, counted with care, that were seen at a velocity.

    Witnesses are made with narrow limits: a feature that wanders, or that
    is seen on several scales at slightly different places, falls into
    several.  Here whatever may be one feature counts once: the witness with
    most sightings takes all whose tracks run within three errors of its
    own, and those that a random walk of one error an interval, about the
    mean velocity of all, may have taken there; and so on.

    Parameters
    ----------
    sightings : `~astro_scc.stacking.Sightings`
    group : array_like of int, shape (n_sightings,)
        The witness of each.
    near : array_like of bool, shape (n_sightings,)
        Sightings of the velocity in question.

    Returns
    -------
    int
        Never more than there are features; fewer, if some are close to one
        another.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import (
    ...     Displacements, Sightings, consecutive_pairs, count_features)
    >>> one, x = np.ones(3), np.array([0.0, 1.0, 30.0])
    >>> d = Displacements(
    ...     d1=5 * one, d2=0 * one, s1=one, s2=one, weight=one,
    ...     reference=np.zeros(3, int), target=np.ones(3, int), ssp=np.arange(3),
    ...     target_ssp=np.arange(3), n_ssps=np.array([3, 3]),
    ...     position=np.stack([x, 0 * x], axis=1),
    ...     motion=np.stack([5 * one, 0 * one], axis=1))
    >>> seen = Sightings.of(d, consecutive_pairs([0, 1]), [0, 1], (9, 9))
    >>> count_features(seen, np.arange(3), np.ones(3, bool))
    2
    """
    near = np.asarray(near)
    if not near.any():
        return 0
    s = sightings.select(near)
    _, group = np.unique(np.asarray(group)[near], return_inverse=True)
    number = np.bincount(group)

    def mean(values):
        return np.bincount(group, values) / number

    time, interval = mean(s.time), mean(s.interval)
    place = np.stack([mean(column) for column in s.middle.T], axis=1)
    velocity = np.stack([mean(column) for column in s.velocity.T], axis=1)
    sigma, common = np.median(s.sigma), s.velocity.mean(axis=0)
    free = np.ones(len(number), dtype=bool)
    features = 0
    for i in np.argsort(-number, kind="stable"):
        if not free[i]:
            continue
        features += 1
        delay = 0.5 * (time - time[i])[:, None]
        mean_interval = np.sqrt(interval * interval[i])
        here = place[i] + delay * velocity[i]
        there = place - delay * velocity
        apart = np.hypot(*(here - there).T)
        faster = np.hypot(*(velocity - velocity[i]).T)
        gap = np.abs(time - time[i]) / mean_interval
        same = (apart <= sigma * (PLACE + GROWTH * gap)) & (
            faster <= VELOCITY * sigma / mean_interval
        )
        strayed = np.hypot(*(place - place[i] - 2 * delay * common).T)
        same |= strayed <= WANDER * sigma * np.sqrt(0.5 + gap)
        same[i] = True
        free &= ~same
    return features
