# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The search of matches for streams, and their velocities."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from astro_scc import kinematics
from astro_scc.measurement import axes
from astro_scc.measurement.followed import FollowedFeatures
from astro_scc.stacking.velocities import VelocitySamples
from astro_scc.streams import find_streams
from astro_scc.streams.dispersion import StreamVelocity, velocity_of
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


def search_matches(matched, settings, plan, *, n_trials, rng):
    """
    Search the matches of epochs for streams.

    Parameters
    ----------
    matched : `~astro_scc.matching.MatchedEpochs`
    settings : `~astro_scc.StackedCrossCorrelation`
    plan : `~astro_scc.matching.SearchPlan`
    n_trials : int
    rng : `~numpy.random.Generator`

    Returns
    -------
    ``Found``
    """
    samples, frame = axes.matched_displacements(matched, settings)
    of = matched, settings, plan, samples, frame
    search, velocities = prepared_search(*of, n_trials=n_trials, rng=rng)()
    return Found(search, velocities, samples, frame)


def prepared_search(
    matched, settings, plan, samples, frame, *, n_trials, rng, intervals=None,
    epochs=None,
):  # fmt: skip
    """
    Return a search that can be sent to another process, as it holds no images.

    ``intervals`` are the shortest and the longest one in years, instead of those of
    the plan, and ``epochs`` a slice, the consecutive epochs to which it is limited.
    """
    cube, max_speed = matched.cube, plan.max_speed
    intervals = plan.intervals if intervals is None else intervals
    if epochs is not None:
        samples = samples.of_epochs(epochs)
    first = 0 if epochs is None else epochs.start or 0
    project = axes.AxisProjection(samples, cube, frame, first)
    known = not isinstance(frame, kinematics.SkyFrame)
    n_axes = 1 if known else N_AXES
    misaligned = axes.alignment_errors(cube, settings.alignment_error)
    return partial(
        _search,
        project,
        np.arange(n_axes) * np.pi / n_axes,
        plan.radius,
        misaligned[epochs or slice(None)],
        alpha=settings.alpha,
        n_trials=n_trials,
        rng=rng,
        outward=settings.outward and known,
        fastest=np.inf if max_speed is None else max_speed / project.beam(0.0)[0],
        intervals=intervals,
        followed=FollowedFeatures(matched, project, plan.radius, epochs, intervals),
    )


def _search(project, angles, radius, misaligned, **how):
    """Return the search for streams, and their velocities."""
    search = find_streams(project, angles, radius, **how)
    return search, tuple(
        velocity_of(stream, project.beam(stream.angle), misaligned)
        for stream in search.streams
    )
