# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speeds of one stream in parts of a flow, their covariance and their slope."""

from dataclasses import dataclass

import numpy as np
import scipy

from astro_scc.spectrum.errors import ONE_SIGMA
from astro_scc.streams.parts import weight_of

#: Errors of differences of scales are too small by this factor in simulated jets.
DIFFERENCES = 1.5


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
    if not all(part is not None and part.knows(0) for part in (first, second)):
        return (np.nan, np.nan), (np.nan, np.nan), np.nan, np.nan
    travel = (first.fit.mean[0] + second.fit.mean[0]) / 2
    both = first.errors(travel), second.errors(travel)
    speeds = abs(first.fit.mean[0]), abs(second.fit.mean[0])
    factors = [
        scipy.special.stdtrit(max(error.number[0] - 1, 1.0), ONE_SIGMA)
        for error in both
    ]
    variance = ((both[1].epochs[0] - both[0].epochs[0]) ** 2).sum()
    for half in (0, 1):
        one, other = (both[k].clusters[0][half] / factors[k] for k in (0, 1))
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
    return float(2 * scipy.special.ndtr(-abs(sigma)))
