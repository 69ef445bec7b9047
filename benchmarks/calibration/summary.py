# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Summarise the calibration in the tables and figures of the documentation.

    python benchmarks/calibration/summary.py

Reads ``results/*.csv``, which ``run.py`` writes, and writes in the same folder the
tables ``speeds_table.csv``, ``streams_table.csv``, ``static_table.csv``,
``flow_table.csv`` and ``sensitivity_table.csv``, and the figure ``calibration.png``.
"""

import csv
from pathlib import Path

import numpy as np
from astropy.stats import binom_conf_interval
from matplotlib.figure import Figure
from run import FLOW, KINDS, OTHER, PAPER, SENSITIVITY

RESULTS = Path(__file__).parent / "results"
ALPHA = 0.01
#: A speed is right within this fraction of the features' mean.
RIGHT = 0.2
TWO = {"two-streams": (0.3, 0.9), **dict.fromkeys(PAPER, (0.5, 2.0))}
TWO |= {
    kind: (how.get("slow", 5.0) / 10, how.get("fast", 20.0) / 10)
    for kind, how in OTHER.items()
}
SINGLE = ("single", "epochs8", "features4", "features16", "faint", "vlba")
#: Dispersion of a flow, relative to its speed, below which it is none.
NONE = 0.01
STILL = ("static", "unrelated", "random")
BROAD = ("lognormal", "uniform", "drift")


def read(kind):
    """Return the rows of each jet of a kind."""
    jets = {}
    path = RESULTS / f"{kind}.csv"
    if not path.exists():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            numbers = {k: v if k == "kind" else float(v) for k, v in row.items()}
            jets.setdefault(row["seed"], []).append(numbers)
    return list(jets.values())


def moving(jet):
    """Return the rows of a jet that move."""
    return [r for r in jet if r["kind"] == "moving"]


def share(number, of):
    """Return a share with the limits of its 95% interval as text."""
    low, high = binom_conf_interval(number, of, 0.95, interval="jeffreys")
    return f"{number / of:.2f} [{low:.2f}, {high:.2f}]"


def distinct(jet):
    """Return whether a second moving row is distinct from the first."""
    return any(r["p_distinct"] <= ALPHA for r in moving(jet)[1:])


def speeds_row(kind, jets):
    """Return how well one stream is measured."""
    first = [(moving(jet) or [None])[0] for jet in jets]
    found = [r for r in first if r is not None]
    right = sum(abs(r["speed"] / r["true_mean"] - 1) <= RIGHT for r in found)
    error = np.array([r["speed"] - r["true_mean"] for r in found])
    pull = error / [r["error"] for r in found]
    # The mean of what is seen of the flow, of which each jet's features are a sample.
    flow = np.mean([jet[0]["true_mean"] for jet in jets])
    own = sum(abs(r["speed"] - flow) <= r["error"] for r in found)
    dispersion = [r["dispersion"] for r in found if np.isfinite(r["dispersion"])]
    return [
        kind,
        len(jets),
        share(len(found), len(jets)),
        share(right, len(jets)),
        f"{np.mean(error / [r['true_mean'] for r in found]):+.3f}",
        f"{pull.mean():+.2f}",
        *(share(int((np.abs(pull) <= k).sum()), len(found)) for k in (1, 2)),
        share(own, len(found)),
        over_bound(found, flow),
        f"{np.median(dispersion):.3f}",
        f"{np.median([jet[0]['true_dispersion'] for jet in jets]):.3f}",
        share(sum(map(distinct, jets)), len(jets)),
    ]


def over_bound(rows, flow):
    """
    Return the rms error of the flow's mean, over that if all features were known.

    The means of the true speeds of the visible features are as good as possible.
    """
    speed, known = (np.array([r[k] for r in rows]) for k in ("speed", "true_mean"))
    bound = np.sqrt(np.mean((known - flow) ** 2))
    if bound < NONE * flow:
        return ""
    return f"{np.sqrt(np.mean((speed - flow) ** 2)) / bound:.2f}"


def streams_row(kind, jets):
    """Return how often each of two streams, both, and other speeds are found."""
    speeds = TWO[kind]
    near = [
        [any(abs(r["speed"] / v - 1) <= RIGHT for r in moving(jet)) for v in speeds]
        for jet in jets
    ]
    other = [
        any(all(abs(r["speed"] / v - 1) > RIGHT for v in speeds) for r in moving(jet))
        for jet in jets
    ]
    slow, fast = np.array(near).sum(axis=0)
    accuracy = []
    for v in speeds:
        own = [min((r for r in moving(jet) if abs(r["speed"] / v - 1) <= RIGHT),
                   key=lambda r: abs(r["speed"] / v - 1), default=None)
               for jet in jets]  # fmt: skip
        error = np.array([(r["speed"] - v, r["error"]) for r in own if r]).T
        if len(error) == 0:
            accuracy += ["", ""]
            continue
        inside = int((np.abs(error[0]) <= error[1]).sum())
        accuracy += [f"{error[0].mean() / v:+.3f}", share(inside, len(error[0]))]
    third = sum(len(moving(jet)) > 2 for jet in jets)
    both = sum(map(all, near))
    n = len(jets)
    numbers = slow, fast, both, sum(other), third
    return [kind, n, *(share(int(number), n) for number in numbers), *accuracy]


def static_row(kind, jets):
    """Return how often something seems to move in static jets."""
    n = len(jets)
    below = sum(
        any(r["kind"] != "stationary" and r["p_global"] <= ALPHA for r in jet)
        for jet in jets
    )
    return [kind, n, share(sum(bool(moving(j)) for j in jets), n), share(below, n)]


def flow_row(kind, jets):
    """Return how often an acceleration, and a difference between scales, is found."""
    n = len(jets)
    found = [
        sum(jet[0][p] <= ALPHA for jet in jets) for p in ("p_acceleration", "p_scales")
    ]
    two = sum(jet[0]["rows"] > 1 for jet in jets)
    finer = [jet[0]["finer"] > 0 for jet in jets if np.isfinite(jet[0]["finer"])]
    right = share(sum(finer), len(finer)) if finer else "-"
    return [kind, n, *(share(number, n) for number in (*found, two)), right]


def sensitivity_row(kind, jets):
    """Return how often, and by how much, the main speed changes with the data."""
    jets = [jet[1:] for jet in jets if len(jet) > 1]
    n = len(jets)
    large = [sum(any(row[k] for row in jet) for jet in jets)
             for k in ("significant", "large")]  # fmt: skip
    change = np.concatenate([[row["change_sigma"] for row in jet] for jet in jets])
    return [kind.removeprefix("sensitivity-"), n, *(share(k, n) for k in large),
            f"{np.sqrt(np.mean(change**2)):.2f}"]  # fmt: skip


def write(name, header, rows):
    """Write a table for the documentation, and print it, if its jets are measured."""
    if not rows:
        return
    with open(RESULTS / f"{name}.csv", "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([header, *rows])
    for row in [header, *rows]:
        print("  ".join(map(str, row)))


def draw(kinds):
    """Draw the distribution of the pulls, and measured against true dispersions."""
    figure = Figure(figsize=(7, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    pulls, true, measured = [], [], []
    for kind in kinds:
        jets = read(kind)
        flow = np.mean([jet[0]["true_mean"] for jet in jets])
        for jet in jets:
            for r in moving(jet)[:1]:
                pulls.append((r["speed"] - flow) / r["error"])
                true.append(r["true_dispersion"] / r["true_mean"])
                measured.append(r["dispersion"] / r["speed"])
    x = np.linspace(-4, 4, 161)
    left.hist(np.clip(pulls, -4, 4), np.linspace(-4, 4, 33), density=True, color="0.7")
    left.plot(x, np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi), color="#0072B2")
    left.set(xlabel="(speed - flow's mean) / error", ylabel="density")
    right.plot(true, measured, ".", ms=3, color="#D55E00")
    right.plot([0, 0.5], [0, 0.5], color="0.5", lw=0.8)
    right.set(xlabel="true dispersion / speed", ylabel="measured dispersion / speed",
              xlim=(0, 0.5), ylim=(0, 0.7))  # fmt: skip
    figure.savefig(RESULTS / "calibration.png", dpi=150)


def main():
    """Write the tables and the figures."""
    have = {kind: jets for kind in KINDS if (jets := read(kind))}
    single = [k for k in have if k.startswith(SINGLE)]
    write(
        "speeds_table",
        ["jets", "n", "moving", "within 20%", "bias", "mean pull", "68% interval",
         "two errors", "68% of the flow", "rms over bound", "dispersion", "true",
         "second distinct"],
        [speeds_row(k, have[k]) for k in have if k.startswith((*SINGLE, *BROAD))],
    )  # fmt: skip
    write(
        "streams_table",
        [
            "jets",
            "n",
            "slow",
            "fast",
            "both",
            "another",
            "third",
            "bias slow",
            "68% slow",
            "bias fast",
            "68% fast",
        ],
        [streams_row(k, have[k]) for k in have if k in TWO],
    )
    write(
        "static_table",
        ["jets", "n", "moving row", f"p_global at most {ALPHA}"],
        [static_row(k, have[k]) for k in have if k.startswith(STILL)],
    )
    write(
        "flow_table",
        ["jets", "n", "acceleration", "scales differ", "two streams", "faster finer"],
        [flow_row(k, have[k]) for k in have if k in FLOW],
    )
    write(
        "sensitivity_table",
        ["jets", "n", "depends", "by more than its error", "change / error"],
        [sensitivity_row(k, have[k]) for k in have if k in SENSITIVITY],
    )
    draw(single)


if __name__ == "__main__":
    main()
