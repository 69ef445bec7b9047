# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""
Measure simulated jets, to check whether p-values, speeds and errors are right.

    python benchmarks/calibration/run.py KIND [KIND ...] [--jets 100] [--trials 199]

``all`` stands for every kind but those of ``sensitivity``, whose main speed is compared
with that of parts of the data.  Each jet of each kind has its own seed.
Measured jets are kept in ``results/KIND.csv`` and not measured again, so a run can be
stopped and resumed.  ``python benchmarks/calibration/summary.py`` makes the tables and
the figures of the documentation from these files.
"""

import argparse
import csv
import os
import sys
import warnings
from functools import partial
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import astropy.units as u
import numpy as np

from astro_scc import StackedCrossCorrelation
from astro_scc import simulation as sim
from astro_scc.exceptions import MeasurementWarning
from astro_scc.flow import compare_scales, measure_acceleration
from astro_scc.simulation import Flow, Stream

RESULTS = Path(__file__).parent / "results"
#: Smaller seeds were used to choose the constants of the search.
FIRST_SEED = 20_000
#: Fewest epochs of the features that give the true mean and dispersion.
SEEN = 4
COLUMNS = ("seed", "true_mean", "true_dispersion", "true_features", "row", "kind",
           "speed", "error", "dispersion", "p_global", "p_distinct",
           "n_features")  # fmt: skip


def jet(**options):
    """Return a function that simulates a jet as surveys see it, given a seed."""
    return lambda seed: sim.simulate_jet(rng=seed, **options)


def vlba(seed):
    """Simulate CLEAN images of a jet."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from vlbi import observe

    return observe(sim.simulate_jet(rng=seed), rng=seed)


def streams(*flows, **options):
    """Return a function that simulates a jet of several streams, given a seed."""
    return jet(streams=[Flow(name, **flow) for name, flow in flows], **options)


def static(**options):
    """Return a function that simulates a static jet, given a seed."""
    return jet(n_features=0, **{"standing": 8, **options})


KINDS = {f"single-{d}": jet(dispersion=d / 100) for d in (0, 10, 20, 30)}
KINDS |= {f"epochs8-{d}": jet(n_epochs=8, dispersion=d / 100) for d in (10, 20)}
KINDS |= {f"features4-{d}": jet(n_features=4, dispersion=d / 100) for d in (10, 20)}
KINDS |= {f"features16-{d}": jet(n_features=16, dispersion=d / 100) for d in (10, 20)}
KINDS |= {
    f"lognormal-{d}": jet(distribution="lognormal", dispersion=d / 10) for d in (4, 8)
}
KINDS["uniform"] = jet(distribution="uniform", dispersion=0.5)
KINDS["two-streams"] = streams(
    ("slow", {"speed": 0.3, "n_features": 5}), ("fast", {"speed": 0.9, "n_features": 5})
)
KINDS["static-flux"] = static(memory=0.0, flux_variation=0.4)
KINDS["static-comb"] = static(standing=tuple(1.5 * np.arange(1, 9)))
KINDS["static-ripple"] = static(ripple=0.004, bowl=0.01)
KINDS |= {f"static-align{a}": static(alignment_error=a / 10) for a in (1, 2, 3)}
KINDS["static-red"] = static(memory=5.0, flux_variation=0.8)
KINDS["vlba"] = vlba
PAPER = {
    f"two-fluid-{density}-{part}": density == "dense"
    for density in ("sparse", "dense")
    for part in ("region", "whole")
}
KINDS |= {
    kind: partial(lambda dense, seed: sim.simulate_two_fluid(dense=dense, rng=seed), d)
    for kind, d in PAPER.items()
}
#: The paper's jet with other speeds in pixels per epoch, densities and random walks.
OTHER = {
    "two-fluid-5-15": {"fast": 15.0},
    "two-fluid-3.5-20": {"slow": 3.5},
    "two-fluid-7-20": {"slow": 7.0},
    "two-fluid-5-10": {"fast": 10.0},
    "two-fluid-density-0.5": {"densities": (0.5, 0.5)},
    "two-fluid-density-3": {"densities": (3.0, 3.0)},
    "two-fluid-jitter-0": {"jitter": 0.0},
    "two-fluid-jitter-4": {"jitter": 4.0},
}
KINDS |= {
    kind: partial(lambda how, seed: sim.simulate_two_fluid(rng=seed, **how), how)
    for kind, how in OTHER.items()
}
KINDS["faint"] = jet(dispersion=0.2, noise=0.01)
KINDS["unrelated"] = lambda seed: sim.simulate_unrelated(rng=seed)
KINDS["random-velocity"] = lambda seed: sim.simulate_random_velocity(rng=seed)


def diffusing(drift, step):
    """Return a function that simulates a random walk of features, in beams a step."""

    def simulate(seed):
        flow = Stream("walk", dx=10 * drift, jitter=10 * step, half_width=40.0,
                      density=1.2)  # fmt: skip
        walk = sim.JetSimulation(streams=[flow], n_epochs=30, shape=(128, 256))
        return walk.run(rng=seed)

    return simulate


KINDS["static-walk"] = diffusing(0.0, 0.2)
KINDS["drift-walk"] = diffusing(0.1, 0.2)
LONG = {"n_epochs": 30, "n_features": 10, "dispersion": 0.1}
#: Both have the same speeds at the middle.
KINDS["accelerated"] = jet(acceleration=1.6, **LONG)
KINDS["steady"] = jet(**LONG)
KINDS["steady-25"] = jet(**LONG | {"dispersion": 0.25})


def layers(spine, sheath):
    """Return a function that simulates small and large features at two speeds."""
    return streams(
        ("spine", {"speed": spine, "n_features": 5, "size": 0.2, "widening": 0.1}),
        ("sheath", {"speed": sheath, "n_features": 5, "size": 1.2, "widening": 0.1,
                    "flux": 0.3}),
        n_epochs=30,
    )  # fmt: skip


KINDS["layers"] = layers(0.9, 0.3)
KINDS["one-layer"] = layers(0.6, 0.6)
#: Other jets that are simulated as streams, with 30 days between epochs.
STREAMS = ("unrelated", "random-velocity", "static-walk", "drift-walk")
FLOW = ("accelerated", "steady", "steady-25", "layers", "one-layer")
#: Jets whose main speed is compared with that of parts of the data.
SENSITIVITY = {
    f"sensitivity-{kind}": kind
    for kind in ("single-20", "epochs8-20", "features4-20", "steady", "accelerated")
}
KINDS |= {name: KINDS[kind] for name, kind in SENSITIVITY.items()}
SENSITIVITY_COLUMNS = ("seed", "kind", "n_features", "change_sigma", "p_value",
                       "large", "significant")  # fmt: skip
FLOW_COLUMNS = ("seed", "rows", "gradient", "gradient_err", "p_acceleration", "fine",
                "coarse", "p_scales", "finer")  # fmt: skip


def measure_flow(kind, seed, n_trials):
    """
    Return a jet's gradient in 1/yr, and speeds by scale in beams per interval.

    Of two streams, ``finer`` is by how much the share of the faster one is larger on
    fine scales than on coarse ones.
    """
    cube = KINDS[kind](seed).cube
    scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeasurementWarning)
        result = scc(cube, n_trials=n_trials, rng=seed)
    found = measure_acceleration(result)
    rows = compare_scales(result, {"fine": [1, 2], "coarse": [3, 4]})
    row = rows[-1]
    finer = row["first_share"] - row["second_share"] if len(rows) > 1 else np.nan
    beam = np.sqrt(cube.beams[0].major * cube.beams[0].minor)
    unit = (beam / (0.2 * u.yr)).to(u.mas / u.yr)
    fine, coarse = ((row[f"{k}_speed"] / unit).value for k in ("first", "second"))
    n = int(np.sum(result.components["kind"] == "moving"))
    # Each stream has its own test.
    p_scales = min(1.0, len(rows) * np.nan_to_num(rows["p_value"], nan=1.0).min())
    numbers = (found.gradient.value, found.gradient_err.value, found.p_value, fine,
               coarse, p_scales, finer)  # fmt: skip
    return [[seed, n, *(f"{x:.4g}" for x in numbers)]]


def measure_sensitivity(kind, seed, n_trials):
    """Return the changes of a jet's main speed with parts of the data."""
    scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeasurementWarning)
        table = scc(KINDS[kind](seed).cube, n_trials=n_trials, rng=seed).sensitivity
    large = np.abs(table["change"]) > table["pm_err"][:1].sum()
    rows = [
        [seed, row["choice"], row["n_features"], f"{row['change_sigma']:.2f}",
         f"{row['p_value']:.4g}", int(own), int(row["significant"])]
        for row, own in zip(table, large, strict=True)
    ]  # fmt: skip
    return rows or [[seed, "nothing moves", 0, "nan", "nan", 0, 0]]


def measure(kind, seed, n_trials):
    """Return the rows of one jet, with speeds in beams per median interval."""
    if kind in FLOW:
        return measure_flow(kind, seed, n_trials)
    if kind in SENSITIVITY:
        return measure_sensitivity(kind, seed, n_trials)
    jet = KINDS[kind](seed)
    cube = jet.cube.to_common_beam() if kind == "vlba" else jet.cube
    paper = kind in (*PAPER, *OTHER, *STREAMS)
    beam = np.sqrt(cube.beams[0].major * cube.beams[0].minor)
    unit = (beam / (30 * u.day if paper else 0.2 * u.yr)).to(u.mas / u.yr)
    region = None
    if kind.endswith("region") or kind == "unrelated":
        region = np.zeros(cube.shape[1:], dtype=bool)
        region[:, 60:160] = True
    scc = StackedCrossCorrelation(position_angle=270 * u.deg)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeasurementWarning)
        result = scc(cube, region=region, n_trials=n_trials, rng=seed)
    truth = features(jet.truth, unit)
    head = [seed, *(f"{x:.4f}" for x in truth[:2]), truth[2]]
    rows = []
    for number, row in enumerate(result.components, 1):
        speeds = ("pm_parallel", "pm_parallel_err", "dispersion")
        values = [f"{(row[name] / unit).to_value(u.one):.4f}" for name in speeds]
        values += [f"{row[name]:.5f}" for name in ("p_global", "p_distinct")]
        rows.append([*head, number, row["kind"], *values, row["n_features"]])
    return rows or [[*head, 0, "nothing", *["nan"] * 5, 0]]


def features(truth, unit):
    """Return mean, dispersion and number of the speeds of visible features."""
    group = np.asarray(truth["group"])
    moving = (group != "core") & (group != "standing") & np.asarray(truth["visible"])
    _, feature = np.unique(np.asarray(truth["feature"])[moving], return_inverse=True)
    # Mean over epochs of the speed along the jet, like the rows it is compared with.
    along = (-truth["pm_east"][moving] / unit).to_value(u.one)
    number = np.bincount(feature)
    speed = (np.bincount(feature, along) / np.maximum(number, 1))[number >= SEEN]
    if len(speed) == 0:
        return np.nan, np.nan, 0
    return speed.mean(), speed.std(ddof=1) if len(speed) > 1 else 0.0, len(speed)


def main():
    """Measure the jets that have not been measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("kinds", nargs="+", choices=[*KINDS, "all", "sensitivity"])
    parser.add_argument("--jets", type=int, default=100)
    parser.add_argument("--trials", type=int, default=199)
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="first seed")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder")
    args = parser.parse_args()
    groups = {"all": [k for k in KINDS if k not in SENSITIVITY]}
    groups["sensitivity"] = list(SENSITIVITY)
    kinds = [kind for name in args.kinds for kind in groups.get(name, [name])]
    args.results.mkdir(exist_ok=True)
    for seed in range(args.first, args.first + args.jets):
        for kind in kinds:
            path = args.results / f"{kind}.csv"
            done = set()
            if path.exists():
                with open(path, newline="", encoding="utf-8") as file:
                    done = {int(row["seed"]) for row in csv.DictReader(file)}
            if seed in done:
                continue
            rows = measure(kind, seed, args.trials)
            with open(path, "a", newline="", encoding="utf-8") as file:
                writer = csv.writer(file, lineterminator="\n")
                if not done:
                    columns = FLOW_COLUMNS if kind in FLOW else COLUMNS
                    writer.writerow(
                        SENSITIVITY_COLUMNS if kind in SENSITIVITY else columns
                    )
                writer.writerows(rows)


if __name__ == "__main__":
    main()
