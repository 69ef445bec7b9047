# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Secure features as those of streams, along an axis and in beams."""

from dataclasses import replace

import numpy as np

from astro_scc.features.diffusion import measure_diffusion
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
    The secure features that move, along axes of a frame, or all of those that diffuse.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
        None are returned of a part of its scales: images show all of them.
    project : `~astro_scc.measurement.axes.AxisProjection`
    epochs : slice, optional
        The range of epochs to which the projection is limited; the features are those
        of all epochs, and their motion is that of their positions within the range.

    Attributes
    ----------
    diffuse : bool
        Whether the features diffuse: a random walk cannot be distinguished from motion
        by one of them, so it is part of the errors, and all of them count.
    """

    def __init__(self, matched, project, epochs=None):
        self.project, self.found, self.diffuse = project, [], False
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
        diffusion = measure_diffusion(features)
        self.diffuse = diffusion.is_walk
        walk = diffusion.variance if self.diffuse else 0.0
        for track, motion, secure in zip(
            features.tracks, features.motions, features.secure, strict=True
        ):
            moves = secure and motion.speed >= SIGNIFICANT * motion.speed_err
            own, moving = track.detection, motion
            own = own[(d.epoch[own] >= first) & (d.epoch[own] < last)]
            if len(own) < LEAST_EPOCHS or not (moves or self.diffuse):
                continue
            at, nearest = [], []
            for number in own.tolist():
                here = order[slice(*starts[d.epoch[number] - first + np.arange(2)])]
                away = np.hypot(*(samples.position[here] - d.place[number]).T)
                at.append(here[away <= NEAR * d.fwhm])
                nearest.append(here[away.argmin()] if len(at[-1]) else -1)
            nearest = np.array(nearest)
            if (nearest >= 0).sum() >= max(2, len(own) / 2):
                if len(own) < len(track.detection):
                    parts = (v[own] for v in (d.time, d.place, d.place_error))
                    moving = fit_motion(*parts, d.fwhm)
                error = np.hypot(moving.velocity_err, np.sqrt(walk / moving.span))
                self.found.append((moving, error, own, nearest, np.concatenate(at)))

    def __call__(self, angle):
        """
        Return the features along an axis.

        Parameters
        ----------
        angle : float
            In radians from the first axis of the frame.

        Returns
        -------
        features : list of ``Feature``
        taken : `~numpy.ndarray` of bool, shape (n_ssps,)
            SSPs of their emission, on all scales.
        """
        turn, beam, frame = turned(angle), self.project.beam(angle), self.project.frame
        found, taken = [], np.zeros(len(self.project.displacements.epoch), dtype=bool)
        for motion, error, own, nearest, ssps in self.found:
            d = self.detections
            place = frame_positions(frame, *d.place[own].T) @ turn.T / beam
            axes = turn @ np.asarray(frame.matrix(*motion.place))
            seen = nearest >= 0
            line = Feature.through(nearest[seen], d.time[own][seen], place[seen])
            speed, across = axes @ motion.velocity / beam
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
