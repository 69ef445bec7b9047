# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stacked cross-correlation of the paper: its maxima, z-score and error."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_interp_spline

from astro_scc.decomposition.segmentation import quadratic_peak
from astro_scc.paper.peaks import VelocityPeak, find_velocity_peaks
from astro_scc.paper.stack import VelocityGrid, gaussian_sum
from astro_scc.paper.trials import DatePairs
from astro_scc.stacking.velocities import VelocitySamples

#: Gaussians are neglected beyond this many standard deviations.
REACH_SIGMA = 5.0
#: Largest distance of the maximum of a velocity at rest, and of any, in boxes.
NEAR = 0.1, 0.5
#: Factorials of larger numbers of epochs are replaced by that of this one.
MOST = 20
#: Standard deviations of stacks are at least this fraction of the largest one.
STD_FLOOR = 0.01
#: Grid points of a box on each axis.
POINTS = 25
#: Spacing of the maps of pairs of images in units of the narrowest kernel.
STEP_SIGMA = 2 / 3
#: Margin of the maps beyond the largest velocity, in kernels: room for shifts.
MARGIN = 6.0
#: Degree of the interpolating spline; with the step above its error is 1e-4.
DEGREE = 7
#: Number of nodes beyond the shortest and the longest interval, so that the ends of the
#: spline between intervals do not matter.
BEYOND = 3
#: With more intervals, stacks are made in single precision.
FEW_INTERVALS = 8
#: Bytes of stacks that are made at once; of maps that are kept (if all maps take more,
#: they are made as needed); and of maps that are added up at once.
BLOCK_BYTES, MAP_BYTES, WORK_BYTES = 2**26, 2**28, 2**24
#: Largest number of points of an axis of the maps.
MAX_SIZE = 1001


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
        At the velocity itself if no maximum is near.
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


# -- permuted epochs ---------------------------------------------------------------


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


def permuted_z_score(
    scc, samples, pairs, grid, n_trials, *, rng, shift=None, progress=None
):  # fmt: skip
    """
    Return the z-score of a stack among those of permuted epochs (paper, Sect. 2.3).

    It is ``(C - mean) / std``, where the standard deviation is at least a hundredth of
    its largest value; where no trial has any correlation, it is zero.  It is not a
    probability: the paper's 11 sigma come from 1000 trials.

    Parameters
    ----------
    scc : `~numpy.ndarray`, shape ``grid.shape``
        The stack.
    samples : ``VelocitySamples``
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
    `~numpy.ndarray`, shape ``grid.shape``
    """
    orders = random_permutations(pairs.n_dates, n_trials, rng)
    pair_maps = PairMaps(samples, pairs, grid)
    parts = [(orders, (0.0, 0.0))]
    if shift is not None:
        s1, s2 = shift
        shifts = [(s1, 0.0), (-s1, 0.0), (0.0, s2), (0.0, -s2)]
        parts = [(orders[i::4], s) for i, s in enumerate(shifts)]
    total, squares = np.zeros(grid.shape), np.zeros(grid.shape)
    for some, offset in parts:
        for block in pair_maps.stacks(some, shift=offset):
            total += block.sum(axis=0)
            squares += np.einsum("tij,tij->ij", block, block)
            if progress is not None:
                progress(len(block))
    mean = total / n_trials
    variance = np.maximum(squares / n_trials - mean**2, 0.0)
    std = np.sqrt(variance * n_trials / (n_trials - 1))
    std = np.maximum(std, STD_FLOOR * std.max())
    return np.divide(scc - mean, std, out=np.zeros_like(scc), where=std > 0)


class PairMaps:
    """
    The correlation peaks of each ordered pair of images as a map.

    The maps are in displacement and do not depend on dates.  A stack is the
    sum, over pairs of dates, of the map of the two images at these dates,
    stretched by the interval, which is a product with two small matrices.  It
    agrees with `stack` within 1e-3 of the maximum.

    Parameters
    ----------
    samples : ``VelocitySamples``
    pairs : ``DatePairs``
    grid : ``VelocityGrid``

    Attributes
    ----------
    axis1, axis2 : `~numpy.ndarray`
        Displacements at which the maps are sampled.
    map_bytes : int
        Bytes of one map.
    """

    def __init__(self, samples, pairs, grid):
        self.samples, self.pairs, self.grid = samples, pairs, grid
        d, n, axes = samples, samples.n_epochs, []
        v_max, longest = grid.v_max, pairs.interval.max()
        for position, sigma, v in ((d.d1, d.s1, v_max[0]), (d.d2, d.s2, v_max[1])):
            position, sigma = (a if len(d) else np.ones(1) for a in (position, sigma))
            narrow, farthest = sigma.min(), np.abs(position).max()
            reach = v * longest + MARGIN * narrow
            reach = min(reach, farthest + REACH_SIGMA * sigma.max())
            half = int(np.ceil(reach / (STEP_SIGMA * narrow)))
            half = min(max(half, DEGREE), MAX_SIZE // 2)
            axes.append(np.linspace(-reach, reach, 2 * half + 1))
        self.axis1, self.axis2 = axes
        self.map_bytes = 4 * len(self.axis1) * len(self.axis2)
        # Matches sorted by pair of images, and where those of images (r, t) begin, at
        # r * n + t.
        pair = d.reference.astype(int) * n + d.target
        self._index = np.argsort(pair, kind="stable").astype(np.int32)
        self._ends = np.searchsorted(pair[self._index], np.arange(n * n + 1))
        # Row of each pair of images in the maps, or -1 without matches.
        used = np.diff(self._ends) > 0
        self._rows = np.where(used, np.cumsum(used) - 1, -1)
        fits = used.sum() * self.map_bytes <= MAP_BYTES
        self._everything = self._maps(np.flatnonzero(used)) if fits else None

    def _maps(self, pairs):
        """Return maps of pairs of images, spline coefficients in single precision."""
        d, axes = self.samples, (self.axis1, self.axis2)
        to1, to2 = (
            make_interp_spline(axis, np.eye(len(axis)), k=DEGREE).c.astype(np.float32)
            for axis in axes
        )
        arrays = *axes, d.d1, d.d2, d.s1, d.s2, d.weight
        axis1, axis2, *columns = (a.astype(np.float32) for a in arrays)
        maps = np.empty((len(pairs), len(axis2) * len(axis1)), dtype=np.float32)
        for own, pair in zip(maps, pairs.tolist(), strict=True):
            k = self._index[self._ends[pair] : self._ends[pair + 1]]
            values = gaussian_sum(*(a[k] for a in columns), axis1, axis2)
            own[:] = (to2 @ values.astype(np.float32) @ to1.T).ravel()
        return maps

    def stacks(self, orders, *, shift=(0.0, 0.0)):
        """
        Return the stacks of many permutations of the images over the dates.

        Parameters
        ----------
        orders : `~numpy.ndarray` of int, shape (n_orders, n_dates)
            Image at each date.
        shift : tuple of float, optional
            Displacement added to all matches.

        Yields
        ------
        `~numpy.ndarray`, shape (m, n2, n1)
            Blocks of stacks, in the order of ``orders``.
        """
        stretch, shape = _Stretch(self, shift), self.grid.shape
        # One stack at a time stays in the cache; where maps are made again for each
        # block, blocks are large.
        size = max(1, BLOCK_BYTES // (8 * shape[0] * shape[1]))
        size = 1 if self._everything is not None else size
        for start in range(0, len(orders), size):
            some = orders[start : start + size]
            reference, target = self.pairs.images(some)
            total = np.zeros((len(some), *shape))
            for maps, rows in self._parts(reference * self.samples.n_epochs + target):
                for own, row in zip(total, rows, strict=True):
                    stretch(maps, row, own)
                # Freed before the next part is made.
                del maps
            total /= number_of_ssps(self.samples, self.pairs, some)[:, None, None]
            yield total

    def _parts(self, images):
        """Yield as many maps as fit into memory, and the rows of the pairs in them."""
        if self._everything is not None:
            yield self._everything, self._rows[images]
            return
        used = np.unique(images)
        used = used[self._rows[used] >= 0]
        most = max(1, MAP_BYTES // self.map_bytes)
        for start in range(0, len(used), most):
            part = used[start : start + most]
            rows = np.full(len(self._rows), -1)
            rows[part] = np.arange(len(part))
            yield self._maps(part), rows[images]


class _Stretch:
    """
    The transformation of maps in displacement to stacks in velocity.

    The stack of a map is a smooth function of the interval.  Maps are therefore
    first added up at a few intervals, with the weights of a spline between
    them, and then stretched.
    """

    def __init__(self, maps, shift):
        grid, weight = maps.grid, maps.pairs.weight
        self.size = len(maps.axis2), len(maps.axis1)
        at, share = _intervals(maps)
        # If dates are even or few, permutations tie, which needs double precision.
        kind = np.float32 if len(at) > FEW_INTERVALS else float
        # Spline weight of each pair of dates at the intervals, times its weight in the
        # stack, shape (n_intervals, n_pairs).
        self.share = share.astype(kind) * weight.astype(kind)
        # For each interval, the part of the map that is needed and the matrices along
        # both axes, of which the second are beside each other.
        self.steps, twos, self.ends = [], [], [0]
        for interval in at:
            columns, one = _basis(maps.axis1, grid.v1 * interval - shift[0])
            rows, two = _basis(maps.axis2, grid.v2 * interval - shift[1])
            to1 = np.ascontiguousarray(one.T, dtype=kind)
            self.steps.append(((rows, columns), to1))
            twos.append(two.astype(kind))
            self.ends.append(self.ends[-1] + two.shape[1])
        self.to2 = np.concatenate(twos, axis=1)

    def __call__(self, maps, row, total):
        """Add the stack of one permutation, given the rows of its pairs, to a total."""
        slots, kind = np.flatnonzero(row >= 0), self.share.dtype
        if len(slots) == 0:
            return
        # To save memory, only a few intervals and pairs of dates at a time.
        few = max(1, WORK_BYTES // (kind.itemsize * maps.shape[1]))
        for first in range(0, len(self.share), few):
            some, added = slice(first, first + few), 0
            for start in range(0, len(slots), few):
                use = slots[start : start + few]
                values = maps[row[use]].astype(kind, copy=False)
                added = added + self.share[some, use] @ values
            added = added.reshape(-1, *self.size)
            steps = self.steps[some]
            lines = np.concatenate(
                [m[p] @ to1 for m, (p, to1) in zip(added, steps, strict=True)]
            )
            end = self.ends[first + len(steps)]
            total += self.to2[:, self.ends[first] : end] @ lines


def _basis(axis, positions):
    """
    Return the matrix from coefficients to values, which are zero beyond the axis.

    Only columns that are not all zero are returned, after a slice that selects them.
    """
    knots = make_interp_spline(axis, axis, k=DEGREE).t
    inside = np.abs(positions) <= axis[-1]
    at = np.clip(positions, axis[0], axis[-1])
    basis = BSpline.design_matrix(at, knots, DEGREE).toarray()
    basis = np.where(inside[:, None], basis, 0.0)
    used = np.flatnonzero(basis.any(axis=0))
    part = slice(used[0], used[-1] + 1) if len(used) else slice(0, 0)
    return part, basis[:, part]


def _intervals(maps):
    """
    Return the intervals by which maps are stretched, and the weights of pairs in them.

    Returns
    -------
    at : `~numpy.ndarray`, shape (n,)
    share : `~numpy.ndarray`, shape (n, n_pairs)
    """
    d, grid, interval = maps.samples, maps.grid, maps.pairs.interval
    own, kind = np.unique(np.round(interval, 9), return_inverse=True)
    if len(own) > 1 and len(d):
        # Along the line v t the map varies on the scale of the kernel.
        fastest = np.hypot(*np.divide(grid.v_max, (d.s1.min(), d.s2.min())))
        number = int(np.ceil(np.ptp(own) * fastest / STEP_SIGMA)) + 1
        number = max(number + 2 * BEYOND, DEGREE + 1)
        if number < len(own):
            step = np.ptp(own) / (number - 1 - 2 * BEYOND)
            at = own[0] + step * np.arange(-BEYOND, number - BEYOND)
            return at, make_interp_spline(at, np.eye(number), k=DEGREE)(own)[kind].T
    return own, (kind == np.arange(len(own))[:, None]).astype(float)


# -- errors ------------------------------------------------------------------------


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
    `~numpy.ndarray`, shape (2, 2)
        Covariance of the maximum over the trials; NaN if fewer than 3 have one.
    """
    index, *columns = sample_velocities(samples, pairs)
    # The rows are velocities and their errors on both axes, and weights.
    columns, half = np.array(columns), np.array(box) / 2
    centre = np.array([peak.v1, peak.v2])
    apart = np.abs(columns[:2] - centre[:, None])
    near = np.all(apart < half[:, None] + 5 * columns[2:4], axis=0)
    index, columns = index[near], columns[:, near]
    # Single precision is enough for positions in units of the box.
    columns[:2] -= centre[:, None]
    columns[:4] /= half[[0, 1, 0, 1], None]
    x, y, sx, sy, w = columns.astype(np.float32)
    grid = np.linspace(-1, 1, POINTS)
    grids = (grid.astype(np.float32),) * 2
    # An SSP is one position in all its matches, at either end of a displacement; an end
    # without an SSP is a position of its own.
    end = samples.target_ssp[index]
    end = np.where(end < 0, -1 - np.arange(len(end)), end)
    both = np.stack([samples.ssp[index], end])
    positions, number = np.unique(both, return_inverse=True)
    (start, end), found = number.reshape(both.shape), []
    for _ in range(n_trials):
        # Each end of a displacement has half of its variance.
        unit = rng.standard_normal((2, len(positions))) / np.sqrt(2)
        shift = (unit[:, end] - unit[:, start]).astype(np.float32)
        moved = x + sx * shift[0], y + sy * shift[1]
        local = gaussian_sum(*moved, sx, sy, w, *grids)
        row, column = np.unravel_index(np.argmax(local), local.shape)
        # A maximum on the border is none.
        if 0 < row < POINTS - 1 and 0 < column < POINTS - 1:
            around = local[row - 1 : row + 2, column - 1 : column + 2]
            dy, dx, _ = quadratic_peak(around)
            found.append(grid[[column, row]] + (grid[1] - grid[0]) * np.array([dx, dy]))
    if len(found) < 3:
        return np.full((2, 2), np.nan)
    return np.cov(np.transpose(found)) * np.outer(half, half)
