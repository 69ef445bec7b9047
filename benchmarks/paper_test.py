# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Compare the speeds in the paper's simulated jets: paper, authors' program, this package.

The jets are those of Sect. 2.4 of Mertens & Lobanov (2016), measured with the settings
of the paper.  The results of the authors' program on the same files are in their
folders::

    python benchmarks/paper_test.py ../shared/data/paper_test
"""

import argparse
import csv
import json
from pathlib import Path

import astropy.units as u
import numpy as np
from common import PM_UNIT, measured, p_text, plain, write_table

from astro_scc import EpochCube, StackedCrossCorrelation

JETS = {
    "two_fluid": {"slow, 5 px": 5.0, "fast, 20 px": 20.0},
    "two_fluid_dense": {"slow, 5 px": 5.0, "fast, 20 px": 20.0},
    "random": {},
}
PAPER = {
    ("two_fluid", "SSPs on scales 1, 2, 3"): "264 in all",
    ("two_fluid", "slow, 5 px"): "4.5 ± 0.4; z 11.4",
    ("two_fluid", "fast, 20 px"): "20.5 ± 0.8; z 6.7",
    ("two_fluid", "strongest other"): "none",
    ("random", "strongest other"): "z < 2",
}
SCALES = (1, 2, 3)
#: First and last column of the region, in pixels.
REGION = (60, 160)
#: Largest difference of a component from its stream, in pixels per epoch.
NEAR = 3.0
METHODS = ("paper", "spectrum")
AXES = ("parallel", "transverse")
HEADER = ["jet", "what", "paper", "authors' program", "--method paper", "streams"]


def main():
    """Measure the three jets and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("folder", type=Path, help="of the three jets")
    parser.add_argument("--n-trials", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    rows = []
    for name, streams in JETS.items():
        folder = args.folder / name
        cube = EpochCube.read(str(folder / "*.fits"))
        step = (cube.pixel_scale / np.diff(cube.years).mean()).to(PM_UNIT)
        results = [measure(cube, step, method, args.n_trials, args.seed)
                   for method in METHODS]  # fmt: skip
        rows += rows_of(name, streams, folder, results, step)
    write_table("paper_test", HEADER, rows)


def measure(cube, step, method, n_trials, seed):
    """Measure with the paper's settings."""
    region = np.zeros(cube.shape[1:], dtype=bool)
    region[:, REGION[0] : REGION[1] + 1] = True
    scc = StackedCrossCorrelation(
        method=method, scales=SCALES, max_speed=40 * step, position_angle=270 * u.deg
    )
    return scc(cube, region=region, n_trials=n_trials, rng=seed)


def rows_of(name, streams, folder, results, step):
    """Return rows that compare what was found in one jet."""
    theirs = program_components(folder)
    found = [components(result, step) for result in results]
    rows = [("SSPs on scales 1, 2, 3", program_ssps(folder), *map(ssp_counts, results))]
    rest = [list(own) for own in found]
    for stream, speed in streams.items():
        cells = []
        for own, others in zip(found, rest, strict=True):
            mine = nearest(own, speed)
            cells.append("not found" if mine is None else text(mine))
            if mine is not None:
                others.remove(mine)
        rows.append((stream, of_program(theirs, speed), *cells))
    others = [
        peak
        for peak in theirs
        if all(abs(peak["v"][0] - speed) > NEAR for speed in streams.values())
    ]
    strongest = [text(own[0]) if own else "none" for own in rest]
    program = program_text(others[0]) if others else "none"
    rows.append(("strongest other", program, *strongest))
    return [[name, what, PAPER.get((name, what), ""), *cells] for what, *cells in rows]


def components(result, step):
    """Return what may move, in pixels per epoch, the most significant first."""
    table = result.components
    strength = "z_score" if "z_score" in table.colnames else "share"
    found = [
        {
            "v": tuple(plain(row[f"pm_{a}"] / step, u.one) for a in AXES),
            "e": tuple(plain(row[f"pm_{a}_err"] / step, u.one) for a in AXES),
            "strength": (strength.removesuffix("_score"), float(row[strength])),
            "p": float(row["p_global"]),
            "kind": str(row["kind"]),
        }
        for row in table
        if row["kind"] != "stationary"
    ]
    return sorted(found, key=lambda c: -c["strength"][1])


def text(c):
    """Return a component as text for a cell of the table."""
    along, across = (
        measured(v, e, d) for v, e, d in zip(c["v"], c["e"], (2, 1), strict=True)
    )
    name, value = c["strength"]
    return (
        f"({along}, {across}); {name} {value:.2g}; p_global {p_text(c['p'])}; "
        f"{c['kind']}"
    )


def nearest(found, speed):
    """Return the strongest component near (speed, 0), or None."""
    near = (c for c in found if np.hypot(c["v"][0] - speed, c["v"][1]) < NEAR)
    return next(near, None)


def ssp_counts(result):
    """Return the number of SSPs in the region on each scale and in total, as text."""
    table = result.ssps[result.ssps["in_region"]]
    counts = [int(np.sum(table["scale"] == scale)) for scale in SCALES]
    return f"{', '.join(map(str, counts))}: {sum(counts)}"


def program_ssps(folder):
    """Return the same for the authors' program."""
    with open(folder / "wise_ssps.csv", newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["in_roi"] == "1"]
    counts = [sum(row["scale_px"] == str(2**s) for row in rows) for s in SCALES]
    return f"{', '.join(map(str, counts))}: {sum(counts)}"


def program_components(folder):
    """Return the peaks of the authors' program, most significant first."""
    found = json.loads((folder / "wise_significance.json").read_text(encoding="utf-8"))
    errors = {e["target"]: e["std"] for e in found.get("unc", ())}
    peaks = [
        {"v": (p["vx_fit"], p["vy_fit"]), "z": p["sig"], "e": None}
        for p in found["peaks"]
    ]
    for peak in peaks:
        for target, std in errors.items():
            if abs(peak["v"][0] - target) < NEAR:
                peak["e"] = std
    return sorted(peaks, key=lambda p: -p["z"])


def of_program(peaks, speed):
    """Return the peak of the authors' program near a speed, as text."""
    for peak in peaks:
        if np.hypot(peak["v"][0] - speed, peak["v"][1]) < NEAR:
            return program_text(peak)
    return "not found"


def program_text(peak):
    """Return a peak of the authors' program as text for a cell of the table."""
    errors = peak["e"] or (np.nan, np.nan)
    along, across = (
        measured(v, e, d) for v, e, d in zip(peak["v"], errors, (2, 1), strict=True)
    )
    return f"({along}, {across}); z {peak['z']:.1f}"


if __name__ == "__main__":
    main()
