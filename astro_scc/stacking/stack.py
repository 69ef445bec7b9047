# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stacked cross-correlation on a grid of velocities: maxima and permutations."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from astro_scc.correlation.zncc import find_peaks
from astro_scc.decomposition.segmentation import quadratic_peak
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
        As in `find_velocity_peaks`; the maximum must lie within half of it, and be
        nearer to the velocity than to rest.
    v1, v2 : float

    Returns
    -------
    `VelocityPeak`
        At the velocity itself, and not ``fitted``, if no maximum is near.
    """

    def distance(c):
        return np.hypot((c.v1 - v1) / box[0], (c.v2 - v2) / box[1])

    nearest = min(find_velocity_peaks(scc, grid, box), key=distance, default=None)
    near = np.clip(0.5 * np.hypot(v1 / box[0], v2 / box[1]), *NEAR)
    if nearest is not None and distance(nearest) <= near:
        return nearest
    row = int(np.abs(grid.v2 - v2).argmin())
    column = int(np.abs(grid.v1 - v1).argmin())
    return VelocityPeak(float(v1), float(v2), float(scc[row, column]), row, column)


def _grid_point(scc, y, x):
    """Return the grid point of a maximum, which simple rounding may miss."""
    ends = ((int(np.floor(place)), int(np.ceil(place))) for place in (y, x))
    return max(itertools.product(*ends), key=lambda point: scc[point])


#: Standard deviations of stacks are at least this fraction of the largest one.
STD_FLOOR = 0.01
#: Largest distance of the maximum of a velocity at rest, and of any, in boxes.
NEAR = 0.1, 0.5
#: Factorials of larger numbers of epochs are replaced by that of this one.
MOST = 20
#: Grid points of a box on each axis.
POINTS = 25


def number_of_permutations(n_epochs):
    """
    Return the number of different orders, where a reversed order is the same one.

    Parameters
    ----------
    n_epochs : int

    Returns
    -------
    float
    """
    return max(math.factorial(min(n_epochs, MOST)) / 2, 1.0)


def random_permutations(n_epochs, n_trials, rng):
    """Return random permutations, all equally likely, (n_trials, n_epochs)."""
    return rng.permuted(np.tile(np.arange(n_epochs), (n_trials, 1)), axis=1)


@dataclass(frozen=True, eq=False)
class PermutedStacks:
    """Mean and standard deviation of the stacks of permuted epochs, on the grid."""

    mean: np.ndarray
    std: np.ndarray

    def z_score(self, scc):
        """
        Return the z-score of a stack, ``(C - mean) / std`` (paper, Sect. 2.3).

        It is not a probability: the paper's 11 sigma come from 1000 trials.  The
        standard deviation is at least a hundredth of its largest value; where no
        trial has any correlation, the result is zero.
        """
        floor = np.maximum(self.std, STD_FLOOR * self.std.max(initial=0.0))
        excess = scc - self.mean
        return np.divide(excess, floor, out=np.zeros_like(excess), where=floor > 0)


def permute_stacks(pair_maps, pairs, grid, n_trials, *, rng, shift=None, progress=None):
    """
    Stack the epochs in many permuted orders, for the paper's z-score.

    Parameters
    ----------
    pair_maps : `~astro_scc.stacking.pair_maps.PairMaps`
    pairs : ``DatePairs``
    grid : ``VelocityGrid``
    n_trials : int
    rng : `~numpy.random.Generator`
    shift : tuple of float, optional
        Displacement (in the paper, a fifth of the beam) by which the images
        of a trial are shifted, along each axis and in each direction in turn.
        This is the paper's correction for small displacements, at which
        permuted epochs of standing structure still correlate.
    progress : callable, optional
        Called with the number of trials done since the last call.

    Returns
    -------
    `PermutedStacks`
    """
    orders = random_permutations(pairs.n_dates, n_trials, rng)
    # A copy, so that the maps that it caches are freed with it.
    pair_maps = replace(pair_maps)
    parts = [(orders, (0.0, 0.0))]
    if shift is not None:
        s1, s2 = shift
        shifts = [(s1, 0.0), (-s1, 0.0), (0.0, s2), (0.0, -s2)]
        parts = [(orders[i::4], s) for i, s in enumerate(shifts)]
    total, squares = np.zeros(grid.shape), np.zeros(grid.shape)
    for some, offset in parts:
        for block in pair_maps.stacks(pairs, grid, some, shift=offset):
            total += block.sum(axis=0)
            squares += np.einsum("tij,tij->ij", block, block)
            if progress is not None:
                progress(len(block))
    mean = total / n_trials
    variance = np.maximum(squares / n_trials - mean**2, 0.0)
    return PermutedStacks(mean, np.sqrt(variance * n_trials / (n_trials - 1)))


@dataclass(frozen=True, eq=False)
class JitteredVelocity:
    """
    Outcome of the velocity-jitter test, in which SSPs are shifted by their errors.

    Attributes
    ----------
    covariance : `~numpy.ndarray`, shape (2, 2)
        Covariance of the velocity peak over the trials.
    bias : `~numpy.ndarray`, shape (2,)
        Mean of the trials minus the observed velocity, which is that of the
        maximum in the box without shifts.
    share : float
        Fraction of the trials that have a maximum in the box.
    """

    covariance: np.ndarray
    bias: np.ndarray
    share: float


def _ends(samples, index):
    """
    Return the positions from which each match starts and at which it ends.

    They are indices of n positions.  An SSP is one position in all its matches,
    at either end of a displacement; an end without an SSP is a position of its
    own.  n is returned as well.
    """
    start, end = samples.ssp[index], samples.target_ssp[index]
    end = np.where(end < 0, -1 - np.arange(len(end)), end)
    positions, number = np.unique(np.concatenate([start, end]), return_inverse=True)
    return number[: len(start)], number[len(start) :], len(positions)


def jitter_positions(samples, pairs, peak, box, n_trials, *, rng):
    """
    Shift the SSPs by their position errors and follow a velocity peak.

    Each trial draws one shift for every SSP from a normal distribution
    (paper, Sect. 2.4), stacks the matches around the peak again and
    finds the maximum.

    Parameters
    ----------
    samples : ``VelocitySamples``
    pairs : ``DatePairs``
    peak : ``VelocityPeak``
    box : tuple of float
        Sides of the box around the peak in which the maximum is searched.
    n_trials : int
    rng : `~numpy.random.Generator`

    Returns
    -------
    `JitteredVelocity`
        Its covariance is NaN if fewer than 3 trials have a maximum.
    """
    index, *columns = sample_velocities(samples, pairs)
    # The rows are velocities and their errors on both axes, and weights.
    columns, half = np.array(columns), np.array(box) / 2
    centre = np.array([peak.v1, peak.v2])
    apart = np.abs(columns[:2] - centre[:, None])
    near = np.all(apart < half[:, None] + 5 * columns[2:4], axis=0)
    index, columns = index[near], columns[:, near]
    grid1, grid2 = (
        np.linspace(v - h, v + h, POINTS) for v, h in zip(centre, half, strict=True)
    )
    observed = _maximum(gaussian_sum(*columns, grid1, grid2), grid1, grid2)
    # Single precision is enough for positions in units of the box.
    columns[:2] -= centre[:, None]
    columns[:4] /= half[[0, 1, 0, 1], None]
    x, y, sx, sy, w = columns.astype(np.float32)
    unit_grid = np.linspace(-1, 1, POINTS, dtype=np.float32)
    start, end, n = _ends(samples, index)
    found = []
    for _ in range(n_trials):
        # Each end of a displacement has half of its variance.
        unit = rng.standard_normal((2, n)) / np.sqrt(2)
        shift = (unit[:, end] - unit[:, start]).astype(np.float32)
        local = gaussian_sum(
            x + sx * shift[0], y + sy * shift[1], sx, sy, w, unit_grid, unit_grid
        )
        place = _maximum(local, grid1, grid2)
        if place is not None:
            found.append(place)
    share = len(found) / max(n_trials, 1)
    if len(found) < 3:
        unknown = np.full((2, 2), np.nan)
        return JitteredVelocity(unknown, unknown[0], share)
    bias = np.mean(found, axis=0) - (centre if observed is None else observed)
    return JitteredVelocity(np.cov(np.transpose(found)), bias, share)


def _maximum(scc, grid1, grid2):
    """Return the position of the largest value, None if it is on the border."""
    row, column = np.unravel_index(np.argmax(scc), scc.shape)
    if not (0 < row < len(grid2) - 1 and 0 < column < len(grid1) - 1):
        return None
    dy, dx, _ = quadratic_peak(scc[row - 1 : row + 2, column - 1 : column + 2])
    step1, step2 = grid1[1] - grid1[0], grid2[1] - grid2[0]
    return grid1[column] + dx * step1, grid2[row] + dy * step2
