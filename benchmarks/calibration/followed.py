# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""
Show which features of simulated jets are followed, and how right their speeds are.

    python benchmarks/calibration/followed.py [--jets 10]

Writes ``results/followed_table.csv``, the share of the features that are followed, and
``results/feature_speeds_table.csv``, the errors of their speeds against their distance
from the core.  No constant was chosen on these jets.
"""

import argparse
import os
from itertools import pairwise

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import astropy.units as u
import numpy as np
from design import matched_jet
from run import SEEN
from summary import write

from astro_scc.streams import SearchSettings, find_streams

FIRST_SEED = 10_000
JETS = ("single-20", "epochs8-20", "features4-20", "features16-20", "two-streams")
#: A feature that is followed lies so close to a true one, in beams.
NEAR = 0.35
DISTANCES = (0, 2, 3, 5, 10, 30)


def truth(jet):
    """Return each feature's epochs, positions along the jet and speed, in beams."""
    table, beam = jet.truth, np.sqrt(jet.cube.beams[0].major * jet.cube.beams[0].minor)
    group = np.asarray(table["group"])
    table = table[(group != "core") & (group != "standing") & table["visible"]]
    found = []
    for number in np.unique(table["feature"]):
        own = table[table["feature"] == number]
        speed = -np.mean(own["pm_east"] / beam).to_value(1 / u.yr)
        place = -(own["east"] / beam).to_value(u.one)
        found.append((np.asarray(own["epoch"]), place, speed))
    return found


def nearest(feature, d, true):
    """Return the number of the true feature that was followed, or None."""
    epoch, place = d.epoch[feature.ssp], d.position[feature.ssp, 0]
    best, least = None, NEAR
    for number, (own, along, _) in enumerate(true):
        _, first, second = np.intersect1d(epoch, own, return_indices=True)
        if 2 * len(first) >= len(epoch):
            apart = np.median(np.abs(place[first] - along[second]))
            if apart < least:
                best, least = number, apart
    return best


def followed(kind, seed):
    """Return which true features are followed, errors of speeds, and the wrong ones."""
    d, jet = matched_jet(kind, seed)
    found = find_streams(
        lambda angle: d, [0.0], SearchSettings().radius, n_trials=199,
        rng=np.random.default_rng(seed),
    )  # fmt: skip
    true = truth(jet)
    features = [f for s in found.streams if s.kind == "moving" for f in s.features]
    numbers = [nearest(f, d, true) for f in features]
    seen = [number in numbers for number, k in enumerate(true) if len(k[0]) >= SEEN]
    errors = [
        (f.place, f.speed / true[k][2] - 1, f.pulled)
        for f, k in zip(features, numbers, strict=True)
        if k is not None
    ]
    return seen, errors, numbers.count(None)


def main():
    """Follow the features of all jets."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("--jets", type=int, default=10)
    args = parser.parse_args()
    rows, errors = [], []
    for kind in JETS:
        jets = [followed(kind, FIRST_SEED + k) for k in range(args.jets)]
        seen = np.concatenate([jet[0] for jet in jets])
        own, wrong = sum((jet[1] for jet in jets), []), sum(jet[2] for jet in jets)
        errors += own
        share = wrong / max(len(own) + wrong, 1)
        rows.append([kind, len(seen), f"{seen.mean():.2f}", f"{share:.2f}"])
    write("followed_table", ["jets", "features", "followed", "wrong"], rows)
    place, error, pulled = np.transpose(errors)
    use = [
        (f"{low} to {high}", (place >= low) & (place < high) & (pulled == 0))
        for low, high in pairwise(DISTANCES)
    ]
    use.append(("only near a standing one", pulled == 1))
    rows = [
        [name, k.sum(), f"{error[k].mean():+.3f}", f"{np.median(error[k]):+.3f}",
         f"{error[k].std():.3f}"]
        for name, k in use if k.any()
    ]  # fmt: skip
    header = ["distance (beams)", "features", "mean error", "median", "scatter"]
    write("feature_speeds_table", header, rows)


if __name__ == "__main__":
    main()
