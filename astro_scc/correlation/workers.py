# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work in several processes, of this machine or of a cluster."""

import math
import multiprocessing
import os
import signal
import threading
from collections import deque
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.connection import wait as wait_for
from numbers import Integral
from pathlib import Path

from astro_scc.correlation.cluster import (
    is_client,
    on_cluster,
    open_client,
    result_of,
)

__all__ = ["as_done", "in_order", "machine_memory", "workers_of"]

#: Pieces that wait for each worker; bounds memory, and how long an
#: interrupted run takes to end.
WAITING = 2

#: Seconds that a worker has to send a result before it ends: of one that is sent in
#: part the pool would await the rest for ever.
GRACE = 0.5

#: Limits of containers and of the jobs of batch systems.
CONTROL_GROUPS = (
    "/sys/fs/cgroup/memory.max",
    "/sys/fs/cgroup/memory/memory.limit_in_bytes",
)
DIED = (
    "a worker process died: stopped by the system for want of memory (fewer workers "
    "take less), or it cannot import what it works with, as in a script that does not "
    "begin its work under if __name__ == '__main__'"
)


def machine_memory():
    """
    Memory that this process may take, in bytes.

    Returns
    -------
    float
        That of the machine, or of the container or job if these have less;
        infinite where the system does not say.
    """
    limits = [math.inf]
    with suppress(AttributeError, ValueError, OSError):
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    for name in CONTROL_GROUPS:
        # "max" where there is no limit.
        with suppress(ValueError, OSError):
            limits.append(int(Path(name).read_text(encoding="ascii")))
    with suppress(ImportError):
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        limits.append(math.inf if limit == resource.RLIM_INFINITY else limit)
    return min(limits)


def _start():
    # The parent ends on what its terminal sends, and then ends its workers.
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.signal(signal.SIGTERM, _end_soon)
    # One that is killed cannot end them.
    threading.Thread(target=_end_with_parent, daemon=True).start()
    from threadpoolctl import threadpool_limits

    # More workers than one already share the processor.
    threadpool_limits(1)


def _end_soon(*_):
    signal.setitimer(signal.ITIMER_REAL, GRACE)


def _work(function, piece):
    """Call the function in a worker, which ends here if it was told to."""
    result = function(piece)
    if hasattr(signal, "getitimer") and signal.getitimer(signal.ITIMER_REAL)[0]:
        os._exit(1)
    return result


def _end_with_parent():
    wait_for([multiprocessing.parent_process().sentinel])
    os._exit(1)


@contextmanager
def workers_of(n_workers):
    """
    Workers for several calls of `in_order`.

    Parameters
    ----------
    n_workers : int, str or `dask.distributed.Client`
        Number of processes, address of a Dask scheduler, or a client of one.

    Yields
    ------
    int or `dask.distributed.Client`
        A client of one's own is closed at the end, one that was given is not.

    Raises
    ------
    ValueError
        If it is a number below 1.
    TypeError
        If it is none of these.
    ImportError
        If Dask is needed and not installed.
    OSError
        If the scheduler does not answer.
    """
    if isinstance(n_workers, str):
        with open_client(n_workers) as client:
            yield client
    elif isinstance(n_workers, Integral) and not isinstance(n_workers, bool):
        if n_workers < 1:
            raise ValueError(f"n_workers must be at least 1, got {n_workers}")
        yield int(n_workers)
    elif is_client(n_workers):
        yield n_workers
    else:
        raise TypeError(
            "n_workers must be a number of processes, the address of a Dask "
            f"scheduler or a client, got {type(n_workers).__name__}"
        )


def in_order(function, pieces, n_workers, *, context=None):
    """
    Apply a function to pieces of work, in this or in other processes.

    Parameters
    ----------
    function : callable
        Of one argument; importable by the workers if there is more than one.
    pieces : iterable
        Taken as they are needed: a few for each worker are in memory.
    n_workers : int, str or `dask.distributed.Client`
        See `workers_of`; 1 works in this process.
    context : str, optional
        Start method of `multiprocessing`, or its default.

    Yields
    ------
    object
        Results in the order of ``pieces``.

    Raises
    ------
    ValueError, TypeError, ImportError, OSError
        See `workers_of`; OSError also if a worker dies.
    """
    with workers_of(n_workers) as workers:
        if not isinstance(workers, int):
            for _, future in on_cluster(function, pieces, workers):
                yield result_of(future)
        elif workers == 1:
            yield from map(function, pieces)
        else:
            yield from _in_processes(function, pieces, workers, context)


def _in_processes(function, pieces, n_workers, context):
    waiting = deque()
    try:
        with _processes(n_workers, context) as pool:
            for piece in pieces:
                waiting.append(pool.submit(_work, function, piece))
                if len(waiting) > WAITING * n_workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
    except BrokenProcessPool:
        raise ChildProcessError(DIED) from None


@contextmanager
def _processes(n_workers, context):
    """A pool whose processes do not outlive it, at work or not."""
    context = multiprocessing.get_context(context)
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(n_workers, context, initializer=_start)
    try:
        yield pool
    except BaseException:
        ours = set(multiprocessing.active_children()) - before
        for process in ours:
            process.terminate()
        for process in ours:
            process.join(4 * GRACE)
            process.kill()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def as_done(function, pieces, n_workers, *, context=None):
    """
    Apply a function to pieces of work, which may fail.

    Parameters
    ----------
    function, pieces, n_workers, context
        See `in_order`.

    Yields
    ------
    index : int
        Of the piece; whichever is done first comes first.
    result : object
        Or the `Exception` that was raised.  A piece whose process dies is done
        once more, by itself, before it counts as failed.

    Raises
    ------
    ValueError, TypeError, ImportError, OSError
        See `workers_of`; OSError also if processes do not start.
    """
    with workers_of(n_workers) as workers:
        if not isinstance(workers, int):
            for index, future in on_cluster(function, pieces, workers, ordered=False):
                yield index, _outcome(result_of, future)
        elif workers == 1:
            for index, piece in enumerate(pieces):
                yield index, _outcome(function, piece)
        else:
            yield from _as_done(function, enumerate(pieces), workers, context)


def _outcome(function, *args):
    try:
        return function(*args)
    except Exception as error:
        return error


def _as_done(function, pieces, n_workers, context):
    lost = []
    while True:
        waiting = {}
        broken = False
        with _processes(n_workers, context) as pool:
            _probe(pool)
            while not broken:
                for item in pieces:
                    try:
                        waiting[pool.submit(_work, function, item[1])] = item
                    except BrokenProcessPool:
                        lost.append(item)
                        broken = True
                        break
                    if len(waiting) > WAITING * n_workers:
                        break
                if not waiting:
                    break
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    item = waiting.pop(future)
                    result = _outcome(future.result)
                    if isinstance(result, BrokenProcessPool):
                        lost.append(item)
                        broken = True
                    else:
                        yield item[0], result
            for future, item in waiting.items():
                # The pool is broken: all of these are done, well or not.
                result = _outcome(future.result)
                if isinstance(result, BrokenProcessPool):
                    lost.append(item)
                else:
                    yield item[0], result
        if not broken:
            return
        for index, piece in lost:
            # Alone, so that no other suffers from what it does.
            with _processes(1, context) as pool:
                result = _outcome(pool.submit(_work, function, piece).result)
                if isinstance(result, BrokenProcessPool):
                    result = ChildProcessError(DIED)
                yield index, result
        lost.clear()


def _probe(pool):
    """Refuse a pool whose processes do not even start."""
    try:
        pool.submit(os.getpid).result()
    except BrokenProcessPool:
        raise ChildProcessError(DIED) from None
