# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""
Time the measurement of the two-fluid jet of the paper on one core.

The jet has ten epochs of 256 x 128 pixels and is measured on three scales, with 1000
trials each of the permutation test, of the paper's z-score and of the velocity-jitter
test, for the SSPs of the whole image and of the paper's region, ten beams long.  The
stages run in this process after all imports; ``astro-scc --help`` is a process of its
own::

    python benchmarks/speed.py
"""

import argparse
import os
import subprocess
import sys
import time

# Libraries read these when they are loaded.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import astropy.units as u
import numpy as np
import scipy.stats  # noqa: F401 (the errors of components load it)
from common import Stopwatch, write_table

from astro_scc import StackedCrossCorrelation
from astro_scc.simulation import simulate_two_fluid

#: Columns of the paper's region.
REGION = slice(60, 160)
HELP = [sys.executable, "-m", "astro_scc", "--help"]


def main():
    """Time the stages and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("--n-trials", type=int, default=1000)
    parser.add_argument("--help-runs", type=int, default=5)
    args = parser.parse_args()
    watch = Stopwatch()
    jet = simulate_two_fluid(rng=1)
    watch.lap("simulate ten epochs")
    scc = StackedCrossCorrelation(
        scales=(1, 2, 3), max_speed=48 * u.mas / u.yr, position_angle=270 * u.deg
    )
    inside = np.zeros(jet.cube.shape[1:], dtype=bool)
    inside[:, REGION] = True
    for where, region in (("region", inside), ("whole image", None)):
        decomposed = scc.decompose(jet.cube, region=region)
        n_features = len(decomposed.follow().table)
        watch.lap(f"{where}: decompose, follow {n_features} features")
        scc.measure(decomposed, n_trials=args.n_trials, rng=1)
        watch.lap(f"{where}: velocity spectrum, streams, {args.n_trials} trials")
    rows = [
        [stage, f"{cpu:.2f}", f"{wall:.2f}"]
        for stage, (cpu, wall) in watch.stages.items()
    ]
    rows.append(["astro-scc --help, best of several", *help_seconds(args.help_runs)])
    write_table("speed", ["stage", "CPU seconds", "seconds"], rows)
    print(f"largest memory: {watch.peak_memory():.2f} GB")


def help_seconds(runs):
    """Return the least processor time and wall clock for printing the help."""
    spent = []
    for _ in range(runs):
        before, start = os.times(), time.perf_counter()
        subprocess.run(HELP, check=True, stdout=subprocess.DEVNULL)
        after = os.times()
        cpu = sum(after[2:4]) - sum(before[2:4])
        spent.append((cpu, time.perf_counter() - start))
    return [f"{min(times):.2f}" for times in zip(*spent, strict=True)]


if __name__ == "__main__":
    main()
