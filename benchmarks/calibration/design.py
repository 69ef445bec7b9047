# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""
Vary the constants of the search one by one, on jets that the calibration does not use.

    python benchmarks/calibration/design.py [--jets 5] [--diffusion TABLES]

Writes ``results/design_table.csv``: for each constant and value, the share of jets with
one stream whose speed is right, of jets with two streams in which both are right, and
of static jets in which something moves.  Each jet is matched once.  With the folder of
MOJAVE's tables it writes ``results/diffusion_table.csv`` instead: what distinguishes
random walks from the jets that were simulated or observed.
"""

import argparse
import os
import sys
import warnings
from dataclasses import replace
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import astropy.units as u
import numpy as np
from run import KINDS, diffusing, features
from summary import RIGHT, TWO, write

from astro_scc import StackedCrossCorrelation
from astro_scc.exceptions import MeasurementWarning
from astro_scc.features import find_features
from astro_scc.features.diffusion import measure_diffusion
from astro_scc.measurement.axes import AxisProjection
from astro_scc.streams import SearchSettings, find_streams

FIRST_SEED = 4000
ONE = ("single-20", "features4-20", "epochs8-20")
#: Drifts and random steps in beams an epoch, and jets with most features.
WALKS = [(drift, step) for drift in (0.0, 0.1) for step in (0.1, 0.2, 0.3, 0.4)]
STEADY = ("single-20", "single-30", "features16-20", "two-streams", "uniform",
          "accelerated", "layers", "static-red")  # fmt: skip
STATIC = ("static-red", "static-align3", "static-comb")
VALUES = {
    "radius": (1.2, 1.5, 1.8),
    "nearest": (0.1, 0.2, 0.3),
    "farthest": (0.7, 1.0, 1.3),
    "blur": (0.12, 0.2, 0.3),
    "smoothing": (0.08, 0.12, 0.2),
    "across": (0.2, 0.35, 0.5),
    "drift": (1.0, 3.0, 5.0),
    "slowest": (0.5, 1.0, 2.0),
    "line": (0.2, 0.3, 0.5),
    "position_error": (0.03, 0.06, 0.12),
    "least_epochs": (3, 4, 5),
    "least_motion": (1.0, 1.75, 2.5),
    "same_speed": (0.2, 0.35, 0.5),
    "apart": (1.25, 1.75, 2.25),
    "error_inflation": (1.0, 1.3, 1.6),
    "lone_dispersion": (0.2, 0.3, 0.4),
}


def matched_jet(kind, seed):
    """Return the displacements of a jet along its axis, and the jet."""
    jet = KINDS[kind](seed)
    scc = StackedCrossCorrelation(scales=[1, 2, 3], position_angle=270 * u.deg)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeasurementWarning)
        matched = scc.match(jet.cube)
    displacements, frame = scc.displacements(matched)
    d = AxisProjection(displacements, matched.cube, frame)(0.0)
    return d, jet


def true_mean(jet):
    """Return the mean speed of a jet's features in beams per median interval."""
    beam = np.sqrt(jet.cube.beams[0].major * jet.cube.beams[0].minor)
    return features(jet.truth, (beam / (0.2 * u.yr)).to(u.mas / u.yr))[0]


def speeds(d, seed, settings):
    """Return the speeds of moving streams, in beams per median interval."""
    found = find_streams(
        lambda angle: d, [0.0], settings.radius, n_trials=199,
        rng=np.random.default_rng(seed), settings=settings,
    )  # fmt: skip
    return [abs(s.along.mean) * 0.2 for s in found.streams if s.kind == "moving"]


def diffusion_table(tables, seeds):
    """Write what the speeds of features show of random walks, jet by jet."""
    sys.path.insert(0, str(Path(__file__).parents[1]))
    from common import mojave_images
    from mojave import SOURCES

    kinds = {f"walk {drift:g} {step:g}": diffusing(drift, step)
             for drift, step in WALKS}  # fmt: skip
    kinds |= {kind: KINDS[kind] for kind in STEADY}
    jets = [(kind, seed, lambda make=make, seed=seed: make(seed).cube)
            for kind, make in kinds.items() for seed in seeds]  # fmt: skip
    jets += [(source.name, "", lambda own=source: mojave_images(
             tables, own.table, own.beam)) for source in SOURCES]  # fmt: skip
    rows = []
    for kind, seed, cube in jets:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = measure_diffusion(find_features(cube()))
        numbers = f"{found.step:.3f}", f"{found.change:.2f}", f"{found.isotropy:.2f}"
        walk = "yes" if found.is_walk else "no"
        rows.append([kind, seed, found.n_features, *numbers, walk])
    header = ["jet", "seed", "features", "step", "change", "isotropy", "diffuses"]
    write("diffusion_table", header, rows)


def main():
    """Measure all jets with each value of each constant."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("--jets", type=int, default=5)
    parser.add_argument("--diffusion", type=Path, help="folder of MOJAVE's tables")
    args = parser.parse_args()
    if args.diffusion:
        diffusion_table(args.diffusion, range(FIRST_SEED, FIRST_SEED + args.jets))
        return
    seeds = range(FIRST_SEED, FIRST_SEED + args.jets)
    kinds = (*ONE, "two-streams", *STATIC)
    jets = {kind: [matched_jet(kind, seed) for seed in seeds] for kind in kinds}

    def shares(settings):
        right, both, false = [], [], []
        for kind in kinds:
            for seed, (d, jet) in zip(seeds, jets[kind], strict=True):
                found = speeds(d, seed, settings)
                if kind in ONE:
                    right.append(
                        bool(found) and abs(found[0] / true_mean(jet) - 1) <= RIGHT
                    )
                elif kind in STATIC:
                    false.append(bool(found))
                else:
                    near = [[abs(v / t - 1) <= RIGHT for v in found] for t in TWO[kind]]
                    both.append(all(map(any, near)))
        return [f"{np.mean(x):.2f}" for x in (right, both, false)]

    chosen = SearchSettings()
    rows = []
    for name, values in VALUES.items():
        for value in values:
            mark = " (chosen)" if value == getattr(chosen, name) else ""
            found = shares(replace(chosen, **{name: value}))
            rows.append([name, f"{value:g}{mark}", *found])
    write("design_table", ["constant", "value", "right", "both", "false"], rows)


if __name__ == "__main__":
    main()
