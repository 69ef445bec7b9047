# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure the share of right links in the paper's dense jet of two streams.

Links of SSPs, and the features that they make, are compared with the truth::

    python benchmarks/tracking.py ../shared/data
"""

import argparse
import json
from pathlib import Path

import astropy.units as u
import numpy as np
from common import PM_UNIT, write_table

from astro_scc import EpochCube
from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.features.tracks import chains
from astro_scc.simulation import simulate_two_fluid
from astro_scc.tracking import FeatureTracker

#: Limits for the paper's jet, where 1 pixel per epoch is 1.2175 mas/yr.
WINDOW = {
    "position_angle": -90 * u.deg,
    "along": [-6, 36] * PM_UNIT,
    "across": [-12, 12] * PM_UNIT,
}
#: Seeds of our own dense jets; the defaults were chosen on seeds 101 to 112.
SEEDS = range(201, 209)
#: Largest distance of a detection from the true place of its feature, in pixels: half
#: a beam.
NEAR = 5.0


def main():
    """Print the tables and write them to ``results``."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("folder", type=Path, help="of the data")
    args = parser.parse_args()
    links(args.folder / "paper_test" / "two_fluid_dense")


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
    for (name, cases), what, settings in (
        (jets[0], "along and across", WINDOW),
        (jets[0], "largest speed", {"max_speed": 36 * PM_UNIT}),
        (jets[1], "along and across", WINDOW),
    ):
        tracker = FeatureTracker(**settings)
        found = [compare(*case, tracker) for case in cases]
        rows.append([name, what, *shares(found)])
    header = [
        "images", "window", "slow", "fast", "wrong", "slow, a beam apart",
        "fast, a beam apart", "wrong, a beam apart", "links", "SSPs",
        "in tracks", "right features",
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


def compare(cube, x, y, seen, group, tracker):
    """Return the counts of right and wrong links in one jet."""
    decompositions = decomposed(cube)
    ssps, links = SSPs.of_epochs(decompositions), tracker.link(cube, decompositions)
    next_of = np.full(len(ssps), -1)
    direct = links.gap == 0
    next_of[links.source[direct]] = links.target[direct]
    tracks = [t for t in chains(links.source, links.target, len(ssps)) if len(t) > 2]
    counts = {"links": len(links), "ssps": len(ssps)}
    counts["share"] = sum(map(len, tracks)) / len(ssps)
    features = tracker(cube, decompositions)
    counts["features"] = right_features(features, x, y, seen)
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
        i, k = links.source, links.target
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


def right_features(features, x, y, seen):
    """Return which features are one true feature at three quarters of their epochs."""
    d, right = features.detections, []
    at = np.stack(features.cube.offset_to_pixel(*d.place.T * u.mas), axis=1)
    for track in features.tracks:
        names = []
        for k in track.detection:
            own = np.flatnonzero(seen[:, d.epoch[k]])
            place = np.stack([x[own, d.epoch[k]], y[own, d.epoch[k]]], axis=1)
            away = np.hypot(*(place - at[k]).T)
            names.append(own[away.argmin()] if away.min() <= NEAR else -1)
        feature, count = np.unique(names, return_counts=True)
        most = count.argmax()
        right.append(feature[most] >= 0 and count[most] >= 0.75 * len(names))
    return np.array(right)


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
    right = np.concatenate([f["features"] for f in found])
    cells.append(f"{right.mean():.2f} of {len(right)}")
    return cells


if __name__ == "__main__":
    main()
