# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stack of the paper: pairs of dates, orders of trials, sums over matches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

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
    every = np.vstack([np.arange(pairs.n_dates), orders])
    reference, target = pairs.images(every)
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
