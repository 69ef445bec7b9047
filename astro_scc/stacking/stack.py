# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stacked cross-correlation on a grid of velocities, and its maxima."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from astro_scc.correlation.zncc import find_peaks
from astro_scc.stacking.velocities import DatePairs, VelocityGrid, VelocitySamples

#: Matches that are summed at once, to limit memory.
BLOCK = 16384
#: Gaussians are neglected beyond this many standard deviations.
REACH_SIGMA = 5.0
#: Fraction of a maximum that a grid point must reach to enter its fit.
LEVEL = 0.5


def gaussian_sum(x, y, sx, sy, weight, grid_x, grid_y):
    """
    Return the weighted sum of axis-parallel Gaussians of unit height on a grid.

    A Gaussian is the product of its profiles, so the sum over K Gaussians
    is one matrix product, (ny x K) (K x nx).

    Parameters
    ----------
    x, y, sx, sy, weight : `~numpy.ndarray`, shape (k,)
        Centres, standard deviations, and weights.
    grid_x, grid_y : `~numpy.ndarray`, shapes (nx,) and (ny,)

    Returns
    -------
    `~numpy.ndarray`, shape (ny, nx)
    """
    total = np.zeros((len(grid_y), len(grid_x)))
    for start in range(0, len(x), BLOCK):
        k = slice(start, start + BLOCK)
        profile_x = np.exp(-0.5 * ((grid_x - x[k, None]) / sx[k, None]) ** 2)
        profile_y = np.exp(-0.5 * ((grid_y - y[k, None]) / sy[k, None]) ** 2)
        total += (profile_y * weight[k, None]).T @ profile_x
    return total


def sample_velocities(samples, pairs, order=None):
    """
    Return the matches of a stack as velocities with errors and weights.

    Parameters
    ----------
    samples : `VelocitySamples`
    pairs : `DatePairs`
    order : array_like of int, shape (n_dates,), optional
        Image at each date; by default the observed order.

    Returns
    -------
    index : `~numpy.ndarray` of int, shape (k,)
        Index of the match; a match can enter with more than one pair of dates.
    v1, v2, s1, s2 : `~numpy.ndarray`, shape (k,)
    weight : `~numpy.ndarray`, shape (k,)
    """
    reference, target = pairs.images(order)
    n = samples.n_epochs
    # Each ordered pair of images meets at most one pair of dates.
    slot = np.full((n, n), -1)
    slot[reference, target] = np.arange(len(pairs))
    of_match = slot[samples.reference, samples.target]
    index = np.flatnonzero(of_match >= 0)
    rate = 1 / pairs.interval[of_match[index]]
    columns = samples.d1, samples.d2, samples.s1, samples.s2
    weight = samples.weight[index] * pairs.weight[of_match[index]]
    return (index, *(column[index] * rate for column in columns), weight)


def number_of_ssps(samples, pairs, order=None):
    """
    Return the normalisation of a stack, the SSPs of all its reference images.

    Parameters
    ----------
    samples : `VelocitySamples`
    pairs : `DatePairs`
    order : array_like of int, shape (..., n_dates), optional
        Image at each date.

    Returns
    -------
    float or `~numpy.ndarray`, shape (...)
        ``sum_t w_t N_SSP(t)``, where w are the weights of the pairs; infinite
        without SSPs, so that an empty stack is zero.
    """
    reference, _ = pairs.images(order)
    number = (samples.n_ssps[reference] * pairs.weight).sum(axis=-1)
    return np.where(number > 0, number, np.inf)


def stack(
    samples: VelocitySamples, pairs: DatePairs, grid: VelocityGrid, *,
    order: ArrayLike | None = None,
) -> np.ndarray:  # fmt: skip
    r"""
    Stack the correlation peaks of all SSPs and pairs of epochs.

    .. math:: C_\mathrm{SCC}(v) = \frac{\sum_t \sum_j \sum_i \sum_p
              \gamma_{i,j,t}(p)\, g(v - p / \Delta t,\ \sigma / \Delta t)}
              {\sum_t \sum_j N^t_{\mathrm{SSP},j}},

    where g is a Gaussian of unit height (Mertens & Lobanov 2016, Eqs. 5 and
    6).  SSPs without a peak count in the denominator.

    Parameters
    ----------
    samples : `VelocitySamples`
    pairs : `DatePairs`
    grid : `VelocityGrid`
        Grid of velocities, in the unit of the displacements per year.
    order : array_like of int, shape (n_dates,), optional
        Image at each date, to stack a permuted order of epochs.

    Returns
    -------
    `~numpy.ndarray`, shape ``grid.shape``

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking.stack import stack
    >>> from astro_scc.stacking.velocities import VelocityGrid, VelocitySamples
    >>> from astro_scc.stacking.velocities import consecutive_pairs
    >>> one = np.ones(1)
    >>> match = VelocitySamples(
    ...     d1=one, d2=0 * one, s1=0.2 * one, s2=0.2 * one, weight=0.9 * one,
    ...     reference=np.array([0]), target=np.array([1]), ssp=np.array([0]),
    ...     target_ssp=np.array([1]), n_ssps=np.array([1, 1]))
    >>> grid = VelocityGrid.covering(4.0, 0.5)
    >>> scc = stack(match, consecutive_pairs([0.0, 0.5]), grid)
    >>> row, column = np.unravel_index(scc.argmax(), scc.shape)
    >>> float(grid.v1[column]), float(grid.v2[row]), float(scc.max())
    (2.0, 0.0, 0.9)
    """
    _, v1, v2, s1, s2, weight = sample_velocities(samples, pairs, order)
    near = np.abs(v1) < grid.v_max[0] + REACH_SIGMA * s1
    near &= np.abs(v2) < grid.v_max[1] + REACH_SIGMA * s2
    total = gaussian_sum(*(a[near] for a in (v1, v2, s1, s2, weight)), grid.v1, grid.v2)
    return total / number_of_ssps(samples, pairs, order)


@dataclass(frozen=True)
class VelocityPeak:
    """
    A maximum of a stack.

    Attributes
    ----------
    v1, v2 : float
        Velocity along the two axes of the grid, from the Gaussian fit.
    coefficient : float
        Stacked correlation coefficient at the maximum.
    row, column : int
        Grid point of the maximum.
    width1, width2 : float
        Standard deviations of the fitted Gaussian along the axes.
    fitted : bool
        False if no Gaussian with a maximum in the box fits, and the velocity
        is that of the local quadratic.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking.stack import find_velocity_peaks
    >>> from astro_scc.stacking.velocities import VelocityGrid
    >>> grid = VelocityGrid.covering(4.0, 0.25)
    >>> scc = np.exp(-((grid.v1 - 1.1) ** 2 + grid.v2[:, None] ** 2) / 2)
    >>> peak = find_velocity_peaks(scc, grid, (2.0, 2.0))[0]
    >>> peak.fitted, round(peak.v1, 1)
    (True, 1.1)
    """

    v1: float
    v2: float
    coefficient: float
    row: int
    column: int
    width1: float = np.nan
    width2: float = np.nan
    fitted: bool = False


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
    tuple of float or None
        ``x0, y0, height, sigma_x, sigma_y``, where the sigmas are those of the
        marginal profiles; None if the surface has no maximum.
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
    a, b, c, d, e, g = solution
    curvature = -np.array([[2 * d, e], [e, 2 * g]])
    if not (curvature[0, 0] > 0 and np.linalg.det(curvature) > 0):
        return None
    covariance = np.linalg.inv(curvature)
    centre = covariance @ np.array([b, c])
    height = np.exp(a + 0.5 * np.array([b, c]) @ centre) * values.max()
    sigma = scale * np.sqrt(np.diag(covariance))
    found = x0 + scale * centre[0], y0 + scale * centre[1], height, *sigma
    return tuple(map(float, found))


def find_velocity_peaks(
    scc: np.ndarray, grid: VelocityGrid, box: tuple[float, float]
) -> list[VelocityPeak]:
    """
    Find the maxima of a stack and fit a Gaussian to a box around each.

    Only grid points in the box that reach half of the maximum and are nearer
    to it than to any other maximum enter the fit: neighbouring maxima would
    attract the fit, and the level of unrelated matches beneath the maximum
    would widen it.

    Parameters
    ----------
    scc : `~numpy.ndarray`, shape ``grid.shape``
    grid : `VelocityGrid`
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
    >>> from astro_scc.stacking.stack import find_velocity_peaks
    >>> from astro_scc.stacking.velocities import VelocityGrid
    >>> grid = VelocityGrid.covering(4.0, 0.25)
    >>> scc = np.exp(-((grid.v1 - 1.1) ** 2 + grid.v2[:, None] ** 2) / 2)
    >>> [round(c.v1, 3) for c in find_velocity_peaks(scc, grid, (2.0, 2.0))]
    [1.1]
    """
    _, y, x, _ = find_peaks(scc[None], np.finfo(float).tiny)
    points = [_grid_point(scc, *place) for place in zip(y, x, strict=True)]
    step1, step2 = grid.step
    found = []
    for (row, column), py, px in zip(points, y, x, strict=True):
        point = float(scc[row, column]), row, column
        v1, v2 = float(grid.v1[0] + px * step1), float(grid.v2[0] + py * step2)
        peak = VelocityPeak(v1, v2, *point)
        part, used = _fitted_points(scc, grid, box, (row, column), points)
        near2, near1 = (np.ravel(index) for index in part)
        values = np.where(used, scc[part], 0.0)
        fit = fit_gaussian(values, grid.v1[near1], grid.v2[near2])
        if (
            fit is not None
            and abs(fit[0] - v1) <= max(box[0] / 2, step1)
            and abs(fit[1] - v2) <= max(box[1] / 2, step2)
        ):
            v1, v2, _, *widths = fit
            peak = VelocityPeak(v1, v2, *point, *widths, fitted=True)
        found.append(peak)
    return sorted(found, key=lambda c: -c.coefficient)


def _fitted_points(scc, grid, box, point, points):
    """Return the grid points of the box, and which of them enter the fit."""
    row, column = point
    step1, step2 = grid.step
    near1 = np.abs(grid.v1 - grid.v1[column]) <= max(box[0] / 2, 1.5 * step1)
    near2 = np.abs(grid.v2 - grid.v2[row]) <= max(box[1] / 2, 1.5 * step2)
    part = rows, columns = np.ix_(near2, near1)
    squares = [(rows - r) ** 2 + (columns - c) ** 2 for r, c in (point, *points)]
    # Grid points that are nearer to this maximum than to any other.
    own = np.all([squares[0] <= other for other in squares[1:]], axis=0)
    return part, own & (scc[part] >= LEVEL * scc[row, column])


def velocity_peak_near(scc, grid, box, v1, v2):
    """
    Return the maximum of a stack nearest to a velocity.

    Parameters
    ----------
    scc : `~numpy.ndarray`, shape ``grid.shape``
    grid : `VelocityGrid`
    box : tuple of float
        As in `find_velocity_peaks`; the maximum must lie within half of it.
    v1, v2 : float

    Returns
    -------
    `VelocityPeak`
        At the velocity itself, and not ``fitted``, if no maximum is near.
    """

    def distance(c):
        return np.hypot((c.v1 - v1) / box[0], (c.v2 - v2) / box[1])

    nearest = min(find_velocity_peaks(scc, grid, box), key=distance, default=None)
    if nearest is not None and distance(nearest) <= 0.5:
        return nearest
    row = int(np.abs(grid.v2 - v2).argmin())
    column = int(np.abs(grid.v1 - v1).argmin())
    return VelocityPeak(float(v1), float(v2), float(scc[row, column]), row, column)


def _grid_point(scc, y, x):
    """Return the grid point of a maximum, which simple rounding may miss."""
    ends = ((int(np.floor(place)), int(np.ceil(place))) for place in (y, x))
    return max(itertools.product(*ends), key=lambda point: scc[point])
