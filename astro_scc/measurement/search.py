# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The search for streams, in all data and again in parts of them, with features."""

from copy import deepcopy
from dataclasses import replace
from functools import partial
from itertools import chain, combinations

import astropy.units as u
import numpy as np
from scipy.spatial import KDTree
from scipy.special import ndtr

from astro_scc.columns import with_errors
from astro_scc.features import motion as motions
from astro_scc.features.diffusion import measure_diffusion
from astro_scc.features.trust import LEAST_EPOCHS
from astro_scc.kinematics import ExpansionFrame, SkyFrame
from astro_scc.matching.matched import ssp_distances
from astro_scc.measurement import axes
from astro_scc.parallel import in_order
from astro_scc.stacking.velocities import VelocitySamples
from astro_scc.streams import find_streams
from astro_scc.streams.chains import Feature
from astro_scc.streams.diagram import DEFAULT
from astro_scc.streams.dispersion import velocity_of
from astro_scc.units import offset_unit

#: Number of directions, over half a turn, that are searched if none is known.
N_AXES = 12
#: SSPs and detections as near to each other as this, in beams, are of one emission.
NEAR = 0.5
#: Scatter of the logarithm of the flux of one feature: a pair of detections counts less
#: by the exponential of the change in this unit.
FADING = 0.7
#: The core is the detection of each epoch that is nearest to the origin, and as near as
#: this, in beams.  It does not move, but what leaves it blends with it.
CORE = 0.5
#: All intervals between dates, in years.
EVERY = 0.0, np.inf
#: Permutations of a search in a part of the data, which only ranks speeds.
TRIALS = 99
#: Fewest epochs of half of the dates.
FEWEST_EPOCHS = 4
#: Speeds of two parts differ if their difference is larger than so many errors.
DIFFERENT = 2.0
#: Speed, error and number of features of a part in which nothing is found.
NOTHING = np.nan, np.nan, 0


def prepared_search(
    matched, settings, plan, samples, frame, *, n_trials, rng, intervals=None,
    epochs=slice(None),
):  # fmt: skip
    """
    Return a search for streams, to be called; it holds no images and can be sent.

    Parameters
    ----------
    matched : `~astro_scc.matching.MatchedEpochs`
    settings : `~astro_scc.StackedCrossCorrelation`
    plan : `~astro_scc.matching.SearchPlan`
    samples : ``VelocitySamples``
        The matches, in mas.
    frame : frame of `astro_scc.kinematics`
    n_trials : int
    rng : `~numpy.random.Generator`
    intervals : (float, float), optional
        The shortest and the longest one in years, instead of those of the plan.
    epochs : slice, optional
        The consecutive epochs to which the search is limited.

    Returns
    -------
    callable
        It returns the ``Search`` and a tuple of ``StreamVelocity``.
    """
    cube, max_speed = matched.cube, plan.max_speed
    intervals = plan.intervals if intervals is None else intervals
    samples = samples.of_epochs(epochs)
    project = axes.AxisProjection(samples, cube, frame, epochs.start or 0)
    known = not isinstance(frame, SkyFrame)
    n_axes = 1 if known else N_AXES
    misaligned = axes.alignment_errors(cube, settings.alignment_error)
    return partial(
        _search,
        project,
        np.arange(n_axes) * np.pi / n_axes,
        plan.radius,
        misaligned[epochs],
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


class FollowedFeatures:
    """
    The secure features that move, along axes of a frame, or all of those that diffuse.

    The pairs of detections of different epochs are samples of the velocities as well.
    Nothing is known of a part of the scales, as images show all of them.

    Parameters
    ----------
    matched : `~astro_scc.matching.MatchedEpochs`
    project : `~astro_scc.measurement.axes.AxisProjection`
    radius : float
        Largest displacement between two detections, in beams.
    epochs : slice, optional
        The range of epochs to which the projection is limited; the features are those
        of all epochs, and their motion is that of their positions within the range.
    intervals : (float, float), optional
        Shortest and longest interval, in years, between positions that give a speed.

    Attributes
    ----------
    diffuse : bool
        Whether the features diffuse: a random walk cannot be distinguished from motion
        by one of them, so it is part of the errors, and all of them count.
    """

    def __init__(self, matched, project, radius, epochs=slice(None), intervals=EVERY):
        self.project, self.diffuse, self.intervals = project, False, intervals
        self.first, last, _ = epochs.indices(len(matched.cube))
        features = matched.features
        self.detections = d = features.detections
        inside = (matched.ssps.epoch >= self.first) & (matched.ssps.epoch < last)
        select = matched.select[inside]
        whole = set(matched.ssps.scale) == set(matched.ssps.scale[matched.select])
        use = np.zeros(len(d), dtype=bool)
        if whole and not isinstance(project.frame, ExpansionFrame):
            use = self._find_ssps(last, select)
        #: Detections of the same emission or of neighbours, the earlier one first.
        moving = np.flatnonzero(use & ~d.core(CORE))
        reach = np.hypot(radius, DEFAULT.across) * d.major
        pairs = KDTree(d.place[moving]).query_pairs(reach, output_type="ndarray")
        # Their detections are in the order of the epochs.
        pairs = moving[np.sort(pairs, axis=1)]
        self._pairs = pairs[d.epoch[pairs[:, 0]] < d.epoch[pairs[:, 1]]].T
        diffusion = measure_diffusion(features)
        self.diffuse = bool(use.any()) and diffusion.is_walk
        self.found = list(self._followed(features, last, use, diffusion))

    def _find_ssps(self, last, select):
        """Find the SSPs of detections; return which are in the selected part."""
        d, samples = self.detections, self.project.displacements
        use, near = np.zeros(len(d), dtype=bool), [np.empty((2, 0), dtype=int)]
        for epoch in range(self.first, last):
            here = np.flatnonzero(d.epoch == epoch)
            ssps = np.flatnonzero(samples.epoch == epoch - self.first)
            if len(here) and len(ssps):
                offset = d.place[here][:, None] - samples.position[ssps]
                away = np.hypot(*np.moveaxis(offset, -1, 0))
                use[here] = select[ssps[away.argmin(axis=1)]]
                detection, ssp = np.nonzero((away <= NEAR * d.fwhm) & select[ssps])
                # The nearest SSP of each detection comes first.
                first = np.lexsort((away[detection, ssp], detection))
                near.append(np.stack([here[detection], ssps[ssp]])[:, first])
        self._near = np.concatenate(near, axis=1)
        return use

    def _followed(self, features, last, use, diffusion):
        """
        Yield the features that are followed.

        Each is its motion, with the error of a random walk, and how each position
        changes it if not as in a straight line; its detections, the nearest SSP of each
        of those that have one, and all SSPs of its emission.
        """
        d, walk = self.detections, diffusion.variance if self.diffuse else 0.0
        for track, motion, secure in zip(
            features.tracks, features.motions, features.secure, strict=True
        ):
            moves = secure and motion.speed >= motions.SIGNIFICANT * motion.speed_err
            epoch = d.epoch[track.detection]
            own = track.detection[(epoch >= self.first) & (epoch < last)]
            if len(own) < LEAST_EPOCHS or not (moves or self.diffuse):
                continue
            # It belongs to the part of the image in which it is half of the time.
            if 2 * use[own].sum() < len(own):
                continue
            moving, response = motion, None
            if len(own) < len(track.detection):
                parts = (v[own] for v in (d.time, d.place, d.place_error))
                moving = motions.fit_motion(*parts, d.fwhm)
            if self.intervals != EVERY:
                where = d.time[own], d.place[own], d.fwhm, self.intervals
                moving, response = motions.motion_in_intervals(moving, *where)
                if not response.any():
                    continue
            error = np.hypot(moving.velocity_err, np.sqrt(walk / moving.span))
            detection, ssps = self._near[:, np.isin(self._near[0], own)]
            nearest = ssps[np.unique(detection, return_index=True)[1]]
            yield moving, error, response, own, nearest, ssps

    def _positions(self, angle):
        """Return the positions of detections along an axis and across it, in beams."""
        place = axes.frame_positions(self.project.frame, *self.detections.place.T)
        return place @ axes.turned(angle).T / self.project.beam(angle)

    def pairs(self, angle, without=()):
        """
        Return pairs of detections of two epochs as velocity samples.

        Parameters
        ----------
        angle : float
            In radians from the first axis of the frame.
        without : sequence of ``Feature``, optional
            Whose emission is left out.

        Returns
        -------
        ``VelocitySamples``
            In beams, along the axis and across it.
        """
        d, (here, there) = self.detections, self._pairs
        if without and len(here):
            lost = np.zeros(len(d), dtype=bool)
            ssps = np.concatenate([f.ssp for f in without])
            lost[self._near[0][np.isin(self._near[1], ssps)]] = True
            lost[np.concatenate([f.detection for f in without])] = True
            keep = ~(lost[here] | lost[there])
            here, there = here[keep], there[keep]
        position = self._positions(angle)
        change = np.abs(np.log(d.flux[here] / d.flux[there]))
        return VelocitySamples(
            *(position[there] - position[here]).T,
            weight=np.exp(-change / FADING),
            reference=d.epoch[here] - self.first,
            target=d.epoch[there] - self.first,
            ssp=here,
            target_ssp=there,
            years=self.project.displacements.years,
        )

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
        project, d, place = self.project, self.detections, self._positions(angle)
        turn, beam = axes.turned(angle), project.beam(angle)
        found, taken = [], np.zeros(len(project.displacements.epoch), dtype=bool)
        for motion, motion_error, response, own, ssp, emission in self.found:
            local = turn @ np.asarray(project.frame.matrix(*motion.place))
            epoch = d.epoch[own] - self.first
            line = Feature.through(ssp, epoch, d.time[own], place[own])
            speed, across = local @ motion.velocity / beam
            error, across_error = np.hypot(*(local * motion_error).T) / beam
            found.append(
                replace(
                    line,
                    speed=float(speed),
                    error=float(error) / DEFAULT.error_inflation,
                    across=float(across),
                    across_error=float(across_error),
                    motion=float(abs(speed) * motion.span),
                    response=line.response if response is None else response,
                    detection=own,
                )
            )
            taken[emission] = True
        return found, taken


# -- parts of the data -------------------------------------------------------------


def sensitivity_rows(
    found, matched, settings, plan, samples, frame, rng, n_workers=1
):  # fmt: skip
    """
    Search parts of the data again, each from the matches on.

    Parameters
    ----------
    found : (``Search``, tuple of ``StreamVelocity``)
        The streams in all data, and their velocities.
    matched, settings, plan, samples, frame
        See ``prepared_search``.
    rng : `~numpy.random.Generator`
    n_workers : int, str or `dask.distributed.Client`, optional

    Returns
    -------
    rows : list of dict
        Those of `SCCResult.sensitivity`, as plain numbers; empty if nothing moves.
    """
    moving, streams = _moving(*found), found[0].streams
    if not moving or streams[0].kind != "moving":
        return []
    axis = _direction(moving[0][0])
    main, *others = _speeds_along(axis, moving)
    speeds = np.array([speed for speed, _, _ in (main, *others)])
    rows = [_row("as measured", main)]
    pairs = list(_pairs_of_parts(samples, matched, streams[0]))

    def searches():
        for _, part, how in chain(*pairs):
            of = part, settings, plan, samples.of_ssps(part.select), frame
            yield prepared_search(*of, n_trials=TRIALS, rng=deepcopy(rng), **how)
            # Each search spawns two generators; the next one gets others.
            rng.spawn(2)

    again = iter(list(in_order(_moving_of, searches(), n_workers)))
    for pair in pairs:
        own = []
        for name, _, _ in pair:
            some = _speeds_along(axis, next(again))
            # What is nearer to another stream is not meant.
            some = [m for m in some if np.abs(speeds - m[0]).argmin() == 0]
            nearest = min(some, key=lambda m: abs(m[0] - main[0]), default=NOTHING)
            own.append(_row(name, nearest, main))
        # Both parts may differ from the whole, if they have other features.
        sigma = largest_difference([*own, rows[0]])
        for row in own:
            p = 2 * ndtr(-sigma) if np.isfinite(row["pm"]) else np.nan
            row |= {"change_sigma": sigma, "p_value": p}
            row["significant"] = bool(sigma > DIFFERENT)
        rows += own
    return rows


def largest_difference(rows):
    """Return the largest known difference of two speeds in errors of both, or NaN."""
    off = [
        abs(a["pm"] - b["pm"]) / np.hypot(a["pm_err"], b["pm_err"])
        for a, b in combinations(rows, 2)
    ]
    return np.fmax.reduce(off)


def with_choices(velocity, rows):
    """
    Return the velocity of a stream whose error holds the differences of choices.

    Parameters
    ----------
    velocity : ``StreamVelocity``
    rows : list of dict
        See `sensitivity_rows`.

    Returns
    -------
    ``StreamVelocity``
    """
    pairs = [row["pm"] for row in rows if row["significant"]]
    if not pairs:
        return velocity
    # The whole is known, and at least one of two parts.
    of_each = np.insert(np.reshape(pairs, (-1, 2)), 0, rows[0]["pm"], axis=1)
    half = np.max(np.nanmax(of_each, axis=1) - np.nanmin(of_each, axis=1)) / 2
    axis = _direction(velocity)
    return replace(velocity, choices=half**2 * np.outer(axis, axis))


def _moving(search, velocities):
    """Return velocities and numbers of features of the streams that move."""
    return [
        (velocity, len(stream.features))
        for stream, velocity in zip(search.streams, velocities, strict=True)
        if stream.kind == "moving"
    ]


def _moving_of(search):
    """Search, and return what moves only: the rest is large to send."""
    return _moving(*search())


def _direction(velocity):
    """Return the unit vector of a velocity that is not zero."""
    return velocity.value / np.hypot(*velocity.value)


def _speeds_along(axis, moving):
    """Return the speeds along an axis, their errors, and the numbers of features."""
    return [
        (float(axis @ v.value), float(np.sqrt(axis @ v.covariance @ axis)), n)
        for v, n in moving
    ]


def _row(choice, measured, main=None):
    """Return a row of the table; the whole, ``main``, does not change."""
    speed, error, number = measured
    change = (0.0, 0.0) if main is None else (speed - main[0], np.hypot(error, main[1]))
    row = {"change_sigma": 0.0, "p_value": 1.0, "significant": False}
    row |= {"choice": choice, "n_features": number}
    return row | with_errors(pm=(speed, error), change=change)


def _pairs_of_parts(samples, matched, stream):
    """Yield two parts of the data with their names and arguments of the search."""
    cube, select = matched.cube, matched.select
    dates = [samples.years[f.epoch] for f in stream.features]
    apart = np.concatenate([np.subtract.outer(t, t).ravel() for t in dates])
    limit = float(np.median(apart[apart > 0]))
    unit = cube.speed_unit.bases[1]
    shown = f"{(limit * u.yr).to_value(unit):.2g} {unit}"
    yield (
        (f"intervals up to {shown}", matched, {"intervals": (0.0, limit)}),
        (f"intervals from {shown}", matched, {"intervals": (limit, np.inf)}),
    )
    middle, dates = len(cube) // 2, cube.times.strftime("%Y-%m-%d")
    if middle >= FEWEST_EPOCHS:
        before, after = slice(middle), slice(middle, None)
        yield (
            (f"epochs before {dates[middle]}", matched, {"epochs": before}),
            (f"epochs from {dates[middle]} on", matched, {"epochs": after}),
        )
    r = ssp_distances(matched)
    place = [r[f.ssp].mean().to_value(u.mas) for f in stream.features if len(f.ssp)]
    if len(place) > 1:
        border = np.median(place) * u.mas
        unit = offset_unit(border.value)
        text = f"{border.to_value(unit):.3g} {unit}"
        yield (
            (f"inner half, up to {text}", matched.part(select & (r < border)), {}),
            (f"outer half, from {text}", matched.part(select & (r >= border)), {}),
        )
    if len(matched.scales) > 1:
        halves = []
        fine, coarse = np.array_split(matched.scales, 2)
        for name, own in (("fine", fine), ("coarse", coarse)):
            part = matched.part(select & np.isin(matched.ssps.scale, own))
            shown = ", ".join(f"{scale:g}" for scale in own)
            halves.append((f"{name} scales ({shown})", part, {}))
        yield halves
