# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Trials side by side, in threads that share the matches."""

from concurrent.futures import ThreadPoolExecutor

__all__ = ["in_threads"]


def in_threads(function, pieces, n_threads):
    """
    Apply a function to pieces of work.

    Parameters
    ----------
    function : callable
        Of one argument.
    pieces : iterable
    n_threads : int
        1 works in this thread.  What takes time has to be numpy's, which
        lets other threads run meanwhile.

    Returns
    -------
    list
        Results in the order of ``pieces``.
    """
    pieces = list(pieces)
    if n_threads == 1 or len(pieces) < 2:
        return [function(piece) for piece in pieces]
    with ThreadPoolExecutor(n_threads) as pool:
        return list(pool.map(function, pieces))
