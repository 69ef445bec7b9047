# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Summarise the calibration: the table and the figure of the documentation.

    python benchmarks/calibration/summary.py

Reads ``results/*.csv`` as ``run.py`` writes them and writes
``results/false_alarms.ecsv``, ``results/power.ecsv``, ``results/errors.ecsv``
and ``results/calibration.png`` beside them.
"""

import csv
from pathlib import Path

import numpy as np
from astropy.stats import binom_conf_interval
from astropy.table import Table
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from run import KINDS

RESULTS = Path(__file__).parent / "results"
NULLS = (
    "unrelated",
    "static",
    "random",
    "ballistic",
    "beam-change",
    "sparse",
    "mixed",
)
#: A component is a stream's if it is this close, in pixels an epoch (0.2 beam).
CLOSE = 2.0
LEVELS = (0.01, 0.05)
COLORS = dict(
    zip(
        NULLS,
        ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#000000"),
        strict=True,
    )
)


def read(kind):
    """Rows of a kind by jet: ``{seed: [row, ...]}``, numbers as floats."""
    jets = {}
    with (RESULTS / f"{kind}.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            what = row.pop("kind")
            numbers = {name: float(value) for name, value in row.items()}
            jets.setdefault(int(row["seed"]), []).append({**numbers, "kind": what})
    return jets


def share(number, of):
    """A share with its 95% interval (Jeffreys)."""
    low, high = binom_conf_interval(number, of, 0.95, interval="jeffreys")
    return round(number / of, 3), round(float(low), 3), round(float(high), 3)


def false_p(kind):
    """Smallest ``p_global`` of each jet's components that should not be there."""
    jets = read(kind).values()
    if kind == "mixed":
        stream = speeds(kind)["slow"]
        jets = [
            [r for r in jet if np.hypot(r["v1"] - stream, r["v2"]) > CLOSE]
            for jet in jets
        ]
    return np.array([smallest_p(jet) for jet in jets])


def smallest_p(rows):
    """Smallest ``p_global`` of the components of a jet that move and are no stream."""
    return min((r["p_global"] for r in rows if r["kind"] == "moving"), default=1.0)


def false_alarms():
    """Share of null jets with a moving component, by level."""
    rows = []
    for kind in NULLS:
        if not (RESULTS / f"{kind}.csv").exists():
            continue
        p = false_p(kind)
        for level in LEVELS:
            rows.append((kind, len(p), level, *share(int((p <= level).sum()), len(p))))
    names = ("jets", "n", "level", "share", "low", "high")
    return Table(rows=rows, names=names)


def speeds(kind):
    """The two speeds that a kind of jet has, in pixels an epoch."""
    fast = 5.0 + float(kind.split("-")[1]) if kind.startswith("difference") else 20.0
    return {"slow": 5.0, "fast": fast}


def nearest(jet, speed):
    """The moving component of a jet nearest to a speed, or None."""
    near = [
        r
        for r in jet
        if r["kind"] == "moving" and np.hypot(r["v1"] - speed, r["v2"]) <= CLOSE
    ]
    return min(near, key=lambda r: abs(r["v1"] - speed), default=None)


def streams_found(jet, truth):
    """Which streams have a component of their own: one between two is of the nearer."""
    best = [nearest(jet, speed) for speed in truth]
    if best[0] is not None and best[0] is best[1]:
        nearer = int(np.argmin([abs(best[0]["v1"] - speed) for speed in truth]))
        best[1 - nearer] = None
    return [row is not None for row in best]


def power():
    """Shares of streams found and of jets with a third component."""
    rows = []
    for kind in KINDS:
        if kind in NULLS or not (RESULTS / f"{kind}.csv").exists():
            continue
        jets = list(read(kind).values())
        truth = speeds(kind)
        streams = np.array([streams_found(jet, list(truth.values())) for jet in jets])
        counts = streams.sum(axis=0).tolist()
        third = sum(
            any(
                r["kind"] == "moving"
                and all(np.hypot(r["v1"] - v, r["v2"]) > CLOSE for v in truth.values())
                for r in jet
            )
            for jet in jets
        )
        shares = [x for number in (*counts, third) for x in share(number, len(jets))]
        rows.append((kind, len(jets), *shares))
    names = ["jets", "n"]
    for name in ("slow", "fast", "third"):
        names += [name, f"{name}_low", f"{name}_high"]
    return Table(rows=rows, names=names)


def errors():
    """Bias and coverage of the speeds of the two-fluid jets."""
    rows = []
    for kind in ("two-fluid", "two-fluid-dense"):
        if not (RESULTS / f"{kind}.csv").exists():
            continue
        for stream, speed in speeds(kind).items():
            found = [nearest(jet, speed) for jet in read(kind).values()]
            found = [r for r in found if r is not None]
            for axis, truth in (("v1", speed), ("v2", 0.0)):
                off = np.array([r[axis] - truth for r in found])
                err = np.array([r[f"{axis}_err"] for r in found])
                covered = share(int((np.abs(off) <= err).sum()), len(off))
                name = "along" if axis == "v1" else "across"
                bias = (off.mean(), off.std(ddof=1) / len(off) ** 0.5, off.std(ddof=1))
                rows.append(
                    (kind, stream, name, len(off), *np.round(bias, 3), *covered)
                )
    names = (
        "jets",
        "stream",
        "axis",
        "n",
        "bias",
        "bias_err",
        "rms",
        "coverage",
        "low",
        "high",
    )
    return Table(rows=rows, names=names)


def to_read(table):
    """The same with each interval beside its share, for a page."""
    table = table.copy()
    shares = {"low": "share" if "share" in table.colnames else "coverage"}
    shares |= {f"{name}_low": name for name in ("slow", "fast", "third")}
    for low in shares.keys() & set(table.colnames):
        share, high = shares[low], low.removesuffix("low") + "high"
        table[share] = [
            f"{row[share]:.3f} [{row[low]:.3f}, {row[high]:.3f}]" for row in table
        ]
        table.remove_columns([low, high])
    return table


def draw():
    """Share of null jets below a probability, against the probability."""
    figure = Figure(figsize=(6, 4.5), layout="constrained")
    ax = figure.add_subplot()
    ax.plot([1e-3, 1], [1e-3, 1], color="0.5", lw=1, label="exact")
    for kind in NULLS:
        if not (RESULTS / f"{kind}.csv").exists():
            continue
        p = np.sort(false_p(kind))
        ax.step(
            np.concatenate([[1e-3], p, [1.0]]),
            np.concatenate([[0], np.arange(1, len(p) + 1), [len(p)]]) / len(p),
            where="post", color=COLORS[kind], label=f"{kind} ({len(p)} jets)",
        )  # fmt: skip
    ax.set(
        xscale="log", yscale="log", xlim=(2e-3, 0.06), ylim=(2e-3, 0.06),
        xlabel="p_global of a moving component",
        ylabel="Share of jets with one at most this",
    )  # fmt: skip
    ticks = [0.002, 0.005, 0.01, 0.02, 0.05]
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.set_minor_formatter(NullFormatter())
    ax.legend(loc="upper left", fontsize=8)
    return figure


def main():
    """Write and print the tables, and draw the figure."""
    for name, table in (
        ("false_alarms", false_alarms()),
        ("power", power()),
        ("errors", errors()),
    ):
        table.write(RESULTS / f"{name}.ecsv", overwrite=True)
        to_read(table).write(RESULTS / f"{name}_table.csv", overwrite=True)
        print(name)
        table.pprint(max_lines=-1, max_width=-1)
    draw().savefig(RESULTS / "calibration.png", dpi=150)


if __name__ == "__main__":
    main()
