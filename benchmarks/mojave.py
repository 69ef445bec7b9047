# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
The jets of the paper, 3C 273 and 3C 120, restored from the features of MOJAVE.

Epochs before 2011, as in Sect. 3 of Mertens & Lobanov (2016), one beam for all, with
noise.  Speeds in rings about the core, beside the paper and beside the straight lines
that MOJAVE's features follow::

    python benchmarks/mojave.py ../shared/data/mojave_xviii
"""

import argparse
import csv
from dataclasses import dataclass
from pathlib import Path

import astropy.units as u
import numpy as np
from common import (
    PM_UNIT,
    RESULTS,
    Stopwatch,
    feature_motions,
    feature_quartiles,
    measured,
    p_text,
    part,
    plain,
    write_table,
)

from astro_scc import Beam, StackedCrossCorrelation
from astro_scc.epochs import read_components, restore
from astro_scc.kinematics import apparent_speed, paper_cosmology
from astro_scc.stacking import find_components

BEFORE = "2011-01-01"
PIXEL = 0.1 * u.mas
NOISE = 0.3 * u.mJy / u.beam
SCALES = (1, 2, 3, 4)
ALL, FINE, COARSE = SCALES, (1, 2), (3, 4)


@dataclass(frozen=True)
class Source:
    """A jet, how it is measured, and what others found: {(r_min, scales): text}."""

    name: str
    table: str
    redshift: float
    beam: Beam
    position_angle: float
    baseline: tuple
    max_speed: float
    rings: tuple
    groups: tuple
    prototype: dict
    paper: dict

    @property
    def per_c(self):
        """Units of c that 1 mas/yr is."""
        speed = apparent_speed(
            1 * PM_UNIT, redshift=self.redshift, cosmology=paper_cosmology()
        )
        return float(speed)


@dataclass(frozen=True)
class Point:
    """The largest maximum of one ring and group of scales."""

    ring: tuple
    group: tuple
    speed: float
    error: float
    kind: str

    @property
    def middle(self):
        """Distance of the middle of the ring."""
        return sum(self.ring) / 2

    @property
    def half_width(self):
        """Of the ring."""
        return (self.ring[1] - self.ring[0]) / 2

    @property
    def top(self):
        """Where the bar of the error ends."""
        return self.speed + np.nan_to_num(self.error)

    @property
    def found(self):
        """Whether it is a component that is more than chance."""
        return self.kind in ("moving", "stationary")


SOURCES = (
    Source(
        name="3C 273",
        table="1226+023",
        redshift=0.158,
        beam=Beam(1.0 * u.mas, 0.5 * u.mas, -7 * u.deg),
        position_angle=-138.0,
        baseline=(0.25, 1.2),
        max_speed=2.0,
        rings=((1, 6), (6, 11), (11, 16)),
        groups=(FINE, COARSE),
        prototype={
            (1, FINE): 0.77, (1, COARSE): 0.98, (6, FINE): 0.86, (6, COARSE): 0.89,
            (11, FINE): 0.86, (11, COARSE): 0.88,
        },
        paper=dict.fromkeys(((1, FINE), (6, FINE), (11, FINE)), "about 7.5 c")
        | dict.fromkeys(((1, COARSE), (6, COARSE), (11, COARSE)), "about 9 c"),
    ),
    Source(
        name="3C 120",
        table="0430+052",
        redshift=0.033,
        beam=Beam(1.2 * u.mas, 0.5 * u.mas, -5 * u.deg),
        position_angle=-112.0,
        baseline=(0.1, 0.6),
        max_speed=5.0,
        rings=((0.5, 1.5), (1.5, 2.5), (2.5, 3.5), (3.5, 5.5), (5.5, 7.5), (7.5, 10.5)),
        groups=(ALL,),
        prototype=dict(
            zip(
                [(r, ALL) for r in (0.5, 1.5, 2.5, 3.5, 5.5, 7.5)],
                (1.67, 1.73, 1.80, 2.00, 2.27, 1.87),
                strict=True,
            )
        ),
        paper={
            (0.5, ALL): "4.0 ± 0.2 c (at 1 mas)",
            (5.5, ALL): "6.0 ± 0.4 c (at 7 mas)",
            (7.5, ALL): "slower",
        },
    ),
)  # fmt: skip
HEADER = [
    "jet", "distance (mas)", "scales", "SSPs", "speed (mas/yr)", "± by jitter",
    "in c", "z",
    "p_global", "kind", "others", "prototype", "features, quartiles", "paper",
]  # fmt: skip
COST_HEADER = [
    "jet", "epochs", "pixels", "pairs", "SSPs", "correlations", "matches",
    "correlate (CPU s)", "one stack (CPU s)", "memory (GB)",
]  # fmt: skip


def main():
    """Restore and measure the jets, write tables and figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("folder", type=Path, help="of the tables of features")
    parser.add_argument("--n-trials", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--redraw", action="store_true", help="draw the table of an earlier run only"
    )
    args = parser.parse_args()
    rows, costs, panels = [], [], []
    for source in SOURCES:
        motions = feature_motions(
            args.folder, source.table, source.position_angle, before=BEFORE
        )
        if args.redraw:
            panels.append((source, earlier_points(source), motions))
            continue
        more, cost, points = measure(source, motions, args)
        rows += more
        costs.append(cost)
        panels.append((source, points, motions))
    if not args.redraw:
        write_table("mojave", HEADER, rows)
        write_table("mojave_cost", COST_HEADER, costs)
    draw(panels)


def earlier_points(source):
    """The points of a source in the table that was written last."""
    with open(RESULTS / "mojave.csv", newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["jet"] == source.name]
    points = []
    for row in rows:
        ring = tuple(float(limit) for limit in row["distance (mas)"].split(" to "))
        group = tuple(int(scale) for scale in row["scales"].split(", "))
        speed, _, error = row["speed (mas/yr)"].partition(" ± ")
        points.append(
            Point(ring, group, float(speed), float(error or "nan"), row["kind"])
        )
    return points


def images(source, folder, seed):
    """The epochs of a source."""
    components = read_components(folder / f"{source.table}.ecsv")
    return restore(
        components.select(before=BEFORE),
        beam=source.beam,
        pixel_scale=PIXEL,
        noise=NOISE,
        rng=seed,
    )


def measure(source, motions, args):
    """Rows of the table, what they cost, and points of the figure."""
    cube = images(source, args.folder, args.seed)
    scc = StackedCrossCorrelation(
        scales=SCALES,
        max_speed=source.max_speed * PM_UNIT,
        position_angle=source.position_angle * u.deg,
        baseline=source.baseline * u.yr,
    )
    watch = Stopwatch()
    matched = scc.match(cube)
    correlate, _ = watch.lap("correlate")
    scc.stack(matched, n_trials=args.n_trials, rng=args.seed)
    stack, _ = watch.lap("stack")
    n = len(cube)
    cost = [
        source.name,
        n,
        f"{cube.shape[2]} x {cube.shape[1]}",
        len(scc.date_pairs(cube)),
        len(matched.ssps),
        len(matched.ssps) * (n - 1),
        len(matched.matches),
        f"{correlate:.0f}",
        f"{stack:.0f}",
        f"{watch.peak_memory():.1f}",
    ]
    rows, points = [], []
    for ring in source.rings:
        features = quartiles_text(motions, *ring)
        for group in source.groups:
            chosen = part(matched, r_min=ring[0], r_max=ring[1], scales=group)
            result = scc.stack(chosen, n_trials=args.n_trials, rng=args.seed)
            found, speed, error, kind = cells(result, source.per_c)
            prototype = source.prototype.get((ring[0], group))
            rows.append(
                [
                    source.name,
                    f"{ring[0]:g} to {ring[1]:g}",
                    ", ".join(map(str, group)),
                    int(chosen.select.sum()),
                    *found,
                    "" if prototype is None else f"{prototype:.2f}",
                    features,
                    source.paper.get((ring[0], group), ""),
                ]
            )
            points.append(Point(ring, group, speed, error, kind))
    return rows, cost, points


def strongest(result):
    """The largest maximum of the stack, and the row of the components that it is."""
    beam = result.cube.beams[0]
    fwhm = np.sqrt(beam.major * beam.minor).to_value(u.mas)
    box = fwhm / np.average(result.pairs.interval, weights=result.pairs.weight)
    top = find_components(result.coefficient, result.grid, (box, box))[0]
    table = result.components
    away = np.hypot(
        table["pm_parallel"].to_value(PM_UNIT) - top.v1,
        table["pm_transverse"].to_value(PM_UNIT) - top.v2,
    )
    if len(away) == 0 or away.min() > box / 4:
        return top, None
    return top, int(away.argmin())


def cells(result, per_c):
    """The cells of the largest maximum of a stack, its speed, error and kind."""
    top, number = strongest(result)
    table = result.components
    others = [
        f"{plain(row['pm_parallel'], PM_UNIT):.2f} ({row['kind']})"
        for k, row in enumerate(table)
        if k != number and row["kind"] != "uncertain"
    ]
    error, jitter, p, kind = np.nan, "", np.nan, "not tested"
    if number is not None:
        row = table[number]
        error = plain(row["pm_parallel_err"], PM_UNIT)
        jitter = f"{plain(row['pm_err_jitter'], PM_UNIT):.2f}"
        p, kind = plain(row["p_global"]), str(row["kind"])
    return (
        [
            measured(top.v1, error),
            jitter,
            measured(per_c * top.v1, per_c * error, 1),
            f"{result.z_score[top.row, top.column]:.1f}",
            p_text(p),
            kind,
            ", ".join(others),
        ],
        top.v1,
        error,
        kind,
    )


def quartiles_text(motions, r_min, r_max):
    """The quartiles of the features' speeds, in a cell of the table."""
    found = feature_quartiles(motions, r_min, r_max)
    return "" if found is None else ", ".join(f"{v:.2f}" for v in found)


def draw(panels):
    """Speed against distance, of the stack and of the features."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 6.5), layout="constrained")
    for ax, (source, points, motions) in zip(
        figure.subplots(len(panels)), panels, strict=True
    ):
        ax.errorbar(
            motions["distance"], motions["speed"], motions["error"], fmt="o", ms=3,
            color="0.6", lw=0.8, label="MOJAVE, each feature", zorder=1,
        )  # fmt: skip
        for group, color, shift in zip(
            source.groups, ("#0072B2", "#D55E00"), (-0.1, 0.1), strict=False
        ):
            shift *= len(source.groups) > 1
            own = [point for point in points if point.group == group]
            draw_points(ax, own, color, shift)
        ax.set(
            title=source.name,
            xlim=(0, source.rings[-1][1] + 0.5),
            ylim=(0, 1.35 * max((point.top for point in points), default=1)),
            xlabel="Distance from the core (mas)",
            ylabel="Speed along the jet (mas/yr)",
        )
        ax.secondary_yaxis(
            "right", functions=(lambda v, k=source.per_c: k * v,
                                lambda v, k=source.per_c: v / k)
        ).set_ylabel("Apparent speed (c)")  # fmt: skip
        ax.legend(loc="upper left", fontsize="small", ncols=2)
    figure.savefig(RESULTS / "mojave.png", dpi=110)


def draw_points(ax, points, color, shift):
    """Filled what is found, open what may be chance."""
    scales = ", ".join(map(str, points[0].group))
    for found, face, label in (
        (True, color, f"scales {scales}"),
        (False, "white", f"scales {scales}, may be chance or not tested"),
    ):
        own = [point for point in points if point.found == found]
        if own:
            ax.errorbar(
                [point.middle + shift for point in own],
                [point.speed for point in own],
                np.nan_to_num([point.error for point in own]),
                [point.half_width for point in own],
                fmt="s", ms=5, color=color, mfc=face, zorder=3, label=label,
            )  # fmt: skip


if __name__ == "__main__":
    main()
