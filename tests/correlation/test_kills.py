# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Workers that are killed at any moment: one line and the end, and no hang."""

import multiprocessing
import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")

#: A command whose workers are killed: while they write a result that nobody reads yet,
#: at a random moment, or when they are told to end.
SCRIPT = """
import multiprocessing, os, random, sys, threading, time
from multiprocessing.util import Finalize

from astro_scc.cli import main, track
from astro_scc.correlation.parallel import in_order

when, context, n = sys.argv[1], sys.argv[2], int(sys.argv[3])
since = None

def work(dies):
    if dies:
        Finalize(None, os.kill, (os.getpid(), 9), exitpriority=1)
    time.sleep(0.01)
    return bytes(3_000_000)

def kill(after):
    global since
    time.sleep(after)
    while not (workers := multiprocessing.active_children()):
        time.sleep(0.01)
    worker = random.choice(workers)
    # By then it has replaced the handlers of the parent.
    ways = [worker.kill] if when == "random" else [worker.kill, worker.terminate]
    since = time.monotonic()
    random.choice(ways)()

def run(args, reporter):
    global since
    # Random: while they start and while they work.
    longest = 0.2 if when == "pipe" else 1 if context == "fork" else 6
    thread = threading.Thread(target=kill, args=[random.uniform(0, longest)])
    if when == "random":
        thread.start()
    pieces = [when == "end"] * (6 if when == "end" else 10_000)
    for k, _ in enumerate(in_order(work, pieces, 2, context=context)):
        if when == "end":
            since = time.monotonic()
        if k == 0 and when == "pipe":
            thread.start()
            time.sleep(0.3)

if __name__ == "__main__":
    track.track = run
    for seed in range(n):
        random.seed(seed)
        status = main(["track", "none.fits"])
        left = len(multiprocessing.active_children())
        print(status, f"{time.monotonic() - since:.2f}", left, flush=True)
"""


@pytest.mark.parametrize("when", ["pipe", "random", "end"])
@pytest.mark.parametrize(
    ("context", "n"),
    [pytest.param(None, 1, id="once")]
    + [
        pytest.param(name, 3, id=name, marks=pytest.mark.slow)
        for name in multiprocessing.get_all_start_methods()
    ],
)
def test_a_killed_worker_is_one_line(tmp_path, when, context, n):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    command = [sys.executable, "-W", "ignore", script, when]
    command += [context or multiprocessing.get_all_start_methods()[0], str(n)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20 + 10 * n)
    found = [line.split() for line in done.stdout.splitlines()]
    assert [(status, left) for status, _, left in found] == [("2", "0")] * n
    assert all(float(seconds) < 10 for _, seconds, _ in found)
    lines = done.stderr.splitlines()
    assert len(lines) == n
    assert all(
        line.startswith("astro-scc track: error: a worker process died")
        for line in lines
    )
