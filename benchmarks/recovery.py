# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure the share of injected motion that is found in simulated and in real images.

    python benchmarks/recovery.py ../shared/data [--parts simulated real]

``simulated`` injects a second stream into a simulated jet that has one, and ``real``
injects features into ten epochs of the quasar 0003+380.
"""

import argparse
import time
from pathlib import Path

import astropy.units as u
import numpy as np
from common import PM_UNIT, write_table
from real_images import MAX_SPEED, POSITION_ANGLE, SCALES, SOURCE, read

from astro_scc import StackedCrossCorrelation
from astro_scc.recovery import completeness
from astro_scc.simulation import JetSimulation, Stream

HEADER = ["speed (mas/yr)", "peak / noise", "found", "of", "fraction", "95% interval",
          "bias", "scatter", "coverage"]  # fmt: skip
#: Half the width of the jet of 0003+380, and the range of distances used, in mas.
HALF_WIDTH, NEAREST, FARTHEST = 1.0, 1.0, 6.0


def main():
    """Run the requested parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("folder", type=Path, help="of all test data")
    parser.add_argument("--parts", nargs="+", default=list(PARTS), choices=list(PARTS))
    parser.add_argument("--n-injections", type=int, default=10)
    parser.add_argument("--n-trials", type=int, default=100)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    for name in args.parts:
        start = time.perf_counter()
        print(f"{name}:")
        PARTS[name](args)
        print(f"({time.perf_counter() - start:.0f} s)\n", flush=True)


def simulated(args):
    """Inject a second stream into a jet that has one of 6.1 mas/yr."""
    sheath = Stream("sheath", dx=5.0, density=0.6, half_width=12.0, jitter=1.0)
    cube = JetSimulation(
        [sheath], n_epochs=8, shape=(64, 192), extent=(15, 175), axis=32.0, noise=0.01
    ).run(rng=args.seed).cube  # fmt: skip
    scc = StackedCrossCorrelation(
        scales=[1, 2], max_speed=36 * PM_UNIT, position_angle=270 * u.deg
    )
    table = completeness(
        cube, scc, speeds=[3, 6, 12, 24] * PM_UNIT,
        fluxes=[3, 5, 10, 30, 100, 300], n_features=8, **common(args),
    )  # fmt: skip
    report("recovery_simulated", table)


def real(args):
    """Inject features into the resolved part of the jet of 0003+380."""
    cube = read(args.folder / SOURCE)
    east, north = cube.pixel_to_offset(*np.meshgrid(*map(np.arange, cube.shape[:0:-1])))
    turn = np.radians(POSITION_ANGLE)
    along = (east * np.sin(turn) + north * np.cos(turn)).to_value(u.mas)
    across = (east * np.cos(turn) - north * np.sin(turn)).to_value(u.mas)
    region = (np.abs(across) <= HALF_WIDTH) & (along >= NEAREST) & (along <= FARTHEST)
    scc = StackedCrossCorrelation(
        scales=SCALES,
        max_speed=MAX_SPEED * PM_UNIT,
        position_angle=POSITION_ANGLE * u.deg,
    )
    table = completeness(
        cube, scc, speeds=[0.1, 0.3, 0.6] * PM_UNIT,
        fluxes=[5, 10, 30, 100], region=region, n_features=4, **common(args),
    )  # fmt: skip
    report("recovery_real", table)


PARTS = {"simulated": simulated, "real": real}


def common(args):
    """Return the arguments that all tables share."""
    return {
        "n_injections": args.n_injections,
        "n_trials": args.n_trials,
        "rng": args.seed,
        "n_workers": args.workers,
    }


def interval(low, high):
    """Return an interval as text."""
    return f"{low:.2f} to {high:.2f}"


def number(value, form):
    """Return a number as text, empty if it is masked."""
    if np.any(getattr(value, "mask", False)):
        return ""
    return form.format(float(u.Quantity(getattr(value, "unmasked", value)).value))


def report(name, table):
    """Print a table of completeness and write it for the documentation."""
    own = table.meta["own_velocities"].to_value(PM_UNIT)
    print("components of the epochs:", np.round(own, 3).tolist(), "mas/yr")
    print(f"tolerance {table.meta['tolerance']:.3g}")
    rows = [
        [
            f"{row['speed'].value:g}" + (" (own)" if row["own"] else ""),
            f"{row['snr']:.0f}",
            row["n_found"],
            row["n_injected"],
            f"{row['fraction']:.2f}",
            interval(row["fraction_low"], row["fraction_high"]),
            number(row["bias"], "{:.3f}")
            + (" ± " + number(row["bias_err"], "{:.3f}") if row["n_found"] > 1 else ""),
            number(row["scatter"], "{:.3f}"),
            number(row["coverage"], "{:.2f}"),
        ]
        for row in table
    ]
    write_table(name, HEADER, rows)


if __name__ == "__main__":
    main()
