# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Trust: whether a track is one feature."""

import numpy as np

from astro_scc.features.detections import Detections
from astro_scc.features.motion import LEAST_EPOCHS, SIGNIFICANT, Motion

#: Logistic regression of what the survey's positions confirm, on the properties in
#: `properties`: constant, and coefficients (``benchmarks/features.py trust``).
CONSTANT = -5.88
COEFFICIENTS = np.array([1.41, -0.60, 0.88, 0.82, 2.32, 1.44, -0.62, -7.23])
#: Which of them is that of the angle between motion and radius.
COSINE = 3
#: A feature is secure if it is false with at most this probability, has the same
#: speed in such a share of the disturbed assignments, and moves so: of static jets at
#: most one in fifteen then has one (``benchmarks/features.py``).
MOST_FALSE, SAME_SPEED = 0.3, 0.5
#: Least motion in beams and in standard errors, and fewest epochs: far, or clearly.
MOTIONS = (1.0, SIGNIFICANT, LEAST_EPOCHS), (0.5, 5.0, 5)
#: Beyond so many beams, other detections do not matter.
FAR = 2.0


def properties(detections: Detections, track: np.ndarray, motion: Motion) -> np.ndarray:
    """
    Return the properties of a track from which its probability follows.

    Parameters
    ----------
    detections : ``Detections``
    track : `~numpy.ndarray` of int
        The detections of the track.
    motion : ``Motion``

    Returns
    -------
    `~numpy.ndarray`, shape (8,)
        Logarithms of the number of its epochs, of its motion and of its distance
        from the core in beams; cosine of the angle between motion and radius;
        share of the epochs from first to last in which it is seen; distance of the
        nearest other detection in beams; scatter of the logarithm of its flux
        from epoch to epoch; scatter of its positions in beams.
    """
    d = detections
    epoch, place = d.epoch[track], d.in_beams
    distance = np.hypot(*motion.place)
    length = distance * motion.speed
    cosine = motion.velocity @ motion.place / length if length > 0 else 0.0
    nearest = []
    for k in track.tolist():
        same = np.arange(*np.searchsorted(d.epoch, (d.epoch[k], d.epoch[k] + 1)))
        away = np.hypot(*(place[same[same != k]] - place[k]).T)
        nearest.append(away.min(initial=FAR))
    return np.array(
        [
            np.log(len(track)),
            np.log(max(np.hypot(*d.to_beams(motion.moved)), 0.05)),
            np.log(distance / d.fwhm + 0.3),
            cosine,
            len(track) / (epoch[-1] - epoch[0] + 1),
            np.median(nearest),
            np.diff(np.log(d.flux[track])).std(),
            np.sqrt((motion.residual**2).mean()) / d.fwhm,
        ]
    )


def p_false_of(known: np.ndarray, *, outward: bool = False) -> np.ndarray:
    """
    Return the probability of each track that it is no feature, or parts of several.

    Parameters
    ----------
    known : array_like, shape (n, 8)
        Their `properties`.
    outward : bool, optional
        Whether they count as moving outward, for want of a core.

    Returns
    -------
    `~numpy.ndarray`, shape (n,)
    """
    known = np.array(known).reshape(-1, len(COEFFICIENTS))
    if outward:
        known[:, COSINE] = 1.0
    return 1 / (1 + np.exp(CONSTANT + known @ COEFFICIENTS))


def are_secure(p_false, same_speed, moved, errors, n_epochs):
    """
    Return which tracks are one feature each, with a reliable speed.

    They have a ``p_false`` of at most ``MOST_FALSE``, the same speed in the share
    ``SAME_SPEED`` of the assignments, and `moves_enough`.

    Parameters
    ----------
    p_false, same_speed : `~numpy.ndarray`, shape (n,)
    moved, errors : `~numpy.ndarray`, shape (n,)
        Motion from the first to the last date, in beams along it, and speed in
        standard errors.
    n_epochs : `~numpy.ndarray` of int, shape (n,)

    Returns
    -------
    `~numpy.ndarray` of bool, shape (n,)
    """
    stable = (same_speed >= SAME_SPEED) & (p_false <= MOST_FALSE)
    return stable & moves_enough(moved, errors, n_epochs)


def moves_enough(moved, errors, n_epochs):
    """Return whether motions in beams and in standard errors are one of ``MOTIONS``."""
    enough = [
        (moved >= beams) & (errors >= sigma) & (n_epochs >= epochs)
        for beams, sigma, epochs in MOTIONS
    ]
    return np.logical_or.reduce(enough)


def motions_in_words():
    """Return ``MOTIONS`` in words."""
    return ", or ".join(
        f"{beams:g} beam{'s' * (beams != 1)} and {sigma:g} standard errors in "
        f"{epochs} epochs"
        for beams, sigma, epochs in MOTIONS
    )
