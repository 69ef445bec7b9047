# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Orders in which epochs are laid on the dates, where nothing tells them apart."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from astro_scc.stacking.shuffle import random_orders

__all__ = ["AllOrders", "BlockOrders", "ReversedBlocks", "WithoutSuccessors"]

#: Factorials beyond this one are as good as endless.
MOST = 20


def _factorial(n):
    return math.factorial(min(n, MOST))


class _Orders:
    """What all sets of orders have."""

    def exhausts(self, n_epochs, n_trials):
        """
        Whether so many trials go through all orders.

        Parameters
        ----------
        n_epochs, n_trials : int

        Returns
        -------
        bool
        """
        return self.number(n_epochs) <= n_trials + 1


@dataclass(frozen=True)
class AllOrders(_Orders):
    """
    Every permutation of the epochs.

    As likely as the observed one if epochs differ in nothing but chance.
    The dates keep their slots: an interval stays what it is, and compares
    whatever two epochs are laid on its ends.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import AllOrders
    >>> AllOrders().draw(3, 10, np.random.default_rng(1)).tolist()
    [[0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]]
    """

    name = "shuffle"

    def number(self, n_epochs):
        """
        How many orders are told apart: one and its reversal are not.

        Parameters
        ----------
        n_epochs : int

        Returns
        -------
        float
        """
        return _factorial(n_epochs) / 2

    def exhausts(self, n_epochs, n_trials):
        """
        Whether so many trials go through all orders, reversed ones too.

        Parameters
        ----------
        n_epochs, n_trials : int

        Returns
        -------
        bool
        """
        return _factorial(n_epochs) <= n_trials + 1

    def draw(self, n_epochs, n_trials, rng):
        """
        Orders, the observed one not among them where all are gone through.

        Parameters
        ----------
        n_epochs, n_trials : int
        rng : `~numpy.random.Generator`

        Returns
        -------
        `~numpy.ndarray` of int, shape (n, n_epochs)
            All there are, if there are no more than ``n_trials``.
        """
        if self.exhausts(n_epochs, n_trials):
            return np.array(list(itertools.permutations(range(n_epochs))))[1:]
        return random_orders(n_epochs, n_trials, rng)


@dataclass(frozen=True)
class WithoutSuccessors(AllOrders):
    """
    Permutations in which no epoch is followed by its true successor.

    The variant of the authors' program, for comparison.  The observed order
    is not one that could have been drawn, so its probabilities are too small.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import WithoutSuccessors
    >>> orders = WithoutSuccessors().draw(5, 20, np.random.default_rng(1))
    >>> bool((np.diff(orders, axis=1) == 1).any())
    False
    """

    name = "paper"

    def draw(self, n_epochs, n_trials, rng):
        """
        Orders without a true successor; see `AllOrders.draw`.

        Parameters
        ----------
        n_epochs, n_trials : int
        rng : `~numpy.random.Generator`

        Returns
        -------
        `~numpy.ndarray` of int, shape (n, n_epochs)
        """
        orders = super().draw(n_epochs, n_trials, rng)
        return orders[~(np.diff(orders, axis=1) == 1).any(axis=1)]


@dataclass(frozen=True)
class BlockOrders(_Orders):
    """
    Blocks of epochs in any order, each as it is.

    For series in which neighbours in time are alike for another reason than
    motion: a season of one array, an outburst.  What happens within a block
    stays, so the test is weaker than that of all orders.

    Parameters
    ----------
    length : int, optional
        Epochs in a block; the last one may be shorter.

    Raises
    ------
    ValueError
        If a block has no epoch.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import BlockOrders
    >>> BlockOrders(2).draw(5, 10, np.random.default_rng(1)).tolist()[0]
    [0, 1, 4, 2, 3]
    """

    length: int = 2
    name = "blocks"

    def __post_init__(self):
        _require_length(self.length)

    def number(self, n_epochs):
        """
        How many orders there are.

        Parameters
        ----------
        n_epochs : int

        Returns
        -------
        float
        """
        return float(_factorial(math.ceil(n_epochs / self.length)))

    def draw(self, n_epochs, n_trials, rng):
        """
        Orders of the blocks; see `AllOrders.draw`.

        Parameters
        ----------
        n_epochs, n_trials : int
        rng : `~numpy.random.Generator`

        Returns
        -------
        `~numpy.ndarray` of int, shape (n, n_epochs)
        """
        blocks = _blocks(n_epochs, self.length)
        orders = AllOrders().draw(len(blocks), n_trials, rng)
        return np.array(
            [np.concatenate([blocks[k] for k in order]) for order in orders],
            dtype=int,
        ).reshape(-1, n_epochs)


@dataclass(frozen=True)
class ReversedBlocks(_Orders):
    """
    Blocks of epochs in their places, each forwards or backwards.

    For structure that changes where it stands: backwards it changes as much,
    while motion turns round.  Epochs stay near their dates, so nothing is
    assumed of those that are years apart.

    Parameters
    ----------
    length : int, optional
        Epochs in a block; the last one may be shorter.

    Raises
    ------
    ValueError
        If a block has fewer than two epochs.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import ReversedBlocks
    >>> ReversedBlocks(2).draw(4, 10, np.random.default_rng(1)).tolist()
    [[0, 1, 3, 2], [1, 0, 2, 3], [1, 0, 3, 2]]
    """

    length: int = 2
    name = "reversal"

    def __post_init__(self):
        _require_length(self.length, 2)

    def _turning(self, n_epochs):
        """Blocks, and how many of them are not the same backwards."""
        blocks = _blocks(n_epochs, self.length)
        return blocks, sum(len(block) > 1 for block in blocks)

    def number(self, n_epochs):
        """
        How many orders there are.

        Parameters
        ----------
        n_epochs : int

        Returns
        -------
        float
        """
        return 2.0 ** self._turning(n_epochs)[1]

    def draw(self, n_epochs, n_trials, rng):
        """
        Orders of the epochs; see `AllOrders.draw`.

        Parameters
        ----------
        n_epochs, n_trials : int
        rng : `~numpy.random.Generator`

        Returns
        -------
        `~numpy.ndarray` of int, shape (n, n_epochs)
        """
        blocks, turning = self._turning(n_epochs)
        if self.exhausts(n_epochs, n_trials):
            ways = list(itertools.product([False, True], repeat=turning))[1:]
            turned = np.array(ways, dtype=bool).reshape(len(ways), turning)
        else:
            turned = rng.random((n_trials, turning)) < 0.5
        orders = np.tile(np.arange(n_epochs), (len(turned), 1))
        for k, block in enumerate(blocks[:turning]):
            orders[np.ix_(turned[:, k], block)] = block[::-1]
        return orders


def _blocks(n_epochs, length):
    return [np.arange(n_epochs)[i : i + length] for i in range(0, n_epochs, length)]


def _require_length(length, least=1):
    if length < least:
        raise ValueError(f"a block needs {least} epochs or more, got {length}")
