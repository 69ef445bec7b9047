# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The search for streams in the matches of epochs, or of a part of them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from astro_scc import kinematics
from astro_scc.measurement import axes
from astro_scc.measurement.followed import FollowedFeatures
from astro_scc.stacking.velocities import VelocitySamples
from astro_scc.streams import find_streams
from astro_scc.streams.errors import StreamVelocity, velocity_of
from astro_scc.streams.search import Search

#: Number of directions, over half a turn, that are searched if none is known.
N_AXES = 12


@dataclass(frozen=True, eq=False)
class Found:
    """
    The streams of a search, and their velocities.

    Attributes
    ----------
    search : ``Search``
    velocities : tuple of ``StreamVelocity``
    samples : ``VelocitySamples``
        The matches, in mas.
    frame : frame of `astro_scc.kinematics`
    """

    search: Search
    velocities: tuple[StreamVelocity, ...]
    samples: VelocitySamples
    frame: Any


def search_matches(
    matched, settings, plan, *, n_trials, rng, intervals=None, epochs=None
):
    """
    Search the matches of epochs for streams.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
    settings : `~astro_scc.StackedCrossCorrelation`
    plan : `~astro_scc.measurement.SearchPlan`
    n_trials : int
    rng : `~numpy.random.Generator`
    intervals : (float, float), optional
        Shortest and longest interval in years, instead of those of the plan.
    epochs : slice, optional
        Consecutive epochs to which the search is limited.

    Returns
    -------
    ``Found``
    """
    cube, max_speed = matched.cube, plan.max_speed
    samples, frame = axes.matched_displacements(matched, settings)
    if epochs is not None:
        samples = samples.of_epochs(epochs)
    project = axes.AxisProjection(samples, cube, frame)
    known = not isinstance(frame, kinematics.SkyFrame)
    n_axes = 1 if known else N_AXES
    search = find_streams(
        project,
        np.arange(n_axes) * np.pi / n_axes,
        plan.radius,
        alpha=settings.alpha,
        n_trials=n_trials,
        rng=rng,
        outward=settings.outward and known,
        fastest=np.inf if max_speed is None else max_speed / project.beam(0.0)[0],
        intervals=plan.intervals if intervals is None else intervals,
        followed=FollowedFeatures(matched, project, plan.radius, epochs),
    )
    misaligned = axes.alignment_errors(cube, settings.alignment_error)
    velocities = tuple(
        velocity_of(stream, project.beam(stream.angle), misaligned)
        for stream in search.streams
    )
    return Found(search, velocities, samples, frame)
