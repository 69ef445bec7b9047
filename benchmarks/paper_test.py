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
from astro_scc.stacking.stack import stack

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
AXES = ("parallel", "transverse")
HEADER = ["jet", "what", "paper", "authors' program", "astro_scc"]


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
        result, step = measure(cube, args.n_trials, args.seed)
        rows += rows_of(name, streams, folder, result, step, args.seed)
    write_table("paper_test", HEADER, rows)


def rows_of(name, streams, folder, result, step, seed):
    """Return rows that compare what the three found in one jet."""
    own, theirs = components(result, step), program_components(folder)
    rows = [("SSPs on scales 1, 2, 3", program_ssps(folder), ssp_counts(result))]
    rest = list(range(len(own)))
    for stream, speed in streams.items():
        mine = nearest(own, speed)
        rows.append(
            (
                stream,
                of_program(theirs, speed),
                "not found" if mine is None else text(own[mine]),
            )
        )
        if mine is not None:
            rest.remove(mine)
            z = z_without_successors(result, mine, seed)
            rows.append((f"{stream}, z if no successor is kept", "", f"z {z:.1f}"))
    others = [
        peak
        for peak in theirs
        if all(abs(peak["v"][0] - speed) > NEAR for speed in streams.values())
    ]
    strongest = max(rest, key=lambda i: own[i]["z"], default=None)
    rows.append(
        (
            "strongest other",
            program_text(others[0]) if others else "none",
            "none" if strongest is None else text(own[strongest]),
        )
    )
    return [
        [name, what, PAPER.get((name, what), ""), program, package]
        for what, program, package in rows
    ]


def measure(cube, n_trials, seed):
    """Measure with the paper's settings; return the result and a pixel per epoch."""
    step = (cube.pixel_scale / np.diff(cube.years).mean()).to(PM_UNIT)
    region = np.zeros(cube.shape[1:], dtype=bool)
    region[:, REGION[0] : REGION[1] + 1] = True
    scc = StackedCrossCorrelation(
        scales=SCALES, max_speed=40 * step, position_angle=270 * u.deg
    )
    return scc(cube, region=region, n_trials=n_trials, rng=seed), step


def components(result, step):
    """Return the components in pixels per epoch."""
    return [
        {
            "v": tuple(plain(row[f"pm_{a}"] / step, u.one) for a in AXES),
            "e": tuple(plain(row[f"pm_{a}_err"] / step, u.one) for a in AXES),
            "z": float(row["z_score"]),
            "p": float(row["p_global"]),
            "kind": str(row["kind"]),
            "jitter": plain(row["pm_err_jitter"] / step, u.one),
        }
        for row in result.components
    ]


def text(c):
    """Return a component as text for a cell of the table."""
    along, across = (
        measured(v, e, d) for v, e, d in zip(c["v"], c["e"], (2, 1), strict=True)
    )
    return (
        f"({along}, {across}), ± {c['jitter']:.2f} by jitter; z {c['z']:.1f}; "
        f"p_global {p_text(c['p'])}; {c['kind']}"
    )


def nearest(found, speed):
    """Return the index of the strongest component near (speed, 0), or None."""
    near = [
        i for i, c in enumerate(found)
        if np.hypot(c["v"][0] - speed, c["v"][1]) < NEAR
    ]  # fmt: skip
    return max(near, key=lambda i: found[i]["z"], default=None)


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


def z_without_successors(result, index, seed, n_orders=300):
    """
    Return the z-score from permutations in which no epoch follows its predecessor.

    These are the permutations of the authors' program.
    """
    rng = np.random.default_rng(seed)
    orders = []
    while len(orders) < n_orders:
        order = rng.permutation(len(result.cube))
        if not np.any(np.diff(order) == 1):
            orders.append(order)
    peak = result.maxima[index]
    here = peak.row, peak.column
    trials = np.array(
        [
            stack(result.displacements, result.pairs, result.grid, order=order)[here]
            for order in orders
        ]
    )
    return (result.coefficient[here] - trials.mean()) / trials.std()


if __name__ == "__main__":
    main()
