# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work on a Dask cluster."""

import importlib
import time
import warnings
from collections import deque
from concurrent.futures import CancelledError
from contextlib import contextmanager

__all__ = ["is_client", "on_cluster", "open_client", "open_local", "result_of"]

#: Pieces of work that wait for each thread of the cluster.
WAITING = 2
#: Seconds after which a scheduler that does not answer is given up.
TIMEOUT = 15
#: Seconds after which work that no worker is there for is given up, and seconds
#: between two looks at whether there is one.
WITHOUT_WORKERS = 45
LOOK = 5


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
        That is done; see `result_of`.

    Raises
    ------
    OSError
        If a worker cannot import the function, there are no workers for a
        while, or the scheduler is lost.
    """
    _check(client, function)
    waiting = deque()
    try:
        for index, piece in enumerate(pieces):
            with _connected(client):
                waiting.append((index, _submit(client, _one_thread, function, piece)))
                threads = sum(client.nthreads().values())
            if len(waiting) > WAITING * max(threads, 1):
                yield _next_done(client, waiting, ordered)
        while waiting:
            yield _next_done(client, waiting, ordered)
    finally:
        if client.status == "running":
            client.cancel([future for _, future in waiting])


@contextmanager
def _connected(client):
    """Say in one way that the scheduler is lost."""
    try:
        yield
    except Exception as error:
        if client.status == "running" and not isinstance(error, OSError):
            raise
        raise OSError("the scheduler was lost; start it and this again") from None


def _check(client, function):
    """Refuse workers that would die of a function that they cannot import."""
    name = getattr(function, "__module__", None) or "builtins"

    def load():
        # Sent as it stands: this module might be the one that is not there.
        importlib.import_module(name)

    waiting = deque([(0, _submit(client, load))])
    _, future = _next_done(client, waiting, True)
    try:
        result_of(future)
    except ImportError as error:
        raise OSError(
            f"workers of the scheduler cannot import {name} ({error}); install there "
            "what is installed here"
        ) from None


def _next_done(client, waiting, ordered):
    """Take whichever is done first, or the first, out of what waits."""
    from distributed import wait

    futures = [future for _, future in waiting]
    last = time.monotonic()
    while True:
        try:
            with client.as_current():
                wait(
                    futures[:1] if ordered else futures,
                    timeout=min(LOOK, WITHOUT_WORKERS),
                    return_when="FIRST_COMPLETED",
                )
            break
        except CancelledError:
            # All are, when the scheduler is lost.
            break
        except TimeoutError:
            now = time.monotonic()
            with _connected(client):
                threads = client.nthreads()
            if threads:
                last = now
            elif now - last >= WITHOUT_WORKERS:
                raise OSError(
                    f"the scheduler has had no workers for {WITHOUT_WORKERS} s; start "
                    "some, or see in their logs why they end"
                ) from None
    first = next(item for item in waiting if item[1].done() or ordered)
    waiting.remove(first)
    return first


def result_of(future):
    """
    The result of a piece of work.

    Parameters
    ----------
    future : `dask.distributed.Future`
        That is done.

    Returns
    -------
    object

    Raises
    ------
    OSError
        If workers died of it again and again, or the scheduler is lost.
    Exception
        What the function raised.
    """
    from distributed import KilledWorker

    try:
        return future.result()
    except KilledWorker as error:
        raise ChildProcessError(
            f"several workers died of one piece of work, the last was "
            f"{error.last_worker.address}; its log says why: for want of memory, often"
        ) from None
    except CancelledError:
        raise OSError("the scheduler was lost; start it and this again") from None


def _submit(client, function, *args):
    with warnings.catch_warnings():
        # That a piece is large: it goes to one worker once.  Data that were
        # sent before would be lost with the worker that holds them.
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
        return client.submit(function, *args, pure=False)


def _one_thread(function, piece):
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        return function(piece)
