# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure the share of right links, compare speeds with MOJAVE's, and time the tracking.

The links in the paper's dense jet of two streams are compared with the truth; tracks in
3C 273 and 3C 120, restored from the features of MOJAVE, with the straight lines that
were fitted to these features; and time is measured against the number of features::

    python benchmarks/tracking.py ../shared/data
"""

import argparse
import json
import time
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import Table
from common import PM_UNIT, RESULTS, measured, mojave_images, write_table

from astro_scc import Beam, EpochCube, StackedCrossCorrelation
from astro_scc.decomposition import Decomposer
from astro_scc.epochs import read_components
from astro_scc.flow import measure_profile
from astro_scc.simulation import simulate_two_fluid
from astro_scc.tracking import FeatureTracker, assign

#: Limits for the paper's jet, where 1 pixel per epoch is 1.2175 mas/yr.
WINDOW = {
    "position_angle": -90 * u.deg,
    "along": [-6, 36] * PM_UNIT,
    "across": [-12, 12] * PM_UNIT,
}
#: Seeds of our own dense jets; the defaults were chosen on seeds 101 to 112.
SEEDS = range(201, 209)
SOURCES = {
    "3C 273": ("1226+023", Beam(1.0 * u.mas, 0.5 * u.mas, -7 * u.deg), 2.0),
    "3C 120": ("0430+052", Beam(1.2 * u.mas, 0.5 * u.mas, -5 * u.deg), 4.0),
}
#: Largest distance of a position of MOJAVE's feature from its track, in mas.
NEAR = 0.3


def main():
    """Print the tables and write them to ``results``."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("folder", type=Path, help="of the data")
    parser.add_argument("--only", choices=("links", "mojave", "profile", "cost"))
    args = parser.parse_args()
    parts = {
        "links": lambda: links(args.folder / "paper_test" / "two_fluid_dense"),
        "mojave": lambda: mojave(args.folder / "mojave_xviii"),
        "profile": lambda: profile(args.folder / "mojave_xviii"),
        "cost": cost,
    }
    for name in [args.only] if args.only else parts:
        parts[name]()


# -- links -------------------------------------------------------------------------


def decomposed(cube, scales=(1, 2, 3)):
    """Return the decompositions of all epochs."""
    decompose = Decomposer(scales=scales)
    return [decompose(d, mask=m) for d, m in zip(cube.data, cube.mask, strict=True)]


def links(folder):
    """Compare the links in dense jets with the truth."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    cube = EpochCube.read(str(folder / "*.fits"))
    params, features = truth["params"], truth["features"]
    x, y = (np.array([f[k] for f in features]) for k in "xy")
    group = np.array([f["group"] for f in features])
    seen = (x > params["x0"]) & (x < params["x1"])
    jets = [("two_fluid_dense", [(cube, x, y, seen, group)])]
    own = []
    for seed in SEEDS:
        jet = simulate_two_fluid(dense=True, rng=seed)
        own.append((jet.cube, *true_positions(jet.truth, len(jet.cube))))
    jets.append((f"{len(own)} simulated jets", own))
    rows = []
    for (name, cases), what, settings, n_trials in (
        (jets[0], "along and across", WINDOW, 10),
        (jets[0], "largest speed", {"max_speed": 36 * PM_UNIT}, 0),
        (jets[1], "along and across", WINDOW, 0),
    ):
        tracker = FeatureTracker(**settings)
        found = [compare(*case, tracker, n_trials) for case in cases]
        rows.append([name, what, *shares(found)])
    header = [
        "images", "window", "slow", "fast", "wrong", "slow, a beam apart",
        "fast, a beam apart", "wrong, a beam apart", "links", "SSPs",
        "in tracks", "if permuted",
    ]  # fmt: skip
    write_table("tracking_links", header, rows)


def true_positions(truth, n_epochs):
    """Return the positions and visibility of simulated features, (n, n_epochs)."""
    feature = np.asarray(truth["feature"])
    names, row = np.unique(feature, return_inverse=True)
    x, y = np.full((2, len(names), n_epochs), np.nan)
    seen = np.zeros(x.shape, bool)
    group = np.empty(len(names), dtype="U10")
    epoch = np.asarray(truth["epoch"])
    x[row, epoch], y[row, epoch] = truth["x"].value, truth["y"].value
    seen[row, epoch] = np.asarray(truth["visible"])
    group[row] = np.asarray(truth["group"])
    return x, y, seen, group


def compare(cube, x, y, seen, group, tracker, n_trials):
    """Return the counts of right and wrong links in one jet."""
    tracking = tracker(cube, decomposed(cube), n_trials=n_trials, rng=1)
    ssps, links = tracking.ssps, tracking.links
    one = links.kind == "link"
    next_of = np.full(len(ssps), -1)
    direct = one & (links.gap == 0)
    next_of[links.source[direct]] = links.target[direct]
    counts = {"links": one.sum(), "ssps": len(ssps)}
    all_scales = tracking.shares[0]
    counts["share"], counts["permuted"] = all_scales.share, all_scales.permuted
    for key, owner in (
        ("segment", alone_in_segment(ssps, x, y, seen, cube.shape[2])),
        ("beam", alone_in_beam(ssps, x, y, seen, 10.0)),
    ):
        at = {
            (owner[i], ssps.epoch[i], ssps.scale[i]): i
            for i in np.flatnonzero(owner >= 0)
        }
        for name in ("slow", "fast"):
            pairs = [
                (i, at[f, e + 1, s])
                for (f, e, s), i in at.items()
                if group[f] == name and (f, e + 1, s) in at
            ]
            right = sum(next_of[i] == k for i, k in pairs)
            counts[f"{key} {name}"] = right, len(pairs)
        i, k = links.source[one], links.target[one]
        known = (owner[i] >= 0) & (owner[k] >= 0)
        counts[f"{key} wrong"] = np.sum(owner[i] != owner[k], where=known), known.sum()
    return counts


def alone_in_segment(ssps, x, y, seen, width):
    """Return the feature of each SSP that holds exactly one, or -1."""
    owner = np.full(len(ssps), -1)
    for epoch in range(seen.shape[1]):
        own = np.flatnonzero(seen[:, epoch])
        pixel = np.rint(y[own, epoch]) * width + np.rint(x[own, epoch])
        for i in np.flatnonzero(ssps.epoch == epoch):
            inside = own[np.isin(pixel, ssps.pixels_of(i))]
            if len(inside) == 1:
                owner[i] = inside[0]
    return owner


def alone_in_beam(ssps, x, y, seen, beam):
    """Return the feature at each SSP, if no other is within a beam of it, or -1."""
    owner = np.full(len(ssps), -1)
    for epoch in range(seen.shape[1]):
        own = np.flatnonzero(seen[:, epoch])
        at = np.stack([x[own, epoch], y[own, epoch]], axis=1)
        apart = np.hypot(*(at[:, None] - at[None]).T) + 1e9 * np.eye(len(own))
        for scale in np.unique(ssps.scale):
            here = np.flatnonzero((ssps.epoch == epoch) & (ssps.scale == scale))
            if len(here) == 0:
                continue
            for k in np.flatnonzero(apart.min(axis=0) > beam):
                away = np.hypot(ssps.x[here] - at[k, 0], ssps.y[here] - at[k, 1])
                if away.min() <= beam / 2:
                    owner[here[away.argmin()]] = own[k]
    return owner


def shares(found):
    """Return the cells of the table of links."""
    cells = []
    for key in ("segment", "beam"):
        for name in ("slow", "fast", "wrong"):
            part, whole = np.sum([f[f"{key} {name}"] for f in found], axis=0)
            cells.append(f"{part / max(whole, 1):.2f} of {whole}")
    cells.append(sum(int(f["links"]) for f in found))
    cells.append(sum(f["ssps"] for f in found))
    cells.append(f"{np.mean([f['share'] for f in found]):.2f}")
    permuted = np.mean([f["permuted"] for f in found])
    cells.append("" if np.isnan(permuted) else f"{permuted:.2f}")
    return cells


# -- features of MOJAVE ------------------------------------------------------------


def mojave(folder):
    """Compare tracks with the straight lines of MOJAVE's features."""
    rows, differences = [], []
    for name, (table, beam, speed) in SOURCES.items():
        components = read_components(folder / f"{table}.ecsv")
        cube = mojave_images(folder, table, beam)
        start = time.process_time()
        decompositions = decomposed(cube, (1, 2, 3, 4))
        tracker = FeatureTracker(max_speed=speed * PM_UNIT)
        tracking = tracker(cube, decompositions)
        spent = time.process_time() - start
        fits = Table.read(folder / f"{table}.linear-fits.csv", format="ascii.csv")
        fits = fits[fits["robust"] == "True"]
        cells = [beside(tracking, components, fit) for fit in fits]
        half = [c for c in cells if c["share"] >= 0.5]
        z = np.array([c["z"] for c in half])
        vector = np.array([c["vector"] for c in half])
        relative = np.array([c["relative"] for c in half])
        moving = np.array([c["mu"] > 3 * c["mu_err"] for c in half])
        rows.append(
            [
                name, len(cube), tracking.n_tracks, len(fits),
                f"{len(half) / len(fits):.2f}",
                f"{np.median(z):.2f}", f"{np.percentile(z, 90):.1f}",
                f"{np.median(vector):.2f}", f"{np.percentile(vector, 90):.1f}",
                f"{100 * np.median(relative[moving]):.0f}%",
                f"{spent:.0f}",
            ]
        )  # fmt: skip
        differences += [
            [name, c["feature"], c["n"], c["near"], c["length"],
             measured(c["mu"], c["mu_err"]),
             measured(c["speed"], c["speed_err"]) if c["near"] else "",
             f"{c['z']:.1f}" if c["near"] else ""]
            for c in cells
        ]  # fmt: skip
    header = [
        "jet", "epochs", "tracks", "robust features", "with a track", "median z",
        "90% z", "median, vectors", "90%, vectors", "median difference", "CPU (s)",
    ]  # fmt: skip
    write_table("tracking_mojave", header, rows)
    header = ["jet", "feature", "epochs", "near the track", "epochs of the track",
              "MOJAVE (mas/yr)", "track (mas/yr)", "z"]  # fmt: skip
    write_table("tracking_mojave_features", header, differences)


def beside(tracking, components, fit):
    """Return the track near most positions of a feature, and how it differs."""
    own = np.flatnonzero(components.feature == fit["feature"])
    at = np.stack([components.east[own].value, components.north[own].value])
    near = {}
    for epoch, place in zip(components.epoch[own], at.T, strict=True):
        away = np.hypot(*(tracking.offsets - place[:, None]))
        here = (tracking.ssps.epoch == epoch) & (tracking.track >= 0) & (away <= NEAR)
        for number in set(tracking.track[here].tolist()):
            near[number] = near.get(number, 0) + 1
    mu, mu_err = float(fit["mu_mas_yr"]), float(fit["mu_err"])
    cells = {"feature": int(fit["feature"]), "n": len(own), "near": 0, "share": 0.0,
             "mu": mu, "mu_err": mu_err, "length": 0}  # fmt: skip
    if not near:
        return cells
    best = max(near, key=lambda k: (near[k], -k))
    row = tracking.tracks[best]
    speed, error = row["pm"].value, row["pm_err"].value
    angle = np.radians(fit["pa_motion_deg"])
    apart = np.array(
        [
            row["pm_ra_cosdec"].value - mu * np.sin(angle),
            row["pm_dec"].value - mu * np.cos(angle),
        ]
    )
    errors = np.array([row["pm_ra_cosdec_err"].value, row["pm_dec_err"].value])
    total = np.hypot(errors, mu_err)
    return cells | {
        "near": near[best],
        "share": near[best] / len(own),
        "length": int(row["n_epochs"]),
        "speed": speed,
        "speed_err": error,
        "z": abs(speed - mu) / np.hypot(error, mu_err),
        # The mean over two axes, so that errors alone give 1 on average.
        "vector": np.sqrt(np.mean((apart / total) ** 2)),
        "relative": abs(speed / mu - 1) if mu else 0.0,
    }


def profile(folder):
    """Measure the speed of tracks, and of the stack, against distance in 3C 120."""
    from astro_scc.kinematics import apparent_speed, paper_cosmology
    from astro_scc.visualization import plot_track_profile

    table, beam, speed = SOURCES["3C 120"]
    cube = mojave_images(folder, table, beam, before="2011-01-01")
    tracker = FeatureTracker(max_speed=speed * PM_UNIT)
    tracking = tracker(cube, decomposed(cube, (1, 2, 3, 4)))
    found = tracking.profile(np.arange(1.0, 11.0) * u.mas)
    per_pm = float(
        apparent_speed(1 * PM_UNIT, redshift=0.033, cosmology=paper_cosmology())
    )
    rows = [
        [f"{row['r'].value:g}", int(row["n_tracks"]),
         measured(row["speed"].value, row["speed_err"].value),
         measured(per_pm * row["speed"].value, per_pm * row["speed_err"].value, 1)]
        for row in found
    ]  # fmt: skip
    write_table(
        "tracking_profile", ["distance (mas)", "tracks", "mas/yr", "in c"], rows
    )
    scc = StackedCrossCorrelation(
        max_speed=speed * PM_UNIT, position_angle=-112 * u.deg
    )
    bins = [0.5, 1.5, 2.5, 3.5, 5.5, 7.5, 10.5] * u.mas
    stack = measure_profile(scc, scc.match(cube), bins, n_trials=200, rng=1).main
    figure = plot_track_profile(found, stack=stack, beta_per_pm=per_pm)
    figure.savefig(RESULTS / "tracking_profile.png", dpi=110)


# -- cost --------------------------------------------------------------------------


def long_jet(length, n_epochs=10):
    """Simulate a dense jet with a length in units of the paper's jet."""
    return simulate_two_fluid(
        dense=True, n_epochs=n_epochs, rng=1, shape=(128, 56 + 200 * length),
        extent=(20.0, 20.0 + 200 * length),
    ).cube  # fmt: skip


def seconds(function, *args, **options):
    """Return the result and the processor time of a call."""
    start = time.process_time()
    result = function(*args, **options)
    return result, time.process_time() - start


def cost():
    """Time the tracking for several numbers of features, and for large cases."""
    rows, sizes, times = [], [], []
    tracker = FeatureTracker(**WINDOW)
    for length in (1, 2, 4, 8, 16):
        cube = long_jet(length)
        decompositions, decompose = seconds(decomposed, cube)
        matches, match = seconds(tracker.match, cube, decompositions)
        runs = [seconds(tracker, cube, decompositions, matches) for _ in range(3)]
        tracking, spent = min(runs, key=lambda run: run[1])
        sizes.append(len(tracking.ssps))
        times.append((decompose, match, spent))
        rows.append([f"{length} jets long, 10 epochs", len(tracking.ssps),
                     *(f"{t:.2f}" for t in times[-1])])  # fmt: skip
    n, spent = np.array(sizes, dtype=float), np.array(times)
    growth = [np.polyfit(np.log(n), np.log(t), 1)[0] for t in spent.T]
    like = np.polyfit(np.log(n), np.log(n * np.log(n)), 1)[0]
    rows.append([f"power of n (n log n: {like:.2f})", "",
                 *(f"{g:.2f}" for g in growth)])  # fmt: skip

    cube = long_jet(3, n_epochs=100)
    decompositions, decompose = seconds(decomposed, cube)
    matches, match = seconds(tracker.match, cube, decompositions)
    tracking, spent = seconds(tracker, cube, decompositions, matches)
    rows.append([f"100 epochs of {len(tracking.ssps) / 100:.0f} SSPs",
                 len(tracking.ssps),
                 f"{decompose:.2f}", f"{match:.2f}", f"{spent:.2f}"])  # fmt: skip

    row, column = (a.ravel() for a in np.mgrid[:50, :50])
    weight = np.random.default_rng(1).uniform(5, 6, row.size)
    chosen, spent = seconds(assign, row, column, weight)
    rows.append(["50 features in 1 group, all pairs", int(chosen.sum()),
                 "", "", f"{spent:.4f}"])  # fmt: skip
    header = ["what", "SSPs", "decompose (s)", "correlate (s)", "track (s)"]
    write_table("tracking_cost", header, rows)


if __name__ == "__main__":
    main()
