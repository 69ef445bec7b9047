# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The paper's significance: stacks of epochs in shuffled order."""

from dataclasses import dataclass, replace

import numpy as np

__all__ = ["ShuffledStacks", "random_orders", "shuffle_epochs"]

#: Standard deviations are floored at this share of their largest value.
SIGMA_FLOOR = 0.01
#: Bytes of stacks that are kept; if all are more they are made twice.
KEEP_BYTES = 2**27


@dataclass(frozen=True, eq=False)
class ShuffledStacks:
    """
    A stack beside the stacks of shuffled epochs.

    Attributes
    ----------
    mean, std : `~numpy.ndarray`, shape (n2, n1)
        Of the trials at each velocity.
    p_local : `~numpy.ndarray`, shape (n2, n1)
        ``(b + 1) / (n + 1)``, b the number of the n trials with at least
        the observed coefficient at this velocity.
    maxima : `~numpy.ndarray`, shape (n_trials,)
        Largest z-score of each trial over all velocities, ascending.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import PairMaps, shuffle_epochs
    >>> from astro_scc.stacking import VelocityGrid, stack
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
    >>> maps = PairMaps.of(d, grid.v_max, 1.0)
    >>> shuffled = shuffle_epochs(maps, pairs, grid, scc, 20, rng=rng)
    >>> shuffled.z_score(scc).shape == grid.shape
    True
    """

    mean: np.ndarray
    std: np.ndarray
    p_local: np.ndarray
    maxima: np.ndarray

    def z_score(self, scc):
        """
        Significance of a stack, ``(C - mean) / std`` (paper, Sect. 2.3).

        It is no probability: the paper's 11 sigma come from 1000 trials.

        Parameters
        ----------
        scc : `~numpy.ndarray`, shape (n2, n1)

        Returns
        -------
        `~numpy.ndarray`, shape (n2, n1)
            Zero where no trial has any correlation.
        """
        return z_score(scc, self.mean, self.std)

    def p_global(self, z_score):
        """
        Probability of a z-score anywhere in the map, in shuffled epochs.

        Parameters
        ----------
        z_score : float

        Returns
        -------
        float
            ``(b + 1) / (n + 1)``, b the number of the n trials whose
            largest z-score is at least this one.
        """
        n = len(self.maxima)
        below = np.searchsorted(self.maxima, z_score, side="left")
        return float((n - below + 1) / (n + 1))


def z_score(scc, mean, std):
    """
    ``(C - mean) / std``, std floored at a hundredth of its largest value.

    Parameters
    ----------
    scc : `~numpy.ndarray`, shape (..., n2, n1)
    mean, std : `~numpy.ndarray`, shape (n2, n1)

    Returns
    -------
    `~numpy.ndarray`, shape (..., n2, n1)
        Zero where no trial has any correlation.
    """
    floor = np.maximum(std, SIGMA_FLOOR * std.max(initial=0.0))
    excess = scc - mean
    return np.divide(excess, floor, out=np.zeros_like(excess), where=floor > 0)


def random_orders(n_epochs, n_trials, rng):
    """
    Random orders of the epochs, all of them equally likely.

    Parameters
    ----------
    n_epochs, n_trials : int
    rng : `~numpy.random.Generator`

    Returns
    -------
    `~numpy.ndarray` of int, shape (n_trials, n_epochs)

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import random_orders
    >>> orders = random_orders(4, 3, np.random.default_rng(1))
    >>> orders.shape, sorted(orders[0].tolist())
    ((3, 4), [0, 1, 2, 3])
    """
    return rng.permuted(np.tile(np.arange(n_epochs), (n_trials, 1)), axis=1)


def shuffle_epochs(
    pair_maps, pairs, grid, observed, n_trials, *, rng, shift=None, progress=None
):
    """
    Stack the epochs in shuffled order, again and again.

    Parameters
    ----------
    pair_maps : `PairMaps`
    pairs : `DatePairs`
    grid : `VelocityGrid`
    observed : `~numpy.ndarray`, shape ``grid.shape``
        The stack of the epochs in their own order.
    n_trials : int
    rng : `~numpy.random.Generator`
    shift : tuple of float, optional
        Displacement (the paper: a fifth of the beam) by which the images of
        a trial are shifted, along either axis and in either sense in turn;
        the paper's correction for small displacements, at which shuffled
        epochs of standing structure still correlate.
    progress : callable, optional
        Called with the number of trials done at a time.

    Returns
    -------
    `ShuffledStacks`

    Raises
    ------
    ValueError
        If ``n_trials`` is below 2.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import PairMaps, shuffle_epochs
    >>> from astro_scc.stacking import VelocityGrid, stack
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
    >>> maps = PairMaps.of(d, grid.v_max, 1.0)
    >>> shuffled = shuffle_epochs(maps, pairs, grid, scc, 20, rng=rng)
    >>> shuffled.mean.shape == grid.shape, shuffled.maxima.shape
    (True, (20,))
    """
    if n_trials < 2:
        raise ValueError(f"shuffling needs at least 2 trials, got {n_trials}")
    orders = random_orders(pairs.n_dates, n_trials, rng)
    # The maps that a copy makes go with it.
    pair_maps = replace(pair_maps)
    if shift is None:
        parts = [(orders, (0.0, 0.0))]
    else:
        s1, s2 = shift
        shifts = [(s1, 0.0), (-s1, 0.0), (0.0, s2), (0.0, -s2)]
        parts = [(orders[i::4], s) for i, s in enumerate(shifts)]

    def trials():
        for some, offset in parts:
            yield from pair_maps.stacks(pairs, grid, some, shift=offset)

    total, squares = np.zeros(grid.shape), np.zeros(grid.shape)
    larger = np.zeros(grid.shape, dtype=int)
    keep = 4 * n_trials * grid.shape[0] * grid.shape[1] <= KEEP_BYTES
    kept = []
    for block in trials():
        if keep:
            kept.append(block.astype(np.float32))
        total += block.sum(axis=0)
        squares += np.einsum("tij,tij->ij", block, block)
        larger += (block >= observed).sum(axis=0)
        if progress is not None:
            progress(len(block))
    mean = total / n_trials
    variance = np.maximum(squares / n_trials - mean**2, 0.0)
    std = np.sqrt(variance * n_trials / (n_trials - 1))
    # The z-scores need mean and spread first.
    maxima = [
        z_score(block, mean, std).max(axis=(1, 2))
        for block in (kept if keep else trials())
    ]
    return ShuffledStacks(
        mean=mean,
        std=std,
        p_local=(larger + 1) / (n_trials + 1),
        maxima=np.sort(np.concatenate(maxima)),
    )
