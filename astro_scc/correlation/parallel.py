# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work in several processes, on this machine or a Dask cluster."""

import importlib
import math
import multiprocessing
import os
import signal
import threading
import time
import warnings
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Future,
    ProcessPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import partial
from multiprocessing.connection import wait as wait_for_any
from numbers import Integral
from pathlib import Path

#: Pieces that wait for each process or thread; this limits memory, and the time that
#: an interrupted run takes to end.
WAITING = 2
#: Seconds that a terminated worker has to send a result: the pool would wait for ever
#: for the rest of a result that was sent in part.
GRACE = 0.5
#: Seconds to wait for a scheduler to answer.
TIMEOUT = 15
#: Seconds to wait for a cluster without workers, and seconds between two checks.
WITHOUT_WORKERS = 45
LOOK = 5
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
LOST = "the scheduler was lost; start it and this again"


def machine_memory():
    """
    Return the memory that this process may use, in bytes.

    It is that of the machine, or of the container or job if these have less,
    and infinite if the system does not tell.
    """
    limits = [math.inf]
    with suppress(AttributeError, ValueError, OSError):
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    for name in CONTROL_GROUPS:
        # The file contains "max" if there is no limit.
        with suppress(ValueError, OSError):
            limits.append(int(Path(name).read_text(encoding="ascii")))
    with suppress(ImportError):
        import resource

        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        limits.append(math.inf if limit == resource.RLIM_INFINITY else limit)
    return min(limits)


@contextmanager
def workers_of(n_workers):
    """
    Open workers for several calls of `in_order` and `as_done`.

    ``n_workers`` is a number of processes, or the address or a client of a Dask
    scheduler; yields the number or the client.  A client that is opened here is
    closed at the end.  Raises a ValueError for a number below 1, a TypeError for
    anything else, an ImportError without Dask, and an OSError if a scheduler does
    not answer.
    """
    if isinstance(n_workers, str):
        with open_client(n_workers) as client:
            yield client
    elif isinstance(n_workers, Integral) and not isinstance(n_workers, bool):
        if n_workers < 1:
            raise ValueError(f"n_workers must be at least 1, got {n_workers}")
        yield int(n_workers)
    elif all(hasattr(n_workers, name) for name in ("submit", "cancel", "nthreads")):
        yield n_workers
    else:
        raise TypeError(
            "n_workers must be a number of processes, the address of a Dask "
            f"scheduler or a client, got {type(n_workers).__name__}"
        )


def in_order(function, pieces, n_workers, *, context=None):
    """
    Apply a function to pieces of work, and yield the results in their order.

    Pieces are taken as they are needed, so only a few for each worker are in memory.
    With more than one worker the function must be importable there.  ``context`` is
    the start method of `multiprocessing`.  Errors of the function are raised
    unchanged; beside them there are those of `workers_of`, and an OSError if a worker
    dies or the scheduler is lost.
    """
    with workers_of(n_workers) as workers:
        if workers == 1:
            yield from map(function, pieces)
        elif isinstance(workers, int):
            with _processes(workers, context) as pool:
                for _, future in _in_pool(pool, workers, function, enumerate(pieces)):
                    yield _result(future)
        else:
            for _, future in _on_cluster(workers, function, pieces):
                yield _result(future)


def as_done(function, pieces, n_workers, *, context=None):
    """
    Apply a function to pieces of work that may fail.

    Yields, in the order of completion, the index of a piece and its result, or the
    `Exception` that was raised.  A piece whose process dies is tried once more, alone,
    before it counts as failed.  Arguments and errors are those of `in_order`.
    """
    with workers_of(n_workers) as workers:
        if workers == 1:
            for index, piece in enumerate(pieces):
                yield index, _outcome(function, piece)
        elif isinstance(workers, int):
            yield from _as_done(function, enumerate(pieces), workers, context)
        else:
            done = _on_cluster(workers, function, pieces, ordered=False)
            for (index, _), future in done:
                yield index, _outcome(_result, future)


def _outcome(function, *args):
    try:
        return function(*args)
    except Exception as error:
        return error


def _result(future):
    """Return the result of a future, or raise a uniform error for lost workers."""
    try:
        return future.result()
    except BrokenProcessPool:
        raise ChildProcessError(DIED) from None
    except CancelledError:
        raise OSError(LOST) from None
    except Exception as error:
        # Dask's KilledWorker has this attribute.
        if not hasattr(error, "last_worker"):
            raise
        raise ChildProcessError(
            f"several workers died of one piece of work, the last was "
            f"{error.last_worker.address}; its log says why: for want of memory, often"
        ) from None


def _next_done(waiting, wait_for, ordered):
    """Take the item whose future is done first or, if ordered, the first item."""
    futures = [future for _, future in waiting]
    wait_for(futures[:1] if ordered else futures)
    done = (k for k, future in enumerate(futures) if ordered or future.done())
    return waiting.pop(next(done))


def _in_pool(pool, n_workers, function, items, *, ordered=True):
    """Yield numbered pieces and their futures, once they are done."""
    waiting, wait_for = [], partial(wait, return_when=FIRST_COMPLETED)
    for item in items:
        try:
            future = pool.submit(_work, function, item[1])
        except BrokenProcessPool as error:
            future = Future()
            future.set_exception(error)
        waiting.append((item, future))
        if len(waiting) > WAITING * n_workers:
            yield _next_done(waiting, wait_for, ordered)
    while waiting:
        yield _next_done(waiting, wait_for, ordered)


def _as_done(function, items, n_workers, context):
    def until_broken():
        while not lost and (item := next(items, None)):
            yield item

    while True:
        lost = []
        with _processes(n_workers, context) as pool:
            # If processes cannot start at all, no piece is tried.
            _result(pool.submit(os.getpid))
            done = _in_pool(pool, n_workers, function, until_broken(), ordered=False)
            for item, future in done:
                if isinstance(future.exception(), BrokenProcessPool):
                    lost.append(item)
                else:
                    yield item[0], _outcome(_result, future)
        for index, piece in lost:
            # Alone, so that it cannot harm other pieces.
            with _processes(1, context) as pool:
                yield index, _outcome(_result, pool.submit(_work, function, piece))
        if not lost:
            return


@contextmanager
def _processes(n_workers, context):
    """Open a pool of processes that end with it, even at work."""
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


def _start():
    """Prepare a worker process."""
    # The parent handles the signals of its terminal, and then ends its workers.
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    watched = [multiprocessing.parent_process().sentinel]
    if hasattr(signal, "setitimer"):
        # A handler in Python would wait for the main thread, which may wait for a
        # lock that a killed worker held, or not be the thread that gets the signal.
        told, tell = os.pipe()
        os.set_blocking(tell, False)
        signal.set_wakeup_fd(tell)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.signal(signal.SIGTERM, lambda *_: None)
        watched.append(told)
    threading.Thread(target=_end_when_told, args=watched, daemon=True).start()
    from threadpoolctl import threadpool_limits

    # The workers already share the processor.
    threadpool_limits(1)


def _end_when_told(parent, *told):
    """End this process with its parent, which may be killed, or soon after SIGTERM."""
    while parent not in wait_for_any([parent, *told]):
        if signal.SIGTERM in os.read(*told, 64):
            signal.setitimer(signal.ITIMER_REAL, GRACE)
    os._exit(1)


def _work(function, piece):
    """Call the function in a worker, which ends afterwards if it was terminated."""
    result = function(piece)
    if hasattr(signal, "getitimer") and signal.getitimer(signal.ITIMER_REAL)[0]:
        os._exit(1)
    return result


@contextmanager
def open_client(address):
    """Connect to a Dask scheduler, such as ``tcp://node1:8786``, in this context."""
    distributed = _dask()
    try:
        # A client that is refused an address would try to close itself for long.
        distributed.comm.resolve_address(address)
        client = distributed.Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise OSError(f"scheduler {address}: cannot be reached: {reason}") from None
    with client:
        yield client


@contextmanager
def open_local(n_workers):
    """Start a Dask cluster of one-thread processes on this machine in this context."""
    distributed = _dask()
    options = {"processes": True, "threads_per_worker": 1, "memory_limit": None}
    with warnings.catch_warnings():
        # If the usual port of the dashboard is taken, it gets another one.
        warnings.filterwarnings("ignore", "Port 8787", UserWarning)
        cluster = distributed.LocalCluster(n_workers=n_workers, **options)
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


def _on_cluster(client, function, pieces, *, ordered=True):
    """
    Yield numbered pieces and their futures, once a cluster has done them.

    Another worker repeats a piece whose worker dies.
    """
    _check_import(client, function)
    waiting, wait_for = [], partial(_wait_on_cluster, client)
    try:
        for item in enumerate(pieces):
            waiting.append((item, _submit(client, _one_thread, function, item[1])))
            threads = sum(_ask(client, client.nthreads).values())
            if len(waiting) > WAITING * max(threads, 1):
                yield _next_done(waiting, wait_for, ordered)
        while waiting:
            yield _next_done(waiting, wait_for, ordered)
    finally:
        if client.status == "running":
            client.cancel([future for _, future in waiting])


def _check_import(client, function):
    """Raise an OSError if the workers cannot import the function."""
    name = getattr(function, "__module__", None) or "builtins"

    def load():
        # Pickled by value, since this module may be the missing one.
        importlib.import_module(name)

    future = _submit(client, load)
    _wait_on_cluster(client, [future])
    try:
        _result(future)
    except ImportError as error:
        raise OSError(
            f"workers of the scheduler cannot import {name} ({error}); install there "
            "what is installed here"
        ) from None


def _ask(client, ask, *args, **options):
    """Ask the scheduler, and raise a uniform error if it is lost."""
    try:
        return ask(*args, **options)
    except Exception as error:
        if client.status == "running" and not isinstance(error, OSError):
            raise
        raise OSError(LOST) from None


def _submit(client, function, *args):
    with warnings.catch_warnings():
        # Pieces are large, but each is sent once to one worker.  Scattered data would
        # be lost with the worker that holds them.
        warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
        return _ask(client, client.submit, function, *args, pure=False)


def _one_thread(function, piece):
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        return function(piece)


def _wait_on_cluster(client, futures):
    """Wait until one future is done, as long as there are workers."""
    from distributed import wait

    last = time.monotonic()
    while True:
        with suppress(TimeoutError), client.as_current():
            # All futures are cancelled when the scheduler is lost.
            with suppress(CancelledError):
                wait(
                    futures,
                    timeout=min(LOOK, WITHOUT_WORKERS),
                    return_when="FIRST_COMPLETED",
                )
            return
        if _ask(client, client.nthreads):
            last = time.monotonic()
        elif time.monotonic() - last >= WITHOUT_WORKERS:
            raise OSError(
                f"the scheduler has had no workers for {WITHOUT_WORKERS} s; start "
                "some, or see in their logs why they end"
            )
