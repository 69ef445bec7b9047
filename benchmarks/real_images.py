# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Compare the speeds in ten epochs of the quasar 0003+380 with those of MOJAVE's features.

The images are aligned on the core by a table and convolved to one beam.  The jet is
measured in rings around the core, with the settings that the dates and the beam
suggest and, to test the sensitivity, with others::

    python benchmarks/real_images.py ../shared/data
"""

import argparse
from pathlib import Path

import astropy.units as u
import numpy as np
from common import (
    PM_UNIT,
    feature_motions,
    measured,
    p_text,
    plain,
    write_table,
)

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.epochs import distance_mask, plan_intervals

SOURCE = "0003+380"
#: Direction from the core to the patterns of the jet, in degrees.
POSITION_ANGLE = 115.0
MAX_SPEED = 1.0
SCALES = (1, 2, 3)
#: Rings in mas; the beam does not distinguish the first from the core.
RINGS = ((0, 1), (1, 3), (3, 6))
VARIANTS = {
    "consecutive": {},
    "consecutive, scales 1, 2": {"scales": (1, 2)},
    "consecutive, scales 2, 3": {"scales": (2, 3)},
    "0.4 to 2 yr": {"baseline": [0.4, 2.0] * u.yr},
    "0.75 to 3.75 yr": {"baseline": [0.75, 3.75] * u.yr},
}
HEADER = [
    "distance",
    "pairs of epochs",
    "SSPs",
    "components: along, across",
    "largest of the map",
]
FIT_HEADER = ["feature", "epochs", "distance", "along the jet"]


def main():
    """Measure the rings and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("folder", type=Path, help="of all test data")
    parser.add_argument("--n-trials", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    cube = read(args.folder / SOURCE)
    print(*cube.meta["history"], plan_intervals(cube), "", sep="\n")

    motions = feature_motions(args.folder / "mojave_xviii", SOURCE, POSITION_ANGLE)
    order = np.argsort(motions["distance"])
    fits = [
        [
            int(motions["feature"][i]),
            len(motions["epochs"][i]),
            f"{motions['distance'][i]:.1f} mas",
            measured(motions["speed"][i], motions["error"][i], 3),
        ]
        for i in order
    ]
    write_table("real_images_fits", FIT_HEADER, fits)
    write_table("real_images", HEADER, rows_of(cube, args))


def read(folder):
    """Read the epochs, convolve them to one beam and align their cores."""
    cube = EpochCube.read(str(folder / "*.fits"))
    return cube.to_common_beam().align("table", table=folder / "core_offsets.csv")


def rows_of(cube, args):
    """Measure all rings with all variants of the settings."""
    found = {}
    for name, changes in VARIANTS.items():
        settings = {
            "scales": SCALES,
            "max_speed": MAX_SPEED * PM_UNIT,
            "position_angle": POSITION_ANGLE * u.deg,
            **changes,
        }
        scc = StackedCrossCorrelation(**settings)
        for r_min, r_max in RINGS:
            ring = distance_mask(cube, r_min * u.mas, r_max * u.mas)
            result = scc(cube, region=ring, n_trials=args.n_trials, rng=args.seed)
            found[r_min, name] = [
                f"{r_min} to {r_max} mas",
                name,
                int(result.ssps["in_region"].sum()),
                "; ".join(map(component_text, result.components)) or "none",
                largest(result),
            ]
    return [found[r_min, name] for r_min, _ in RINGS for name in VARIANTS]


def component_text(row):
    """Return a component as text for a cell of the table."""
    along, across = (
        measured(plain(row[name], PM_UNIT), plain(row[f"{name}_err"], PM_UNIT))
        for name in ("pm_parallel", "pm_transverse")
    )
    return (
        f"{along}, {across} (share {row['share']:.2f}, p {p_text(row['p_global'])}, "
        f"{row['kind']})"
    )


def largest(result):
    """Return the maximum of the velocity map, significant or not, as text."""
    k = np.unravel_index(result.coefficient.argmax(), result.coefficient.shape)
    v1, v2 = result.grid.v1[k[1]], result.grid.v2[k[0]]
    return f"{v1 + 0.0:.2f}, {v2 + 0.0:.2f} ({result.coefficient[k]:.2f})"


if __name__ == "__main__":
    main()
