# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The paper's significance: stacks of epochs in shuffled order."""

from dataclasses import dataclass

import numpy as np

__all__ = ["ShuffledStacks", "random_orders", "shuffle_epochs"]

#: Standard deviations are floored at this share of their largest value.
SIGMA_FLOOR = 0.01


@dataclass(frozen=True, eq=False)
class ShuffledStacks:
    """
    Mean and spread of the stacks of shuffled epochs.

    Attributes
    ----------
    mean, std : `~numpy.ndarray`, shape (n2, n1)
        Of the trials at each velocity.
    n_trials : int
    """

    mean: np.ndarray
    std: np.ndarray
    n_trials: int

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
        floor = SIGMA_FLOOR * self.std.max(initial=0.0)
        std = np.maximum(self.std, floor)
        return np.divide(scc - self.mean, std, out=np.zeros_like(scc), where=std > 0)


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
    """
    return rng.permuted(np.tile(np.arange(n_epochs), (n_trials, 1)), axis=1)


def shuffle_epochs(pair_maps, pairs, grid, n_trials, *, rng, shift=None, progress=None):
    """
    Stack the epochs in shuffled order, again and again.

    Parameters
    ----------
    pair_maps : `PairMaps`
    pairs : `DatePairs`
    grid : `VelocityGrid`
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
    """
    if n_trials < 2:
        raise ValueError(f"shuffling needs at least 2 trials, got {n_trials}")
    orders = random_orders(pairs.n_dates, n_trials, rng)
    if shift is None:
        parts = [(orders, (0.0, 0.0))]
    else:
        s1, s2 = shift
        shifts = [(s1, 0.0), (-s1, 0.0), (0.0, s2), (0.0, -s2)]
        parts = [(orders[i::4], s) for i, s in enumerate(shifts)]
    total = np.zeros(grid.shape)
    squares = np.zeros(grid.shape)
    for some, offset in parts:
        for block in pair_maps.stacks(pairs, grid, some, shift=offset):
            total += block.sum(axis=0)
            squares += np.einsum("tij,tij->ij", block, block)
            if progress is not None:
                progress(len(block))
    mean = total / n_trials
    variance = np.maximum(squares / n_trials - mean**2, 0.0)
    std = np.sqrt(variance * n_trials / (n_trials - 1))
    return ShuffledStacks(mean, std, n_trials)
