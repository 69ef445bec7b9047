# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""How the main speed depends on parts of the data, which are searched again."""

from copy import deepcopy
from dataclasses import replace
from itertools import chain, combinations

import astropy.units as u
import numpy as np
from scipy.special import ndtr

from astro_scc.columns import build_table, cell, round_to_errors, with_errors
from astro_scc.matching.matched import ssp_distances
from astro_scc.measurement.search import prepared_search
from astro_scc.parallel import in_order
from astro_scc.units import PM_UNIT, in_speed_unit, offset_unit

#: Permutations of a search in a part of the data, which only ranks speeds.
TRIALS = 99
#: Fewest epochs of half of the dates.
FEWEST_EPOCHS = 4
#: Speeds of two parts differ if their difference is larger than so many errors.
DIFFERENT = 2.0
#: Speed, error and number of features of a part in which nothing is found.
NOTHING = np.nan, np.nan, 0


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
        See `~astro_scc.measurement.search.prepared_search`.
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
    main = _measured(*moving[0], axis)
    speeds = np.array([axis @ velocity.value for velocity, _ in moving])
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
            some = [_measured(*one, axis) for one in next(again)]
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


def _measured(velocity, n_features, axis):
    """Return the speed along an axis, its error, and the number of features."""
    error = np.sqrt(axis @ velocity.covariance @ axis)
    return float(axis @ velocity.value), float(error), n_features


def _row(choice, measured, main=None):
    """Return a row of the table; the whole, ``main``, does not change."""
    speed, error, number = measured
    change = (0.0, 0.0) if main is None else (speed - main[0], np.hypot(error, main[1]))
    return with_errors(pm=(speed, error), change=change) | {
        "choice": choice,
        "n_features": number,
        "change_sigma": 0.0,
        "p_value": 1.0,
        "significant": False,
    }


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
        parts = np.array_split(matched.scales, 2)
        for name, own in zip(("fine", "coarse"), parts, strict=True):
            part = matched.part(select & np.isin(matched.ssps.scale, own))
            shown = ", ".join(f"{scale:g}" for scale in own)
            halves.append((f"{name} scales ({shown})", part, {}))
        yield halves
