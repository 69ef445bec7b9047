# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speeds of features in bins, and of a flow by scale, in parts and in cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Any

import astropy.units as u
import numpy as np
import scipy
from astropy.io import fits
from astropy.table import QTable
from astropy.wcs import WCS

from astro_scc.kinematics import RidgeLine
from astro_scc.measurement import SCCResult
from astro_scc.quantities import check_range, named, random_generator
from astro_scc.settings import require
from astro_scc.spectrum.gaussians import ONE_SIGMA
from astro_scc.streams.decomposed import find_motion, fit_part, has_flow, weight_of
from astro_scc.streams.members import mean_speed, moving_features
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
        moves; ``difference`` with its error, and ``p_value``.  What is unknown is NaN,
        and all is in a bin where nothing moves significantly.  None with one scale.

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
            moves = any(moves_in(found[k]) for found in measured.results.values())
            fits = {name: f[k] if moves else None for name, f in measured.fits.items()}
            for name, found in measured.results.items():
                if both and moves and found[k] is not None:
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


def moves_in(result):
    """Return whether anything moves in a bin, whose result may be None."""
    return result is not None and any(s.kind == "moving" for s in result.search.streams)


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


# -- speeds in cells ----------------------------------------------------------------

#: Length of a cell along the flow in beams, and number across it, if none are given.
LENGTH, ACROSS = 2.0, 3
#: Columns of the table that are images of the FITS file.
IMAGES = {"SPEED": "pm_parallel", "ERROR": "pm_parallel_err", "P_FDR": "p_fdr"}


@dataclass(frozen=True, eq=False, repr=False)
class FlowField:
    """
    Speeds in cells of distance and place across the flow.

    Attributes
    ----------
    table : `~astropy.table.QTable`
        A row for each cell: ``r_min``, ``r_max``; ``offset_min``, ``offset_max``,
        across the flow, positive to larger position angles, or, of radial flows, the
        position angles themselves;
        ``pm_parallel`` with ``pm_parallel_err``; ``p_global`` and, adjusted for all
        cells, ``p_fdr``.  What is unknown is NaN.
    along, across : `~astropy.units.Quantity`
        Edges of the cells; ``to_fits`` needs even ones.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> from astro_scc.flow import FlowField
    >>> table = QTable({"pm_parallel": [1.0], "pm_parallel_err": [0.1]},
    ...                units=[u.mas / u.yr] * 2)
    >>> field = FlowField(table, [0, 5] * u.mas, [-1, 1] * u.mas)
    >>> len(field.table)
    1
    """

    table: QTable
    along: u.Quantity
    across: u.Quantity

    def to_fits(self) -> fits.HDUList:
        """
        Return the cells, of even edges, as images with a WCS of distance and offset.

        Returns
        -------
        `~astropy.io.fits.HDUList`
            ``SPEED``, ``ERROR`` and ``P_FDR``.

        Raises
        ------
        ValueError
            If the cells are not of one size.
        """
        wcs = WCS(naxis=2)
        wcs.wcs.ctype = ["DISTANCE", "OFFSET"]
        wcs.wcs.crpix = [0.5, 0.5]
        for k, name in enumerate(("along", "across")):
            edges = getattr(self, name)
            step = np.diff(edges.value)
            if not np.allclose(step, step[0], rtol=1e-6):
                raise ValueError(
                    f"images need cells of one size: give even edges {name}"
                )
            wcs.wcs.cunit[k] = edges.unit.to_string("fits")
            wcs.wcs.crval[k], wcs.wcs.cdelt[k] = edges.value[0], step[0]
        shape, hdus = (len(self.across) - 1, len(self.along) - 1), []
        for name, column in IMAGES.items():
            kind = fits.ImageHDU if hdus else fits.PrimaryHDU
            values = u.Quantity(self.table[column])
            hdu = kind(values.value.reshape(shape), wcs.to_header())
            hdu.name, hdu.header["BUNIT"] = name, values.unit.to_string("fits")
            hdus.append(hdu)
        return fits.HDUList(hdus)


def measure_field(
    result: SCCResult, *, along: u.Quantity | str | None = None,
    across: u.Quantity | None = None, n_trials: int = 200,
    rng: np.random.Generator | int | None = None,
) -> FlowField:  # fmt: skip
    """
    Measure speeds in cells of distance and place across the flow.

    One stream is fitted in each cell, and motion is tested there.  The side of the
    counter-jet is left out, and cells have no speed where nothing can be followed for
    half a beam, as beside an edge of the images.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    along : `~astropy.units.Quantity` or str, optional
        Edges of the cells: increasing distances, by default every two beams.
        `FlowField.to_fits` needs even ones, also across.
    across : `~astropy.units.Quantity`, optional
        Increasing offsets or, of radial and expanding flows, position angles; by
        default three cells over what is seen.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `FlowField`

    Raises
    ------
    ValueError
        If edges do not increase, or nothing is seen in any cell.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import measure_field
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    >>> result = scc(simulate_two_fluid(n_epochs=8, rng=1).cube, n_trials=100, rng=1)
    >>> field = measure_field(
    ...     result, along=[2, 10, 18] * u.mas, across=[-2, 0, 2] * u.mas, n_trials=20)
    >>> len(field.table), [hdu.name for hdu in field.to_fits()]
    (4, ['SPEED', 'ERROR', 'P_FDR'])
    """
    from scipy.stats import false_discovery_control

    n_trials = require("n_trials", n_trials)
    flow, (r, offset, unit) = result.flow, cell_coordinates(result.flow)
    seen = flow.planes[0].mask & ~flow.grids[0].counter
    along, across = _edges(along, across, r[seen], offset[seen], unit, flow.beam)
    rows, rngs = [], iter(random_generator(rng).spawn(len(along) * len(across)))
    for low, high in pairwise(across.value):
        for r_min, r_max in pairwise(along.value):
            ahead = offset - low
            if unit == u.deg:
                # Position angles are the same a turn later.
                ahead = ahead % 360
            inside = (r >= r_min) & (r < r_max) & (ahead >= 0) & (ahead < high - low)
            cell = flow.part(places=[(inside & ~flow.grids[0].counter) * 1.0])
            found = _measure_cell(cell, result, n_trials, next(rngs))
            rows.append((r_min, r_max, low, high, *found))
    names = ("r_min", "r_max", "offset_min", "offset_max", "pm_parallel",
             "pm_parallel_err", "p_global")  # fmt: skip
    units = [u.mas, u.mas, unit, unit, PM_UNIT, PM_UNIT]
    table = QTable(rows=rows, names=names, units=dict(zip(names, units, strict=False)))
    p = table["p_global"] = u.Quantity(table["p_global"]).value
    known = np.isfinite(p)
    if not known.any():
        raise ValueError(
            "nothing is seen in any cell: choose other edges, such as those that are "
            "taken without along and across"
        )
    table["p_fdr"] = np.full(len(p), np.nan)
    table["p_fdr"][known] = false_discovery_control(p[known])
    return FlowField(table, along, across)


def _edges(along, across, r, offset, unit, beam):
    """Return the edges of the cells, by default those of what is seen."""
    if along is None:
        step = LENGTH * beam
        first, last = np.floor(r.min() / step), np.ceil(r.max() / step)
        along = np.arange(first, last + 1) * step * u.mas
    if across is None:
        across = np.linspace(offset.min(), offset.max() + 1e-9, ACROSS + 1) * unit
    given = "increasing distances", "0.5 1.5 2.5 mas", 0, np.less, None
    along = named("along", check_range, along, *given).to(u.mas)
    across, kind = u.Quantity(across), "offsets"
    is_right = across.unit.is_equivalent(unit)
    if unit == u.deg:
        # Offsets on the sky are angles, too.
        kind, is_right = "position angles, in deg", across.unit in (u.deg, u.rad)
    rises = across.ndim == 1 and len(across) > 1 and np.all(np.diff(across) > 0)
    if not (is_right and rises):
        raise ValueError(f"across = {across} must be two increasing {kind} or more")
    return along, across.to(unit)


def _measure_cell(cell, result, n_trials, rng):
    """Return speed, error and p-value of a cell, or NaN."""
    if not has_flow(cell):
        return np.nan, np.nan, np.nan
    outward, fit = result.meta["settings"]["outward"], result.search.fit
    _, test = find_motion(cell, n_trials, rng, outward=outward)
    part = fit_part(cell, sign=1.0 if fit is None else np.sign(fit.mean[0]))
    if part.fit is None or not part.fit.amplitude[0] > 0:
        return np.nan, np.nan, test.p_global
    speed = part.fit.mean[0]
    (error,), *_ = part.errors(speed)
    return abs(speed) * cell.beam, error * cell.beam, test.p_global


def cell_coordinates(flow):
    """
    Return the coordinates of the points of a flow's grid.

    Parameters
    ----------
    flow : ``DecomposedFlow``

    Returns
    -------
    distance, offset : `~numpy.ndarray`, shape (n_along, n_across)
        The first in mas.
    unit : `~astropy.units.Unit`
        Of the offset: mas, or degrees of the position angle in radial flows.
    """
    grid, frame, beam = flow.grids[0], flow.frame, flow.beam
    shape, place = grid.x.shape, flow.cube.pixel_to_offset(grid.x, grid.y)
    distance = grid.distances * beam
    if isinstance(frame, RidgeLine):
        return distance, np.broadcast_to(grid.across * beam, shape), u.mas
    if np.isfinite(grid.angle):
        offset = np.tensordot(grid.axes[1], [p.to_value(u.mas) for p in place], 1)
        return distance, offset, u.mas
    place = zip(place, frame.origin, strict=True)
    east, north = ((p - origin).to_value(u.mas) for p, origin in place)
    # The last row, as a radial grid begins at the origin.  Angles do not jump at north.
    angle = np.degrees(np.unwrap(np.arctan2(east[-1], north[-1])))
    angle -= np.floor(angle.mean() / 360) * 360
    return np.hypot(east, north), np.broadcast_to(angle, shape), u.deg
