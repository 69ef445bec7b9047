# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The features of a stream: those that move along the flow, and their speeds."""

import numpy as np

from astro_scc.features.motion import LEAST_EPOCHS, SIGNIFICANT

#: A secure feature that moves, along a direction: speeds, errors, epochs, number, and
#: 1 on the side of the jet, -1 on that of a counter-jet.
MOVING = {
    "names": "along along_err across across_err weight number side".split(),
    "formats": [float] * 5 + [int] * 2,
}


def moving_features(features, frame, angle, use=None, walk=None, *, folded=False):
    """
    Return the secure features that move, with speeds in mas/yr, as a record array.

    If they diffuse, ``walk`` is the variance of their speeds times years, and all that
    are followed count: a random walk cannot be told from motion by one of them.  If
    both sides of a core are ``folded``, the directions of those of the counter-jet are
    turned by 180 degrees.
    """
    chosen = features.secure if walk is None else np.ones(len(features.tracks), bool)
    chosen = np.flatnonzero(chosen if use is None else chosen & use)
    turn, rows = turn_to_flow(angle), []
    for k in chosen:
        motion = features.motions[k]
        n = len(features.tracks[k].detection)
        slow = motion.speed < SIGNIFICANT * motion.speed_err
        if n < LEAST_EPOCHS or (slow and walk is None):
            continue
        local = turn @ np.asarray(frame.matrix(*motion.place))
        if not np.isfinite(local).all():
            continue
        behind = folded and (local @ motion.place)[0] < 0
        side = -1 if behind else 1
        along, across = side * (local @ motion.velocity)
        errors = np.hypot(*(local * motion.velocity_err).T)
        if walk is not None:
            errors = np.hypot(errors, np.sqrt(walk / motion.span))
        elif abs(along) < max(SIGNIFICANT * errors[0], abs(across)):
            continue
        rows.append((along, errors[0], across, errors[1], n, k, side))
    return np.array(rows, dtype=MOVING).view(np.recarray)


def passing_features(features, beam, *, aligned=0.7):
    """
    Return the reliable features that move towards the reference position and past it.

    From a core nothing comes that is a beam or more behind it and moves as what is
    before it does.  Where there are more of those that move away behind it, it has a
    counter-jet.

    Parameters
    ----------
    features : `~astro_scc.features.Features`
    beam : float
        In mas.
    aligned : float, optional
        Least cosine of the angle between a velocity and the mean direction, and between
        it and the way to the reference position.

    Returns
    -------
    list of int
        Those behind the reference position; empty if none are before it.
    """
    secure = np.flatnonzero(features.secure_without_core)
    weight = np.array([len(features.tracks[k]) for k in secure])
    velocity = np.reshape([features.motions[k].velocity for k in secure], (-1, 2))
    ways = velocity / np.hypot(*velocity.T)[:, None]
    mean = weight @ ways
    mean /= max(np.hypot(*mean), 1e-9)
    place = features.places[secure]
    along, at = ways @ mean, place @ mean
    outward = (place * ways).sum(axis=1) / np.hypot(*place.T)
    behind, with_flow = at < -beam, along > aligned
    moving = behind & with_flow & (outward < -aligned)
    away = behind & (along < -aligned)
    if not np.any(with_flow & (at > 0)) or weight @ moving <= weight @ away:
        return []
    return secure[moving].tolist()


def frame_velocities(frame, features):
    """
    Return the velocities of features along the axes of a frame.

    Parameters
    ----------
    frame : frame of `astro_scc.kinematics`
    features : `~astro_scc.features.Features`

    Returns
    -------
    velocity, covariance : `~numpy.ndarray`, shapes (n, 2) and (n, 2, 2)
        In mas/yr and its square; NaN where the frame has no axes.
    """
    motions = features.motions
    place, velocity, error = (
        np.reshape([getattr(motion, name) for motion in motions], (-1, 2))
        for name in ("place", "velocity", "velocity_err")
    )
    axes = np.asarray(frame.matrix(*place.T))
    turned = axes * error[:, None, :]
    return (axes @ velocity[..., None])[..., 0], turned @ turned.swapaxes(-1, -2)


def turn_to_flow(angle):
    """Return the matrix that turns axes of the frame into those along the flow."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def mean_across(moving, mean):
    """Return the mean speed of features across the flow, and its error."""
    share = moving.weight / moving.weight.sum()
    across = share @ moving.across
    variance = share @ (moving.across - across) ** 2 * (share**2).sum()
    error = np.sqrt(variance + (share**2) @ moving.across_err**2)
    n = len(share)
    # A few features may agree by chance: directions scatter by ten degrees or more.
    prior = (0.15 * mean.mean) ** 2 * 2 / (n + 1) / n
    return across, np.sqrt(error**2 + prior)


def divided(moving, speeds):
    """Return the features of each of two streams: the nearer one by ratio."""
    slow = np.abs(moving.along) < np.sqrt(np.prod(speeds))
    return [moving[slow], moving[~slow]]
