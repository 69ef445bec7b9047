# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speeds of features in bins of distance, and speeds by scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple
from itertools import combinations
from typing import Any

import astropy.units as u
import numpy as np
import scipy
from astropy.table import QTable

from astro_scc.measurement import SCCResult
from astro_scc.spectrum.errors import ONE_SIGMA
from astro_scc.streams.members import moving_features
from astro_scc.streams.parts import fit_part
from astro_scc.streams.spread import mean_speed
from astro_scc.units import PM_UNIT

#: Features of a bin: with fewer a dispersion has an error of half its size.
LEAST = 5
#: Most bins.
MOST_BINS = 8
#: Errors of differences of scales are too small by this factor in simulated jets.
DIFFERENCES = 1.5
#: Columns of the bins: numbers, distances and speeds.
BINS = ("stream", "n_features", "r_min", "r_max", "r_mid", "pm_parallel",
        "pm_parallel_err", "dispersion", "dispersion_err")  # fmt: skip
#: Columns of a comparison of speeds, of which the first two are distances.
COMPARED = ("r_min", "r_max", "stream", "first", "first_speed", "first_speed_err",
            "first_share", "second", "second_speed", "second_speed_err", "second_share",
            "difference", "difference_err", "p_value")  # fmt: skip


def feature_profile(result: SCCResult) -> QTable:
    """
    Return the mean speeds of moving features in bins of distance.

    The features of each moving stream are sorted by their distance and divided
    into bins of equal numbers, at least five in each.  Nothing is measured again.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`

    Returns
    -------
    `~astropy.table.QTable`
        One row per stream and bin: ``stream``, ``n_features``, ``r_min``,
        ``r_max`` and ``r_mid``, the smallest, the largest and the mean distance,
        ``pm_parallel`` with ``pm_parallel_err``, and ``dispersion`` with
        ``dispersion_err``.  Empty if no stream has five features.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import feature_profile
    >>> from astro_scc.simulation import simulate_jet
    >>> scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    >>> result = scc(simulate_jet(n_features=12, rng=1).cube, n_trials=199, rng=1)
    >>> bool(feature_profile(result)["n_features"].min() >= 5)
    True
    """
    features, frame = result.tracked_features, result.frame
    distance = distances_along(result.flow, features.places)
    rows = []
    for number, stream in enumerate(result.search.streams, 1):
        members = np.isin(np.arange(len(features.tracks)), stream.members)
        moving = moving_features(features, frame, stream.angle, members)
        place = distance[moving.number]
        n_bins = min(len(place) // LEAST, MOST_BINS)
        if stream.kind != "moving" or n_bins == 0:
            continue
        for k in np.array_split(np.argsort(place), n_bins):
            part, r = moving[k], place[k]
            mean = mean_speed(np.abs(part.along), part.along_err, part.weight)
            rows.append((number, len(k), r.min(), r.max(), r.mean(), *astuple(mean)))
    units = dict.fromkeys(BINS[2:5], u.mas) | dict.fromkeys(BINS[5:], PM_UNIT)
    return QTable(rows=rows, names=BINS, dtype=[int] * 2 + [float] * 7, units=units)


def distances_along(flow, place):
    """
    Return the distances of places along a flow, as its bins have them, in mas.

    Parameters
    ----------
    flow : ``DecomposedFlow``
        Along one direction.
    place : `~numpy.ndarray`, shape (n, 2)
        East and north from the reference pixel.

    Returns
    -------
    `~numpy.ndarray`, shape (n,)
    """
    grid, frame = flow.grids[0], flow.frame
    if np.isfinite(grid.angle):
        return np.abs(place @ grid.axes[0])
    if hasattr(frame, "coordinates"):
        return frame.coordinates(*(place.T * u.mas))[0].to_value(u.mas)
    origin = getattr(frame, "origin", [0, 0] * u.mas).to_value(u.mas)
    return np.hypot(*(place - origin).T)


# -- speeds by scale ---------------------------------------------------------------


def compare_scales(
    measured: SCCResult | Any,
    scale_groups: Mapping[str, Sequence[float]] | None = None,
) -> QTable | None:
    """
    Compare the speeds of groups of scales.

    The streams of the whole flow, or of the bin, are fitted to each group, and each is
    compared by itself: one stream would be the slow one in some groups and the fast one
    in others.  Layers of two speeds differ in the shares of both.  The variance of the
    images is normalised along the flow only, as what differs across it belongs to the
    scales.  What the same clusters and epochs add to both groups cancels in a
    difference, and so does not count in its error; in simulated jets that error is too
    small by a factor of 1.5, by which it is multiplied.

    Parameters
    ----------
    measured : `~astro_scc.measurement.SCCResult` or `Profile`
        A profile has groups of its own; it is compared in each bin.
    scale_groups : dict of sequence of float, optional
        Numbers of the scales of each group, by its name; by default the finer and the
        coarser half of the scales of the result.

    Returns
    -------
    `~astropy.table.QTable` or None
        A row for each pair of groups, bin and stream: ``r_min`` and ``r_max`` (0 and
        infinity for the whole); ``stream``, of two 1 is the slower; ``first`` and
        ``second``, their names; the speed of each with its error, and its share of what
        moves; ``difference`` with its error, and ``p_value``.  What is unknown is NaN.
        None with one scale.

    Raises
    ------
    ValueError
        If there are fewer than two groups, or they share scales.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import compare_scales
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> scc = StackedCrossCorrelation(scales=[1, 2, 3], position_angle=270 * u.deg)
    >>> result = scc(simulate_two_fluid(n_epochs=8, rng=1).cube, n_trials=99, rng=1)
    >>> groups = {"fine": [1], "coarse": [2, 3]}
    >>> compared = compare_scales(result, groups)
    >>> print(compared["first"][0], compared["second"][0])
    fine coarse
    """
    rows = []
    if hasattr(measured, "results"):
        for k, limits in enumerate(measured.bins.to_value(u.mas)):
            fits, both = {}, measured.pairs[k]
            for name, results in measured.results.items():
                fit, one = measured.fits[name][k], results[k]
                if both and one is not None:
                    fit = fit_part(
                        one.flow, root=False, start=both, diagram=one.search.diagram,
                        intervals=one.search.intervals,
                    )  # fmt: skip
                fits[name] = fit
            compared = _compared(fits, measured.flow.beam, both)
            rows += [(*limits, *row) for row in compared]
    else:
        flow, fit = measured.flow, measured.search.fit
        if scale_groups is None and len(flow.planes[0].scales) < 2:
            return None
        groups = scale_groups or halves(flow.planes[0].scales)
        sign, used = 1.0 if fit is None else np.sign(fit.mean[0]), measured.search
        settings = {"root": False, "intervals": used.intervals, "start": used.pair}
        fits = {
            name: fit_part(part, sign=sign, **settings)
            for name, part in flows_by_scale(flow, groups).items()
        }
        rows = [(0.0, np.inf, *row) for row in _compared(fits, flow.beam, used.pair)]
    speeds = [name for name in COMPARED if "speed" in name or "difference" in name]
    units = dict.fromkeys(COMPARED[:2], u.mas) | dict.fromkeys(speeds, PM_UNIT)
    kinds = dict.fromkeys(COMPARED, float) | {"stream": int}
    kinds = [*(kinds | {"first": str, "second": str}).values()]
    return QTable(rows=rows or None, names=COMPARED, units=units, dtype=kinds)


def flows_by_scale(flow, groups):
    """
    Return the flows of groups of scales, normalised along the flow, by their names.

    Fewer than two groups, and groups that share a scale, are refused.
    """
    if len(groups) < 2:
        raise ValueError(f"a comparison needs two groups or more, got {len(groups)}")
    for (a, first), (b, second) in combinations(groups.items(), 2):
        if both := set(first) & set(second):
            raise ValueError(
                f"groups {a!r} and {b!r} share scale {min(both):g}: leave it out of one"
            )
    every = sorted(set().union(*groups.values()))
    whole = flow.along(scales=tuple(every), normalise="along")
    return {name: whole.part(scales=scales) for name, scales in groups.items()}


def halves(scales):
    """Return the finer and the coarser half of scales, or all, by their numbers."""
    parts = [part for part in np.array_split(scales, 2) if len(part)]
    return {", ".join(f"{s:g}" for s in part): part.tolist() for part in parts}


def _compared(fits, beam, both):
    """Return the rows of a comparison of groups of scales."""
    rows = []
    for (one, first), (other, second) in combinations(fits.items(), 2):
        for k in range(len(both or [None])):
            speeds, errors, off, error = difference(first, second, k, both)
            p = 2 * scipy.special.ndtr(-abs(off / error)) if error > 0 else np.nan
            groups = [
                (name, beam * v, beam * e, part.fit.share[k] if v > 0 else np.nan)
                for name, part, v, e in zip(
                    (one, other), (first, second), speeds, errors, strict=True
                )
            ]
            rows.append((k + 1, *groups[0], *groups[1], beam * off, beam * error, p))
    return rows


def difference(first, second, stream=0, both=None):
    """
    Return the difference of the speeds of two groups of scales, and its error.

    What the same clusters and epochs add to both cancels.

    Parameters
    ----------
    first, second : `PartFit`
        Of the same places.
    stream : int, optional
        Number of the stream, from 0.
    both : sequence of (mean, sd), optional
        Of two streams, those of the whole: speeds that are nearer to that of the other,
        by ratio, are not known.

    Returns
    -------
    speeds, errors : (float, float)
        Of both groups.
    difference, error : float
        All in beams/yr; NaN where a speed is not known.
    """
    if not all(_knows(part, stream, both) for part in (first, second)):
        return (np.nan, np.nan), (np.nan, np.nan), np.nan, np.nan
    means = [part.fit.mean[stream] for part in (first, second)]
    found = [part.errors(np.mean(means), stream) for part in (first, second)]
    speeds = abs(means[0]), abs(means[1])
    factors = [
        scipy.special.stdtrit(max(error.number[0] - 1, 1.0), ONE_SIGMA)
        for error in found
    ]
    variance = ((found[1].epochs[0] - found[0].epochs[0]) ** 2).sum()
    for half in (0, 1):
        one, other = (found[k].clusters[0][half] / factors[k] for k in (0, 1))
        apart = other - one
        used = apart[apart != 0]
        m = len(used)
        square = ((used - used.mean()) ** 2).sum() if m else 0.0
        variance += max(factors) ** 2 * square * m / max(m - 1, 1) / 2
    errors = found[0].mean[0], found[1].mean[0]
    return speeds, errors, speeds[1] - speeds[0], DIFFERENCES * np.sqrt(variance)


def _knows(part, stream, both):
    """Return whether a group of scales has a stream, and that of the whole."""
    if part is None or not part.knows(stream):
        return False
    speed, slow_and_fast = abs(part.fit.mean[stream]), [abs(v) for v, _ in both or ()]
    return not both or (speed > np.sqrt(np.prod(slow_and_fast))) == bool(stream)
