# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Compare speeds of twelve jets of MOJAVE, measured without options, with the survey's.

Neither a speed nor an interval nor a direction is given.  The whole jet, and rings
around the core, are compared with the straight lines that the survey fits to features::

    python benchmarks/mojave.py ../shared/data/mojave_xviii
    python benchmarks/mojave.py ../shared/data/mojave_xviii --only 1641+399

It takes some minutes on one processor and 1 GB; the rows of a source are written as
soon as it is measured.
"""

import argparse
import csv
import warnings
from dataclasses import dataclass
from pathlib import Path

import astropy.units as u
import numpy as np
from common import (
    PM_UNIT,
    RESULTS,
    Stopwatch,
    feature_motions,
    measured,
    mojave_images,
    p_text,
    plain,
    write_table,
)

from astro_scc import Beam, StackedCrossCorrelation
from astro_scc.epochs import distance_mask
from astro_scc.exceptions import MeasurementWarning
from astro_scc.kinematics import apparent_speed, paper_cosmology

#: The paper uses the images of 3C 273 and 3C 120 before this date.
BEFORE = "2011-01-01"
BEAM = Beam(0.9 * u.mas, 0.6 * u.mas, -5 * u.deg)
RINGS = ((0.5, 2), (2, 4), (4, 7), (7, 12), (12, 20))
#: Fewest features of a ring that is judged, and fewest epochs of a feature.
FEATURES, EPOCHS = 5, 5
#: A speed is right within this fraction of the features' mean, or within two errors.
RIGHT = 0.2


@dataclass(frozen=True)
class Source:
    """A jet of the survey, with redshift and direction if the paper measures it."""

    name: str
    table: str
    beam: Beam = BEAM
    redshift: float = np.nan
    position_angle: float = np.nan

    @property
    def per_c(self):
        """Apparent speed of 1 mas/yr in units of c."""
        speed = apparent_speed(
            1 * PM_UNIT, redshift=self.redshift, cosmology=paper_cosmology()
        )
        return float(speed)


SOURCES = (
    Source("0003+380", "0003+380"),
    Source("0333+321", "0333+321"),
    Source("3C 111", "0415+379"),
    Source(
        "3C 120", "0430+052", Beam(1.2 * u.mas, 0.5 * u.mas, -5 * u.deg), 0.033, -112.0
    ),
    Source("0716+714", "0716+714"),
    Source(
        "3C 273", "1226+023", Beam(1.0 * u.mas, 0.5 * u.mas, -7 * u.deg), 0.158, -138.0
    ),
    Source("M 87", "1228+126"),
    Source("3C 279", "1253-055"),
    Source("1308+326", "1308+326"),
    Source("1510-089", "1510-089"),
    Source("3C 345", "1641+399"),
    Source("BL Lac", "2200+420"),
)
HEADER = [
    "jet", "epochs", "ring (mas)", "features", "their mean (mas/yr)", "kind",
    "speed (mas/yr)", "dispersion", "p_global", "n_features", "right", "CPU s", "GB",
]  # fmt: skip


def main():
    """Measure the requested jets, and judge all that are in the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("folder", type=Path, help="of the tables of features")
    parser.add_argument("--only", nargs="+", metavar="TABLE", help="as 1641+399")
    parser.add_argument("--n-trials", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    for source in SOURCES:
        if args.only is None or source.table in args.only:
            rows = measure(source, args)
            others = [row for row in earlier() if row[0] != source.name]
            order = [s.name for s in SOURCES]
            rows = sorted(others + rows, key=lambda row: order.index(row[0]))
            write_table("mojave", HEADER, rows)
    judge(earlier())


def earlier():
    """Return the rows of the existing table."""
    path = RESULTS / "mojave.csv"
    if not path.exists():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    return rows if header == HEADER else []


def measure(source, args):
    """Return the rows of the table for the whole jet and its rings."""
    watch = Stopwatch()
    cube = mojave_images(args.folder, source.table, source.beam, seed=args.seed)
    scc = StackedCrossCorrelation(position_angle="fit")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeasurementWarning)
        whole = scc(cube, n_trials=args.n_trials, rng=args.seed)
    angle = whole.position_angle.to_value(u.deg)
    motions = feature_motions(args.folder, source.table, angle, epochs=EPOCHS)
    cost = f"{sum(watch.lap('whole')[:1]):.0f}", f"{watch.peak_memory():.1f}"
    rows = rows_of(source, cube, "all", whole, motions, cost)
    scc = StackedCrossCorrelation(position_angle=whole.position_angle)
    for low, high in RINGS:
        inside = (motions["distance"] >= low) & (motions["distance"] < high)
        if inside.sum() < FEATURES:
            continue
        own = {k: motions[k][inside] for k in ("speed", "error")}
        ring = distance_mask(cube, low * u.mas, high * u.mas)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeasurementWarning)
            result = scc(cube, region=ring, n_trials=args.n_trials, rng=args.seed)
        rows += rows_of(source, cube, f"{low:g} to {high:g}", result, own, ("", ""))
    return rows


def rows_of(source, cube, ring, result, motions, cost):
    """Return a row for each component that is not stationary."""
    speed, error = motions["speed"], motions["error"]
    moving = np.abs(speed) > 2 * error
    mean = np.mean(speed[moving]) if moving.any() else np.nan
    head = [source.name, len(cube), ring, f"{moving.sum()} of {len(speed)}",
            f"{mean:.3f}"]  # fmt: skip
    rows = []
    for row in result.components:
        if row["kind"] == "stationary":
            continue
        v, e = (plain(row[c], PM_UNIT) for c in ("pm_parallel", "pm_parallel_err"))
        away = np.abs(v - mean)
        right = away <= max(RIGHT * abs(mean), 2 * np.nan_to_num(e))
        # For a single feature, its own error is added to the error of the row.
        near = np.abs(v - speed) <= np.maximum(
            RIGHT * np.abs(speed), 2 * np.hypot(error, np.nan_to_num(e))
        )
        verdict = "mean" if right else "a feature" if near.any() else "no"
        rows.append([
            *head, row["kind"], measured(v, e, 3),
            f"{plain(row['dispersion'], PM_UNIT):.3f}", p_text(row["p_global"]),
            row["n_features"], verdict, *cost,
        ])  # fmt: skip
    return rows or [[*head, "nothing", "", "", "", 0, "", *cost]]


def judge(rows):
    """Print how many rows are right."""
    first = {}
    for row in rows:
        first.setdefault((row[0], row[2]), row)
    judged = [row for row in first.values() if int(row[3].split(" of ")[1]) >= FEATURES]
    moving = [row for row in judged if row[5] == "moving"]
    right = [row for row in moving if row[10] == "mean"]
    every = [row for row in rows if row[5] == "moving"]
    empty = [row for row in every if row[10] == "no"]
    print(f"moving: {len(moving)} of {len(judged)} jets and rings")
    print(f"within 20% or two errors of the features' mean: {len(right)}")
    print(f"moving rows without a feature at their speed: {len(empty)} of {len(every)}")


if __name__ == "__main__":
    main()
