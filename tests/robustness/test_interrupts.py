# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Measurements that are stopped at any moment, see ``tools/interrupts.py``."""

import os
import signal
import sys
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


@pytest.mark.slow
def test_a_run_that_is_started_again_gives_the_same(tool, inputs, epochs, tmp_path):
    words = ["measure", *map(str, epochs), *inputs.QUICK, "--no-report"]
    options = {"number": 3, "seed": 1, "launch": start}
    trials = tool("interrupts").trials(words, tmp_path / "runs", **options)
    for trial, seconds in trials:
        assert trial.good, trial
        assert 0 < trial.after < seconds
        assert trial.status in (128 + trial.how, 70, -trial.how)
        assert "Traceback" not in trial.said
