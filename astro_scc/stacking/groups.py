# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Whether two groups of sightings of one flow have different speeds."""

from dataclasses import dataclass

import numpy as np

__all__ = ["GroupSpeeds", "compare_groups", "paired_p_value"]

#: Width of the kernel in standard errors of a sighting.
WIDTH = 2.0
#: Spacing of the speeds in standard errors.
STEP = 0.1
#: Speeds of the groups are sought so far from that of both together, in standard
#: errors: a beam over the interval.
REACH = 5.0
#: Fewest blocks that give an error.
FEWEST = 4


@dataclass(frozen=True, eq=False)
class GroupSpeeds:
    """
    Speeds of two groups and their difference.

    Attributes
    ----------
    speed, error : `~numpy.ndarray`, shape (2,)
    difference, difference_err : float
        Of the second from the first.
    p_value : float
        Of a difference as large on either side, if the groups are alike.
    n_blocks : int
    n_trials : int

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import compare_groups
    >>> rng = np.random.default_rng(1)
    >>> second, block = rng.random(400) < 0.5, rng.integers(0, 20, 400)
    >>> v, one = np.where(second, 2.5, 2.0) + rng.normal(0, 0.2, 400), np.ones(400)
    >>> found = compare_groups(v, 0.2 * one, one, second, block, rng=1)
    >>> round(found.difference, 1), found.n_blocks
    (0.5, 20)
    """

    speed: np.ndarray
    error: np.ndarray
    difference: float
    difference_err: float
    p_value: float
    n_blocks: int
    n_trials: int


def compare_groups(v, s, weight, second, block, *, n_trials=1000, rng=None):
    r"""
    Compare the speeds at which two groups of sightings stack.

    The speed of a group is the maximum of

    .. math:: C(v) = \sum_i w_i\, g(v - v_i,\ 2 \sigma_i)

    within a beam of that of both together.  Errors are those of a jackknife
    over blocks of the flow.  For the probability the blocks keep what is in
    them, but in each the names of the groups are kept or swapped at random:
    features that both groups see, at whatever speed, make no difference.

    Parameters
    ----------
    v, s : array_like, shape (n,)
        Speeds of the sightings and their standard errors.
    weight : array_like, shape (n,)
    second : array_like of bool, shape (n,)
        Which are of the second group.
    block : array_like of int, shape (n,)
        Lengths of the flow, see `flow_blocks`.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `GroupSpeeds`

    Raises
    ------
    ValueError
        If a group has no sighting.

    Notes
    -----
    Each group has a total weight of one, so that the one with more SSPs
    does not outweigh the other when names are swapped.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import compare_groups
    >>> rng = np.random.default_rng(1)
    >>> second = rng.random(400) < 0.5
    >>> v = np.where(second, 2.5, 2.0) + rng.normal(0, 0.2, 400)
    >>> one, block = np.ones(400), rng.integers(0, 20, 400)
    >>> found = compare_groups(v, 0.2 * one, one, second, block, rng=1)
    >>> found.speed.round(1), found.p_value < 0.01
    (array([2. , 2.5]), True)
    """
    v, s, weight = (np.asarray(a, dtype=float) for a in (v, s, weight))
    second = np.asarray(second, dtype=bool)
    totals = [weight[~second].sum(), weight[second].sum()]
    if min(totals) <= 0:
        raise ValueError("each of the two groups needs a sighting, one has none")
    weight = weight / np.where(second, totals[1], totals[0])
    grid, middle = _grid(v, s, weight)
    numbers, block = np.unique(block, return_inverse=True)
    profiles = np.zeros((2, len(numbers), len(grid)))
    for k in range(len(numbers)):
        for g in (0, 1):
            own = (block == k) & (second == bool(g))
            z = (grid - v[own, None]) / (WIDTH * s[own, None])
            profiles[g, k] = weight[own] @ np.exp(-0.5 * z**2)
    both = profiles.sum(axis=1)
    speed = middle + _maxima(both, grid - middle)
    n = len(numbers)
    error, difference_err = np.full(2, np.inf), np.inf
    if n >= FEWEST:
        without = both[:, None] - profiles
        others = _maxima(without.reshape(-1, len(grid)), grid - middle).reshape(2, n)
        error = _jackknife(others)
        difference_err = float(_jackknife(others[1] - others[0]))
    difference = float(speed[1] - speed[0])
    rng = np.random.default_rng(rng)
    swap = rng.random((n_trials, n)) < 0.5
    apart = profiles[1] - profiles[0]
    change = swap @ apart
    trials = _maxima(both[1] - change, grid - middle) - _maxima(
        both[0] + change, grid - middle
    )
    return GroupSpeeds(
        speed=speed,
        error=error,
        difference=difference,
        difference_err=difference_err,
        p_value=paired_p_value(difference, trials),
        n_blocks=n,
        n_trials=n_trials,
    )


def paired_p_value(observed, trials):
    """
    Two-sided probability of a statistic among those of trials.

    Parameters
    ----------
    observed : float
    trials : array_like, shape (n,)

    Returns
    -------
    float
        ``(b + 1) / (n + 1)``, b the trials at least as far from zero.

    Examples
    --------
    >>> from astro_scc.stacking import paired_p_value
    >>> paired_p_value(2.0, [0.1, -2.5, 0.3])
    0.5
    """
    trials = np.abs(np.asarray(trials, dtype=float))
    # What differs by rounding only is as far.
    beyond = np.count_nonzero(trials >= abs(observed) * (1 - 1e-9))
    return (int(beyond) + 1) / (len(trials) + 1)


def _grid(v, s, weight):
    """Speeds around the maximum of everything together."""
    error = float(np.median(s))
    coarse = np.arange(v.min(), v.max() + error, 0.5 * error)
    total = np.zeros(len(coarse))
    for start in range(0, len(v), 4096):
        k = slice(start, start + 4096)
        z = (coarse - v[k, None]) / (WIDTH * s[k, None])
        total += weight[k] @ np.exp(-0.5 * z**2)
    middle = float(coarse[total.argmax()])
    n = round(REACH / STEP)
    return middle + STEP * error * np.arange(-n, n + 1), middle


def _maxima(values, x):
    """Where rows have their maximum, between grid points."""
    k = values.argmax(axis=1)
    inside = np.clip(k, 1, values.shape[1] - 2)
    rows = np.arange(len(values))
    low, mid, high = (values[rows, inside + d] for d in (-1, 0, 1))
    bend = low - 2 * mid + high
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(bend < 0, 0.5 * (low - high) / bend, 0.0)
    shift = np.where(inside == k, np.clip(shift, -0.5, 0.5), 0.0)
    return x[k] + shift * (x[1] - x[0])


def _jackknife(values):
    n = values.shape[-1]
    apart = values - values.mean(axis=-1, keepdims=True)
    return np.sqrt((n - 1) / n * (apart**2).sum(axis=-1))
