# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Pieces of work that fail, or whose process dies, cost themselves only."""

import multiprocessing
import os
import signal
import time

import pytest

from astro_scc.correlation.workers import as_done, workers_of


def inverse(value):
    return 1 / value


def deadly(value):
    """One of them kills its process, whoever works on it."""
    if value == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return 10 * value


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


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_piece_that_kills_its_process():
    found = dict(as_done(deadly, range(6), 2))
    assert set(found) == set(range(6))
    assert {k: v for k, v in found.items() if k != 3} == {
        k: 10 * k for k in range(6) if k != 3
    }
    assert isinstance(found[3], Exception)
    assert multiprocessing.active_children() == []


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_a_pool_that_is_found_broken_with_the_next_piece():
    def pieces():
        yield 3
        # Long enough for the process to die.
        time.sleep(0.5)
        yield from (1, 2, 4)

    found = dict(as_done(deadly, pieces(), 2))
    assert isinstance(found.pop(0), Exception)
    assert found == {1: 10, 2: 20, 3: 40}


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
