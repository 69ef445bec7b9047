# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The paper's uncertainty: stacks of SSPs shifted by their position errors."""

from dataclasses import dataclass

import numpy as np

from astro_scc.decomposition.segmentation import quadratic_peak
from astro_scc.stacking.stack import gaussian_sum, velocities

__all__ = ["JitteredVelocity", "jitter_positions"]

#: Half-width of the searched box, in units of the component's.
SEARCH = 1.0
#: Grid points of a box on each axis.
POINTS = 25


@dataclass(frozen=True, eq=False)
class JitteredVelocity:
    """
    What happens to a component when the SSPs are shifted by their errors.

    Attributes
    ----------
    err1, err2 : float
        Standard deviation of the component's velocity over the trials.
    covariance : float
        Between the two axes.
    bias1, bias2 : float
        Mean of the trials minus the observed velocity, that of the maximum
        in the box without shifts.
    gaussian_p : float
        Smaller p-value of the two axes of D'Agostino and Pearson's test
        that the trials are Gaussian.
    share : float
        Share of the trials that have a maximum in the box.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import VelocityGrid, stack
    >>> from astro_scc.stacking import find_components, jitter_positions
    >>> rng = np.random.default_rng(1)
    >>> years, n, one = np.array([0.0, 1.0, 2.0]), 40, np.ones(40)
    >>> first = np.repeat([0, 1], 20)
    >>> d = Displacements(
    ...     d1=3 + rng.normal(0, 0.2, n), d2=rng.normal(0, 0.2, n), s1=0.3 * one,
    ...     s2=0.3 * one, weight=0.8 * one, reference=first, target=first + 1,
    ...     ssp=np.arange(n), target_ssp=np.full(n, -1), n_ssps=np.full(3, 20))
    >>> pairs = consecutive_pairs(years)
    >>> grid = VelocityGrid.covering(6.0, 0.2)
    >>> scc = stack(d, pairs, grid)
    >>> best = find_components(scc, grid, (1.5, 1.5))[0]
    >>> jittered = jitter_positions(d, pairs, best, (1.5, 1.5), 50, rng=rng)
    >>> jittered.share, bool(abs(jittered.bias1) < 3 * jittered.err1)
    (1.0, True)
    """

    err1: float
    err2: float
    covariance: float
    bias1: float
    bias2: float
    gaussian_p: float
    share: float


def _ends(displacements, index):
    """
    Which of n positions each match starts from and which it ends at.

    An SSP is one position, whatever it is matched with and whichever of the
    two ends of a displacement it is; an end without an SSP is one of its own.
    """
    start, end = displacements.ssp[index], displacements.target_ssp[index]
    end = np.where(end < 0, -1 - np.arange(len(end)), end)
    positions, number = np.unique(np.concatenate([start, end]), return_inverse=True)
    return number[: len(start)], number[len(start) :], len(positions)


def jitter_positions(displacements, pairs, component, box, n_trials, *, rng):
    """
    Shift the SSPs by their position errors and follow a component.

    Each trial draws one shift for every SSP from a normal distribution
    (paper, Sect. 2.4), stacks the matches around the component again and
    takes its maximum.

    Parameters
    ----------
    displacements : `Displacements`
    pairs : `DatePairs`
    component : `Component`
    box : tuple of float
        Sides of the box around the component in which the maximum is
        looked for.
    n_trials : int
    rng : `~numpy.random.Generator`

    Returns
    -------
    `JitteredVelocity`
        Errors are NaN if fewer than 3 trials have a maximum.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import VelocityGrid, stack
    >>> from astro_scc.stacking import find_components, jitter_positions
    >>> rng = np.random.default_rng(1)
    >>> years, n, one = np.array([0.0, 1.0, 2.0]), 40, np.ones(40)
    >>> first = np.repeat([0, 1], 20)
    >>> d = Displacements(
    ...     d1=3 + rng.normal(0, 0.2, n), d2=rng.normal(0, 0.2, n), s1=0.3 * one,
    ...     s2=0.3 * one, weight=0.8 * one, reference=first, target=first + 1,
    ...     ssp=np.arange(n), target_ssp=np.full(n, -1), n_ssps=np.full(3, 20))
    >>> pairs = consecutive_pairs(years)
    >>> grid = VelocityGrid.covering(6.0, 0.2)
    >>> scc = stack(d, pairs, grid)
    >>> best = find_components(scc, grid, (1.5, 1.5))[0]
    >>> jittered = jitter_positions(d, pairs, best, (1.5, 1.5), 200, rng=rng)
    >>> bool(0.03 < jittered.err1 < 0.15)
    True
    """
    index, v1, v2, s1, s2, weight = velocities(displacements, pairs)
    half1, half2 = SEARCH * box[0] / 2, SEARCH * box[1] / 2
    near = (np.abs(v1 - component.v1) < half1 + 5 * s1) & (
        np.abs(v2 - component.v2) < half2 + 5 * s2
    )
    index, v1, v2, s1, s2, weight = (a[near] for a in (index, v1, v2, s1, s2, weight))
    grid1 = np.linspace(component.v1 - half1, component.v1 + half1, POINTS)
    grid2 = np.linspace(component.v2 - half2, component.v2 + half2, POINTS)
    start, end, n = _ends(displacements, index)
    observed = _maximum(
        gaussian_sum(v1, v2, s1, s2, weight, grid1, grid2), grid1, grid2
    )
    found = []
    # Single precision is enough for places in units of the box.
    scaled = [
        a.astype(np.float32)
        for a in (
            (v1 - component.v1) / half1,
            (v2 - component.v2) / half2,
            s1 / half1,
            s2 / half2,
            weight,
        )
    ]
    unit_grid = np.linspace(-1, 1, POINTS, dtype=np.float32)
    for _ in range(n_trials):
        # Half the variance of a displacement belongs to either end.
        unit = rng.standard_normal((2, n)) / np.sqrt(2)
        shift = (unit[:, end] - unit[:, start]).astype(np.float32)
        x, y, sx, sy, w = scaled
        local = gaussian_sum(
            x + sx * shift[0], y + sy * shift[1], sx, sy, w, unit_grid, unit_grid
        )
        place = _maximum(local, grid1, grid2)
        if place is not None:
            found.append(place)
    if observed is None:
        observed = component.v1, component.v2
    return _summary(np.array(found).reshape(-1, 2), observed, n_trials)


def _maximum(scc, grid1, grid2):
    """Position of the largest value, None if it is on the border."""
    row, column = np.unravel_index(np.argmax(scc), scc.shape)
    if not (0 < row < len(grid2) - 1 and 0 < column < len(grid1) - 1):
        return None
    dy, dx, _ = quadratic_peak(scc[row - 1 : row + 2, column - 1 : column + 2])
    return (
        grid1[column] + dx * (grid1[1] - grid1[0]),
        grid2[row] + dy * (grid2[1] - grid2[0]),
    )


def _summary(found, observed, n_trials):
    share = len(found) / n_trials if n_trials else 0.0
    if len(found) < 3:
        return JitteredVelocity(*(np.nan,) * 6, share)
    covariance = np.cov(found.T)
    bias = found.mean(axis=0) - observed
    return JitteredVelocity(
        err1=float(np.sqrt(covariance[0, 0])),
        err2=float(np.sqrt(covariance[1, 1])),
        covariance=float(covariance[0, 1]),
        bias1=float(bias[0]),
        bias2=float(bias[1]),
        gaussian_p=_gaussian_p(found),
        share=share,
    )


def _gaussian_p(found):
    from scipy.stats import normaltest

    # The test's kurtosis part is not valid for fewer.
    if len(found) < 20 or np.any(np.ptp(found, axis=0) == 0):
        return float("nan")
    return float(np.min(normaltest(found, axis=0).pvalue))
