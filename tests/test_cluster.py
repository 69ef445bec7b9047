# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work on a real Dask cluster of two processes, one of which is killed."""

import builtins
import operator
import os
import signal
import sys
import time
import types
from concurrent.futures import Future
from contextlib import contextmanager

import numpy as np
import pytest

from astro_scc.correlation import Correlator, all_pairs
from astro_scc.decomposition import Decomposer
from astro_scc.parallel import (
    _result,
    as_done,
    in_order,
    open_client,
    workers_of,
)
from astro_scc.simulation import simulate_two_fluid


@pytest.fixture(scope="module")
def cluster():
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            dashboard_address=":0",
            memory_limit=None,
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        client.wait_for_workers(2)
        yield client


@pytest.fixture(scope="module")
def epochs():
    images = simulate_two_fluid(n_epochs=5, rng=5).cube.data
    return [Decomposer(scales=[1, 2])(image) for image in images]


@pytest.mark.slow
def test_results_come_in_order_and_as_needed(cluster):
    taken = []

    def pieces():
        for k in range(12):
            taken.append(k)
            yield k

    results = in_order(operator.neg, pieces(), cluster)
    assert next(results) == 0
    assert len(taken) < 12
    assert list(results) == [-k for k in range(1, 12)]
    found = dict(as_done(operator.neg, range(12), cluster))
    assert found == {k: -k for k in range(12)}


def test_an_address_is_as_good_as_a_client(cluster):
    address = cluster.scheduler.address
    assert list(in_order(operator.neg, [1, 2], address)) == [-1, -2]
    with workers_of(cluster) as same:
        assert same is cluster
    assert cluster.status == "running"


def test_a_killed_worker_changes_nothing(cluster, epochs, monkeypatch):
    # One block for each reference epoch.
    monkeypatch.setattr("astro_scc.correlation.correlate.BLOCK_WORK", 1)
    pairs = all_pairs(5)
    correlate = Correlator()
    assert len(list(correlate._blocks(epochs, pairs, (8, 8), None))) == 5
    serial = correlate(epochs, pairs, 8)
    assert len(serial) > 50
    done = []

    def kill(number):
        done.append(number)
        if len(done) == 1:
            pids = cluster.run(os.getpid)
            os.kill(min(pids.values()), signal.SIGKILL)

    found = correlate(epochs, pairs, 8, n_workers=cluster, progress=kill)
    assert len(done) == 5
    np.testing.assert_equal(vars(found), vars(serial))


def test_a_function_that_workers_cannot_import(cluster, monkeypatch):
    # Here it is, there it is not; workers died of it, for ever.
    module = types.ModuleType("only_here")
    module.negative = types.FunctionType(
        (lambda value: -value).__code__, {}, "negative"
    )
    module.negative.__module__ = "only_here"
    module.negative.__qualname__ = "negative"
    monkeypatch.setitem(sys.modules, "only_here", module)
    for work in (in_order, as_done):
        with pytest.raises(OSError, match="scheduler cannot import only_here"):
            list(work(module.negative, [1], cluster))
    assert list(in_order(operator.neg, [1], cluster)) == [-1]


@contextmanager
def threads(number):
    """A client of a scheduler whose workers are threads of this process."""
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=number, processes=False, dashboard_address=":0"
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        yield client


def test_a_scheduler_without_workers(monkeypatch):
    monkeypatch.setattr("astro_scc.parallel.WITHOUT_WORKERS", 0.1)
    monkeypatch.setattr("astro_scc.parallel.LOOK", 0.1)
    with threads(0) as client:
        for work in (in_order, as_done):
            with pytest.raises(OSError, match="has had no workers for 0.1 s; start"):
                list(work(operator.neg, [1], client))


def test_workers_that_are_lost_between_two_stages(monkeypatch):
    monkeypatch.setattr("astro_scc.parallel.WITHOUT_WORKERS", 0.1)
    monkeypatch.setattr("astro_scc.parallel.LOOK", 0.1)
    with threads(1) as client:
        assert list(in_order(operator.neg, [1], client)) == [-1]
        # By their addresses, and again: the scheduler keeps those that seem busy, or
        # that still hold a result.
        while workers := [*client.nthreads()]:
            client.retire_workers(workers)
            time.sleep(0.01)
        # Nobody waits as long as for the first workers.
        with pytest.raises(OSError, match="has had no workers for 0.1 s; start"):
            list(in_order(operator.neg, [1], client))


def test_a_scheduler_that_is_lost():
    def pieces(client):
        yield 1
        client.close()
        yield 2

    with threads(1) as client:
        with pytest.raises(OSError, match="was lost; start it and this again"):
            list(in_order(operator.neg, pieces(client), client))


def test_work_that_is_not_done():
    distributed = pytest.importorskip("distributed")
    future = Future()
    future.cancel()
    future.set_running_or_notify_cancel()
    with pytest.raises(OSError, match="was lost; start it and this again"):
        _result(future.result)
    # As the scheduler says after four workers died of one piece.
    future = Future()
    worker = types.SimpleNamespace(address="tcp://127.0.0.1:9")
    future.set_exception(distributed.KilledWorker("piece", worker, 3))
    with pytest.raises(ChildProcessError, match="several workers died of one piece"):
        _result(future.result)


def test_without_dask(monkeypatch):
    original = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name.split(".")[0] == "distributed":
            raise ImportError(name)
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(ImportError, match="pip install distributed"):
        with open_client("tcp://127.0.0.1:9"):
            pass


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("tcp://127.0.0.1:9", "tcp://127.0.0.1:9: cannot be reached"),
        ("node1", "node1: cannot be reached: missing port number"),
    ],
)
def test_a_scheduler_that_is_not_there(monkeypatch, address, message):
    pytest.importorskip("distributed")
    monkeypatch.setattr("astro_scc.parallel.TIMEOUT", 0.2)
    with pytest.raises(OSError, match=message):
        list(in_order(operator.neg, [1], address))
