# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What a candidate is worth as a part of the best path through it."""

from dataclasses import dataclass

import numpy as np

__all__ = ["Transitions", "link_gains"]


@dataclass(frozen=True, eq=False)
class Transitions:
    """
    Pairs of candidates that follow one another through an SSP.

    Attributes
    ----------
    before, after : `~numpy.ndarray` of int, shape (n,)
        Candidates; the target of the first is the source of the second.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking import Transitions
    >>> found = Transitions.of(np.array([0, 1, 2]), np.array([1, 2, 3]), 4)
    >>> found.before.tolist(), found.after.tolist()
    ([0, 1], [1, 2])
    """

    before: np.ndarray
    after: np.ndarray

    @classmethod
    def of(cls, source, target, n_nodes):
        """
        All transitions between candidates.

        Parameters
        ----------
        source, target : `~numpy.ndarray` of int, shape (n,)
        n_nodes : int

        Returns
        -------
        `Transitions`
        """
        order = np.argsort(target, kind="stable")
        count = np.bincount(target, minlength=n_nodes)
        start = np.concatenate([[0], np.cumsum(count)])
        entering = count[source]
        after = np.repeat(np.arange(len(source)), entering)
        first = np.repeat(np.cumsum(entering) - entering, entering)
        before = order[start[source[after]] + np.arange(len(after)) - first]
        return cls(before, after)


def link_gains(source, target, value, transitions, between, step, n_nodes, *, use=None):
    """
    What each candidate adds to the best paths that it connects.

    The value of a path is the sum of the values of its candidates and of the
    transitions between them; a path may begin and end anywhere.  Two passes,
    forward and back in time, give the best path through each candidate;
    its gain is the value of that less the values of the best path that ends
    at its source and of the best one that begins at its target.

    Parameters
    ----------
    source, target : `~numpy.ndarray` of int, shape (n,)
    value : `~numpy.ndarray`, shape (n,)
    transitions : `Transitions`
    between : `~numpy.ndarray`, shape (2, n_transitions)
        Values of the transitions, forward and back in time.
    step : `~numpy.ndarray` of int, shape (n_nodes,)
        Place in time of each SSP.
    n_nodes : int
    use : `~numpy.ndarray` of bool, shape (n,), optional
        The candidates that may come before and after another one.

    Returns
    -------
    `~numpy.ndarray`, shape (n,)

    Notes
    -----
    Linear in the number of transitions.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking import Transitions, link_gains
    >>> source, target = np.array([0, 1, 1]), np.array([1, 2, 3])
    >>> steps = Transitions.of(source, target, 4)
    >>> link_gains(source, target, np.array([2.0, 3.0, 1.0]), steps, np.zeros((2, 2)),
    ...            np.array([0, 1, 2, 2]), 4).tolist()
    [2.0, 3.0, 1.0]
    """
    use = np.ones(len(source), bool) if use is None else use
    before, after = transitions.before, transitions.after
    forward, ending = _sweep(
        source, target, value, before[use[before]], after[use[before]],
        between[0, use[before]], step, n_nodes, use,
    )  # fmt: skip
    back, beginning = _sweep(
        target, source, value, after[use[after]], before[use[after]],
        between[1, use[after]], -step, n_nodes, use,
    )  # fmt: skip
    return forward + back - value - ending[source] - beginning[target]


def _sweep(source, target, value, before, after, between, step, n_nodes, use):
    """Value of the best path up to each candidate, and up to each SSP."""
    best = value.astype(float).copy()
    at = step[source]
    order = np.lexsort((after, at[after]))
    before, after, between = before[order], after[order], between[order]
    place = at[after]
    first = np.flatnonzero(np.diff(place, prepend=np.nan) != 0)
    for start, stop in zip(first, [*first[1:], len(after)][: len(first)], strict=True):
        own = slice(start, stop)
        head = np.flatnonzero(np.diff(after[own], prepend=-1))
        gain = np.maximum.reduceat(best[before[own]] + between[own], head)
        best[after[own][head]] += np.maximum(gain, 0.0)
    ending = np.zeros(n_nodes)
    np.maximum.at(ending, target[use], best[use])
    return best, ending
