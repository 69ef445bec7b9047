# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work on a Dask cluster."""

import warnings
from collections import deque
from contextlib import contextmanager

__all__ = ["is_client", "on_cluster", "open_client", "open_local"]

#: Pieces of work that wait for each thread of the cluster.
WAITING = 2
#: Seconds after which a scheduler that does not answer is given up.
TIMEOUT = 15


def is_client(workers):
    """
    Whether an object is a `dask.distributed.Client`, or works like one.

    Parameters
    ----------
    workers : object

    Returns
    -------
    bool
    """
    return all(hasattr(workers, name) for name in ("submit", "cancel", "nthreads"))


@contextmanager
def open_client(address):
    """
    Connect to a Dask scheduler for a while.

    Parameters
    ----------
    address : str
        Such as ``tcp://node1:8786``.

    Yields
    ------
    `dask.distributed.Client`

    Raises
    ------
    ImportError
        If Dask is not installed.
    OSError
        If the scheduler does not answer.
    """
    distributed = _dask()
    try:
        client = distributed.Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise OSError(f"scheduler {address}: cannot be reached: {reason}") from None
    with client:
        yield client


@contextmanager
def open_local(n_workers):
    """
    A Dask cluster on this machine, for a while.

    Parameters
    ----------
    n_workers : int
        Number of processes, of one thread each.

    Yields
    ------
    `dask.distributed.Client`

    Raises
    ------
    ImportError
        If Dask is not installed.
    """
    distributed = _dask()
    with warnings.catch_warnings():
        # That the usual port of the dashboard is taken; it gets another one.
        warnings.filterwarnings("ignore", "Port 8787", UserWarning)
        cluster = distributed.LocalCluster(
            n_workers=n_workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=None,
        )
    with cluster, distributed.Client(cluster, set_as_default=False) as client:
        yield client


def _dask():
    try:
        import distributed
    except ImportError:
        raise ImportError(
            "a scheduler needs Dask: pip install 'astro_scc[dask]', or give a number "
            "of processes"
        ) from None
    return distributed


def on_cluster(function, pieces, client, *, ordered=True):
    """
    Apply a function to pieces of work on a Dask cluster.

    A piece whose worker dies is done again by another one.

    Parameters
    ----------
    function : callable
        Of one argument, importable where the workers are.
    pieces : iterable
        Taken as they are needed.
    client : `dask.distributed.Client`
    ordered : bool, optional
        Without, results come as they are done.

    Yields
    ------
    index : int
        Of the piece.
    future : `dask.distributed.Future`
        That is done.
    """
    from distributed import wait

    waiting = deque()

    def done():
        # Whichever is done first, or the first.
        futures = [future for _, future in waiting]
        with client.as_current():
            wait(futures[:1] if ordered else futures, return_when="FIRST_COMPLETED")
        first = next(item for item in waiting if item[1].done() or ordered)
        waiting.remove(first)
        return first

    try:
        for index, piece in enumerate(pieces):
            waiting.append((index, _submit(client, function, piece)))
            threads = sum(client.nthreads().values())
            if len(waiting) > WAITING * max(threads, 1):
                yield done()
        while waiting:
            yield done()
    finally:
        client.cancel([future for _, future in waiting])


def _submit(client, function, piece):
    with warnings.catch_warnings():
        # That a piece is large: it goes to one worker once.  Data that were
        # sent before would be lost with the worker that holds them.
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
        return client.submit(_one_thread, function, piece, pure=False)


def _one_thread(function, piece):
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        return function(piece)
