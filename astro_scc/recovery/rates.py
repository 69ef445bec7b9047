# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Shares with their intervals, and what few epochs or trials can show at all."""

import math

import astropy.units as u
import numpy as np
from astropy.utils.masked import Masked

__all__ = ["epochs_needed", "partly_known", "share", "smallest_p"]

CONFIDENCE = 0.95


def smallest_p(n_epochs, n_trials=None):
    """
    Smallest ``p_global`` of something that moves.

    ``max(2 / N!, 1 / (n + 1))`` for N epochs and n trials, see
    :ref:`significance`.

    Parameters
    ----------
    n_epochs : int
    n_trials : int, optional
        Without it that of the number of epochs alone.

    Returns
    -------
    float
    """
    # The factorial of 171 is no float any more.
    epochs = min(1.0, 2 / math.factorial(min(n_epochs, 170)))
    return epochs if n_trials is None else max(epochs, 1 / (n_trials + 1))


def epochs_needed(level):
    """
    Fewest epochs with which a moving component can reach a level.

    Parameters
    ----------
    level : float

    Returns
    -------
    int
    """
    n_epochs = 2
    while smallest_p(n_epochs) > level:
        n_epochs += 1
    return n_epochs


def share(number, of):
    """
    A share with the limits of its 95% interval (Jeffreys).

    Parameters
    ----------
    number : array_like of int, shape (n,)
    of : int

    Returns
    -------
    share, low, high : `~numpy.ndarray`, shape (n,)
    """
    from astropy.stats import binom_conf_interval

    number = np.asarray(number, dtype=int)
    low, high = binom_conf_interval(number, of, CONFIDENCE, interval="jeffreys")
    return number / of, np.asarray(low), np.asarray(high)


def partly_known(values, unit=None):
    """
    A column of numbers some of which are not known.

    Parameters
    ----------
    values : sequence of float or None
    unit : `~astropy.units.Unit`, optional

    Returns
    -------
    `~numpy.ndarray` or `~astropy.units.Quantity`
        Masked where a value is None.
    """
    missing = np.array([value is None for value in values], dtype=bool)
    numbers = np.array([0.0 if v is None else v for v in values], dtype=float)
    column = numbers if unit is None else u.Quantity(numbers, unit)
    if not missing.any():
        return column
    if unit is None:
        return np.ma.MaskedArray(column, mask=missing)
    return Masked(column, mask=missing)
