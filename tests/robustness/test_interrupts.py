# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Measurements that are stopped at any moment, see ``tools/interrupts.py``."""

import os
import random
import signal
import sys
import time
import warnings

import pytest

from astro_scc.cli import main

pytestmark = pytest.mark.skipif(
    not hasattr(os, "fork"), reason="the system has no processes of this kind"
)


def start(argv, log):
    """A process that runs the command, quicker than a new one, and its number."""
    with warnings.catch_warnings():
        # Of threads, which the libraries of arrays may have.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child:
        return child
    status = 70
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for how in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(how, signal.SIG_DFL)
        sys.stdout = sys.stderr = log.open("a", encoding="utf-8")
        status = main(argv)
        sys.stdout.close()
    finally:
        os._exit(status)


def stop(child, after, how):
    """Send a signal after some seconds; how the process ended."""
    time.sleep(after)
    os.kill(child, how)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status)


def contents(folder):
    """Files, but for the hidden folder that a kill leaves."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    found = {str(path.relative_to(folder)): path.read_bytes() for path in files}
    return {name: content for name, content in found.items() if name[0] != "."}


@pytest.fixture
def usual(inputs, epochs, tmp_path):
    """The arguments without the folder, the products, and the seconds they take."""
    argv = ["measure", *map(str, epochs), *inputs.QUICK, "--no-report", "-o"]
    begin = time.monotonic()
    assert main([*argv, str(tmp_path / "usual")]) == 0
    seconds = time.monotonic() - begin
    return argv, contents(tmp_path / "usual"), seconds


@pytest.mark.slow
@pytest.mark.parametrize(("how", "seed"), [(signal.SIGINT, 1), (signal.SIGTERM, 3)])
def test_an_interrupt_leaves_nothing(usual, tmp_path, how, seed):
    argv, expected, seconds = usual
    out, log = tmp_path / "here" / "out", tmp_path / "log"
    rng = random.Random(seed)
    for _ in range(3):
        child = start([*argv, str(out), "--overwrite"], log)
        # 70 and the signal itself: before the command began.
        end = stop(child, rng.uniform(0, 1.1 * seconds), how)
        assert end in (0, 128 + how, 70, -how)
        # All of it, or nothing.
        assert not out.parent.exists() or contents(out) == expected
    assert main([*argv, str(out), "--overwrite"]) == 0
    assert contents(out) == expected
    assert not list(out.parent.rglob(".*"))
    assert "Traceback" not in log.read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_run_that_is_started_again_gives_the_same(tool, inputs, epochs, tmp_path):
    words = ["measure", *map(str, epochs), *inputs.QUICK, "--no-report"]
    options = {"number": 1, "seed": 1, "launch": start}
    trials = tool("interrupts").trials(words, tmp_path / "runs", **options)
    for trial, seconds in trials:
        assert trial.good, trial
        assert 0 < trial.after < seconds
        assert trial.status in (128 + trial.how, 70, -trial.how)
        assert "Traceback" not in trial.said
