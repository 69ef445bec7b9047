# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work in several processes."""

import multiprocessing
import signal
from collections import deque
from concurrent.futures import ProcessPoolExecutor

__all__ = ["in_order"]

#: Pieces that wait for each worker; bounds memory, and how long an
#: interrupted run takes to end.
WAITING = 2


def _start():
    # The parent ends on an interrupt, and then its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from threadpoolctl import threadpool_limits

    # More workers than one already share the processor.
    threadpool_limits(1)


def in_order(function, pieces, n_workers, *, context=None):
    """
    Apply a function to pieces of work, in this or in other processes.

    Parameters
    ----------
    function : callable
        Of one argument; picklable if there is more than one worker.
    pieces : iterable
        Taken as they are needed: a few for each worker are in memory.
    n_workers : int
        Number of processes; 1 works in this one.
    context : str, optional
        Start method of `multiprocessing`, or its default.

    Yields
    ------
    object
        Results in the order of ``pieces``.

    Raises
    ------
    ValueError
        If ``n_workers`` is below 1.
    """
    if n_workers < 1:
        raise ValueError(f"n_workers must be at least 1, got {n_workers}")
    if n_workers == 1:
        yield from map(function, pieces)
        return
    pool = ProcessPoolExecutor(
        n_workers, multiprocessing.get_context(context), initializer=_start
    )
    try:
        waiting = deque()
        for piece in pieces:
            waiting.append(pool.submit(function, piece))
            if len(waiting) > WAITING * n_workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)
