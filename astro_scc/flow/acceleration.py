# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speeds of one stream in parts of a flow, and their slope, its acceleration."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
import scipy

from astro_scc.measurement import SCCResult
from astro_scc.quantities import with_error
from astro_scc.streams.parts import fit_part, weight_of
from astro_scc.units import PM_UNIT, offset_unit

#: Distance from the core below which speeds are not used, and length of a part, in
#: beams.
CORE, LENGTH = 2.0, 2.0
#: Fewest and most parts.
FEWEST, MOST = 3, 10


@dataclass(frozen=True, eq=False)
class PartSpeeds:
    """
    Mean speeds of a stream in parts of a flow, in beams and years.

    Attributes
    ----------
    place : `~numpy.ndarray`, shape (n,)
        Mean distance of each part.
    speed : `~numpy.ndarray`, shape (n,)
        NaN where it is not known.
    covariance : `~numpy.ndarray`, shape (n, n)
    """

    place: np.ndarray
    speed: np.ndarray
    covariance: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """Standard errors of the speeds."""
        return np.sqrt(np.diag(self.covariance))


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
    `PartSpeeds`
    """
    n = len(fits)
    speed, covariance = np.full(n, np.nan), np.full((n, n), np.nan)
    known = [k for k, fit in enumerate(fits) if fit is not None and fit.knows(stream)]
    if not known:
        return PartSpeeds(np.array(places), speed, covariance)
    means = np.array([fits[k].fit.mean[stream] for k in known])
    errors = [fits[k].errors(np.median(means)) for k in known]
    epochs = np.array([error.epochs[stream] for error in errors])
    total = epochs @ epochs.T
    for half in (0, 1):
        clusters = np.array([error.clusters[stream][half] for error in errors])
        m = np.count_nonzero(clusters.any(axis=0))
        total += clusters @ clusters.T * m / max(m - 1, 1) / 2
    speed[known] = np.abs(means)
    covariance[np.ix_(known, known)] = total
    return PartSpeeds(np.array(places), speed, covariance)


def slope_of(parts):
    """
    Return the slope of speeds with distance by weighted least squares.

    Weights are the inverse variances; the error follows from the whole covariance,
    which is not inverted, as it has few clusters.  Speeds that scatter by more than
    their errors about the line, as where two streams are seen as one, enlarge it.

    Parameters
    ----------
    parts : `PartSpeeds`

    Returns
    -------
    centre, speed, slope, error : float
        Mean distance and the speed there; NaN with fewer than three speeds.
    number : int
        Speeds that are known.
    """
    use = np.isfinite(parts.speed) & np.isfinite(np.diag(parts.covariance))
    number = int(use.sum())
    if number < 3:
        return np.nan, np.nan, np.nan, np.nan, number
    square = parts.covariance[np.ix_(use, use)]
    x, y, weight = parts.place[use], parts.speed[use], 1 / np.diag(square)
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
    parts : `PartSpeeds`
    beam : float
        In mas.
    unit : `~astropy.units.Unit`, optional
        Of speeds.

    Returns
    -------
    `FlowAcceleration`
    """
    centre, speed, slope, error, number = slope_of(parts)
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
    fits = [
        fit_part(part, sign=sign, start=search.pair, intervals=search.intervals)
        for part in known
    ]
    places = [place_of(part) for part in known]
    found = []
    for row, moves in zip(rows, moving, strict=True):
        of_row = slice(None if moves else 0)
        speeds = speeds_in_parts(fits[of_row], places[of_row], stream=row)
        found.append(acceleration_of(speeds, flow.beam, result.cube.speed_unit))
    return found


def parts_along(flow):
    """Return limits of parts with equal amounts of emission, in mas, shape (n, 2)."""
    planes = flow.planes[0]
    along = flow.grids[0].distance
    power = (planes.values**2).sum(axis=(0, 1)) * weight_of(flow)
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
