# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speeds of features in bins, speeds by scale and in parts, and their acceleration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import astropy.units as u
import numpy as np
import scipy
from astropy.table import QTable

from astro_scc.measurement import SCCResult
from astro_scc.quantities import with_error
from astro_scc.spectrum.gaussians import ONE_SIGMA
from astro_scc.streams.decomposed import fit_part, weight_of
from astro_scc.streams.members import mean_speed, moving_features
from astro_scc.units import PM_UNIT, offset_unit

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
            rows.append((number, len(k), r.min(), r.max(), r.mean(), *mean))
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
            both = measured.pairs[k]
            fits = {name: found[k] for name, found in measured.fits.items()}
            for name, found in measured.results.items():
                if both and found[k] is not None:
                    one = found[k].search
                    fits[name] = fit_part(one.flow, start=both, diagram=one.diagram)
            compared = _compared(fits, measured.flow.beam, both)
            rows += [(*limits, *row) for row in compared]
    else:
        flow, fit, both = measured.flow, measured.search.fit, measured.search.pair
        if scale_groups is None and len(flow.planes[0].scales) < 2:
            return None
        groups = scale_groups or halves(flow.planes[0].scales)
        sign = 1.0 if fit is None else np.sign(fit.mean[0])
        fits = {
            name: fit_part(part, sign=sign, start=both)
            for name, part in flows_by_scale(flow, groups).items()
        }
        rows = [(0.0, np.inf, *row) for row in _compared(fits, flow.beam, both)]
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
    errors, numbers, clusters, epochs = zip(*found, strict=True)
    speeds = abs(means[0]), abs(means[1])
    factors = [
        scipy.special.stdtrit(max(number[0] - 1, 1.0), ONE_SIGMA) for number in numbers
    ]
    variance = ((epochs[1][0] - epochs[0][0]) ** 2).sum()
    for half in (0, 1):
        one, other = (clusters[k][0][half] / factors[k] for k in (0, 1))
        apart = other - one
        used = apart[apart != 0]
        m = len(used)
        square = ((used - used.mean()) ** 2).sum() if m else 0.0
        variance += max(factors) ** 2 * square * m / max(m - 1, 1) / 2
    errors = errors[0][0], errors[1][0]
    return speeds, errors, speeds[1] - speeds[0], DIFFERENCES * np.sqrt(variance)


def _knows(part, stream, both):
    """Return whether a group of scales has a stream, and that of the whole."""
    if part is None or not part.knows(stream):
        return False
    speed, slow_and_fast = abs(part.fit.mean[stream]), [abs(v) for v, _ in both or ()]
    return not both or (speed > np.sqrt(np.prod(slow_and_fast))) == bool(stream)


# -- speeds in parts ---------------------------------------------------------------

#: Distance from the core below which speeds are not used, and length of a part, in
#: beams.
CORE, LENGTH = 2.0, 2.0
#: Fewest and most parts.
FEWEST, MOST = 3, 10


def place_of(flow):
    """Return the mean distance of what is seen, in beams, or NaN."""
    weight = weight_of(flow).sum(axis=1)
    if not weight.sum() > 0:
        return np.nan
    return float(weight @ flow.grids[0].distance / weight.sum())


def speeds_in_parts(fits, places, *, stream=0):
    """
    Return the speeds of a stream in several parts, with their covariance.

    What a cluster of ejection adds to the speeds of several parts, it adds to all: the
    clusters move at one speed, the median of the parts, from one beginning.  The same
    holds for what each epoch adds.

    Parameters
    ----------
    fits : sequence of `PartFit` or None
        Of parts of the same flow.
    places : sequence of float
    stream : int, optional
        Number of the stream, from 0.

    Returns
    -------
    place : `~numpy.ndarray`, shape (n,)
        Mean distance of each part, in beams.
    speed : `~numpy.ndarray`, shape (n,)
        In beams a year; NaN where it is not known.
    covariance : `~numpy.ndarray`, shape (n, n)
    """
    n = len(fits)
    speed, covariance = np.full(n, np.nan), np.full((n, n), np.nan)
    known = [k for k, fit in enumerate(fits) if fit is not None and fit.knows(stream)]
    if not known:
        return np.array(places), speed, covariance
    means = np.array([fits[k].fit.mean[stream] for k in known])
    errors = [fits[k].errors(np.median(means)) for k in known]
    epochs = np.array([by_epoch[stream] for *_, by_epoch in errors])
    total = epochs @ epochs.T
    for half in (0, 1):
        clusters = np.array([each[stream][half] for _, _, each, _ in errors])
        m = np.count_nonzero(clusters.any(axis=0))
        total += clusters @ clusters.T * m / max(m - 1, 1) / 2
    speed[known] = np.abs(means)
    covariance[np.ix_(known, known)] = total
    return np.array(places), speed, covariance


def slope_of(place, speed, covariance):
    """
    Return the slope of speeds with distance by weighted least squares.

    Weights are the inverse variances; the error follows from the whole covariance,
    which is not inverted, as it has few clusters.  Speeds that scatter by more than
    their errors about the line, as where two streams are seen as one, enlarge it.

    Parameters
    ----------
    place, speed, covariance : `~numpy.ndarray`
        See `speeds_in_parts`.

    Returns
    -------
    centre, speed, slope, error : float
        Mean distance and the speed there; NaN with fewer than three speeds.
    number : int
        Speeds that are known.
    """
    use = np.isfinite(speed) & np.isfinite(np.diag(covariance))
    number = int(use.sum())
    if number < 3:
        return np.nan, np.nan, np.nan, np.nan, number
    square = covariance[np.ix_(use, use)]
    x, y, weight = place[use], speed[use], 1 / np.diag(square)
    centre = float(np.average(x, weights=weight))
    design = np.stack([np.ones(number), x - centre], axis=1)
    gain = np.linalg.solve(design.T @ (weight[:, None] * design), design.T * weight)
    speed, slope = gain @ y
    rest = np.eye(number) - design @ gain
    scatter = weight @ (rest @ y) ** 2 / (weight @ np.diag(rest @ square @ rest.T))
    error = np.sqrt(max(scatter, 1.0) * (gain @ square @ gain.T)[1, 1])
    return centre, float(speed), float(slope), float(error), number


# -- acceleration ------------------------------------------------------------------


@dataclass(frozen=True)
class FlowAcceleration:
    """
    Acceleration of a flow, from its speeds in parts along it.

    Attributes
    ----------
    speed : `~astropy.units.Quantity`
        Speed at the centre, in mas/yr.
    centre : `~astropy.units.Quantity`
        Mean distance of the parts along the flow, in mas.
    gradient, gradient_err : `~astropy.units.Quantity`
        Change of the speed with distance, in 1/yr.
    acceleration, acceleration_err : `~astropy.units.Quantity`
        Acceleration of the matter, the gradient times the speed, in mas/yr^2.
    p_value : float
        Probability of as large an acceleration of either sign if there is none, by
        Student's distribution, as the parts scatter about a line.
    n_parts : int
        Parts whose speed is known.  With fewer than three the other numbers are NaN.
    """

    speed: u.Quantity
    centre: u.Quantity
    gradient: u.Quantity
    gradient_err: u.Quantity
    acceleration: u.Quantity
    acceleration_err: u.Quantity
    p_value: float
    n_parts: int

    def __str__(self):
        if np.isnan(self.p_value):
            return (
                "acceleration: unknown, as speeds are needed in three parts of the "
                f"flow, of two beams each, and there are {self.n_parts}"
            )
        length, time = self.speed.unit.bases
        both = self.acceleration, self.acceleration_err
        value = with_error(*(a.to_value(length / time**2) for a in both), "+-")
        far = offset_unit(self.centre.to_value(u.mas))
        return (
            f"acceleration: {value} {length}/{time}^2 at "
            f"{self.centre.to_value(far):.3g} {far}, p {self.p_value:.2g}, "
            f"{self.n_parts} parts of the flow"
        )


def acceleration_of(parts, beam, unit=PM_UNIT):
    """
    Return the acceleration from speeds in parts of a flow.

    Parameters
    ----------
    parts : tuple of `~numpy.ndarray`
        See `speeds_in_parts`.
    beam : float
        In mas.
    unit : `~astropy.units.Unit`, optional
        Of speeds.

    Returns
    -------
    `FlowAcceleration`
    """
    centre, speed, slope, error, number = slope_of(*parts)
    length, time = unit.bases
    speed = (speed * beam * PM_UNIT).to(unit)
    gradients = [u.Quantity(x, 1 / u.yr).to(1 / time) for x in (slope, error)]
    return FlowAcceleration(
        speed, centre * beam * u.mas, *gradients,
        *((gradient * speed).to(length / time**2) for gradient in gradients),
        p_value=2 * float(scipy.special.stdtr(number - 2, -abs(slope / error))),
        n_parts=number,
    )  # fmt: skip


def measure_acceleration(result: SCCResult, row: int = 0) -> FlowAcceleration:
    """
    Measure the acceleration of a flow.

    The flow beyond two beams from the core is divided into three to ten parts with
    equal amounts of emission, of about two beams.  The speed of the stream is fitted in
    each, and a straight line to these speeds with their covariance, as neighbouring
    parts see the same patterns.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    row : int, optional
        Row in the table of streams.

    Returns
    -------
    ``FlowAcceleration``
        ``speed`` in the unit of proper motions at the mean distance ``centre``;
        ``gradient`` of the speed with distance in 1/yr and ``acceleration`` in
        mas/yr^2, each with ``_err``; ``p_value`` and ``n_parts``.  It prints
        as one line.

    Raises
    ------
    ValueError
        If there is no such row.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import measure_acceleration
    >>> from astro_scc.simulation import simulate_jet
    >>> jet = simulate_jet(n_epochs=30, n_features=10, acceleration=3.0,
    ...                    dispersion=0.05, rng=1)
    >>> scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    >>> found = measure_acceleration(scc(jet.cube, n_trials=199, rng=1))
    >>> bool(found.acceleration > 0 * u.mas / u.yr**2), found.p_value < 0.05
    (True, True)
    """
    n = len(result.search.streams)
    if not 0 <= row < n:
        raise ValueError(f"row must be from 0 to {n - 1}, got {row}")
    return accelerations(result, [row])[0]


def accelerations(result, rows):
    """Return the acceleration of each of some rows; the parts are fitted once."""
    search = result.search
    flow, fit, known = search.flow, search.fit, []
    # Features that are not tested have no speed of the spectrum.
    moving = [np.isfinite(search.streams[row].p_global) for row in rows]
    if any(moving) and fit is not None:
        known = [flow.between(low, high) for low, high in parts_along(flow)]
    sign = 1 if fit is None else np.sign(fit.mean[0])
    fits = [fit_part(part, sign=sign, start=search.pair) for part in known]
    places = [place_of(part) for part in known]
    found = []
    for row, moves in zip(rows, moving, strict=True):
        of_row = slice(None if moves else 0)
        speeds = speeds_in_parts(fits[of_row], places[of_row], stream=row)
        found.append(acceleration_of(speeds, flow.beam, result.cube.speed_unit))
    return found


def parts_along(flow):
    """Return limits of parts with equal amounts of emission, in mas, shape (n, 2)."""
    along = flow.grids[0].distance
    power = (flow.planes[0].values ** 2).sum(axis=(0, 1)) * weight_of(flow)
    power = power.sum(axis=1) * (along > (CORE if flow.outward else 0))
    order = np.argsort(along, kind="stable")
    total = np.cumsum(power[order])
    if not total[-1] > 0:
        return np.empty((0, 2))
    seen = along[order][power[order] > 0]
    length = np.ptp(seen)
    if length < FEWEST * LENGTH / 2:
        return np.empty((0, 2))
    n = int(np.clip(length / LENGTH, FEWEST, MOST))
    inner = np.interp(np.arange(1, n) / n * total[-1], total, along[order])
    edges = np.concatenate([[seen[0]], inner, [seen[-1] * (1 + 1e-9)]])
    return np.stack([edges[:-1], edges[1:]], axis=1) * flow.beam
