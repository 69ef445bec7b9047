# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work in several processes, of which some fail, are killed or end."""

import multiprocessing
import operator
import os
import pickle
import subprocess
import sys
import time
from functools import partial
from operator import truediv

import pytest

from astro_scc.parallel import WAITING, as_done, in_order

posix = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
inverse = partial(truediv, 1)
KILL = "__import__('os').kill(__import__('os').getpid(), 9)"
#: An error that is pickled, and raises another one when it is unpickled.
AGAIN = (
    "type('E', (Exception,), {'__reduce__': lambda s: (UnicodeDecodeError, ())})"
    "('again')"
)
#: The usual way to start a process, and others, which take longer.
FIRST, *OTHERS = multiprocessing.get_all_start_methods()
STARTS = [FIRST, *(pytest.param(name, marks=pytest.mark.slow) for name in OTHERS)]


@pytest.fixture(autouse=True)
def none_left():
    """Whoever stops, fails or ends leaves no process behind."""
    yield
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize("work", [as_done, in_order])
def test_workers_that_are_refused(work):
    for n_workers, words in ((0, "at least 1"), (True, "a number of processes")):
        with pytest.raises((ValueError, TypeError), match=f"n_workers .*{words}"):
            list(work(inverse, [1], n_workers))


@pytest.mark.parametrize(("work", "n"), [(as_done, 1), (in_order, 1), (in_order, 2)])
def test_pieces_are_taken_as_needed_and_keep_their_order(work, n):
    taken = []

    def pieces():
        for k in range(1, 31):
            taken.append(k)
            yield k

    results = work(operator.neg, pieces(), n)
    first = [next(results), next(results)]
    assert first == ([-1, -2] if work is in_order else [(0, -1), (1, -2)])
    assert len(taken) <= (2 if n == 1 else n * WAITING + 2)
    results.close()


@pytest.mark.parametrize("n_workers", [1, 2])
def test_errors_are_results(n_workers):
    found = dict(as_done(inverse, [2, 0, 4, 0], n_workers))
    assert {k: v for k, v in found.items() if k in (0, 2)} == {0: 0.5, 2: 0.25}
    assert all(isinstance(found[k], ZeroDivisionError) for k in (1, 3))


def test_errors_of_workers():
    with pytest.raises(ZeroDivisionError) as caught:
        list(in_order(eval, ["1 // 0"], 2))
    assert "Traceback" in str(caught.value.__cause__)
    # What cannot be sent: to the worker, from it, or as an error.
    unsendable = (AttributeError, TypeError, pickle.PicklingError)
    with pytest.raises(unsendable):
        list(in_order(lambda value: value, [1], 2))
    found = dict(as_done(eval, ["lambda: 1", "2"], 2))
    assert isinstance(found[0], unsendable)
    assert found[1] == 2
    for error in ("OSError(lambda: 1)", AGAIN):
        with pytest.raises(RuntimeError, match="(OSError: .*lambda|E: again)"):
            list(in_order(exec, [f"raise {error}"], 2))


@pytest.mark.slow
@pytest.mark.parametrize("context", STARTS)
def test_workers_have_one_thread_each(context):
    # With numpy, of which a worker that was not forked has nothing yet.
    threads = (
        "__import__('numpy') and "
        "[p['num_threads'] for p in __import__('threadpoolctl').threadpool_info()]"
    )
    for pools in in_order(eval, [threads] * 2, 2, context=context):
        assert set(pools) == {1}


def deadly(values):
    """Expressions, of which that of 3 kills its process, whoever works on it."""
    return [KILL if k == 3 else f"10 * {k}" for k in values]


@posix
@pytest.mark.parametrize("context", STARTS)
def test_a_piece_that_kills_its_process(context, tmp_path):
    mark = str(tmp_path / "mark")
    once = f"__import__('os').path.exists({mark!r}) or open({mark!r}, 'w') and {KILL}"

    def pieces():
        yield from deadly(range(6))
        # Long enough for a process to die before the next piece.
        time.sleep(0.3)
        yield "60"

    found = dict(as_done(eval, pieces(), 2, context=context))
    assert isinstance(found[3], ChildProcessError)
    assert "a worker process died" in str(found.pop(3))
    assert found == {0: 0, 1: 10, 2: 20, 4: 40, 5: 50, 6: 60}
    assert dict(as_done(eval, ["1", once, "3"], 2)) == {0: 1, 1: True, 2: 3}
    with pytest.raises(ChildProcessError, match="fewer workers take less"):
        list(in_order(eval, deadly(range(6)), 2, context=context))


#: A worker is killed at a random moment while it starts, works or writes a result.
SCRIPT = """
import multiprocessing, random, signal, sys, threading, time
from astro_scc.parallel import in_order

context, n = sys.argv[1], int(sys.argv[2])

def work(_):
    time.sleep(0.01)
    return bytes(3_000_000)

def kill(after):
    time.sleep(after)
    while not (workers := multiprocessing.active_children()):
        time.sleep(0.01)
    random.choice(workers).kill()

if __name__ == "__main__":
    for seed in range(n):
        random.seed(seed)
        after = random.uniform(0, 1 if context == "fork" else 4)
        threading.Thread(target=kill, args=[after]).start()
        try:
            for _ in in_order(work, range(10_000), 2, context=context):
                pass
        except ChildProcessError as error:
            print(len(multiprocessing.active_children()), error)
"""


@posix
@pytest.mark.parametrize("context", STARTS)
def test_a_killed_worker_is_an_error(tmp_path, context):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    command = [sys.executable, script, context, "3"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=90)
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert len(lines) == 3
    assert all(line.startswith("0 a worker process died") for line in lines)
