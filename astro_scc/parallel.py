# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work in several processes, on this machine or a Dask cluster."""

import importlib
import logging
import math
import multiprocessing
import os
import signal
import threading
import time
import traceback
import warnings
from collections import deque
from concurrent.futures import BrokenExecutor, CancelledError, Future
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from multiprocessing.connection import wait as wait_for_any
from multiprocessing.reduction import ForkingPickler
from numbers import Integral
from pathlib import Path

#: Pieces that wait for each process or thread; this limits memory, and the time that
#: an interrupted run takes to end.
WAITING = 2
#: Seconds that a process has to end.
GRACE = 2
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
        elif isinstance(workers, int):
            with closing(_Pool(workers, context)) as pool:
                for _, future in _in_pool(pool, function, enumerate(pieces)):
                    yield _result(future.result)
        else:
            for _, get in _on_cluster(workers, function, pieces):
                yield _result(get)


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
            for (index, _), get in done:
                yield index, _outcome(_result, get)


def _outcome(function, *args):
    try:
        return function(*args)
    except Exception as error:
        return error


def _result(get):
    """Get the result of a future, or raise a uniform error for lost workers."""
    try:
        return get()
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


def _each_done(items, waiting, submit, wait_for, n_workers, ordered):
    """Yield numbered pieces and their futures, once they are done."""

    def next_done():
        futures = [future for _, future in waiting]
        wait_for(futures[:1] if ordered else futures)
        done = (k for k, future in enumerate(futures) if ordered or future.done())
        return waiting.pop(next(done))

    for item in items:
        waiting.append((item, submit(item[1])))
        if len(waiting) > WAITING * n_workers():
            yield next_done()
    while waiting:
        yield next_done()


def _in_pool(pool, function, items, *, ordered=True):
    """Yield numbered pieces and their futures, once processes have done them."""
    how = partial(pool.submit, function), pool.wait, lambda: pool.n_workers, ordered
    return _each_done(items, [], *how)


def _as_done(function, items, n_workers, context):
    def until_broken():
        while not lost and (item := next(items, None)):
            yield item

    while True:
        lost = []
        with closing(_Pool(n_workers, context)) as pool:
            # If processes cannot start at all, no piece is tried.
            pool.call(eval, "None")
            done = _in_pool(pool, function, until_broken(), ordered=False)
            for item, future in done:
                if isinstance(future.exception(), BrokenExecutor):
                    lost.append(item)
                else:
                    yield item[0], _outcome(_result, future.result)
        for index, piece in lost:
            # Alone, so that it cannot harm other pieces.
            with closing(_Pool(1, context)) as pool:
                yield index, _outcome(pool.call, function, piece)
        if not lost:
            return


class _Worker:
    """A process, the parent's end of its pipe, and the future of its task."""

    def __init__(self, context):
        self.pipe, theirs = context.Pipe()
        self.future = None
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        # The end of the file is only seen where nobody else can write.
        with theirs:
            self.process.start()


class _Pool:
    """
    Processes that share nothing: each has a pipe for tasks and results.

    One that is killed, at whatever moment, ends its own message and holds no lock, as
    it would with the queues of `concurrent.futures`.  It breaks the pool: whatever is
    not done fails with a BrokenExecutor, and the other processes are killed.
    """

    def __init__(self, n_workers, context):
        self.n_workers = n_workers
        self._context = multiprocessing.get_context(context)
        self._workers, self._tasks = [], deque()

    def submit(self, function, piece):
        """Return the future of a call, of which `wait` gets the result."""
        future = Future()
        self._tasks.append((future, ForkingPickler.dumps((function, piece))))
        self._send()
        return future

    def call(self, function, piece):
        """Return the result of a call."""
        future = self.submit(function, piece)
        self.wait([future])
        return _result(future.result)

    def wait(self, futures):
        """Wait until one of the futures is done."""
        while not any(future.done() for future in futures):
            ready = wait_for_any([worker.pipe for worker in self._workers])
            for worker in [w for w in self._workers if w.pipe in ready]:
                try:
                    answer = worker.pipe.recv_bytes()
                except (EOFError, OSError):
                    self._break()
                    break
                future, worker.future = worker.future, None
                try:
                    error, result = ForkingPickler.loads(answer)
                except Exception as wrong:
                    error = wrong
                if error is None:
                    future.set_result(result)
                else:
                    future.set_exception(error)
            self._send()

    def _send(self):
        """Send tasks to processes that have none."""
        try:
            # All start at once, for a task is sent no faster than its process starts.
            while len(self._workers) < self.n_workers:
                self._workers.append(_Worker(self._context))
            for worker in self._workers:
                if worker.future is None and self._tasks:
                    worker.future, task = self._tasks.popleft()
                    worker.pipe.send_bytes(task)
        except (ConnectionError, EOFError):
            self._break()

    def _break(self):
        futures = [w.future for w in self._workers] + [f for f, _ in self._tasks]
        self._tasks.clear()
        self.close()
        for future in futures:
            if future is not None:
                future.set_exception(BrokenExecutor())

    def close(self):
        """Kill the processes, even at work."""
        for worker in self._workers:
            worker.process.kill()
        while self._workers:
            worker = self._workers.pop()
            worker.process.join(GRACE)
            worker.pipe.close()


def _serve(pipe):
    """Work in a process."""
    # The parent handles the signals of its terminal, and then ends its workers.
    for name, handler in (
        ("SIGINT", signal.SIG_IGN),
        ("SIGHUP", signal.SIG_IGN),
        ("SIGTERM", signal.SIG_DFL),
    ):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), handler)
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
    wait_for_any([multiprocessing.parent_process().sentinel])
    os._exit(1)


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
    with _without_logs(), client:
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
    with (
        _without_logs(),
        cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


@contextmanager
def _without_logs():
    """Keep quiet about lost workers and schedulers, of which there is one error."""
    with ExitStack() as stack:
        for name in ("distributed", "distributed.client", "asyncio"):
            log = logging.getLogger(name)
            stack.callback(log.setLevel, log.level)
            log.setLevel(logging.CRITICAL)
        yield


def _dask():
    try:
        import distributed
    except ImportError:
        raise ImportError(
            "a scheduler needs Dask: pip install distributed, or give a number "
            "of processes"
        ) from None
    return distributed


def _on_cluster(client, function, pieces, *, ordered=True):
    """
    Yield numbered pieces, once a cluster has done them, and how to get their results.

    Another worker repeats a piece whose worker dies.
    """
    _check_import(client, function)
    submit = partial(_submit, client, _one_thread, function)
    how = submit, partial(_wait_on_cluster, client), partial(_threads, client), ordered
    waiting = []
    try:
        for item, future in _each_done(enumerate(pieces), waiting, *how):
            # A worker may take a result with it when it ends.
            yield item, partial(_while_workers, client, future.result)
    finally:
        if client.status == "running":
            client.cancel([future for _, future in waiting])


def _threads(client):
    return max(sum(_ask(client, client.nthreads).values()), 1)


def _check_import(client, function):
    """Raise an OSError if the workers cannot import the function."""
    name = getattr(function, "__module__", None) or "builtins"

    def load():
        # Pickled by value, since this module may be the missing one.
        importlib.import_module(name)

    future = _submit(client, load)
    _wait_on_cluster(client, [future])
    try:
        _result(partial(_while_workers, client, future.result))
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

    def wait_for(timeout):
        # All futures are cancelled when the scheduler is lost.
        with client.as_current(), suppress(CancelledError):
            wait(futures, timeout=timeout, return_when="FIRST_COMPLETED")

    _while_workers(client, wait_for)


def _while_workers(client, ask):
    """Ask with a timeout, again and again as long as there are workers."""
    last = time.monotonic()
    while True:
        begin = time.monotonic()
        try:
            return ask(timeout=LOOK)
        except TimeoutError:
            # The function may have raised it.
            if time.monotonic() - begin < LOOK:
                raise
        if _ask(client, client.nthreads):
            last = time.monotonic()
        elif time.monotonic() - last >= WITHOUT_WORKERS:
            raise OSError(
                f"the scheduler has had no workers for {WITHOUT_WORKERS} s; start "
                "some, or see in their logs why they end"
            )
