# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Random orders of the epochs, and the stacks of the epochs in them."""

import math
from dataclasses import dataclass, replace

import numpy as np

#: Standard deviations of stacks are at least this fraction of the largest one.
STD_FLOOR = 0.01
#: Factorials of larger numbers of epochs are replaced by that of this one.
MOST = 20


def number_of_permutations(n_epochs):
    """
    Return the number of different orders, where a reversed order is the same one.

    Parameters
    ----------
    n_epochs : int

    Returns
    -------
    float
    """
    return max(math.factorial(min(n_epochs, MOST)) / 2, 1.0)


def random_permutations(n_epochs, n_trials, rng):
    """Return random permutations, all equally likely, (n_trials, n_epochs)."""
    return rng.permuted(np.tile(np.arange(n_epochs), (n_trials, 1)), axis=1)


@dataclass(frozen=True, eq=False)
class PermutedStacks:
    """Mean and standard deviation of the stacks of permuted epochs, on the grid."""

    mean: np.ndarray
    std: np.ndarray

    def z_score(self, scc):
        """
        Return the z-score of a stack, ``(C - mean) / std`` (paper, Sect. 2.3).

        It is not a probability: the paper's 11 sigma come from 1000 trials.  The
        standard deviation is at least a hundredth of its largest value; where no
        trial has any correlation, the result is zero.
        """
        floor = np.maximum(self.std, STD_FLOOR * self.std.max(initial=0.0))
        excess = scc - self.mean
        return np.divide(excess, floor, out=np.zeros_like(excess), where=floor > 0)


def permute_stacks(pair_maps, pairs, grid, n_trials, *, rng, shift=None, progress=None):
    """
    Stack the epochs in many permuted orders, for the paper's z-score.

    Parameters
    ----------
    pair_maps : `~astro_scc.stacking.pair_maps.PairMaps`
    pairs : ``DatePairs``
    grid : ``VelocityGrid``
    n_trials : int
    rng : `~numpy.random.Generator`
    shift : tuple of float, optional
        Displacement (in the paper, a fifth of the beam) by which the images
        of a trial are shifted, along each axis and in each direction in turn.
        This is the paper's correction for small displacements, at which
        permuted epochs of standing structure still correlate.
    progress : callable, optional
        Called with the number of trials done since the last call.

    Returns
    -------
    `PermutedStacks`

    Raises
    ------
    ValueError
        If ``n_trials`` is below 2.
    """
    if n_trials < 2:
        raise ValueError(f"permutations need at least 2 trials, got {n_trials}")
    orders = random_permutations(pairs.n_dates, n_trials, rng)
    # A copy, so that the maps that it caches are freed with it.
    pair_maps = replace(pair_maps)
    parts = [(orders, (0.0, 0.0))]
    if shift is not None:
        s1, s2 = shift
        shifts = [(s1, 0.0), (-s1, 0.0), (0.0, s2), (0.0, -s2)]
        parts = [(orders[i::4], s) for i, s in enumerate(shifts)]
    total, squares = np.zeros(grid.shape), np.zeros(grid.shape)
    for some, offset in parts:
        for block in pair_maps.stacks(pairs, grid, some, shift=offset):
            total += block.sum(axis=0)
            squares += np.einsum("tij,tij->ij", block, block)
            if progress is not None:
                progress(len(block))
    mean = total / n_trials
    variance = np.maximum(squares / n_trials - mean**2, 0.0)
    return PermutedStacks(mean, np.sqrt(variance * n_trials / (n_trials - 1)))
