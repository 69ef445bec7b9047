# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The paper's error of a velocity: SSPs shifted by the errors of their positions."""

from dataclasses import dataclass

import numpy as np

from astro_scc.decomposition.segmentation import quadratic_peak
from astro_scc.stacking.stack import gaussian_sum, sample_velocities

#: Grid points of a box on each axis.
POINTS = 25


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
