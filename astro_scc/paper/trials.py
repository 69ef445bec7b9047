# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Pairs of dates that a stack compares, and the orders of epochs of its trials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

#: Most ordered pairs of epochs that the trials of a series need, about a minute of
#: correlations; and fewest epochs that are exchanged with one another.
MOST_PAIRS, FEWEST_EXCHANGED = 5000, 5


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
    most_pairs: int = MOST_PAIRS,
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
        Number of ordered pairs of epochs about which groups are made.  There are at
        least five epochs in each.

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
        size = max(int(np.sqrt(most_pairs / len(pairs))), FEWEST_EXCHANGED)
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
        Sorted, each once: the ``pairs`` of `~astro_scc.correlation.Correlator`.

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
