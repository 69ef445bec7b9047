# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The paper's measurement: stack, significance, and velocity components."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from astro_scc.paper.peaks import (
    find_velocity_peaks,
    jitter_positions,
    normal_probability,
)
from astro_scc.paper.stack import (
    Displacements,
    match_velocities,
    stack_matches,
    velocity_axes,
)
from astro_scc.paper.trials import DatePairs
from astro_scc.spectrum.maps import VelocityMap

#: Spacing of the velocity grid in units of the narrowest kernel; and grid points on
#: either side of zero where there are no matches.
GRID_STEP, GRID_POINTS = 0.5, 20
#: Standard deviations of stacks are at least this fraction of the largest one: where
#: hardly a trial has a match, a small coefficient is no discovery.
STD_FLOOR = 0.3
#: Components that a larger share of the trials exceeds are left out, but for the first.
MOST_NOISE = 0.5
#: A match belongs to a component within this many of its standard errors.
MEMBER_SIGMA = 2.0


@dataclass(frozen=True)
class PaperComponent:
    """
    A maximum of a stack: a velocity component of the paper.

    Attributes
    ----------
    v1, v2 : float
        Velocity along the two axes, of a Gaussian fitted in a box of a beam.
    v1_err, v2_err, correlation : float
        Standard deviations of the maximum over trials with shifted SSPs, and their
        correlation; NaN if fewer than three trials have it.
    coefficient : float
        Stacked correlation coefficient.
    z_score : float
        Height above the mean of the trials, in their standard deviations.
    p_global : float
        Probability that permuted epochs have as large a z-score at any velocity.
    significant : bool
        Whether ``p_global`` is at most ``alpha``.
    offset1, offset2 : float
        Mean of the maximum over the trials with shifted SSPs, from the velocity: a
        small part of the error where the error is valid.
    p_normal : float
        Probability that a normal distribution of these trials looks less normal.
    found : float
        Share of these trials in which the maximum is found again.
    n_ssp, n_pairs : int
        SSPs with a match within two standard errors, and their pairs of dates.
    """

    v1: float
    v2: float
    v1_err: float
    v2_err: float
    correlation: float
    coefficient: float
    z_score: float
    p_global: float
    significant: bool
    offset1: float
    offset2: float
    p_normal: float
    found: float
    n_ssp: int
    n_pairs: int


@dataclass(frozen=True, eq=False, repr=False)
class PaperStack:
    """
    The stacked cross-correlation of a series, and its velocity components.

    Attributes
    ----------
    velocities : ``VelocityMap``
        The stack, of Eq. 6 of the paper, and its z-score among the stacks of permuted
        epochs, zero where no trial has a correlation.
    trial_z : `~numpy.ndarray`, shape (n_trials,)
        The largest z-score of each trial among all the others and the observed order.
    components : tuple of ``PaperComponent``
        The largest z-score first.
    n_ssp : int
        Number of SSPs, the denominator of the stack where weights are one.
    """

    velocities: VelocityMap
    trial_z: np.ndarray
    components: tuple[PaperComponent, ...]
    n_ssp: int

    def __repr__(self):
        n = len(self.components)
        return f"<PaperStack: {n} components of {self.n_ssp} SSPs>"


def stack_patterns(
    displacements: Displacements, pairs: DatePairs, orders: ArrayLike, *,
    fwhm: ArrayLike, max_speed: ArrayLike, rng: np.random.Generator,
    alpha: float = 0.01, shift_beams: float = 0.0,
    progress: Callable[[int], Any] | None = None,
) -> PaperStack:  # fmt: skip
    """
    Measure velocity components by stacked cross-correlation, as in the paper.

    Parameters
    ----------
    displacements : `Displacements`
        Of the matches of all ordered pairs of images that the orders compare.
    pairs : ``DatePairs``
        Pairs of dates, see `consecutive_pairs` and `baseline_pairs`.
    orders : array_like of int, shape (n_trials, n_dates)
        Orders of the images over the dates, see `draw_orders`.
    fwhm : float or array_like, shape (2,)
        Full width at half maximum of the beam along both axes.
    max_speed : float or array_like, shape (2,)
        Largest speed along both axes, in the unit of the displacements per year.
    rng : `~numpy.random.Generator`
        For the errors, which have as many trials as there are orders.
    alpha : float, optional
        Largest ``p_global`` of a significant component.
    shift_beams : float, optional
        Shift of the images of a trial, in beams, along each axis and in each direction
        in turn.  A fifth is the paper's correction for small displacements, at which
        permuted epochs of standing structure correlate as well.
    progress : callable, optional
        Called with 1 for each order that was stacked.

    Returns
    -------
    ``PaperStack``

    Raises
    ------
    ValueError
        If the orders are not two or more permutations of the epochs.

    Examples
    --------
    From a cube of images, step by step; `astro_scc.paper_method.measure_as_in_paper`
    does the same in one call:

    >>> import numpy as np
    >>> from astro_scc.correlation import Correlator
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.paper import (
    ...     Displacements, consecutive_pairs, draw_orders, image_pairs, stack_patterns)
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube, rng = simulate_two_fluid(n_epochs=6, rng=1).cube, np.random.default_rng(1)
    >>> epochs = [Decomposer(scales=[2, 3])(image) for image in cube.data]
    >>> ssps = SSPs.of_epochs(epochs)
    >>> pairs = consecutive_pairs(np.arange(len(cube)))
    >>> orders = draw_orders(pairs, 50, rng)
    >>> matches = Correlator()(epochs, image_pairs(pairs, orders), (10, 35))
    >>> two = np.full(len(matches), 2.0)
    >>> displacements = Displacements(
    ...     d1=matches.dx, d2=matches.dy, s1=two, s2=two, weight=matches.coefficient,
    ...     reference=ssps.epoch[matches.ssp], target=matches.target, ssp=matches.ssp,
    ...     target_ssp=-np.ones(len(matches), dtype=int),
    ...     n_ssps=np.bincount(ssps.epoch, minlength=len(cube)))
    >>> found = stack_patterns(
    ...     displacements, pairs, orders, fwhm=10.0, max_speed=30.0, rng=rng)
    >>> [round(component.v1) for component in found.components[:1]]
    [5]
    """
    orders, n = np.asarray(orders), pairs.n_dates
    every = np.tile(np.arange(n), (len(orders), 1))
    if len(orders) < 2 or not np.array_equal(np.sort(orders), every):
        raise ValueError(f"orders must be two or more permutations of {n} epochs")
    fwhm, max_speed = np.broadcast_to(fwhm, 2), np.broadcast_to(max_speed, 2)
    axes = _axes(displacements, pairs, max_speed)
    shifts = shift_beams * fwhm * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    # Single precision halves the time; ties of equal orders stay ties.
    stacks = np.empty((len(orders) + 1, *map(len, axes[::-1])), dtype=np.float32)
    stacks[0] = stack_matches(displacements, pairs, axes, kind=np.float32)
    for k, order in enumerate(orders):
        stacks[k + 1] = stack_matches(
            displacements, pairs, axes, order=order, shift=shifts[k % 4],
            kind=np.float32,
        )  # fmt: skip
        if progress is not None:
            progress(1)
    z_score, trial_z = _significance(stacks)
    box = tuple(fwhm / np.average(pairs.interval, weights=pairs.weight))
    coefficient = stack_matches(displacements, pairs, axes)
    peaks = find_velocity_peaks(coefficient, axes, box)
    peaks.sort(key=lambda c: -z_score[c.row, c.column])
    noise = np.quantile(trial_z, 1 - MOST_NOISE)
    strong = [c for c in peaks[1:] if z_score[c.row, c.column] > noise]
    matches = match_velocities(displacements, pairs)
    components = tuple(
        _component(matches, c, box, z_score[c.row, c.column], trial_z, alpha, rng)
        for c in peaks[:1] + strong
    )
    number = int(displacements.n_ssps[np.unique(pairs.first)].sum())
    velocities = VelocityMap(*axes, coefficient, z_score)
    return PaperStack(velocities, trial_z, components, number)


def _axes(displacements, pairs, max_speed):
    rate = GRID_STEP / pairs.interval.max()
    step = max_speed / GRID_POINTS
    if len(displacements):
        narrowest = np.array([displacements.s1.min(), displacements.s2.min()])
        step = np.minimum(step, rate * narrowest)
    return velocity_axes(max_speed, step)


def _significance(stacks):
    """
    Return the z-score of the first of many stacks.

    Each stack is compared with all others, so that under permutations the first is one
    of equals.  The largest z-score of each of the others is returned, too.
    """
    n = len(stacks)
    total = stacks.sum(axis=0, dtype=float)
    squares = np.einsum("kij,kij->ij", stacks, stacks, dtype=float)
    variance = np.maximum(squares / n - (total / n) ** 2, 0.0)
    floor = STD_FLOOR * np.sqrt(variance.max() * n / (n - 1))
    highest = np.zeros(n)
    for k in range(n - 1, -1, -1):
        stack = stacks[k].astype(float)
        mean = (total - stack) / (n - 1)
        variance = (squares - stack**2 - (n - 1) * mean**2) / (n - 2)
        std = np.sqrt(np.maximum(variance, floor**2))
        z_score = np.divide(stack - mean, std, out=np.zeros_like(std), where=std > 0)
        highest[k] = z_score.max()
    return z_score, highest[1:]


def _component(matches, peak, box, z_score, trial_z, alpha, rng):
    """Return a maximum with its significance, errors, and matches."""
    n_trials = len(trial_z)
    # Equal orders give equal z-scores within rounding.
    larger = np.count_nonzero(trial_z >= z_score * (1 - 1e-6))
    p_global = (1 + larger) / (n_trials + 1)
    ends, pair, columns = matches
    away = jitter_positions(ends, columns, peak, box, n_trials, rng)
    covariance, offset = np.full((2, 2), np.nan), np.full(2, np.nan)
    if len(away) >= 3:
        covariance, offset = np.cov(away.T), away.mean(axis=0)
    error = np.sqrt(np.diag(covariance))
    v1, v2, s1, s2, _ = columns
    member = np.hypot((v1 - peak.v1) / s1, (v2 - peak.v2) / s2) <= MEMBER_SIGMA
    n_ssp = len(np.unique(ends[0, member]))
    return PaperComponent(
        peak.v1, peak.v2, *error.tolist(), float(covariance[0, 1] / np.prod(error)),
        peak.coefficient, float(z_score), p_global, p_global <= alpha,
        *offset.tolist(), normal_probability(away), len(away) / n_trials,
        n_ssp, len(np.unique(pair[member])),
    )  # fmt: skip
