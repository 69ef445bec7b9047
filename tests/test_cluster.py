# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Work on a real Dask cluster of two processes, one of which is killed."""

import operator
import os
import signal
import sys
import types
from concurrent.futures import Future
from contextlib import contextmanager

import numpy as np
import pytest

from astro_scc.cli import main
from astro_scc.parallel import _result, as_done, in_order

distributed = pytest.importorskip("distributed")


@contextmanager
def cluster_of(n_workers, *, processes=False):
    """A client of a scheduler whose workers are threads here, or processes."""
    with (
        distributed.LocalCluster(
            n_workers=n_workers, threads_per_worker=1, processes=processes,
            dashboard_address=":0", memory_limit=None,
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):  # fmt: skip
        yield client


@pytest.fixture(scope="module")
def cluster():
    with cluster_of(2, processes=True) as client:
        client.wait_for_workers(2)
        yield client


def test_results_come_in_order_and_as_needed():
    taken = []

    def pieces():
        for k in range(12):
            taken.append(k)
            yield k

    with cluster_of(2) as cluster:
        results = in_order(operator.neg, pieces(), cluster)
        assert next(results) == 0
        assert len(taken) < 12
        assert list(results) == [-k for k in range(1, 12)]
        found = dict(as_done(operator.neg, range(12), cluster))
        assert found == {k: -k for k in range(12)}
        # An address is as good as a client.
        address = cluster.scheduler.address
        assert list(in_order(operator.neg, [1, 2], address)) == [-1, -2]
        assert cluster.status == "running"


def test_a_survey_on_a_cluster(tmp_path, capsys):
    plan, out = tmp_path / "s.toml", tmp_path / "out"
    plan.write_text("[sources.A]\nepochs = 'no.fits'\n")
    with cluster_of(1) as client:
        address = client.scheduler.address
        assert main(f"survey {plan} -o {out} --scheduler {address}".split()) == 2
    err = capsys.readouterr().err
    assert "note: dashboard of the cluster: http" in err
    assert "no source could be measured" in err


@pytest.mark.slow
def test_a_killed_worker_changes_nothing(cluster):
    pieces = np.random.default_rng(1).normal(size=(8, 1000))
    found = in_order(np.cumsum, pieces, cluster)
    for k, own in enumerate(found):
        np.testing.assert_array_equal(own, np.cumsum(pieces[k]))
        if k == 0:
            os.kill(min(cluster.run(os.getpid).values()), signal.SIGKILL)
    assert k == 7


@pytest.mark.slow
def test_a_function_that_workers_cannot_import(cluster, monkeypatch):
    # Here it is, there it is not; workers died of it, for ever.
    module = types.ModuleType("only_here")
    code = (lambda value: -value).__code__
    module.negative = types.FunctionType(code, {}, "negative")
    module.negative.__module__ = "only_here"
    module.negative.__qualname__ = "negative"
    monkeypatch.setitem(sys.modules, "only_here", module)
    for work in (in_order, as_done):
        with pytest.raises(OSError, match="scheduler cannot import only_here"):
            list(work(module.negative, [1], cluster))
    assert list(in_order(operator.neg, [1], cluster)) == [-1]


def test_a_scheduler_without_workers_and_one_that_is_lost(monkeypatch):
    for name in ("WITHOUT_WORKERS", "LOOK"):
        monkeypatch.setattr(f"astro_scc.parallel.{name}", 0.1)
    with cluster_of(0) as client:
        for work in (in_order, as_done):
            with pytest.raises(OSError, match="has had no workers for 0.1 s; start"):
                list(work(operator.neg, [1], client))

    def pieces(client):
        yield 1
        client.close()
        yield 2

    with cluster_of(1) as client:
        with pytest.raises(OSError, match="was lost; start it and this again"):
            list(in_order(operator.neg, pieces(client), client))


def test_without_dask_or_a_scheduler(monkeypatch):
    monkeypatch.setattr("astro_scc.parallel.TIMEOUT", 0.2)
    for address in ("tcp://127.0.0.1:9", "node1"):
        with pytest.raises(OSError, match=f"{address}: cannot be reached"):
            list(in_order(operator.neg, [1], address))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ImportError, match="pip install distributed"):
        list(in_order(operator.neg, [1], "tcp://127.0.0.1:9"))


def test_work_that_is_not_done():
    future = Future()
    future.cancel()
    future.set_running_or_notify_cancel()
    with pytest.raises(OSError, match="was lost; start it and this again"):
        _result(future, 2)
    # As the scheduler says after four workers died of one piece.
    future = Future()
    worker = types.SimpleNamespace(address="tcp://127.0.0.1:9")
    future.set_exception(distributed.KilledWorker("piece", worker, 3))
    with pytest.raises(ChildProcessError, match="several workers died of one piece"):
        _result(future, 2)
