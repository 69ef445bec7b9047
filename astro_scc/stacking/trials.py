# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The trials of the paper: permuted epochs, and SSPs shifted by their errors."""

import math
from dataclasses import dataclass, replace

import numpy as np

from astro_scc.decomposition.segmentation import quadratic_peak
from astro_scc.stacking.stack import gaussian_sum, sample_velocities

#: Standard deviations of stacks are at least this fraction of the largest one.
STD_FLOOR = 0.01
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
