# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure how the time and memory of a measurement grow.

Cases that are compared run in turn, several times, and the ratio of the medians of
their processor times is given, so that a busy machine slows all alike.  The parts are::

    python benchmarks/scaling.py doubling   # epochs, pixels, trials
    python benchmarks/scaling.py workers    # two workers against one, minutes
    python benchmarks/scaling.py imports    # beside numpy and astropy.units
    python benchmarks/scaling.py whole      # 69 epochs of 512 x 512, some minutes

The jet has about 90 SSPs per epoch on four scales, at uneven dates.
"""

import argparse
import os
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.time import Time
from common import Sampler, memory_of, write_table

from astro_scc import Beam, StackedCrossCorrelation
from astro_scc.simulation import JetSimulation, Stream

SCALES = (1, 2, 3, 4)
#: Width of the beam in pixels.
BEAM = 6.0
#: Columns of the table of whole measurements.
WHOLE = [
    "largest motion",
    "SSPs an epoch",
    "decompose: CPU s",
    "measure: CPU s",
    "wall clock, s",
    "largest memory, GB",
    "others at work",
]


def simulate(n_epochs, shape=(512, 512), rng=1):
    """Simulate a jet of two streams along an image, at dates 20 to 40 days apart."""
    gaps = np.random.default_rng(rng).uniform(20, 40, n_epochs - 1)
    dates = Time("2000-01-01") + np.concatenate([[0], np.cumsum(gaps)]) * u.day
    streams = [
        Stream("slow", dx=2.0, half_width=12, jitter=1, density=0.25, fwhm=(1, 4)),
        Stream("fast", dx=6.0, sigma=4, jitter=1, density=0.21, fwhm=(1, 4)),
    ]
    beam = Beam(0.1 * BEAM * u.mas, 0.1 * BEAM * u.mas)
    return JetSimulation(
        streams,
        dates=dates,
        shape=shape,
        extent=(40, shape[1] - 40),
        axis=shape[0] / 2,
        beams=beam,
        noise=0.005,
    ).run(rng=rng)


def measurer(cube, reach):
    """Return a measurement of motions of up to so many pixels in the whole time."""
    settings = {"scales": SCALES, "position_angle": 270 * u.deg}
    speed = reach * 0.1 * u.mas / np.ptp(cube.years)
    return StackedCrossCorrelation(max_speed=speed, **settings)


def medians(functions, runs):
    """Return the median processor times of functions that run in turn."""
    spent = np.empty((runs, len(functions)))
    for row in spent:
        for k, function in enumerate(functions):
            start = time.process_time()
            function()
            row[k] = time.process_time() - start
    return np.median(spent, axis=0)


def workers_part(runs, n_epochs, n_trials):
    """Measure the wall clock of a whole measurement with one worker and with two."""
    cube = simulate(n_epochs).cube
    scc = measurer(cube, 20)
    spent = np.empty((runs, 2))
    for row in spent:
        for k in range(2):
            start = time.perf_counter()
            scc(cube, n_trials=n_trials, rng=1, n_workers=k + 1)
            row[k] = time.perf_counter() - start
    one, two = np.median(spent, axis=0)
    write_table(
        "scaling_workers",
        ["one worker, s", "two, s", "ratio", "at work"],
        [[f"{one:.1f}", f"{two:.1f}", f"{one / two:.2f}", f"{os.getloadavg()[0]:.1f}"]],
    )


def doubling_part(runs):
    """Measure the processor time when epochs, pixels or trials are doubled."""

    def measure(n_epochs, shape, n_trials):
        cube = simulate(n_epochs, shape).cube
        scc = measurer(cube, 20)

        def run():
            scc(cube, n_trials=n_trials, rng=1)

        return run

    small = (20, (256, 256), 500)
    cases = {
        "epochs": (40, (256, 256), 500),
        "pixels": (20, (256, 512), 500),
        "trials": (20, (256, 256), 1000),
    }
    runs_of = [measure(*small), *(measure(*case) for case in cases.values())]
    spent = medians(runs_of, runs)
    names = ["20 epochs of 256 x 256, 500 trials", *(f"twice the {c}" for c in cases)]
    write_table(
        "scaling_doubling",
        ["case", "CPU seconds", "ratio"],
        [
            [name, f"{t:.1f}", f"{t / spent[0]:.2f}"]
            for name, t in zip(names, spent, strict=True)
        ],
    )


def imports_part(runs):
    """Measure the time to import the package, beyond numpy and astropy.units."""
    base = "import numpy, astropy.units"
    spent = np.empty((runs, 2))
    for row in spent:
        for k, code in enumerate((base, f"{base}; import astro_scc")):
            before = os.times()
            subprocess.run([sys.executable, "-c", code], check=True)
            after = os.times()
            row[k] = sum(after[2:4]) - sum(before[2:4])
    alone, both = np.median(spent, axis=0)
    write_table(
        "scaling_imports",
        ["numpy and astropy.units, CPU seconds", "astro_scc beyond"],
        [[f"{alone:.2f}", f"{both - alone:.2f}"]],
    )


def whole_part(reaches, n_epochs, n_trials, n_workers):
    """Measure processor time, wall clock and memory for many epochs."""
    rows = []
    for reach in reaches:
        code = (
            f"import scaling; scaling.whole({reach}, {n_epochs}, {n_trials}, "
            f"{n_workers})"
        )
        done = subprocess.run(
            [sys.executable, "-c", code],
            check=True,
            cwd=Path(__file__).parent,
            stdout=subprocess.PIPE,
            text=True,
        )
        rows.append(done.stdout.split("|"))
        write_table("scaling_whole", WHOLE, rows)


def whole(reach, n_epochs, n_trials, n_workers):
    """Print one row of the table, in a process of its own."""
    import scipy.stats  # noqa: F401 (the errors of components load it)

    cube = simulate(n_epochs).cube
    scc = measurer(cube, reach)
    with Sampler(partial(memory_of, os.getpid()), 0.2) as memory:
        start, wall = os.times(), time.perf_counter()
        decomposed = scc.decompose(cube, n_workers=n_workers)
        middle = os.times()
        scc.measure(decomposed, n_trials=n_trials, rng=1)
        end, wall = os.times(), time.perf_counter() - wall
    row = [
        f"± {reach} px",
        f"{len(decomposed.ssps) / n_epochs:.0f}",
        f"{sum(middle[:4]) - sum(start[:4]):.0f}",
        f"{sum(end[:4]) - sum(middle[:4]):.0f}",
        f"{wall:.0f}",
        f"{max(memory.values):.2f}",
        f"{os.getloadavg()[0]:.1f}",
    ]
    print("|".join(row), end="")


def main():
    """Print the tables of the requested parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    names = ["doubling", "workers", "imports", "whole"]
    parser.add_argument("parts", nargs="*", choices=names, default=[])
    parser.add_argument("--runs", type=int, default=5, help="of what is compared")
    parser.add_argument("--reach", type=int, nargs="+", default=[20, 40])
    parser.add_argument("--n-epochs", type=int, default=69)
    parser.add_argument("--n-trials", type=int, default=1000)
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    for part in args.parts or names:
        if part == "whole":
            whole_part(args.reach, args.n_epochs, args.n_trials, args.workers)
        elif part == "workers":
            workers_part(args.runs, args.n_epochs, args.n_trials)
        else:
            globals()[f"{part}_part"](args.runs)


if __name__ == "__main__":
    main()
