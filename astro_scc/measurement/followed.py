# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Secure features as those of streams, along an axis and in beams."""

from dataclasses import replace

import numpy as np

from astro_scc.features.motion import SIGNIFICANT, fit_motion
from astro_scc.features.trust import LEAST_EPOCHS
from astro_scc.kinematics import ExpansionFrame
from astro_scc.measurement.axes import frame_positions, turned
from astro_scc.stacking.features import Feature
from astro_scc.stacking.search_settings import DEFAULT

#: SSPs as near to a feature as this, in beams, are of its emission.
NEAR = 0.5


class FollowedFeatures:
    """
    The secure features that move, along axes of a frame.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
        None are returned of a part of its scales: images show all of them.
    project : `~astro_scc.measurement.axes.AxisProjection`
    epochs : slice, optional
        The range of epochs to which the projection is limited; the features are those
        of all epochs, and their motion is that of their positions within the range.
    """

    def __init__(self, matched, project, epochs=None):
        self.project, self.found = project, []
        first, last, _ = (epochs or slice(None)).indices(len(matched.cube))
        inside = (matched.ssps.epoch >= first) & (matched.ssps.epoch < last)
        samples, chosen = project.displacements, np.flatnonzero(matched.select[inside])
        whole = set(matched.ssps.scale) == set(matched.ssps.scale[matched.select])
        if not whole or isinstance(project.frame, ExpansionFrame):
            return
        features = matched.features
        self.detections = d = features.detections
        order = chosen[np.argsort(samples.epoch[chosen], kind="stable")]
        starts = np.searchsorted(samples.epoch[order], np.arange(last - first + 1))
        walk = random_walk(features)
        for k, (track, motion) in enumerate(
            zip(features.tracks, features.motions, strict=True)
        ):
            own, moving = track.detection, motion
            own = own[(d.epoch[own] >= first) & (d.epoch[own] < last)]
            if len(own) < LEAST_EPOCHS:
                continue
            at, nearest = [], []
            for number in own.tolist():
                here = order[slice(*starts[d.epoch[number] - first + np.arange(2)])]
                away = np.hypot(*(samples.position[here] - d.place[number]).T)
                at.append(here[away <= NEAR * d.fwhm])
                nearest.append(here[away.argmin()] if len(at[-1]) else -1)
            nearest = np.array(nearest)
            if (nearest >= 0).sum() >= max(2, len(own) / 2):
                moves = motion.speed >= SIGNIFICANT * motion.speed_err
                if len(own) < len(track.detection):
                    parts = (v[own] for v in (d.time, d.place, d.place_error))
                    moving = fit_motion(*parts, d.fwhm)
                error = np.hypot(moving.velocity_err, np.sqrt(walk / moving.span))
                one = moving, error, own, nearest, np.concatenate(at)
                self.found.append((bool(features.secure[k] and moves), one))

    def __call__(self, angle, every=False):
        """
        Return the features along an axis.

        Parameters
        ----------
        angle : float
            In radians from the first axis of the frame.
        every : bool, optional
            Return also those that are not secure or do not move.  As the random walk
            of features cannot be told from motion by one of them, it is then part of
            the errors.

        Returns
        -------
        features : list of ``Feature``
        taken : `~numpy.ndarray` of bool, shape (n_ssps,)
            SSPs of their emission, on all scales.
        """
        turn, beam, frame = turned(angle), self.project.beam(angle), self.project.frame
        found, taken = [], np.zeros(len(self.project.displacements.epoch), dtype=bool)
        for moves, (motion, with_walk, own, nearest, ssps) in self.found:
            if not (moves or every):
                continue
            d = self.detections
            place = frame_positions(frame, *d.place[own].T) @ turn.T / beam
            axes = turn @ np.asarray(frame.matrix(*motion.place))
            seen = nearest >= 0
            line = Feature.through(nearest[seen], d.time[own][seen], place[seen])
            speed, across = axes @ motion.velocity / beam
            error = with_walk if every else motion.velocity_err
            error, across_error = np.hypot(*(axes * error).T) / beam
            found.append(
                replace(
                    line,
                    speed=float(speed),
                    error=float(error) / DEFAULT.error_inflation,
                    across=float(across),
                    across_error=float(across_error),
                    motion=float(abs(speed) * motion.span),
                    followed=True,
                )
            )
            taken[ssps] = True
        return found, taken


def random_walk(features):
    """
    Return the variance of the speeds of features from their random walk, times years.

    The variance of a step about the motion is that of the walk plus twice that of a
    position, and neighbouring steps have minus the latter in common.  The slope of a
    straight line through a walk of variance q a year over T years has the variance
    1.2 q / T.

    Parameters
    ----------
    features : `~astro_scc.features.Features`

    Returns
    -------
    float
        In mas^2/yr.
    """
    d, walk, years = features.detections, 0.0, 0.0
    for track, motion in zip(features.tracks, features.motions, strict=True):
        time, place = d.time[track.detection], d.place[track.detection]
        n = len(time) - 1
        if n < LEAST_EPOCHS - 1:
            continue
        step = np.diff(place, axis=0) - np.diff(time)[:, None] * motion.velocity
        own = (step**2).sum() + 2 * (step[1:] * step[:-1]).sum()
        # The straight line takes up one of the steps.
        walk += own / 2 * n / (n - 1)
        years += time[-1] - time[0]
    return 1.2 * max(walk, 0.0) / years if years else 0.0
