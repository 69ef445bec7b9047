# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Pieces of work that fail, or whose process dies, cost themselves only.

What is sent to workers is of the standard library (`eval`, of an expression), for they
cannot import a module of tests however the tests are started.
"""

import multiprocessing
import os
import subprocess
import sys
import time
from functools import partial
from operator import truediv

import pytest

from astro_scc.correlation.parallel import as_done, in_order, workers_of

inverse = partial(truediv, 1)
KILL = "__import__('os').kill(__import__('os').getpid(), 9)"
STARTS = [
    pytest.param(name, marks=() if name != "forkserver" else pytest.mark.slow)
    for name in multiprocessing.get_all_start_methods()
]


def deadly(values):
    """Expressions, of which that of 3 kills its process, whoever works on it."""
    return [KILL if k == 3 else f"10 * {k}" for k in values]


@pytest.mark.parametrize("n_workers", [1, 2])
def test_errors_are_results(n_workers):
    found = dict(as_done(inverse, [2, 0, 4, 0], n_workers))
    assert {k: v for k, v in found.items() if k in (0, 2)} == {0: 0.5, 2: 0.25}
    assert all(isinstance(found[k], ZeroDivisionError) for k in (1, 3))
    assert multiprocessing.active_children() == []


def test_in_this_process_pieces_are_taken_as_needed():
    taken = []

    def pieces():
        for k in range(1, 4):
            taken.append(k)
            yield k

    results = as_done(inverse, pieces(), 1)
    assert next(results) == (0, 1.0)
    assert taken == [1]
    assert [k for k, _ in results] == [1, 2]


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("context", STARTS)
def test_a_piece_that_kills_its_process(context):
    found = dict(as_done(eval, deadly(range(6)), 2, context=context))
    assert isinstance(found[3], ChildProcessError)
    assert "a worker process died" in str(found.pop(3))
    assert found == {k: 10 * k for k in range(6) if k != 3}
    assert multiprocessing.active_children() == []


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_piece_whose_process_is_killed_once(tmp_path):
    mark = str(tmp_path / "mark")
    once = f"__import__('os').path.exists({mark!r}) or open({mark!r}, 'w') and {KILL}"
    assert sorted(as_done(eval, ["1", once, "3"], 2)) == [(0, 1), (1, True), (2, 3)]


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_worker_that_dies_ends_work_in_order():
    with pytest.raises(ChildProcessError, match="fewer workers take less"):
        list(in_order(eval, deadly(range(6)), 2))
    assert multiprocessing.active_children() == []


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_pool_that_is_found_broken_with_the_next_piece():
    def pieces():
        yield from deadly([3])
        # Long enough for the process to die.
        time.sleep(0.5)
        yield from deadly((1, 2, 4))

    found = dict(as_done(eval, pieces(), 2))
    assert isinstance(found.pop(0), ChildProcessError)
    assert found == {1: 10, 2: 20, 3: 40}


UNGUARDED = """
import multiprocessing, operator
from astro_scc.correlation.parallel import as_done, in_order
multiprocessing.set_start_method({context!r}, force=True)
try:
    print(list({name}(operator.neg, [1, 2], 2)))
except ChildProcessError as error:
    print("error:", error)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["as_done", pytest.param("in_order", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("context", [c for c in STARTS if c.values != ("fork",)])
def test_processes_that_cannot_start(tmp_path, name, context):
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED.format(name=name, context=context))
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0
    assert done.stdout.splitlines()[-1].startswith("error: a worker process died")
    assert "if __name__ == '__main__'" in done.stdout


def test_who_stops_leaves_no_process():
    results = as_done(inverse, range(1, 30), 2)
    next(results)
    results.close()
    assert multiprocessing.active_children() == []


@pytest.mark.parametrize("n_workers", [0, -2])
def test_needs_a_worker(n_workers):
    with pytest.raises(ValueError, match="n_workers must be at least 1"):
        list(as_done(inverse, [1], n_workers))
    with workers_of(3) as workers:
        assert workers == 3
