# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""
Measure movies of jets that are resolved across, in true and in scrambled order.

    python benchmarks/resolved.py [--cadences 11x21d 24x8d] [--kinds two static]
                                  [--seeds 24] [--first 1] [--jobs 2]
                                  [--weights contrast] [--write]
    python benchmarks/resolved.py --limbs [--seeds 24] [--first 1] [--jobs 2]

Movies are measured without options, and their images once more in scrambled order of
the dates.  The truth of a layer is the mean apparent speed of its clumps, weighted by
their flux densities, where they can be seen beside the core; with ``--weights
contrast`` by flux densities over the mean brightness at their distance, as a search
weighs them that divides images by their local rms.  A row is right within 15% of it.
Without ``--write`` tables are only printed.  ``--limbs`` compares the field of speeds
of 24 epochs with the layers: the slow one at the limbs, the fast one in the spine.
"""

import argparse
import os
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import astropy.units as u
import numpy as np
from common import PM_UNIT, print_table, write_table

from astro_scc import EpochCube, StackedCrossCorrelation, measure_velocities
from astro_scc.flow import measure_field
from astro_scc.simulation import m87_layers, simulate_resolved_jet

#: Epochs and intervals of programmes that have observed M 87.
CADENCES = {
    "11x21d": (11, 21 * u.day), "14x5d": (14, 5 * u.day), "17x1yr": (17, 1 * u.yr),
    "24x8d": (24, 8 * u.day),
}  # fmt: skip
#: Largest relative error of a row that is right.
RIGHT = 0.15
#: Edges of the cells of the field in mas, and the largest relative error of its speeds.
ALONG, ACROSS, CLOSE = (1, 3, 6), (-0.9, -0.35, -0.12, 0.12, 0.35, 0.9), 0.1
#: Distance in beams from the core where the truth begins, as the search does.
CORE = 1.2
HEADER = ["cadence", "kind", "order", "movies", "moving", "slowest right", "both right",
          "movies with a row at neither", "rows", "rows at neither",
          "median s"]  # fmt: skip


def layers_of(kind):
    """Return the layers of a kind of movie."""
    slow, fast = m87_layers()
    still = {"speed": 0 * slow.speed}
    # Large and small clumps lie at the same places across the jet.
    wide = {"across": (0.0,), "scatter": 0.5}
    return {
        "two": (slow, fast),
        "fast": (fast,),
        "scales": (
            replace(slow, **wide, size=(0.05, 0.15) * u.mas),
            replace(fast, **wide, size=(0.5, 0.8) * u.mas, n_clumps=fast.n_clumps / 2),
        ),
        # Clumps that stay, with varying fluxes, and clumps that also live and fade.
        "static": [replace(a, **still, life=np.inf * u.yr) for a in (slow, fast)],
        "static-lives": [replace(a, **still) for a in (slow, fast)],
    }[kind]


KINDS = ("two", "fast", "scales", "static", "static-lives")


def simulate(kind, cadence, seed):
    """Simulate a movie of a kind."""
    n_epochs, interval = CADENCES[cadence]
    dates = {"n_epochs": n_epochs, "interval": interval}
    return simulate_resolved_jet(layers=layers_of(kind), **dates, rng=seed)


def scrambled(jet, seed):
    """Return the images of a movie at dates in another order."""
    cube, simulation = jet.cube, jet.simulation
    order = np.random.default_rng(seed).permutation(len(cube))
    return EpochCube.from_arrays(
        cube.data[order], cube.times, unit=cube.unit, beams=simulation.beams,
        pixel_scale=simulation.pixel_scale, noise=simulation.noise[0] * cube.unit,
        reference_pixel=(simulation.extent[0], simulation.axis),
    )  # fmt: skip


def true_speeds(jet, weights="flux", beyond=0.0):
    """Return the mean speed of each layer that moves in mas/yr, slowest first."""
    truth, angle = jet.truth, jet.simulation.position_angle
    r = (truth["east"] * np.sin(angle) + truth["north"] * np.cos(angle)).to(u.mas)
    beam = jet.simulation.beam_length * jet.simulation.pixel_scale
    groups, means = np.asarray(truth["group"]), []
    for layer in jet.simulation.streams:
        own = (groups == layer.name) & (r > max(CORE * beam, beyond * u.mas))
        own &= truth["visible"]
        weight = truth["flux"][own].value
        if weights == "contrast":
            weight = weight / np.interp(r[own], layer.distance, layer.brightness).value
        # Clumps that are seen at one epoch alone have a speed, but no displacement.
        speed = np.interp(r[own], layer.distance, layer.speed).to_value(PM_UNIT)
        means.append(np.average(speed, weights=weight))
    return sorted(mean for mean in means if mean > 0)


def measure(task, weights="flux"):
    """Return what is found in one movie: its truth, rows in mas/yr, and seconds."""
    cadence, kind, order, seed = task
    jet = simulate(kind, cadence, seed)
    cube = jet.cube if order == "true" else scrambled(jet, seed)
    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rows = measure_velocities(cube, rng=seed)
    rows = rows[rows["kind"] == "moving"]
    found = [rows[name].to_value(PM_UNIT) for name in ("pm", "pm_err")]
    return true_speeds(jet, weights), *found, time.perf_counter() - start


def limbs(seed):
    """Return the true and found speeds of limbs and spine, in mas/yr."""
    jet = simulate("two", "24x8d", seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = StackedCrossCorrelation()(jet.cube, n_trials=99, rng=seed)
        cells = {"along": ALONG * u.mas, "across": ACROSS * u.mas}
        table = measure_field(result, **cells, n_trials=19, rng=seed).table
    middle = (table["offset_min"] + table["offset_max"]).value / 2
    speed, error = (table[k].value for k in ("pm_parallel", "pm_parallel_err"))
    found = []
    for part in (
        np.abs(middle) > ACROSS[-2],
        (np.abs(middle) < ACROSS[-3]) & (table["r_min"].value == ALONG[1]),
    ):
        part &= np.isfinite(speed * error)
        found.append(np.average(speed[part], weights=error[part] ** -2))
    slow, _ = true_speeds(jet, "contrast")
    _, fast = true_speeds(jet, "contrast", beyond=ALONG[1])
    return (slow, fast), found


def limbs_and_spine(seeds, jobs):
    """Print the speeds of limbs and spine of movies, and how many are close."""
    close = np.zeros(2, int)
    with ProcessPoolExecutor(jobs) as pool:
        for seed, (truth, found) in zip(seeds, pool.map(limbs, seeds), strict=True):
            close += np.abs(np.divide(found, truth) - 1) <= CLOSE
            print(seed, "true", np.round(truth, 2), "found", np.round(found, 2),
                  flush=True)  # fmt: skip
    print("within 10%: limbs and spine of", close, "of", len(seeds))


def score(movies):
    """Return the numbers of movies that are right, and of rows, and the median time."""
    slow = both = wrong = neither = moving = n_rows = 0
    for truth, pm, _, _ in movies:
        near = np.abs(np.array(truth)[:, None] / pm - 1) <= RIGHT if len(truth) else []
        near = np.reshape(near, (len(truth), len(pm)))
        slow += bool(len(truth) and near[0].any())
        both += bool(len(truth) > 1 and near.any(axis=1).all())
        lost = np.count_nonzero(~near.any(axis=0))
        neither, wrong = neither + lost, wrong + bool(lost)
        moving, n_rows = moving + bool(len(pm)), n_rows + len(pm)
    seconds = f"{np.median([movie[-1] for movie in movies]):.1f}"
    return [len(movies), moving, slow, both, wrong, n_rows, neither, seconds]


def main():
    """Measure movies of all kinds and cadences."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("--cadences", nargs="+", default=[*CADENCES], choices=CADENCES)
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    parser.add_argument("--orders", nargs="+", default=("true", "scrambled"),
                        choices=("true", "scrambled"))  # fmt: skip
    parser.add_argument("--seeds", type=int, default=24, help="movies of a kind")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--weights", default="flux", choices=("flux", "contrast"))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--limbs", action="store_true", help="speeds across the jet")
    parser.add_argument("--write", action="store_true", help="also to results/")
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    if args.limbs:
        limbs_and_spine(seeds, args.jobs)
        return
    table, task = [], partial(measure, weights=args.weights)
    with ProcessPoolExecutor(args.jobs) as pool:
        for group in product(args.cadences, args.kinds, args.orders):
            movies = []
            tasks = [(*group, seed) for seed in seeds]
            found = pool.map(task, tasks)
            for seed, movie in zip(seeds, found, strict=True):
                truth, pm, err, seconds = movie
                rows = [f"{v:.2f} +- {e:.2f}" for v, e in zip(pm, err, strict=True)]
                print(*group, seed, "true", *(f"{v:.2f}" for v in truth), "found",
                      ", ".join(rows) or "nothing", f"({seconds:.1f} s)",
                      flush=True)  # fmt: skip
                movies.append(movie)
            table.append([*group, *score(movies)])
    show = partial(write_table, "resolved") if args.write else print_table
    print()
    show(HEADER, table)


if __name__ == "__main__":
    main()
