# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Fits of motion to the positions of features, ejection epochs and mean speeds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import stdtrit

from astro_scc.kinematics.frames import axes_along

#: Residuals beyond this many standard deviations lose weight (Huber 1981).
HUBER = 1.345
#: Ratio of standard deviation to median absolute deviation of a normal distribution.
MAD = 1.4826
#: Largest factor by which correlated residuals inflate a variance.
LARGEST_INFLATION = 10.0
#: Probability of a normal distribution below one standard deviation.
ONE_SIGMA = 0.8413447
#: Standard errors from which a speed or an acceleration is significant.
SIGNIFICANT = 3.0
#: Largest angle between motion and radius, plus two standard errors, in degrees.
RADIAL = 15.0


@dataclass(frozen=True, eq=False)
class MotionFit:
    """
    The motion of a feature, fitted on two axes.

    Attributes
    ----------
    middle : float
        Time to which the coefficients refer, midway between first and last.
    coefficients : `~numpy.ndarray`, shape (2, degree + 1)
        For each axis: position, velocity and, for degree 2, acceleration.
    covariance : `~numpy.ndarray`, shape (2, degree + 1, degree + 1)
    scatter : `~numpy.ndarray`, shape (2,)
        Robust standard deviation of the residuals.
    weight : `~numpy.ndarray`, shape (2, n)
        Weight of each position, between 0 and 1.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking import fit_motion
    >>> years = np.arange(6.0)
    >>> fit = fit_motion(years, [0.3 * years, 2 - 0.1 * years], np.full((2, 6), 0.05))
    >>> float(fit.middle), fit.coefficients.round(2).tolist()
    (2.5, [[0.75, 0.3], [1.75, -0.1]])
    """

    middle: float
    coefficients: np.ndarray
    covariance: np.ndarray
    scatter: np.ndarray
    weight: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """Standard errors of the coefficients, shape (2, degree + 1)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    def at(self, time: ArrayLike) -> np.ndarray:
        """
        Return the fitted positions.

        Parameters
        ----------
        time : array_like, shape (n,)

        Returns
        -------
        `~numpy.ndarray`, shape (2, n)
        """
        return self.coefficients @ _design(
            np.asarray(time, dtype=float) - self.middle, self.coefficients.shape[1] - 1
        )

    @property
    def velocity_errors(self) -> tuple[float, float]:
        """Standard errors of the speed and of its direction (rad, at most pi)."""
        v, error = self.coefficients[:, 1], self.errors[:, 1]
        speed = np.hypot(*v)
        if speed == 0:
            return float(np.hypot(*error)), np.pi
        along, across = projected_errors(axes_along(*v / speed), error)
        return float(along), min(across / speed, np.pi)


def projected_errors(axes, error):
    """Return errors along other axes, which are the rows of a matrix."""
    return np.sqrt(np.sum((axes * error) ** 2, axis=1))


def _design(time, degree):
    """Return the powers of the time, the square halved for the acceleration."""
    return np.stack([time**k / (1 if k < 2 else 2) for k in range(degree + 1)])


def fit_motion(
    time: ArrayLike, position: ArrayLike, error: ArrayLike, *, degree: int = 1
) -> MotionFit:
    r"""
    Fit a straight line or a parabola to positions on two axes.

    .. math:: x(t) = x_m + \mu (t - t_m) + \tfrac12 \dot\mu (t - t_m)^2

    with :math:`t_m` midway between the first and the last date (Lister et al.
    2009, AJ 138, 1874, Eq. 1).  Positions are weighted by their errors, and by
    Huber's function of the residuals, which reduces the weight of outliers.
    The covariance is scaled by three factors: the robust scatter of the
    residuals, never below the errors of the positions, with Huber's correction
    for small numbers; Student's factor, so that one standard error holds 68%
    also with few dates; and, because features wander,
    :math:`(1 + r)/(1 - r)`, ten at most, if the correlation r of residuals of
    consecutive dates is above what chance gives.

    Parameters
    ----------
    time : array_like, shape (n,)
        Not decreasing.
    position : array_like, shape (2, n)
    error : array_like, shape (2, n)
        Standard errors, positive.
    degree : int, optional
        1 or 2.

    Returns
    -------
    `MotionFit`

    Raises
    ------
    ValueError
        If there are fewer different dates than coefficients.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking import fit_motion
    >>> time = np.arange(2000.0, 2006.0)
    >>> fit = fit_motion(time, [0.3 * time, 0 * time], np.full((2, 6), 0.1))
    >>> fit.coefficients[:, 1].round(6) + 0.0
    array([0.3, 0. ])
    """
    time = np.asarray(time, dtype=float)
    position, error = (np.asarray(a, dtype=float) for a in (position, error))
    n_dates = len(np.unique(time))
    if n_dates < degree + 1:
        raise ValueError(
            f"a motion of degree {degree} needs {degree + 1} different dates, "
            f"got {n_dates}"
        )
    middle = (time.min() + time.max()) / 2
    design = _design(time - middle, degree)
    fits = [_fit_axis(design, x, e) for x, e in zip(position, error, strict=True)]
    return MotionFit(middle, *(np.stack(parts) for parts in zip(*fits, strict=True)))


def _fit_axis(design, x, error):
    """Fit one axis by iteratively reweighted least squares."""
    p, n = design.shape
    free = n - p
    # In units of their errors, all positions have the same weight.
    a, y = design / error, x / error
    weight = np.ones(n)
    for _ in range(50):
        root = np.sqrt(weight)
        solution = np.linalg.lstsq((a * root).T, y * root, rcond=None)[0]
        residual = y - solution @ a
        scatter = _scatter(residual, free)
        size = np.abs(residual) / (HUBER * scatter)
        new = 1 / np.maximum(size, 1.0) if free > 1 else np.ones(n)
        if np.max(np.abs(new - weight)) < 1e-6:
            break
        weight = new
    variance = scatter**2
    if free > 0:
        # Huber (1981), Sect. 7.6: psi is the clipped residual.
        inside = np.mean(weight == 1.0)
        psi = weight * residual
        small = 1 + p / n * (1 - inside) / max(inside, 1e-3)
        robust = small**2 * np.sum(psi**2) / free / max(inside, 0.5) ** 2
        # The scatter of few residuals is itself uncertain.
        robust *= stdtrit(free, ONE_SIGMA) ** 2
        # The scatter is never below the errors of the positions.
        variance = max(robust * _inflation(psi, p), 1.0)
    inverse = np.linalg.pinv(a @ a.T)
    return solution, variance * inverse, scatter * np.median(error), weight


def _scatter(residual, free):
    """Return the normalised median deviation; for few residuals the standard one."""
    if free < 1:
        return 1.0
    n = len(residual)
    usual = np.sqrt(np.sum(residual**2) / free)
    robust = MAD * np.median(np.abs(residual)) * np.sqrt(n / free)
    return max(robust if n >= 5 else usual, 0.1 * usual, 1e-9)


def _inflation(residual, p):
    """Return the factor by which correlated residuals inflate the variance."""
    n, energy, r = len(residual), np.sum(residual**2), 0.0
    if n >= 6 and energy > 0:
        # The fit of p coefficients anticorrelates residuals, which p / n corrects.
        r = np.sum(residual[1:] * residual[:-1]) / energy + p / n
        r = np.clip(r, 0.0, 0.95)
    return min((1 + r) / (1 - r), LARGEST_INFLATION) if r >= 1 / np.sqrt(n) else 1.0


def ejection_epoch(
    fit: MotionFit, beam: float, *, accelerated: bool = False
) -> tuple[float, float] | tuple[None, None]:
    r"""
    Return the date at which a feature that moves radially was at the origin.

    .. math:: t_\mathrm{ej} = t_m - \frac{\boldsymbol r \cdot \boldsymbol\mu}
                                         {|\boldsymbol\mu|^2}

    with position and velocity of the straight fit at its middle date.  As in
    MOJAVE (Lister et al. 2009, AJ 138, 1874; 2019, ApJ 874, 43), a date is
    given only if the speed is at least three standard errors, the motion is
    not accelerated, and its angle to the radius plus two standard errors is
    within 15 degrees.  Since 15 degrees are several beams far from the origin,
    the straight line must also pass the origin within one beam.

    Parameters
    ----------
    fit : `~astro_scc.tracking.MotionFit`
        Of degree 1; the first axis is east, the second north.
    beam : float
        Width of the beam, in the unit of the positions.
    accelerated : bool, optional

    Returns
    -------
    epoch, error : float or None
        In the unit and from the zero point of the times of the fit; None if the
        criteria are not met.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking import ejection_epoch, fit_motion
    >>> time = np.arange(2000.0, 2006.0)
    >>> fit = fit_motion(time, [0.3 * (time - 1998), 0 * time], np.full((2, 6), 0.01))
    >>> round(ejection_epoch(fit, 0.5)[0], 3)
    1998.0
    """
    r, v = fit.coefficients[:, 0], fit.coefficients[:, 1]
    speed = np.hypot(*v)
    speed_err, angle_err = fit.velocity_errors
    if accelerated or speed < SIGNIFICANT * speed_err or not r.any():
        return None, None
    passes = np.abs(r[0] * v[1] - r[1] * v[0]) / speed
    # The direction to the mean position has an error, too.
    across = np.array([r[1], -r[0]]) / np.hypot(*r) ** 2
    radius_err = np.sqrt(np.sum(across**2 * fit.covariance[:, 0, 0]))
    off = turn_between(r, v) + 2 * np.degrees(np.hypot(angle_err, radius_err))
    if passes > beam or off > RADIAL:
        return None, None
    along = r @ v
    by_r = -v / speed**2
    by_v = -r / speed**2 + 2 * v * along / speed**4
    gradient = np.stack([by_r, by_v], axis=1)
    variance = np.einsum("ai,aij,aj->", gradient, fit.covariance[:, :2, :2], gradient)
    return float(fit.middle - along / speed**2), float(np.sqrt(variance))


def turn_between(a, b):
    """Return the angle between two vectors in degrees, 0 if one has no length."""
    cross = a[0] * b[1] - a[1] * b[0]
    return float(np.degrees(np.abs(np.arctan2(cross, np.dot(a, b)))))


def track_profile(
    time, distance, error, track, radii, *, half_width, min_epochs=3, scale=0
):
    """
    Return the mean radial speed of the features near each distance.

    At each radius, a straight line is fitted to the distances of every track
    within ``half_width`` of the radius, and the slopes are averaged (Mertens &
    Lobanov 2016, Sect. 3.3).  Tracks with fewer than ``min_epochs`` dates there
    are not used.  One feature makes tracks on several scales, which are not
    independent: errors grow by the square root of the number of scales used.

    Returned are the speeds and their errors, zero if no track is used, and the
    numbers of tracks, each with the shape of ``radii``.
    """
    time, distance, error, track = map(np.asarray, (time, distance, error, track))
    scale = np.broadcast_to(scale, track.shape)
    speed, speed_err = np.zeros((2, len(radii)))
    n_tracks = np.zeros(len(radii), dtype=int)
    for k, radius in enumerate(radii):
        near = np.abs(distance - radius) <= half_width
        found = []
        for number in np.unique(track[near]):
            own = np.flatnonzero(near & (track == number))
            if len(np.unique(time[own])) >= max(min_epochs, 2):
                fit = fit_motion(time[own], distance[None, own], error[None, own])
                found.append((fit.coefficients[0, 1], fit.errors[0, 1], scale[own[0]]))
        n_tracks[k] = len(found)
        if found:
            slopes, errors, scales = zip(*found, strict=True)
            speed[k], mean_err = average_with_scatter(slopes, errors)
            speed_err[k] = mean_err * np.sqrt(len(set(scales)))
    return speed, speed_err, n_tracks


def average_with_scatter(values, errors):
    """
    Return the weighted mean of values that scatter beyond their errors, and its error.

    Weights are ``1 / (error^2 + s^2)``, where s is the scatter of the values
    beyond their errors (DerSimonian & Laird 1986).
    """
    values, weight = np.asarray(values, float), 1 / np.asarray(errors, float) ** 2
    mean = np.average(values, weights=weight)
    free = len(values) - 1
    spare = weight.sum() - np.sum(weight**2) / weight.sum()
    excess = np.sum(weight * (values - mean) ** 2) - free
    extra = max(excess / spare, 0.0) if free else 0.0
    weight = 1 / (1 / weight + extra)
    return float(np.average(values, weights=weight)), float(weight.sum() ** -0.5)
