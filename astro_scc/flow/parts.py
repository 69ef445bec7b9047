# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speeds of one stream in parts of a flow, their covariance and their slope."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, stdtrit

from astro_scc.spectrum.diagram import Diagram, correlate
from astro_scc.spectrum.equations import Equations, set_up
from astro_scc.spectrum.errors import ONE_SIGMA, fit_errors
from astro_scc.spectrum.gaussians import StreamFit, fit_streams, one_stream
from astro_scc.spectrum.permutations import EVERY
from astro_scc.spectrum.planes import FlowPlanes

#: Part of the fastest speed of the search that is not known to be slower.
TOP = 0.99
#: Errors of differences of scales are too small by this factor in simulated jets.
DIFFERENCES = 1.5


@dataclass(frozen=True, eq=False)
class PartFit:
    """Streams that are fitted to a part of a flow."""

    planes: FlowPlanes
    region: np.ndarray | None
    diagram: Diagram
    equations: Equations
    fit: StreamFit

    def errors(self, travel):
        """Return the errors, of clusters that move at a speed."""
        return fit_errors(
            self.planes, self.diagram, self.equations, self.fit, region=self.region,
            travel=travel,
        )  # fmt: skip


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


def fit_part(
    flow, *, sign=1.0, root=True, start=None, intervals=EVERY, diagram=None, fit=None
):
    """
    Fit one stream, or those of the whole flow, to a part of it.

    Parameters
    ----------
    flow : ``DecomposedFlow``
        Along one direction.
    sign : float, optional
        Of the speed of one stream.
    root : bool, optional
        Of the square root of the planes, see `FlowPlanes.square_root`.
    start : sequence of (mean, sd), optional
        Streams of the whole.
    intervals : (float, float), optional
        Shortest and longest interval that is used, in years.
    diagram : ``Diagram``, optional
        That of these planes, if it is known.
    fit : ``StreamFit``, optional
        If it is known.

    Returns
    -------
    `PartFit` or None
    """
    planes = flow.planes[0].square_root() if root else flow.planes[0]
    if not has_flow(flow):
        return None
    region = flow.regions[0]
    diagram = correlate(planes, region=region) if diagram is None else diagram
    equations = set_up(diagram, fastest=flow.fastest, intervals=intervals)
    if fit is None and start is None:
        fit = one_stream(equations, 1 / np.ptp(flow.years), sign)
    elif fit is None:
        fit = fit_streams(equations, start)
    return None if fit is None else PartFit(planes, region, diagram, equations, fit)


def has_flow(flow):
    """Return whether a flow is seen in a part."""
    return float(weight_of(flow).sum()) >= 4


def weight_of(flow):
    """Return the weight of each point of the first grid, shape (n_along, n_across)."""
    mask, region = flow.planes[0].mask, flow.regions[0]
    return mask * 1.0 if region is None else mask * region


def place_of(flow):
    """Return the mean distance of what is seen, in beams, or NaN."""
    weight = weight_of(flow).sum(axis=1)
    if not weight.sum() > 0:
        return np.nan
    return float(weight @ np.abs(flow.grids[0].along) / weight.sum())


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
    known = [
        k for k, fit in enumerate(fits) if fit is not None and _is_known(fit, stream)
    ]
    if not known:
        return PartSpeeds(np.array(places), speed, covariance)
    means = np.array([fits[k].fit.mean[stream] for k in known])
    errors = [fits[k].errors(np.median(means)) for k in known]
    epochs = np.array([own.epochs[stream] for own in errors])
    total = epochs @ epochs.T
    for half in (0, 1):
        clusters = np.array([own.clusters[stream][half] for own in errors])
        m = np.count_nonzero(clusters.any(axis=0))
        total += clusters @ clusters.T * m / max(m - 1, 1) / 2
    speed[known] = np.abs(means)
    covariance[np.ix_(known, known)] = total
    return PartSpeeds(np.array(places), speed, covariance)


def _is_known(part, stream):
    """Return whether a speed is not at the limit of the search."""
    fit = part.fit
    inside = abs(fit.mean[stream]) < TOP * part.equations.speed[-1]
    return bool(fit.amplitude[stream] > 0 and inside)


def difference(first, second):
    """
    Return the difference of the speeds of two groups of scales, and its error.

    What the same clusters and epochs add to both cancels.

    Parameters
    ----------
    first, second : `PartFit`
        Of the same places.

    Returns
    -------
    speeds, errors : (float, float)
        Of both groups.
    difference, error : float
        All in beams/yr; NaN where a speed is not known.
    """
    unknown = (np.nan, np.nan), (np.nan, np.nan), np.nan, np.nan
    if first is None or second is None:
        return unknown
    if not (_is_known(first, 0) and _is_known(second, 0)):
        return unknown
    travel = (first.fit.mean[0] + second.fit.mean[0]) / 2
    both = first.errors(travel), second.errors(travel)
    speeds = abs(first.fit.mean[0]), abs(second.fit.mean[0])
    factors = [stdtrit(max(own.number[0] - 1, 1.0), ONE_SIGMA) for own in both]
    variance = ((both[1].epochs[0] - both[0].epochs[0]) ** 2).sum()
    for half in (0, 1):
        one, other = (
            own.clusters[0][half] / factor
            for own, factor in zip(both, factors, strict=True)
        )
        apart = other - one
        used = apart[apart != 0]
        m = len(used)
        square = ((used - used.mean()) ** 2).sum() if m else 0.0
        variance += max(factors) ** 2 * square * m / max(m - 1, 1) / 2
    errors = both[0].mean[0], both[1].mean[0]
    return speeds, errors, speeds[1] - speeds[0], DIFFERENCES * np.sqrt(variance)


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


def two_sided(sigma):
    """Return the probability of as large a value of either sign."""
    return float(2 * ndtr(-abs(sigma)))
