# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work in several processes, on this machine or a Dask cluster, and its progress."""

import importlib
import logging
import math
import os
import signal
import sys
import threading
import time
import warnings
from collections import deque
from concurrent import futures
from contextlib import ExitStack, contextmanager, suppress
from itertools import islice
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait as wait_for_any
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from distributed import Client

#: Number of processes, or a Dask scheduler, given by its address or a client.
Workers: TypeAlias = "int | str | Client"

#: Pieces that wait for each process or thread; this limits memory, and the time that
#: an interrupted run takes to end.
WAITING = 2
#: Seconds to wait for a scheduler to answer.
TIMEOUT = 15
#: Seconds to wait for workers of a cluster that has none, and between two looks at
#: the processes or the cluster.
WITHOUT_WORKERS = 45
LOOK = 1
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
            return
        waiting = deque()
        with _executor(workers, function, context) as pool:
            for piece in pieces:
                waiting.append(_submit(pool, function, piece))
                if len(waiting) > WAITING * _number(workers):
                    yield _result(waiting.popleft(), workers)
            while waiting:
                yield _result(waiting.popleft(), workers)


def as_done(function, pieces, n_workers, *, context=None):
    """
    Apply a function to pieces of work that may fail.

    Yields, in the order of completion, the index of a piece and its result, or the
    `Exception` that was raised.  Pieces that are at work when a process dies are tried
    once more, each alone, before they count as failed.  Arguments and errors are those
    of `in_order`.
    """
    items, lost = enumerate(pieces), [None]
    with workers_of(n_workers) as workers:
        if workers == 1:
            for index, piece in items:
                yield index, _outcome(function, piece)
            return
        # After the death of a process, a fresh executor goes on.
        while lost:
            lost, waiting = [], {}
            with _executor(workers, function, context) as pool:
                while True:
                    free = 0 if lost else _number(workers) - len(waiting)
                    for item in islice(items, max(free, 0)):
                        waiting[_submit(pool, function, item[1])] = item
                    if not waiting:
                        break
                    for future in _wait(waiting, workers):
                        item = waiting.pop(future)
                        died = not future.cancelled() and future.exception()
                        if isinstance(died, futures.BrokenExecutor):
                            lost.append(item)
                        else:
                            yield item[0], _outcome(_result, future, workers)
            for index, piece in lost:
                # Alone, so that it has all of the memory.
                with _executor(1, function, context) as pool:
                    yield index, _outcome(_result, _submit(pool, function, piece), 1)


def _outcome(function, *args):
    try:
        return function(*args)
    except Exception as error:
        return error


def _number(workers):
    """Return the number of processes, or of threads of all workers of a cluster."""
    if isinstance(workers, int):
        return workers
    try:
        return max(sum(workers.nthreads().values()), 1)
    except Exception:
        raise OSError(LOST) from None


def _submit(pool, function, piece):
    """Return the future of a call; that of an executor that is broken has its error."""
    try:
        with warnings.catch_warnings():
            # Pieces are large, but each is sent once to one worker.  Scattered data
            # would be lost with the worker that holds them.
            warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
            of_machine = isinstance(pool, futures.ProcessPoolExecutor)
            call = _call if of_machine else _call_on_one_thread
            return pool.submit(call, function, piece)
    except futures.BrokenExecutor as error:
        future = futures.Future()
        future.set_exception(error)
        return future


def _call_on_one_thread(function, piece):
    """Work on a cluster, whose workers have other work, too."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        return _call(function, piece)


def _call(function, piece):
    """Work in a process."""
    from multiprocessing.reduction import ForkingPickler

    try:
        return function(piece)
    except Exception as error:
        found = error
    try:
        ForkingPickler.loads(ForkingPickler.dumps(found))
    except Exception:
        # An error that cannot be sent would break the executor.
        found = RuntimeError(f"{type(found).__name__}: {found}")
    # Outside of the handlers, as the error before may be sent with it.
    raise found


def _wait(waiting, workers):
    """Return the futures that are done, at least one, as long as there are workers."""
    while not (done := futures.wait(waiting, LOOK, futures.FIRST_COMPLETED).done):
        if not isinstance(workers, int):
            _require_workers(workers)
    return done


def _require_workers(client):
    """Raise an OSError if a cluster remains without workers, or is lost."""
    try:
        client.wait_for_workers(1, timeout=WITHOUT_WORKERS)
    except TimeoutError:
        raise OSError(
            f"the scheduler has had no workers for {WITHOUT_WORKERS} s; start some, or "
            "see in their logs why they end"
        ) from None
    except Exception:
        raise OSError(LOST) from None


def _result(future, workers):
    """Return the result of a future, or raise a uniform error for lost workers."""
    _wait([future], workers)
    try:
        return future.result()
    except futures.BrokenExecutor:
        raise ChildProcessError(DIED) from None
    except futures.CancelledError:
        raise OSError(LOST) from None
    except Exception as error:
        # Dask's KilledWorker has this attribute.
        if not hasattr(error, "last_worker"):
            raise
        raise ChildProcessError(
            f"several workers died of one piece of work, the last was "
            f"{error.last_worker.address}; its log says why: for want of memory, often"
        ) from None


def _executor(workers, function, context):
    """Return the context of an executor that can work on a function."""
    if isinstance(workers, int):
        return _processes(workers, context)
    return _cluster(workers, function)


@contextmanager
def _processes(number, context):
    """
    Provide an executor of processes, which are killed at the end, even at work.

    When one has died, the others are killed, too: it may have left a lock or half a
    message, for the rest of which the executor would wait for ever.
    """
    pool = futures.ProcessPoolExecutor(number, get_context(context), initializer=_begin)
    processes, results = pool._processes, pool._result_queue._writer

    def end():
        for process in list(processes.values()):
            process.kill()

    def watch():
        # More processes may start.
        while not wait_for_any([p.sentinel for p in list(processes.values())], LOOK):
            pass
        end()
        results.close()

    guard = threading.Thread(target=watch, daemon=True)
    try:
        first = _submit(pool, int, 0)
        # After the processes, since those that are forked should have one thread.
        guard.start()
        # If processes cannot start at all, this is the error.
        _result(first, number)
        yield pool
    finally:
        end()
        if guard.ident:
            guard.join()
        pool.shutdown(cancel_futures=True)


def _begin():
    """Prepare a process for its work, on one thread, as all share the processor."""
    from threadpoolctl import threadpool_limits

    # The parent handles the signals of its terminal, and then ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # What has threads, with numpy, is not there in processes that begin as no copy.  To
    # limit each piece takes as long as many a piece.
    importlib.import_module("scipy.linalg")
    threadpool_limits(1)


def _end_with_parent():
    wait_for_any([parent_process().sentinel])
    os._exit(1)


@contextmanager
def open_client(address):
    """Connect to a Dask scheduler, such as ``tcp://node1:8786``, in this context."""
    try:
        import distributed
    except ImportError:
        raise ImportError(
            "a scheduler needs Dask: pip install distributed, or give a number "
            "of processes"
        ) from None
    try:
        # A client that is refused an address would try to close itself for long.
        distributed.comm.resolve_address(address)
        client = distributed.Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise OSError(f"scheduler {address}: cannot be reached: {reason}") from None
    with ExitStack() as stack:
        # Of lost workers and schedulers there is one error.
        for name in ("distributed", "distributed.client", "asyncio"):
            log = logging.getLogger(name)
            stack.callback(log.setLevel, log.level)
            log.setLevel(logging.CRITICAL)
        yield stack.enter_context(client)


@contextmanager
def _cluster(client, function):
    """
    Provide the executor of a cluster; what is not done at the end is cancelled.

    Another worker repeats a piece whose worker dies.  Raises an OSError if there are
    no workers, or they cannot import the function.
    """
    module = getattr(getattr(function, "func", function), "__module__", None)
    _require_workers(client)
    pool = client.get_executor(pure=False)
    try:
        if module:
            _result(pool.submit(importlib.import_module, module), client)
    except ImportError as error:
        raise OSError(
            f"workers of the scheduler cannot import {module} ({error}); install "
            "there what is installed here"
        ) from None
    try:
        yield pool
    except Exception:
        if client.status == "running":
            raise
        raise OSError(LOST) from None
    finally:
        if client.status == "running":
            pool.shutdown(wait=False)


# -- progress ----------------------------------------------------------------------

#: Seconds between two lines of progress where there is no terminal.
EVERY = 30


@contextmanager
def progress(total, label, *, show=True):
    """
    Show a progress bar, or lines of text where there is no terminal.

    Parameters
    ----------
    total : int or None
        Number of steps, if it is known.
    label : str
    show : bool, optional
        If False, nothing is shown and nothing imported.

    Yields
    ------
    callable
        To be called with the number of steps done since the last call.

    Examples
    --------
    >>> from astro_scc.parallel import progress
    >>> with progress(10, "Waiting", show=False) as done:
    ...     done(10)
    """
    if not show or total == 0:
        yield lambda number: None
    # A notebook is not a terminal, but it can show the bar.
    elif sys.stderr.isatty() or "ipykernel" in sys.modules:
        from tqdm import tqdm

        with tqdm(total=total, desc=label, dynamic_ncols=True) as bar:
            yield bar.update
    else:
        with _lines(total, label) as update:
            yield update


@contextmanager
def _lines(total, label):
    """Print a line every `EVERY` seconds, even if no step has ended since."""
    done, begun, ended = 0, time.monotonic(), threading.Event()

    def update(number):
        nonlocal done
        done += number

    def tell():
        while not ended.wait(EVERY):
            steps = f"{done} of {total}" if total else f"{done} done"
            minutes = (time.monotonic() - begun) / 60
            sys.stderr.write(f"{label}: {steps}, {minutes:.1f} min\n")
            sys.stderr.flush()

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield update
    finally:
        ended.set()
        teller.join()
