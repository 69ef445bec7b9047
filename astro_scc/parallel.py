# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work in several processes, on this machine or a Dask cluster."""

import importlib
import logging
import math
import os
import signal
import threading
import time
import traceback
import warnings
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    ThreadPoolExecutor,
    wait,
)
from contextlib import ExitStack, closing, contextmanager, suppress
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait as wait_for_any
from multiprocessing.reduction import ForkingPickler
from numbers import Integral
from pathlib import Path
from queue import SimpleQueue

#: Pieces that wait for each process or thread; this limits memory, and the time that
#: an interrupted run takes to end.
WAITING = 2
#: Seconds to wait for a scheduler to answer.
TIMEOUT = 15
#: Seconds to wait for workers of a cluster that has none, and between two checks.
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
        with _pool(workers, context, function) as pool:
            for _, future in _each_done(pool, function, enumerate(pieces)):
                yield _result(future)


def as_done(function, pieces, n_workers, *, context=None):
    """
    Apply a function to pieces of work that may fail.

    Yields, in the order of completion, the index of a piece and its result, or the
    `Exception` that was raised.  A piece whose process dies is tried once more, alone,
    before it counts as failed.  Arguments and errors are those of `in_order`.
    """
    items, lost = enumerate(pieces), []

    def until_lost():
        while not lost and (item := next(items, None)):
            yield item

    with workers_of(n_workers) as workers:
        if workers == 1:
            for index, piece in items:
                yield index, _outcome(function, piece)
            return
        while True:
            lost.clear()
            with _pool(workers, context, function) as pool:
                done = _each_done(pool, function, until_lost(), ordered=False)
                for item, future in done:
                    died = not future.cancelled() and future.exception()
                    if isinstance(died, BrokenExecutor):
                        lost.append(item)
                    else:
                        yield item[0], _outcome(_result, future)
            for index, piece in lost:
                # Alone, so that it has all of the memory.
                with _pool(1, context, function) as pool:
                    yield index, _outcome(_result, pool.submit(function, piece))
            if not lost:
                return


def _outcome(function, *args):
    try:
        return function(*args)
    except Exception as error:
        return error


def _result(future):
    """Return the result of a future, or raise a uniform error for lost workers."""
    try:
        return future.result()
    except BrokenExecutor:
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


def _each_done(pool, function, items, *, ordered=True):
    """Yield numbered pieces and their futures, once they are done."""
    waiting = {}

    def next_done():
        futures = list(waiting)[: 1 if ordered else None]
        pool.wait(futures)
        done = next(future for future in futures if future.done())
        return waiting.pop(done), done

    for item in items:
        waiting[pool.submit(function, item[1])] = item
        if len(waiting) > WAITING * pool.n_workers:
            yield next_done()
    while waiting:
        yield next_done()


@contextmanager
def _pool(workers, context, function):
    """Open processes or a cluster that can work on a function."""
    local = isinstance(workers, int)
    pool = _Processes(workers, context) if local else _Cluster(workers)
    with closing(pool):
        pool.check(function)
        yield pool


class _Processes:
    """
    Processes that share nothing: each has a pipe, and a thread here that waits for it.

    One that is killed, at whatever moment, ends its own message and holds no lock, as
    it would with the queues of `concurrent.futures`.
    """

    def __init__(self, n_workers, context):
        self.n_workers = n_workers
        context, self._processes, self._pipes = get_context(context), [], SimpleQueue()
        self._threads = ThreadPoolExecutor(n_workers)
        try:
            for _ in range(n_workers):
                ours, theirs = context.Pipe()
                process = context.Process(target=_serve, args=(theirs,), daemon=True)
                # The end of the file is only seen where nobody else can write.
                with theirs:
                    process.start()
                self._processes.append(process)
                self._pipes.put(ours)
        except BaseException:
            self.close()
            raise

    def check(self, function):
        """Raise an error if processes cannot start at all."""
        _result(self.submit(eval, "None"))

    def submit(self, function, piece):
        """Return the future of a call."""
        return self._threads.submit(self._call, function, piece)

    def _call(self, *task):
        pipe = self._pipes.get()
        try:
            pipe.send_bytes(ForkingPickler.dumps(task))
            answer = pipe.recv_bytes()
        except (EOFError, OSError):
            raise BrokenExecutor from None
        finally:
            self._pipes.put(pipe)
        error, result = ForkingPickler.loads(answer)
        if error is not None:
            raise error
        return result

    def wait(self, futures):
        """Wait until one future is done."""
        wait(futures, return_when=FIRST_COMPLETED)

    def close(self):
        """Kill the processes, even at work."""
        for process in self._processes:
            process.kill()
            process.join()
        self._threads.shutdown(cancel_futures=True)


def _serve(pipe):
    """Work in a process."""
    # The parent handles the signals of its terminal, and then ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    from threadpoolctl import threadpool_limits

    # The workers already share the processor.
    threadpool_limits(1)
    # The parent may be killed.
    with suppress(EOFError, ConnectionError):
        while True:
            pipe.send_bytes(_answer(pipe.recv_bytes()))


def _answer(task):
    """Return the error and the result of a call, of which one is None, as bytes."""
    try:
        function, piece = ForkingPickler.loads(task)
        return ForkingPickler.dumps((None, function(piece)))
    except BaseException as error:
        error.add_note(f"In a worker process:\n{traceback.format_exc()}")
        try:
            return ForkingPickler.dumps((error, None))
        except Exception:
            error = RuntimeError(f"{type(error).__name__}: {error}")
            return ForkingPickler.dumps((error, None))


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


class _Cluster:
    """A Dask cluster, on which another worker repeats a piece whose worker dies."""

    def __init__(self, client):
        self._client, self._pool = client, client.get_executor(pure=False)

    def check(self, function):
        """Raise an OSError if the workers cannot import the function."""
        function = getattr(function, "func", function)
        name = getattr(function, "__module__", None) or "builtins"

        def load(_):
            # Pickled by value, since this module may be the missing one.
            importlib.import_module(name)

        future = self._submit(load, None)
        self.wait([future])
        try:
            _result(future)
        except ImportError as error:
            raise OSError(
                f"workers of the scheduler cannot import {name} ({error}); install "
                "there what is installed here"
            ) from None

    @property
    def n_workers(self):
        """Number of threads of all workers, at least 1."""
        return max(sum(self._ask(self._client.nthreads).values()), 1)

    def submit(self, function, piece):
        """Return the future of a call."""
        return self._submit(_one_thread, function, piece)

    def _submit(self, *call):
        with warnings.catch_warnings():
            # Pieces are large, but each is sent once to one worker.  Scattered data
            # would be lost with the worker that holds them.
            warnings.filterwarnings("ignore", "Sending large graph", UserWarning)
            return self._ask(self._pool.submit, *call)

    def wait(self, futures):
        """Wait until one future is done, as long as there are workers."""
        last = time.monotonic()
        while not wait(futures, LOOK, FIRST_COMPLETED).done:
            if self._ask(self._client.nthreads):
                last = time.monotonic()
            elif time.monotonic() - last >= WITHOUT_WORKERS:
                raise OSError(
                    f"the scheduler has had no workers for {WITHOUT_WORKERS} s; start "
                    "some, or see in their logs why they end"
                )

    def _ask(self, ask, *args):
        """Ask the scheduler, and raise a uniform error if it is lost."""
        try:
            return ask(*args)
        except Exception as error:
            if self._client.status == "running" and not isinstance(error, OSError):
                raise
            raise OSError(LOST) from None

    def close(self):
        """Cancel what is not done."""
        if self._client.status == "running":
            self._pool.shutdown(wait=False)


def _one_thread(function, piece):
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        return function(piece)
