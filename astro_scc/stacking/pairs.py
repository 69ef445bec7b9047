# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which pairs of dates enter a stack."""

from dataclasses import dataclass

import numpy as np

__all__ = ["DatePairs", "baseline_pairs", "consecutive_pairs"]


@dataclass(frozen=True, eq=False)
class DatePairs:
    """
    Pairs of dates that a stack compares, earlier one first.

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
    >>> from astro_scc.stacking import consecutive_pairs
    >>> pairs = consecutive_pairs([2000.0, 2000.5, 2002.0])
    >>> len(pairs), pairs.interval.tolist()
    (2, [0.5, 1.5])
    """

    first: np.ndarray
    second: np.ndarray
    interval: np.ndarray
    weight: np.ndarray
    n_dates: int

    def __len__(self):
        return len(self.first)

    def images(self, order):
        """
        The ordered pairs of images, for an order of images over dates.

        Parameters
        ----------
        order : array_like of int, shape (..., n_dates)
            Image at each date.

        Returns
        -------
        reference, target : `~numpy.ndarray` of int, shape (..., n_pairs)
        """
        order = np.asarray(order)
        return order[..., self.first], order[..., self.second]


def _pairs(years, first, second, weight=None):
    years = np.asarray(years, dtype=float)
    interval = years[second] - years[first]
    weight = np.ones(len(first)) if weight is None else weight
    return DatePairs(first, second, interval, weight, len(years))


def consecutive_pairs(years):
    """
    Each date and the next one, as in the paper.

    Dates at which several epochs were taken have no interval between them
    and make no pair.

    Parameters
    ----------
    years : array_like, shape (n_dates,)
        Dates in years, ascending.

    Returns
    -------
    `DatePairs`

    Examples
    --------
    >>> from astro_scc.stacking import consecutive_pairs
    >>> consecutive_pairs([0.0, 0.5, 1.5]).interval
    array([0.5, 1. ])
    """
    years = np.asarray(years, dtype=float)
    first = np.flatnonzero(np.diff(years) > 0)
    return _pairs(years, first, first + 1)


def baseline_pairs(years, shortest, longest):
    """
    Every pair of dates whose separation lies in a range.

    A displacement error sigma is a velocity error sigma / interval, so pairs
    weigh with the square of their interval, normalised to a mean of one:
    the inverse variances.

    Parameters
    ----------
    years : array_like, shape (n_dates,)
        Dates in years, ascending.
    shortest, longest : float
        Range of separations in years, both included.

    Returns
    -------
    `DatePairs`

    Raises
    ------
    ValueError
        If the range is empty or not positive.

    Examples
    --------
    >>> from astro_scc.stacking import baseline_pairs
    >>> pairs = baseline_pairs([0.0, 0.5, 1.5], 0.8, 1.2)
    >>> pairs.first, pairs.second
    (array([1]), array([2]))
    """
    if not 0 <= shortest <= longest or longest <= 0:
        raise ValueError(
            "a baseline needs 0 <= shortest <= longest years with longest > 0, "
            f"got {shortest} and {longest}"
        )
    years = np.asarray(years, dtype=float)
    separation = years[None, :] - years[:, None]
    # A rounded limit must not lose a pair: a third of a day, or a percent of
    # what is limited where dates are minutes apart.
    slack = min(1e-3, 0.01 * longest)
    inside = (separation >= shortest - slack) & (separation <= longest + slack)
    first, second = np.nonzero(inside & (separation > 0))
    interval = separation[first, second]
    weight = interval**2 / np.mean(interval**2) if len(interval) else interval
    return _pairs(years, first, second, weight)
