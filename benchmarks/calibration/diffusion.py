# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""
Show what distinguishes random walks from jets that were simulated or observed.

    python benchmarks/calibration/diffusion.py ../shared/data/mojave_xviii [--jets 5]

Prints what the speeds of the features of each jet say, on jets that the calibration
does not use, and on those of MOJAVE's tables.
"""

import argparse
import os
import sys
import warnings
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

from run import KINDS, diffusing

from astro_scc.features import find_features
from astro_scc.features.motion import is_walk, measure_diffusion

sys.path.insert(0, str(Path(__file__).parents[1]))
from common import mojave_images, print_table
from mojave import SOURCES

FIRST_SEED = 4000
#: Drifts and random steps in beams an epoch, and jets with most features.
WALKS = [(drift, step) for drift in (0.0, 0.1) for step in (0.1, 0.2, 0.3, 0.4)]
STEADY = ("single-20", "single-30", "features16-20", "two-streams", "uniform",
          "accelerated", "layers", "static-red")  # fmt: skip


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("tables", type=Path, help="folder of MOJAVE's tables")
    parser.add_argument("--jets", type=int, default=5)
    args = parser.parse_args()
    kinds = {f"walk {drift:g} {step:g}": diffusing(drift, step)
             for drift, step in WALKS}  # fmt: skip
    kinds |= {kind: KINDS[kind] for kind in STEADY}
    rows = [row_of(kind, seed, make(seed).cube) for kind, make in kinds.items()
            for seed in range(FIRST_SEED, FIRST_SEED + args.jets)]  # fmt: skip
    for source in SOURCES:
        cube = mojave_images(args.tables, source.table, source.beam)
        rows.append(row_of(source.name, "", cube))
    header = ["jet", "seed", "features", "step", "change", "isotropy", "diffuses"]
    print_table(header, rows)


def row_of(name, seed, cube):
    """Return the row of one jet."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = measure_diffusion(find_features(cube))
    numbers = (f"{found['step']:.3f}", f"{found['change']:.2f}",
               f"{found['isotropy']:.2f}")  # fmt: skip
    walk = "yes" if is_walk(found) else "no"
    return [name, seed, found["n_features"], *numbers, walk]


if __name__ == "__main__":
    main()
