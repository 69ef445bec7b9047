# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""
Measure simulated jets, to see whether probabilities and errors hold.

    python benchmarks/calibration/run.py KIND [KIND ...] [--jets 300] [--trials 400]

Each jet of each kind has its seed; what has been measured is kept in
``results/KIND.csv`` and not measured again, so a run can be stopped and
started.  ``python benchmarks/calibration/summary.py`` makes the table and the
figure of the documentation from these files.
"""

import argparse
import csv
import os
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import astropy.units as u
import numpy as np

from astro_scc import StackedCrossCorrelation
from astro_scc import simulation as sim
from astro_scc.epochs import Beam

RESULTS = Path(__file__).parent / "results"
#: One pixel an epoch in the simulations: 0.1 mas in 30 days.
PIXEL = (0.1 * u.mas / (30 * u.day)).to(u.mas / u.yr)
#: The region of the paper's test, 10 beams long.
REGION = slice(60, 160)
#: First seed, where those before have been used to choose something: here how
#: many features a common velocity needs.
FIRST = {"sparse": 300}
COLUMNS = ("seed", "component", "kind", "v1", "v1_err", "v2", "v2_err", "z_score",
           "p_scramble", "p_shuffle", "p_global", "n_features")  # fmt: skip


def changing_beams(n_epochs, rng):
    """Beams of 0.8 to 1.2 mas by 0.6 to 1 mas at any angle."""
    return [
        Beam(
            rng.uniform(0.9, 1.3) * u.mas,
            rng.uniform(0.6, 0.9) * u.mas,
            rng.uniform(-90, 90) * u.deg,
        )
        for _ in range(n_epochs)
    ]


def beam_change(seed):
    """A static jet seen with a different beam at every epoch."""
    rng = np.random.default_rng(seed)
    return sim.simulate_static(beams=changing_beams(10, rng), rng=rng)


def sparse(seed):
    """About four features, each with a velocity of its own about which it wanders."""
    options = {"density": 0.2, "dx": (0.0, 20.0), "dy": (-2.0, 2.0), "jitter": 2.0}
    return sim.simulate_ballistic(rng=seed, **options)


def mixed(seed):
    """A stream of five pixels an epoch among features with velocities of their own."""
    streams = (
        sim.Stream("sheath", dx=5.0, density=1.0, half_width=15.0, jitter=2.0),
        sim.Stream("others", dx=(0.0, 40.0), dy=(-5.0, 5.0), half_width=12.0),
    )
    return sim.JetSimulation(streams).run(rng=seed)


def two_fluid(**options):
    """A two-fluid jet with options, by seed."""
    return lambda seed: sim.simulate_two_fluid(rng=seed, **options)


KINDS = {
    "unrelated": lambda seed: sim.simulate_unrelated(rng=seed),
    "static": lambda seed: sim.simulate_static(rng=seed),
    "random": lambda seed: sim.simulate_random_velocity(rng=seed),
    "ballistic": lambda seed: sim.simulate_ballistic(rng=seed),
    "beam-change": beam_change,
    "sparse": sparse,
    "mixed": mixed,
    "two-fluid": two_fluid(),
    "two-fluid-dense": two_fluid(dense=True),
}
KINDS |= {f"epochs-{n}": two_fluid(n_epochs=n) for n in (5, 20, 40)}
KINDS |= {f"difference-{d}": two_fluid(fast=5.0 + d) for d in (3, 5, 10, 20)}
KINDS |= {f"noise-{s}": two_fluid(noise=s) for s in (0.01, 0.05)}
KINDS |= {f"density-{f}": two_fluid(densities=(f * 1.0, f * 0.8)) for f in (0.5, 2.0)}


def measure(kind, seed, n_trials):
    """Rows of one jet."""
    cube = KINDS[kind](seed).cube
    if kind == "beam-change":
        cube = cube.to_common_beam()
    region = np.zeros(cube.shape[1:], dtype=bool)
    region[:, REGION] = True
    scc = StackedCrossCorrelation(
        scales=[1, 2, 3], max_speed=40 * PIXEL, position_angle=270 * u.deg
    )
    result = scc(cube, region=region, n_trials=n_trials, rng=seed)
    rows = []
    for row, finding in zip(result.components, result.findings, strict=True):
        values = [
            f"{row[name].to_value(PIXEL):.3f}"
            for name in (
                "pm_parallel",
                "pm_parallel_err",
                "pm_transverse",
                "pm_transverse_err",
            )  # fmt: skip
        ]
        p = [finding.tests[name].p_global for name in ("scramble", "shuffle")]
        p = [f"{x:.5f}" for x in (*p, row["p_global"])]
        head = (seed, row["component"], row["kind"])
        z_score = f"{row['z_score']:.3f}"
        rows.append((*head, *values, z_score, *p, row["n_features"]))
    return rows or [(seed, 0, "none", *["nan"] * 5, 1.0, 1.0, 1.0, 0)]


def main():
    """Measure what is missing."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("kinds", nargs="+", choices=[*KINDS, "all"])
    parser.add_argument("--jets", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--trials", type=int, default=400)
    options = parser.parse_args()
    RESULTS.mkdir(exist_ok=True)
    for kind in KINDS if "all" in options.kinds else options.kinds:
        path = RESULTS / f"{kind}.csv"
        done = set()
        if path.exists():
            with path.open(newline="") as file:
                done = {int(row["seed"]) for row in csv.DictReader(file)}
        else:
            path.write_text(",".join(COLUMNS) + "\n")
        start = FIRST.get(kind, 0)
        for seed in range(start + options.first, start + options.jets):
            if seed in done:
                continue
            rows = measure(kind, seed, options.trials)
            with path.open("a", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main()
