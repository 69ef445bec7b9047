# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work in other processes: the same, in order, and nothing left behind."""

import math
import multiprocessing
import operator
import os
import pickle
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from astro_scc.correlation.parallel import WAITING, in_order, machine_memory

STARTS = [
    pytest.param(name, marks=() if name != "forkserver" else pytest.mark.slow)
    for name in multiprocessing.get_all_start_methods()
]


#: An error that is pickled, and raises another one when it is unpickled.
AGAIN = "type('E', (), {'__reduce__': lambda self: (UnicodeDecodeError, ())})()"


def test_in_this_process():
    taken = []

    def pieces():
        for k in range(3):
            taken.append(k)
            yield k

    results = in_order(lambda k: 10 * k, pieces(), 1)
    assert next(results) == 0
    assert taken == [0]
    assert list(results) == [10, 20]


def test_results_come_in_order():
    results = list(in_order(operator.neg, range(20), 2))
    assert results == [-k for k in range(20)]
    assert multiprocessing.active_children() == []


def test_pieces_are_taken_as_needed():
    taken = []

    def pieces():
        for k in range(30):
            taken.append(k)
            yield k

    results = in_order(operator.neg, pieces(), 2)
    next(results)
    assert len(taken) <= 2 * WAITING + 1
    # Whoever stops in the middle leaves no process behind.
    results.close()
    assert multiprocessing.active_children() == []


def test_an_error_of_a_worker_is_raised_here():
    with pytest.raises(ZeroDivisionError):
        list(in_order((1).__floordiv__, [1, 0, 1], 2))
    assert multiprocessing.active_children() == []


def test_an_error_says_where_in_the_worker_it_was_raised():
    with pytest.raises(ZeroDivisionError) as caught:
        list(in_order(eval, ["1 // 0"], 2))
    (note,) = caught.value.__notes__
    assert note.startswith("In a worker process:\nTraceback")


def test_what_cannot_be_sent_is_an_error():
    # To the worker, from it, and as an error; and what cannot be made here again.
    with pytest.raises((AttributeError, TypeError, pickle.PicklingError)):
        list(in_order(lambda value: value, [1], 2))
    with pytest.raises((AttributeError, TypeError, pickle.PicklingError)):
        list(in_order(eval, ["lambda: 1"], 2))
    with pytest.raises(RuntimeError, match="OSError: .*lambda"):
        list(in_order(exec, ["raise OSError(lambda: 1)"], 2))
    with pytest.raises(TypeError, match="UnicodeDecodeError|argument"):
        list(in_order(eval, [AGAIN], 2))
    assert multiprocessing.active_children() == []


@pytest.mark.slow
@pytest.mark.parametrize("context", STARTS)
def test_workers_have_one_thread_each(context):
    # With numpy, of which a worker that was not forked has nothing yet.
    threads = (
        "__import__('numpy') and "
        "[p['num_threads'] for p in __import__('threadpoolctl').threadpool_info()]"
    )
    for pools in in_order(eval, [threads] * 2, 2, context=context):
        assert set(pools) <= {1}


@pytest.mark.parametrize("n_workers", [0, -1])
def test_needs_a_worker(n_workers):
    with pytest.raises(ValueError, match="n_workers must be at least 1"):
        list(in_order(operator.neg, [1], n_workers))


def test_memory_of_the_machine_and_of_a_job(monkeypatch, tmp_path):
    resource = pytest.importorskip("resource")
    whole = machine_memory()
    assert 1e8 < whole < 1e15
    names = [str(tmp_path / name) for name in ("v1", "v2", "none")]
    (tmp_path / "v1").write_text("max\n")
    (tmp_path / "v2").write_text("12345\n")
    monkeypatch.setattr("astro_scc.correlation.parallel.CONTROL_GROUPS", names[::2])
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY,) * 2)
    assert machine_memory() >= whole
    monkeypatch.setattr("astro_scc.correlation.parallel.CONTROL_GROUPS", names)
    assert machine_memory() == 12345
    monkeypatch.setattr(resource, "getrlimit", lambda _: (1234, -1))
    assert machine_memory() == 1234
    # As on Windows.
    monkeypatch.setattr("astro_scc.correlation.parallel.CONTROL_GROUPS", ())
    monkeypatch.setitem(sys.modules, "resource", None)
    monkeypatch.delattr("os.sysconf")
    assert machine_memory() == math.inf


SCRIPT = """
import signal
import time
from astro_scc.correlation.parallel import in_order
# Whatever starts the tests may have told its children to ignore it.
signal.signal(signal.SIGINT, signal.default_int_handler)
print("begun", flush=True)
try:
    for _ in in_order(time.sleep, [0.0] + [0.2] * 500, 2):
        print("piece", flush=True)
except KeyboardInterrupt:
    import multiprocessing
    print("left:", len(multiprocessing.active_children()), flush=True)
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_an_interrupt_ends_it_at_once():
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout.readline() == "begun\n"
    for _ in range(3):
        assert process.stdout.readline() == "piece\n"
    # As a terminal does: to all processes of the group.
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert out.count("piece") < 100
    assert out.splitlines()[-1] == "left: 0"
    assert err == ""


LARGE = """
from astro_scc.correlation.parallel import in_order

def large(value):
    return bytes(value)

if __name__ == "__main__":
    for round in range(5):
        try:
            for k, _ in enumerate(in_order(large, [1_000_000] * 1000, 2)):
                if k == 5 + round:
                    raise KeyboardInterrupt
        except KeyboardInterrupt:
            print("ended", flush=True)
"""


@pytest.mark.slow
def test_workers_end_between_results(tmp_path):
    """One that ends while it sends its result would leave the pool waiting for ever."""
    script = tmp_path / "large.py"
    script.write_text(LARGE)
    with subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, text=True
    ) as process:
        out, _ = process.communicate(timeout=100)
    assert out.count("ended") == 5


UNENDING = """
import multiprocessing, sys, time
from astro_scc.correlation.parallel import in_order

def nap(value):
    time.sleep(0.05)
    return value

if __name__ == "__main__":
    for _ in in_order(nap, range(10_000), 2):
        print(*(p.pid for p in multiprocessing.active_children()), flush=True)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(UNENDING)
    with subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, text=True
    ) as parent:
        workers = next(line.split() for line in parent.stdout if len(line.split()) == 2)
        parent.kill()
        parent.wait()
        limit = time.monotonic() + 60
        while any(Path(f"/proc/{pid}").exists() for pid in workers):
            assert time.monotonic() < limit
            time.sleep(0.05)
