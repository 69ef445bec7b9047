# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Maxima of stacks, and their errors from shifted positions."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from astro_scc.correlation.zncc import find_peaks
from astro_scc.paper.stack import REACH_SIGMA, gaussian_sum, velocity_axes

#: Fraction of a maximum that a grid point must reach to enter its fit.
LEVEL = 0.5
#: Grid points of a box on each axis, in trials with shifted positions.
POINTS = 21
#: Fewest values whose distribution is compared with a normal one.
FEWEST_VALUES = 8


@dataclass(frozen=True)
class VelocityPeak:
    """
    A maximum of a stack.

    Attributes
    ----------
    v1, v2 : float
        Velocity along the two axes, from the Gaussian fit or, if no
        Gaussian with a maximum in the box fits, from the local quadratic.
    coefficient : float
        Stacked correlation coefficient at the maximum.
    row, column : int
        Grid point of the maximum.
    """

    v1: float
    v2: float
    coefficient: float
    row: int
    column: int


def fit_gaussian(values, x, y):
    """
    Fit a two-dimensional Gaussian by linear least squares of its logarithm.

    ``ln f = a + b x + c y + d x^2 + e x y + g y^2`` is fitted with weights f^2,
    so that the residuals are those of f itself to first order (Guo 2011, IEEE
    Signal Process. Mag. 28, 134).

    Parameters
    ----------
    values : array_like, shape (ny, nx)
        Only positive values enter the fit.
    x, y : array_like, shapes (nx,) and (ny,)

    Returns
    -------
    (float, float) or None
        Its centre (x, y); None if the surface has no maximum.
    """
    values = np.asarray(values, dtype=float)
    gx, gy = np.meshgrid(x, y)
    good = values > 1e-6 * values.max(initial=0.0)
    if good.sum() < 6:
        return None
    f, gx, gy = values[good] / values.max(), gx[good], gy[good]
    # Coordinates are centred and scaled, or the normal equations lose digits.
    x0, y0 = gx.mean(), gy.mean()
    scale = max(np.ptp(gx), np.ptp(gy))
    px, py = (gx - x0) / scale, (gy - y0) / scale
    design = np.stack([np.ones_like(px), px, py, px * px, px * py, py * py], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(design * f[:, None], f * np.log(f))
    if rank < 6:
        return None
    _, b, c, d, e, g = solution
    curvature = -np.array([[2 * d, e], [e, 2 * g]])
    if not (curvature[0, 0] > 0 and np.linalg.det(curvature) > 0):
        return None
    centre = np.linalg.inv(curvature) @ np.array([b, c])
    return float(x0 + scale * centre[0]), float(y0 + scale * centre[1])


def find_velocity_peaks(
    scc: np.ndarray, axes: tuple[np.ndarray, np.ndarray], box: tuple[float, float]
) -> list[VelocityPeak]:
    """
    Find the maxima of a stack and fit a Gaussian to a box around each.

    Only grid points in the box that reach half of the maximum and are nearer
    to it than to any other maximum enter the fit: neighbouring maxima would
    attract the fit, and the level of unrelated matches beneath the maximum
    would widen it.

    Parameters
    ----------
    scc : `~numpy.ndarray`, shape (n2, n1)
    axes : tuple of `~numpy.ndarray`, shapes (n1,) and (n2,)
        Velocities, evenly spaced.
    box : tuple of float
        Sides of the box along the two axes; in the paper, the beam divided by
        the interval.

    Returns
    -------
    list of `VelocityPeak`
        In the order of decreasing coefficient.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.paper.peaks import find_velocity_peaks
    >>> v = np.linspace(-4, 4, 33)
    >>> scc = np.exp(-((v - 1.1) ** 2 + v[:, None] ** 2) / 2)
    >>> [round(c.v1, 3) for c in find_velocity_peaks(scc, (v, v), (2.0, 2.0))]
    [1.1]
    """
    _, y, x, _ = find_peaks(scc[None], np.finfo(float).tiny)
    # Simple rounding may miss the grid point of a maximum.
    ends = np.stack([np.floor([y, x]), np.ceil([y, x])], axis=-1).astype(int)
    points = [max(product(*both), key=scc.__getitem__) for both in ends.swapaxes(0, 1)]
    (axis1, axis2), found = axes, []
    step1, step2 = axis1[1] - axis1[0], axis2[1] - axis2[0]
    for (row, column), py, px in zip(points, y, x, strict=True):
        v1, v2 = float(axis1[0] + px * step1), float(axis2[0] + py * step2)
        near1 = np.abs(axis1 - axis1[column]) <= max(box[0] / 2, 1.5 * step1)
        near2 = np.abs(axis2 - axis2[row]) <= max(box[1] / 2, 1.5 * step2)
        part = rows, columns = np.ix_(near2, near1)
        # Grid points that are nearer to this maximum than to any other.
        apart = [(rows - r) ** 2 + (columns - c) ** 2 for r, c in points]
        nearest = (rows - row) ** 2 + (columns - column) ** 2 <= np.min(apart, axis=0)
        use = nearest & (scc[part] >= LEVEL * scc[row, column])
        values = np.where(use, scc[part], 0.0)
        fit = fit_gaussian(values, axis1[near1], axis2[near2])
        if fit is not None:
            away1, away2 = np.abs(np.subtract(fit, (v1, v2)))
            if away1 <= max(box[0] / 2, step1) and away2 <= max(box[1] / 2, step2):
                v1, v2 = fit
        found.append(VelocityPeak(v1, v2, float(scc[row, column]), row, column))
    return sorted(found, key=lambda c: -c.coefficient)


def jitter_positions(
    ends: np.ndarray, columns: np.ndarray, peak: VelocityPeak,
    box: tuple[float, float], n_trials: int, rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    """
    Shift the SSPs by their position errors and find a maximum of the stack again.

    Each trial draws one shift for every SSP from a normal distribution (paper,
    Sect. 2.4), stacks the matches about the maximum again, and takes the maximum
    nearest to it, within half a box.

    Parameters
    ----------
    ends : `~numpy.ndarray` of int, shape (2, k)
        The SSP of each match, and the SSP on which it falls, or -1.
    columns : `~numpy.ndarray`, shape (5, k)
        See ``match_velocities``.
    peak : `VelocityPeak`
    box : tuple of float
        Sides of the box, see `find_velocity_peaks`.
    n_trials : int
    rng : `~numpy.random.Generator`

    Returns
    -------
    `~numpy.ndarray`, shape (n_found, 2)
        How far the maximum lies from the formal one, along both axes, in the trials in
        which it is found.
    """
    box = np.asarray(box, dtype=float)
    # Two boxes wide, so that what the fit takes from a box is inside.
    axes = velocity_axes(box, box / (POINTS - 1))
    apart = np.abs(columns[:2] - np.array([[peak.v1], [peak.v2]]))
    near = np.all(apart < box[:, None] + REACH_SIGMA * columns[2:4], axis=0)
    (ssp, target), (v1, v2, s1, s2, weight) = ends[:, near], columns[:, near]
    # An SSP is one position in all its matches, at either end of a displacement; an end
    # without an SSP is a position of its own.
    target = np.where(target < 0, -1 - np.arange(len(target)), target)
    positions, number = np.unique([ssp, target], return_inverse=True)
    (start, end), found = number.reshape(2, -1), []
    for _ in range(n_trials):
        # Each end of a displacement has half of its variance.
        unit = rng.standard_normal((2, len(positions))) / np.sqrt(2)
        moved1, moved2 = unit[:, end] - unit[:, start]
        x, y = v1 - peak.v1 + s1 * moved1, v2 - peak.v2 + s2 * moved2
        local = gaussian_sum(x, y, s1, s2, weight, *axes)
        maxima = np.array([(c.v1, c.v2) for c in find_velocity_peaks(local, axes, box)])
        if len(maxima):
            away = np.abs(maxima / box)
            nearest = np.argmin((away**2).sum(axis=1))
            if away[nearest].max() <= 0.5:
                found.append(maxima[nearest])
    return np.reshape(found, (-1, 2))


def normal_probability(values: np.ndarray) -> float:
    """
    Return the probability that normally distributed values look less normal.

    The test of Jarque and Bera, of skewness and kurtosis with their exact moments
    (Urzua 1996, Econ. Lett. 53, 247), for two uncorrelated linear combinations of two
    variables.

    Parameters
    ----------
    values : `~numpy.ndarray`, shape (n, 2)

    Returns
    -------
    float
        NaN for fewer than eight values, or if they lie on a line.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.paper.peaks import normal_probability
    >>> values = np.random.default_rng(1).normal(size=(500, 2))
    >>> bool(normal_probability(values) > 0.05 > normal_probability(values**3))
    True
    """
    n = len(values)
    covariance = np.cov(values.T, bias=True) if n >= FEWEST_VALUES else np.zeros((2, 2))
    if not np.linalg.det(covariance) > 0:
        return np.nan
    root = np.linalg.cholesky(covariance)
    unit = np.linalg.solve(root, (values - values.mean(axis=0)).T)
    skewness = (unit**3).mean(axis=1) / np.sqrt(6 * (n - 2) / ((n + 1) * (n + 3)))
    variance = 24 * n * (n - 2) * (n - 3) / ((n + 1) ** 2 * (n + 3) * (n + 5))
    kurtosis = (unit**4).mean(axis=1) - 3 * (n - 1) / (n + 1)
    # The tail of a chi-squared distribution of four degrees of freedom.
    half = 0.5 * float((skewness**2 + kurtosis**2 / variance).sum())
    return float(np.exp(-half) * (1 + half))
