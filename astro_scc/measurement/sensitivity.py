# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The search of matches, and how its main speed depends on parts of the data."""

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import astropy.units as u
import numpy as np
from scipy.special import ndtr

from astro_scc import kinematics
from astro_scc.columns import build_table, cell, round_to_errors
from astro_scc.measurement import axes
from astro_scc.measurement.followed import FollowedFeatures
from astro_scc.measurement.matched import ssp_distances
from astro_scc.stacking.velocities import VelocitySamples
from astro_scc.streams import find_streams
from astro_scc.streams.errors import StreamVelocity, velocity_of
from astro_scc.streams.search import Search
from astro_scc.units import PM_UNIT, in_speed_unit, offset_unit

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
    intervals = plan.intervals if intervals is None else intervals
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
        intervals=intervals,
        followed=FollowedFeatures(matched, project, plan.radius, epochs, intervals),
    )
    misaligned = axes.alignment_errors(cube, settings.alignment_error)
    velocities = tuple(
        velocity_of(stream, project.beam(stream.angle), misaligned)
        for stream in search.streams
    )
    return Found(search, velocities, samples, frame)


#: Permutations of a search in a part of the data, which only ranks speeds.
TRIALS = 99
#: Fewest epochs of half of the dates.
FEWEST_EPOCHS = 4
#: Speeds of two parts differ if their difference is larger than so many errors.
DIFFERENT = 2.0


def sensitivity_rows(found, matched, settings, plan, rng):
    """
    Search parts of the data again, each from the matches on.

    Parameters
    ----------
    found : ``Found``
        The search in all data.
    matched : `~astro_scc.measurement.MatchedEpochs`
    settings : `~astro_scc.StackedCrossCorrelation`
    plan : `~astro_scc.measurement.SearchPlan`
    rng : `~numpy.random.Generator`

    Returns
    -------
    rows : list of dict
        Those of `SCCResult.sensitivity`, as plain numbers; empty if nothing moves.
    """
    streams = found.search.streams
    if not streams or streams[0].kind != "moving":
        return []
    stream, velocity = streams[0], found.velocities[0]
    axis = _direction(velocity)
    main = _measured(stream, velocity, axis)
    speeds = np.array([axis @ own.value for _, own in _moving(found)])
    rows = [_row("as measured", main)]
    for pair in _pairs_of_parts(found, matched, stream):
        own = []
        for name, part, how in pair:
            again = search_matches(
                part, settings, plan, n_trials=TRIALS, rng=rng, **how
            )
            some = [_measured(*one, axis) for one in _moving(again)]
            # What is nearer to another stream is not meant.
            some = [m for m in some if np.abs(speeds - m[0]).argmin() == 0]
            nearest = min(some, key=lambda m: abs(m[0] - main[0]), default=None)
            own.append(_row(name, nearest, *main[:2]))
        # Both parts may differ from the whole, if they have other features.
        sigma = largest_difference([*own, rows[0]])
        for row in own:
            row["change_sigma"] = sigma
            row["p_value"] = 2 * ndtr(-sigma)
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


def sensitivity_table(rows, unit=PM_UNIT):
    """
    Return the speed of the first component with other choices of the data.

    Parameters
    ----------
    rows : list of dict
        See `sensitivity_rows`.
    unit : `~astropy.units.Unit`, optional
        Of speeds.

    Returns
    -------
    `~astropy.table.QTable`
        See `SCCResult.sensitivity`.
    """
    table = in_speed_unit(build_table("sensitivity", rows), unit)
    if not rows:
        table.meta["note"] = "nothing moves significantly"
    return round_to_errors(table)


def sensitivity_line(table):
    """
    Return on what the main speed depends, in words.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        See `SCCResult.sensitivity`.

    Returns
    -------
    str
        Empty if it depends on nothing that was tried, and most parts show it.
    """
    lines, found = [], np.isfinite(table["pm"])
    parts = [
        f"{cell(row, 'pm', '+-')} {row['pm'].unit} ({row['choice']})"
        for row in table[table["significant"] & found]
    ]
    if parts:
        lines.append("differs with the data: " + ", ".join(parts))
    # The first row is the whole.
    missing, n = np.sum(~found), len(table[1:])
    if 2 * missing > n:
        lines.append(f"not found in {missing} of {n} parts of the data")
    return "; ".join(lines)


def _moving(found):
    """Return the streams that move, each with its velocity."""
    pairs = zip(found.search.streams, found.velocities, strict=True)
    return [pair for pair in pairs if pair[0].kind == "moving"]


def _direction(velocity):
    """Return the unit vector of a velocity that is not zero."""
    return velocity.value / np.hypot(*velocity.value)


def _measured(stream, velocity, axis):
    """Return the speed along an axis, its error, and the number of features."""
    error = np.sqrt(axis @ velocity.covariance @ axis)
    return float(axis @ velocity.value), float(error), len(stream.features)


def _row(choice, measured, main=None, main_err=0.0):
    """Return a row of the table."""
    speed, error, number = measured or (np.nan, np.nan, 0)
    change = 0.0 if main is None else speed - main
    return {
        "choice": choice,
        "n_features": number,
        "pm": speed,
        "pm_err": error,
        "change": change,
        "change_err": np.sqrt(max(error**2 - main_err**2, (error / 2) ** 2)),
        "change_sigma": 0.0,
        "p_value": 1.0,
        "significant": False,
    }


def _pairs_of_parts(found, matched, stream):
    """Yield two parts of the data with their names and arguments of the search."""
    cube, d = matched.cube, found.samples
    limit = _middle_interval(d, stream)
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
        select = matched.select
        yield (
            (f"inner half, up to {text}", matched.part(select & (r < border)), {}),
            (f"outer half, from {text}", matched.part(select & (r >= border)), {}),
        )
    scales = np.array(matched.scales)
    if len(scales) > 1:
        parts = np.array_split(scales, 2)
        yield tuple(
            (
                f"{name} scales ({', '.join(f'{s:g}' for s in own)})",
                matched.part(matched.select & np.isin(matched.ssps.scale, own)),
                {},
            )
            for name, own in zip(("fine", "coarse"), parts, strict=True)
        )


def _middle_interval(d, stream):
    """Return the median of the intervals between the epochs of features, in years."""
    dates = [d.years[f.epoch] for f in stream.features]
    apart = np.concatenate([np.subtract.outer(t, t).ravel() for t in dates])
    return float(np.median(apart[apart > 0]))
