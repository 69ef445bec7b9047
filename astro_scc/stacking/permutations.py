# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Permutations of the epochs."""

import itertools
import math

import numpy as np

from astro_scc.stacking.shuffle import random_orders

__all__ = ["number_of_orders", "permutations_of_epochs"]

#: Factorials beyond this one are as good as endless.
MOST = 20
#: Up to so many epochs all orders are taken: a sample of few has a poor variance.
ALL_ORDERS_OF = 6


def number_of_orders(n_epochs):
    """
    Return how many orders are distinguished: one and its reversal are not.

    Parameters
    ----------
    n_epochs : int

    Returns
    -------
    float

    Examples
    --------
    >>> from astro_scc.stacking import number_of_orders
    >>> number_of_orders(4)
    12.0
    """
    return max(math.factorial(min(n_epochs, MOST)) / 2, 1.0)


def permutations_of_epochs(n_epochs, n_trials, rng):
    """
    Draw permutations of the epochs, as likely as the observed order.

    Parameters
    ----------
    n_epochs, n_trials : int
    rng : `~numpy.random.Generator`

    Returns
    -------
    `~numpy.ndarray` of int, shape (n, n_epochs)
        All but the observed one of up to six epochs, or if there are no more
        than ``n_trials``.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import permutations_of_epochs
    >>> permutations_of_epochs(3, 10, np.random.default_rng(1)).tolist()
    [[0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]]
    """
    if n_epochs <= ALL_ORDERS_OF or math.factorial(min(n_epochs, MOST)) <= n_trials + 1:
        return np.array(list(itertools.permutations(range(n_epochs))))[1:]
    return random_orders(n_epochs, n_trials, rng)
