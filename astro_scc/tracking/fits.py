# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Straight and accelerated motion fitted to the positions of a feature."""

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

__all__ = ["MotionFit", "fit_motion"]

#: Residuals beyond so many standard deviations lose weight (Huber 1981).
HUBER = 1.345
#: Normalised median absolute deviation of a normal distribution.
MAD = 1.4826
#: Largest factor of a variance by residuals that depend on one another.
LARGEST_INFLATION = 10.0
#: Share of a normal distribution below one standard deviation.
ONE_SIGMA = 0.8413447


@dataclass(frozen=True, eq=False)
class MotionFit:
    """
    The motion of a feature, fitted on two axes.

    Attributes
    ----------
    middle : float
        Time that the coefficients refer to, the middle of first and last.
    coefficients : `~numpy.ndarray`, shape (2, degree + 1)
        Of each axis: position, velocity and, for degree 2, acceleration.
    covariance : `~numpy.ndarray`, shape (2, degree + 1, degree + 1)
    scatter : `~numpy.ndarray`, shape (2,)
        Robust standard deviation of the residuals.
    weight : `~numpy.ndarray`, shape (2, n)
        Between 0 and 1: how much each position counts.

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
    def errors(self):
        """Standard errors of the coefficients, shape (2, degree + 1)."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    def at(self, time):
        """
        Fitted positions.

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


def _design(time, degree):
    return np.stack([time**k / (1 if k < 2 else 2) for k in range(degree + 1)])


def fit_motion(time, position, error, *, degree=1):
    r"""
    Fit a straight line or a parabola to positions on two axes.

    .. math:: x(t) = x_m + \mu (t - t_m) + \tfrac12 \dot\mu (t - t_m)^2

    with :math:`t_m` the middle of first and last date (Lister et al. 2009,
    AJ 138, 1874, Eq. 1).  Positions are weighted by their errors and, by
    Huber's function of the residuals, less if they lie away.  The errors
    of positions count relative to one another only: the covariance is
    scaled by the robust scatter of the residuals, with Huber's correction
    for small numbers, by Student's factor, so that one standard error holds
    68% with few dates too, and by :math:`(1 + r)/(1 - r)`, ten at most, where
    residuals of consecutive dates have a correlation r above what chance
    gives, for features that wander.  The scatter is never taken below the
    errors of the positions.

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
    if len(np.unique(time)) < degree + 1:
        raise ValueError(
            f"a motion of degree {degree} needs {degree + 1} different dates, "
            f"got {len(np.unique(time))}"
        )
    middle = (time.min() + time.max()) / 2
    design = _design(time - middle, degree)
    fits = [_fit_axis(design, x, e) for x, e in zip(position, error, strict=True)]
    return MotionFit(middle, *(np.stack(parts) for parts in zip(*fits, strict=True)))


def _fit_axis(design, x, error):
    """Iteratively reweighted least squares on one axis."""
    p, n = design.shape
    free = n - p
    # In units of the errors, all positions are alike.
    a, y = design / error, x / error
    weight = np.ones(n)
    scatter = 1.0
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
        # A scatter from few residuals is uncertain itself.
        robust *= stdtrit(free, ONE_SIGMA) ** 2
        # Never better than the positions themselves.
        variance = max(robust * _inflation(psi, p), 1.0)
    inverse = np.linalg.pinv(a @ a.T)
    return solution, variance * inverse, scatter * np.median(error), weight


def _scatter(residual, free):
    """Normalised median deviation, or the standard one of few residuals."""
    if free < 1:
        return 1.0
    n = len(residual)
    usual = np.sqrt(np.sum(residual**2) / free)
    if n < 5:
        return max(usual, 1e-9)
    robust = MAD * np.median(np.abs(residual)) * np.sqrt(n / free)
    return max(robust, 0.1 * usual, 1e-9)


def _inflation(residual, p):
    """By how much the variance grows if residuals follow one another."""
    n = len(residual)
    energy = np.sum(residual**2)
    if n < 6 or energy <= 0:
        return 1.0
    # A fit of p coefficients makes independent residuals look anticorrelated.
    r = np.sum(residual[1:] * residual[:-1]) / energy + p / n
    r = np.clip(r, 0.0, 0.95)
    if r < 1 / np.sqrt(n):
        return 1.0
    return min((1 + r) / (1 - r), LARGEST_INFLATION)
