# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stack of the paper: pairs of dates, orders, sums, its maxima and their errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from astro_scc.images.zncc import find_peaks
from astro_scc.spectrum.rays import VelocityMap

#: Gaussians are neglected beyond this many standard deviations.
REACH_SIGMA = 5.0


@dataclass(frozen=True, eq=False)
class DatePairs:
    """
    Pairs of dates that a stack compares, the earlier date first.

    Attributes
    ----------
    first, second : `~numpy.ndarray` of int, shape (n_pairs,)
        Indices of the dates.
    interval : `~numpy.ndarray`, shape (n_pairs,)
        Time between them in years, positive.
    weight : `~numpy.ndarray`, shape (n_pairs,)
        Weight of the pair in the stack.
    n_dates : int

    Examples
    --------
    >>> from astro_scc.paper import consecutive_pairs
    >>> pairs = consecutive_pairs([2000.0, 2000.5, 2002.0])
    >>> len(pairs), pairs.interval.tolist()
    (2, [0.5, 1.5])
    """

    first: np.ndarray
    second: np.ndarray
    interval: np.ndarray
    weight: np.ndarray
    n_dates: int

    def __len__(self) -> int:
        return len(self.first)

    def images(self, order: ArrayLike | None = None) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the ordered pairs of images for an order of the images over the dates.

        Parameters
        ----------
        order : array_like of int, shape (..., n_dates), optional
            Image at each date; by default the observed order.

        Returns
        -------
        reference, target : `~numpy.ndarray` of int, shape (..., n_pairs)
        """
        order = np.arange(self.n_dates) if order is None else np.asarray(order)
        return order[..., self.first], order[..., self.second]


def consecutive_pairs(years: ArrayLike) -> DatePairs:
    """
    Return the pairs of each date and the next one, as in the paper.

    Epochs of the same date have no interval between them and make no pair.

    Parameters
    ----------
    years : array_like, shape (n_dates,)
        Dates in years, ascending.

    Returns
    -------
    ``DatePairs``

    Examples
    --------
    >>> from astro_scc.paper import consecutive_pairs
    >>> consecutive_pairs([0.0, 0.5, 1.5]).interval
    array([0.5, 1. ])
    """
    gaps = np.diff(np.asarray(years, dtype=float))
    first = np.flatnonzero(gaps > 0)
    return DatePairs(first, first + 1, gaps[first], np.ones(len(first)), len(years))


def baseline_pairs(years: ArrayLike, shortest: float, longest: float) -> DatePairs:
    """
    Return all pairs of dates whose separation lies in a range.

    The weights are inverse variances: a displacement error sigma gives a
    velocity error sigma / interval, so pairs are weighted by the square of
    their interval, normalised to a mean of one.

    Parameters
    ----------
    years : array_like, shape (n_dates,)
        Dates in years, ascending.
    shortest, longest : float
        Range of separations in years, both included.

    Returns
    -------
    ``DatePairs``

    Examples
    --------
    >>> from astro_scc.paper import baseline_pairs
    >>> pairs = baseline_pairs([0.0, 0.5, 1.5], 0.8, 1.2)
    >>> pairs.first, pairs.second
    (array([1]), array([2]))
    """
    years = np.asarray(years, dtype=float)
    separation = years[None, :] - years[:, None]
    # Rounded limits must not lose a pair.  The slack is a third of a day, or 1% of
    # the longest separation if dates are minutes apart.
    slack = min(1e-3, 0.01 * longest)
    inside = (separation >= shortest - slack) & (separation <= longest + slack)
    first, second = np.nonzero(inside & (separation > 0))
    interval = separation[first, second]
    weight = interval**2 / np.mean(interval**2) if len(interval) else interval
    return DatePairs(first, second, interval, weight, len(years))


def draw_orders(
    pairs: DatePairs, n_trials: int, rng: np.random.Generator, *,
    most_pairs: int = 5000,
) -> np.ndarray:  # fmt: skip
    """
    Draw random orders of the epochs, of which few ordered pairs need matches.

    In a short series all orders are equally likely, also those in which an epoch
    keeps its successor: only then is the observed order one of them.  In a longer
    one, epochs are divided at random into groups, and each is exchanged within its
    group alone.  These orders are a group of permutations, too, so that
    probabilities stay exact however many trials there are.

    Parameters
    ----------
    pairs : ``DatePairs``
    n_trials : int
    rng : `~numpy.random.Generator`
    most_pairs : int, optional
        Number of ordered pairs of epochs, for which groups are made; 5000 are about a
        minute of correlations.  There are at least five epochs in each group.

    Returns
    -------
    `~numpy.ndarray` of int, shape (n_trials, n_dates)
        Image at each date.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.paper import consecutive_pairs, draw_orders, image_pairs
    >>> pairs = consecutive_pairs(np.arange(200.0))
    >>> orders = draw_orders(pairs, 1000, np.random.default_rng(1))
    >>> len(image_pairs(pairs, orders)) < 6000
    True
    """
    n = size = pairs.n_dates
    if n * (n - 1) > most_pairs:
        size = max(int(np.sqrt(most_pairs / len(pairs))), 5)
    orders = np.tile(np.arange(n), (n_trials, 1))
    for group in np.array_split(rng.permutation(n), max(n // size, 1)):
        orders[:, group] = rng.permuted(np.tile(group, (n_trials, 1)), axis=1)
    return orders


def image_pairs(pairs: DatePairs, orders: ArrayLike) -> np.ndarray:
    """
    Return the ordered pairs of images that a stack and its trials compare.

    Parameters
    ----------
    pairs : ``DatePairs``
    orders : array_like of int, shape (n_trials, n_dates)
        See `draw_orders`; the observed order is added.

    Returns
    -------
    `~numpy.ndarray` of int, shape (n, 2)
        Sorted, each once: the ``pairs`` of `~astro_scc.paper.Correlator`.

    Examples
    --------
    >>> from astro_scc.paper import consecutive_pairs, image_pairs
    >>> image_pairs(consecutive_pairs([0.0, 1.0, 2.0]), [[1, 0, 2]]).tolist()
    [[0, 1], [0, 2], [1, 0], [1, 2]]
    """
    reference, target = pairs.images(np.vstack([np.arange(pairs.n_dates), orders]))
    number = np.unique(reference * pairs.n_dates + target)
    return np.stack(np.divmod(number, pairs.n_dates), axis=1)


# -- the stack ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class Displacements:
    """
    Displacements of matches along two axes, with their errors.

    Attributes
    ----------
    d1, d2 : `~numpy.ndarray`, shape (n,)
        Displacement from the SSP to its match along the first and the second axis.
    s1, s2 : `~numpy.ndarray`, shape (n,)
        Their standard errors, SSP and match combined, above 0.
    weight : `~numpy.ndarray`, shape (n,)
        Correlation coefficient.
    reference, target : `~numpy.ndarray` of int, shape (n,)
        Epochs of the SSP and of the image in which it was matched.
    ssp, target_ssp : `~numpy.ndarray` of int, shape (n,)
        The SSP, and the SSP on which the match falls, or -1.
    n_ssps : `~numpy.ndarray` of int, shape (n_epochs,)
        Number of SSPs of each epoch that were correlated, with or without a match.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.paper import Displacements
    >>> one, number = np.ones(2), np.array([0, 1])
    >>> there_and_back = Displacements(
    ...     d1=np.array([0.5, -0.5]), d2=0 * one, s1=0.2 * one, s2=0.2 * one,
    ...     weight=0.9 * one, reference=number, target=number[::-1], ssp=number,
    ...     target_ssp=number[::-1], n_ssps=np.array([1, 1]))
    >>> len(there_and_back)
    2
    """

    d1: np.ndarray
    d2: np.ndarray
    s1: np.ndarray
    s2: np.ndarray
    weight: np.ndarray
    reference: np.ndarray
    target: np.ndarray
    ssp: np.ndarray
    target_ssp: np.ndarray
    n_ssps: np.ndarray

    def __len__(self) -> int:
        return len(self.d1)


def velocity_axes(v_max, step, *, most=301):
    """
    Return velocities along two axes, evenly spaced and symmetric about zero.

    Parameters
    ----------
    v_max : float or array_like, shape (2,)
        Largest velocity, above 0; two numbers are for the two axes.
    step : float or array_like, shape (2,)
        Largest spacing, above 0.
    most : int, optional
        Most velocities along an axis; the spacing grows if there would be more.

    Returns
    -------
    tuple of `~numpy.ndarray`

    Examples
    --------
    >>> from astro_scc.paper.stack import velocity_axes
    >>> velocity_axes(2.0, 0.7)[0].round(2)
    array([-2.  , -1.33, -0.67, 0.  , 0.67, 1.33, 2.  ])
    """
    v_max, step = np.broadcast_to(v_max, 2), np.broadcast_to(step, 2)
    half = np.ceil(v_max / step - 1e-9).astype(int)
    half = np.clip(half, 1, most // 2)
    axes = zip(v_max, half, strict=True)
    return tuple(v * (np.arange(-n, n + 1) / n) for v, n in axes)


def gaussian_sum(columns, axes, *, block=16384):
    """
    Return the weighted sum of axis-parallel Gaussians of unit height on a grid.

    A Gaussian is the product of its profiles, so the sum over K Gaussians
    is one matrix product, (ny x K) (K x nx).

    Parameters
    ----------
    columns : `~numpy.ndarray`, shape (5, k)
        Centres and standard deviations on both axes, and weights.
    axes : tuple of `~numpy.ndarray`, shapes (nx,) and (ny,)
    block : int, optional
        Gaussians that are summed at once, to limit memory.

    Returns
    -------
    `~numpy.ndarray`, shape (ny, nx)
    """
    grid_x, grid_y = axes
    total = np.zeros((len(grid_y), len(grid_x)))
    for start in range(0, columns.shape[1], block):
        x, y, sx, sy, weight = columns[:, start : start + block, None]
        profile_x = np.exp(-0.5 * ((grid_x - x) / sx) ** 2)
        profile_y = np.exp(-0.5 * ((grid_y - y) / sy) ** 2)
        total += (profile_y * weight).T @ profile_x
    return total


def match_velocities(displacements, pairs, order=None):
    """
    Return the matches of an order of the epochs as velocities.

    Parameters
    ----------
    displacements : `Displacements`
    pairs : ``DatePairs``
    order : `~numpy.ndarray` of int, shape (n_dates,), optional
        Image at each date; by default the observed order.

    Returns
    -------
    ends : `~numpy.ndarray` of int, shape (2, k)
        The SSP of each match, and the SSP on which it falls, or -1.
    pair : `~numpy.ndarray` of int, shape (k,)
        Its pair of dates.  A match enters at most once.
    columns : `~numpy.ndarray`, shape (5, k)
        Velocities and their errors on both axes, and weights.
    """
    d, pair = displacements, np.full((pairs.n_dates,) * 2, -1)
    pair[pairs.images(order)] = np.arange(len(pairs))
    pair = pair[d.reference, d.target]
    index = np.flatnonzero(pair >= 0)
    index = index[np.argsort(pair[index], kind="stable")]
    pair = pair[index]
    rate = 1 / pairs.interval[pair]
    columns = [column[index] * rate for column in (d.d1, d.d2, d.s1, d.s2)]
    columns.append(d.weight[index] * pairs.weight[pair])
    return np.stack([d.ssp[index], d.target_ssp[index]]), pair, np.array(columns)


def stack_matches(
    displacements, pairs, axes, *, order=None, shift=(0.0, 0.0), kind=float
):
    r"""
    Stack the correlation peaks of all SSPs and pairs of epochs.

    .. math:: C_\mathrm{SCC}(v) = \frac{\sum_t w_t \sum_j \sum_i \sum_p
              \gamma_{i,j,t}(p)\, g(v - p / \Delta t,\ \sigma / \Delta t)}
              {\sum_t w_t \sum_j N^t_{\mathrm{SSP},j}},

    where g is a Gaussian of unit height and w the weights of the pairs of dates
    (Mertens & Lobanov 2016, Eqs. 5 and 6).  SSPs without a peak count in the
    denominator.

    Parameters
    ----------
    displacements : `Displacements`
    pairs : ``DatePairs``
    axes : tuple of `~numpy.ndarray`
        Velocities along both axes, in the unit of the displacements per year.
    order : array_like of int, shape (n_dates,), optional
        Image at each date, to stack another order of the epochs.
    shift : tuple of float, optional
        Displacement that is added to all matches.
    kind : type, optional
        Of the numbers that are summed.

    Returns
    -------
    `~numpy.ndarray`, shape (n2, n1)
        Zero where there are no SSPs.
    """
    _, pair, columns = match_velocities(displacements, pairs, order)
    columns[:2] += np.multiply.outer(shift, 1 / pairs.interval[pair])
    reach = np.array([[v[-1]] for v in axes]) + REACH_SIGMA * columns[2:4]
    columns = columns[:, np.all(np.abs(columns[:2]) < reach, axis=0)]
    total = gaussian_sum(columns.astype(kind), [v.astype(kind) for v in axes])
    reference, _ = pairs.images(order)
    number = (displacements.n_ssps[reference] * pairs.weight).sum()
    return total / number if number > 0 else total


# -- streams -----------------------------------------------------------------------


def stack_patterns(
    displacements: Displacements, pairs: DatePairs, orders: ArrayLike, *,
    fwhm: ArrayLike, max_speed: ArrayLike, rng: np.random.Generator,
    shift_beams: float = 0.0, progress: Callable[[int], Any] | None = None,
) -> tuple[VelocityMap, np.ndarray, list[dict[str, Any]]]:  # fmt: skip
    """
    Measure streams by stacked cross-correlation, as in the paper.

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
    shift_beams : float, optional
        Shift of the images of a trial, in beams, along each axis and in each direction
        in turn.  A fifth is the paper's correction for small displacements, at which
        permuted epochs of standing structure correlate as well.
    progress : callable, optional
        Called with 1 for each order that was stacked.

    Returns
    -------
    velocities : ``VelocityMap``
        The stack, of Eq. 6 of the paper, and its z-score among the stacks of permuted
        epochs, zero where no trial has a correlation.
    trial_z : `~numpy.ndarray`, shape (n_trials,)
        The largest z-score of each trial among all the others and the observed order.
    components : list of dict
        The maxima of the stack, the largest z-score first: ``velocity``, shape (2,), of
        a Gaussian fitted in a box of a beam; ``covariance`` over trials with shifted
        SSPs, NaN if fewer than three have it; ``coefficient``; ``z_score``, the height
        above the mean of the trials in their standard deviations; ``p_global``, the
        probability that permuted epochs have as large a z-score at any velocity, and
        ``p_global_err``, its Monte Carlo error; ``offset1`` and ``offset2``, the mean
        over the trials with shifted SSPs from the velocity, a small part of the error
        where that is valid; ``p_normal``, the probability that a normal distribution of
        these trials looks less normal; ``found``, the share of them in which the
        maximum is found again; ``n_ssp`` and ``n_pairs``, SSPs with a match within two
        standard errors, and their pairs of dates.

    Raises
    ------
    ValueError
        If the orders are not two or more permutations of the epochs.

    Examples
    --------
    From a cube of images, step by step; `astro_scc.paper.method.measure_as_in_paper`
    does the same in one call:

    >>> import numpy as np
    >>> from astro_scc.paper import Correlator
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
    >>> _, _, components = stack_patterns(
    ...     displacements, pairs, orders, fwhm=10.0, max_speed=30.0, rng=rng)
    >>> [round(component["velocity"][0]) for component in components[:1]]
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
    velocities, points = find_velocity_peaks(coefficient, axes, box)
    heights = z_score[tuple(points.T)]
    order = np.argsort(-heights, kind="stable")
    # But for the first, those that more than half of the trials exceed are left out.
    strong = [k for k in order[1:] if heights[k] > np.median(trial_z)]
    matches = match_velocities(displacements, pairs)
    components = [
        {"coefficient": coefficient[tuple(points[k])]}
        | _component(matches, velocities[k], box, heights[k], trial_z, rng)
        for k in [*order[:1], *strong]
    ]
    return VelocityMap(*axes, coefficient, z_score), trial_z, components


def _axes(displacements, pairs, max_speed):
    """Return velocities half a standard error of the surest match apart, or less."""
    step = max_speed / 20
    if len(displacements):
        narrowest = np.array([displacements.s1.min(), displacements.s2.min()])
        step = np.minimum(step, 0.5 * narrowest / pairs.interval.max())
    return velocity_axes(max_speed, step)


def _significance(stacks, least_std=0.3):
    """
    Return the z-score of the first of many stacks.

    Each stack is compared with all others, so that under permutations the first is one
    of equals.  The largest z-score of each of the others is returned, too.  Standard
    deviations are at least ``least_std`` of the largest one: where hardly a trial has a
    match, a small coefficient is no discovery.
    """
    n = len(stacks)
    total = stacks.sum(axis=0, dtype=float)
    squares = np.einsum("kij,kij->ij", stacks, stacks, dtype=float)
    variance = np.maximum(squares / n - (total / n) ** 2, 0.0)
    floor = least_std * np.sqrt(variance.max() * n / (n - 1))
    highest = np.zeros(n)
    for k in range(n - 1, -1, -1):
        one = stacks[k].astype(float)
        mean = (total - one) / (n - 1)
        variance = (squares - one**2 - (n - 1) * mean**2) / (n - 2)
        std = np.sqrt(np.maximum(variance, floor**2))
        z_score = np.divide(one - mean, std, out=np.zeros_like(std), where=std > 0)
        highest[k] = z_score.max()
    return z_score, highest[1:]


def _component(matches, velocity, box, z_score, trial_z, rng):
    """Return a maximum with its significance, errors, and matches."""
    n, (ends, pair, columns) = len(trial_z), matches
    # Equal orders give equal z-scores within rounding.
    larger = np.count_nonzero(trial_z >= z_score * (1 - 1e-6))
    p_global = (1 + larger) / (n + 1)
    away = jitter_positions(ends, columns, velocity, box, n, rng)
    covariance, offset = np.full((2, 2), np.nan), np.full(2, np.nan)
    if len(away) >= 3:
        covariance, offset = np.cov(away.T), away.mean(axis=0)
    member = np.hypot(*((columns[:2].T - velocity).T / columns[2:4])) <= 2
    return {
        "velocity": velocity, "covariance": covariance, "z_score": z_score,
        "p_global": p_global, "p_global_err": np.sqrt(p_global * (1 - p_global) / n),
        "offset1": offset[0], "offset2": offset[1],
        "p_normal": normal_probability(away), "found": len(away) / n,
        "n_ssp": len(np.unique(ends[0, member])),
        "n_pairs": len(np.unique(pair[member])),
    }  # fmt: skip


# -- maxima and their errors -------------------------------------------------------


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
    scc: np.ndarray, axes: tuple[np.ndarray, np.ndarray], box: tuple[float, float],
    *, level: float = 0.5,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """
    Find the maxima of a stack and fit a Gaussian to a box around each.

    Only grid points in the box that reach ``level`` of the maximum and are nearer
    to it than to any other maximum enter the fit: neighbouring maxima would
    attract the fit, and unrelated matches beneath the maximum would widen it.

    Parameters
    ----------
    scc : `~numpy.ndarray`, shape (n2, n1)
    axes : tuple of `~numpy.ndarray`, shapes (n1,) and (n2,)
        Velocities, evenly spaced.
    box : tuple of float
        Sides of the box along the two axes; in the paper, the beam divided by
        the interval.
    level : float, optional
        Smallest value that enters the fit, as a fraction of the maximum.

    Returns
    -------
    velocities : `~numpy.ndarray`, shape (n, 2)
        From the Gaussian fit or, if no Gaussian with a maximum in the box fits, from
        the local Gaussian; in the order of decreasing coefficient.
    points : `~numpy.ndarray` of int, shape (n, 2)
        Row and column of the grid point of each maximum.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.paper.stack import find_velocity_peaks
    >>> v = np.linspace(-4, 4, 33)
    >>> scc = np.exp(-((v - 1.1) ** 2 + v[:, None] ** 2) / 2)
    >>> velocities, _ = find_velocity_peaks(scc, (v, v), (2.0, 2.0))
    >>> velocities.round(3) + 0
    array([[1.1, 0. ]])
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
        use = nearest & (scc[part] >= level * scc[row, column])
        values = np.where(use, scc[part], 0.0)
        fit = fit_gaussian(values, axis1[near1], axis2[near2])
        if fit is not None:
            away1, away2 = np.abs(np.subtract(fit, (v1, v2)))
            if away1 <= max(box[0] / 2, step1) and away2 <= max(box[1] / 2, step2):
                v1, v2 = fit
        found.append((v1, v2))
    pixels = np.reshape(points, (-1, 2)).astype(int)
    order = np.argsort(-scc[tuple(pixels.T)], kind="stable")
    return np.reshape(found, (-1, 2))[order], pixels[order]


def jitter_positions(
    ends: np.ndarray, columns: np.ndarray, velocity: np.ndarray,
    box: tuple[float, float], n_trials: int, rng: np.random.Generator, *,
    n_points: int = 21,
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
    velocity : `~numpy.ndarray`, shape (2,)
        Of the maximum.
    box : tuple of float
        Sides of the box, see `find_velocity_peaks`.
    n_trials : int
    rng : `~numpy.random.Generator`
    n_points : int, optional
        Grid points of a box on each axis.

    Returns
    -------
    `~numpy.ndarray`, shape (n_found, 2)
        How far the maximum lies from the formal one, along both axes, in the trials in
        which it is found.
    """
    box = np.asarray(box, dtype=float)
    # Two boxes wide, so that what the fit takes from a box is inside.
    axes = velocity_axes(box, box / (n_points - 1))
    place = columns[:2] - np.reshape(velocity, (2, 1))
    reach = box[:, None] + REACH_SIGMA * columns[2:4]
    near = np.all(np.abs(place) < reach, axis=0)
    (ssp, target), place, width = ends[:, near], place[:, near], columns[2:4, near]
    # An SSP is one position in all its matches, at either end of a displacement; an end
    # without an SSP is a position of its own.
    target = np.where(target < 0, -1 - np.arange(len(target)), target)
    positions, number = np.unique([ssp, target], return_inverse=True)
    (start, end), found = number.reshape(2, -1), []
    for _ in range(n_trials):
        # Each end of a displacement has half of its variance.
        unit = rng.standard_normal((2, len(positions))) / np.sqrt(2)
        moved = place + width * (unit[:, end] - unit[:, start])
        local = gaussian_sum(np.vstack([moved, width, columns[4, near]]), axes)
        maxima, _ = find_velocity_peaks(local, axes, box)
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
    >>> from astro_scc.paper.stack import normal_probability
    >>> values = np.random.default_rng(1).normal(size=(500, 2))
    >>> bool(normal_probability(values) > 0.05 > normal_probability(values**3))
    True
    """
    n = len(values)
    covariance = np.cov(values.T, bias=True) if n >= 8 else np.zeros((2, 2))
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
