# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""
Count how many features of a survey are found, and how many of ours are right.

    python benchmarks/features.py survey ../shared FOLDER [--jobs 2] [--seeds 3]
    python benchmarks/features.py trust ../shared FOLDER [--jobs 2] [--seeds 3]
    python benchmarks/features.py simulated [--jets 100]

``survey`` makes images of the sources of a table of fitted features, restored with one
beam, and observed and CLEANed, in FOLDER, finds their features as ``astro-scc track``
does without options, and compares them with the survey's.  The constants were chosen
on the development sources and the twelve well-known ones; the others were not looked
at.
``trust`` fits the coefficients of `astro_scc.features.motion` to the development and
the well-known sources, and compares probabilities with shares: for these by
cross-validation, for the others by the fit to all of these.  Both take means of several
seeds of the disturbed assignments, which change a few features.  ``simulated`` counts
secure features of static jets, and compares those of moving ones with the truth.
"""

import argparse
import os
import sys
import time
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import astropy.units as u
import numpy as np
from astropy.table import QTable
from common import write_table
from scipy.optimize import minimize

from astro_scc import EpochCube
from astro_scc.cli import main as astro_scc
from astro_scc.features import find_features
from astro_scc.features.motion import are_secure, properties
from astro_scc.features.tracks import find_tracks

TABLE = "data/mojave_xviii/apjac230ft4_mrt.txt"
KNOWN = (
    "0430+052 1226+023 1228+126 0003+380 0415+379 1641+399 1308+326 0333+321 1510-089 "
    "1253-055 2200+420 0716+714"
).split()
KINDS = "restored", "cleaned"
STATIC = ("flux", "comb", "ripple", "align1", "align2", "red")
MOVING = ("single-20", "epochs8-20", "features4-20", "features16-20", "two-streams",
          "lognormal-8", "vlba", "two-fluid-dense-whole")  # fmt: skip
FIRST_SEED = 40_000
#: Folds of the cross-validation, and bins of probability.
FOLDS, BINS = 5, (0, 0.1, 0.2, 0.3, 0.5, 1)
#: Beams that a feature moves that blends of standing ones seldom seem to move.
FAR = 1.75
#: A feature is followed if its median distance from a true one is less, in beams.
NEAR = 0.35


def main():
    """Run one of the parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("part", choices=("survey", "trust", "simulated"))
    parser.add_argument("shared", type=Path, nargs="?", help="data and survey tools")
    parser.add_argument("folder", type=Path, nargs="?", help="of images and tables")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--jets", type=int, default=100)
    parser.add_argument("--seeds", type=int, default=3)
    args = parser.parse_args()
    if args.part == "simulated":
        simulated(args.jets, args.jobs)
        return
    sys.path.insert(0, str(args.shared / "survey"))
    {"survey": survey_table, "trust": trust}[args.part](args)


def source_sets(sources):
    """Return the names of the sources of each set."""
    others = [name for name in sources if name not in KNOWN]
    return {"development": others[::2], "report": others[1::2], "well-known": KNOWN}


def images_of(kind, name, shared, folder):
    """Return the files of a source, which are made unless they exist."""
    import observe
    import survey

    own = folder / kind / name
    if not (own / "images").exists():
        rows = survey.read(shared / TABLE)[name]
        own.mkdir(parents=True, exist_ok=True)
        if kind == "cleaned":
            observe.main(shared / TABLE, folder / kind, name)
        else:
            survey.ecsv(name, rows).write(own / "table.ecsv", overwrite=True)
            major, minor = survey.beam(name)
            astro_scc(
                ["restore", str(own / "table.ecsv"), "-o", str(own / "images"),
                 "--beam", f"{major} mas {minor} mas -5 deg", "--pixel", "0.1 mas",
                 "--noise", "0.3 mJy/beam", "--seed", str(int(name[:4]))]
            )  # fmt: skip
    return sorted(map(str, (own / "images").glob("*.fits")))


def features_of(kind, name, *, shared, folder, seeds):
    """Return the features of a source with each seed, and the seconds of the first."""
    files, start = images_of(kind, name, shared, folder), time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        first = find_features(EpochCube.read(files))
        seconds = time.process_time() - start
        found = (find_tracks(first.detections, seed=seed) for seed in range(1, seeds))
        names = "tracks", "same_speed", "proven"
        others = (dict(zip(names, one, strict=True)) for one in found)
        return [first, *(replace(first, **other) for other in others)], seconds


def measured(kind, name, **options):
    """Return the scores of a source, the errors and pulls of its speeds, seconds."""
    import score
    import survey

    rows, beam = survey.read(options["shared"] / TABLE)[name], survey.beam(name)[0]
    out, known = options["folder"] / kind / name / "out", survey.features(rows)
    out.mkdir(exist_ok=True)
    # The score of streams is not asked for.
    QTable({"kind": np.array([], str)}).write(out / "components.ecsv", overwrite=True)
    each, seconds = features_of(kind, name, **options)
    counts, relative, pulls = Counter(), [], []
    for features in each:
        features.table.write(out / "features.ecsv", overwrite=True)
        one, errors, _ = score.score(rows, out, beam)
        counts.update(one)
        relative += errors
        ours = [one for one in score.ours(out / "features.ecsv") if one["secure"]]
        pulls += [confirmed(one, known, beam)[1] for one in ours]
    return counts, relative, [pull for pull in pulls if np.isfinite(pull)], seconds


def confirmed(one, known, beam):
    """Return whether the survey's positions confirm a speed, and its pull."""
    import survey

    best = np.inf, np.nan
    for other in known:
        own = (other["t"] >= one["first"] - 0.01) & (other["t"] <= one["last"] + 0.01)
        if own.sum() >= 3:
            at = other["t"][own], other["east"][own], other["north"][own]
            date, place, velocity, speed, _ = survey.line(*at)
            off = place + velocity * (one["date"] - date) - one["place"]
            best = min(best, (np.hypot(*off), speed))
    if not best[0] < 0.6 * beam:
        return False, np.nan
    off = one["pm"] - best[1]
    return abs(off) <= max(0.2 * best[1], 2 * one["err"]), off / one["err"]


def survey_table(args):
    """Write the table of recall and precision."""
    import survey

    sets, rows = source_sets(survey.read(args.shared / TABLE)), []
    job = partial(measured, shared=args.shared, folder=args.folder, seeds=args.seeds)
    with ProcessPoolExecutor(args.jobs) as pool:
        for kind in KINDS:
            for which, names in sets.items():
                each = list(pool.map(partial(job, kind), names))
                total = {key: sum(one[0][key] for one in each) for key in each[0][0]}
                relative, pulls = (sum((one[k] for one in each), []) for k in (1, 2))
                seconds = [one[3] for one in each]
                rows.append(
                    [kind, which, len(names), total["survey"] // args.seeds,
                     f"{total['right'] / total['survey']:.2f}",
                     f"{total['found'] / total['survey']:.2f}",
                     f"{total['moving'] / args.seeds:.1f}",
                     f"{total['agree'] / max(total['moving'], 1):.2f}",
                     f"{np.median(relative):.2f}",
                     f"{np.mean(np.abs(pulls) <= 1):.2f}",
                     f"{np.median(seconds):.1f}", f"{max(seconds):.1f}"]
                )  # fmt: skip
    header = ["images", "sources", "number", "moving features", "recall", "followed",
              "secure", "precision", "error / speed", "cover", "median (s)",
              "largest (s)"]  # fmt: skip
    write_table("features", header, rows)


def trust(args):
    """Print the coefficients of the logistic regression, and write its calibration."""
    import survey

    sets = source_sets(survey.read(args.shared / TABLE))
    tasks = [(kind, which, name) for kind in KINDS for which in sets
             for name in sets[which]]  # fmt: skip
    job = partial(examples, shared=args.shared, folder=args.folder, seeds=args.seeds)
    with ProcessPoolExecutor(args.jobs) as pool:
        each = list(pool.map(job, tasks))
    number = [len(rows) for rows in each]
    kind, which, name = np.repeat(np.array(tasks), number, axis=0).T
    *x, can_be_secure, right = np.array(sum(each, [])).T
    x, right = np.stack([np.ones(len(right)), *x], axis=1), right > 0
    old = which != "report"
    found = regression(x[old], right[old], args.seeds)
    print(old.sum() // args.seeds, "moving features,", f"{right[old].mean():.2f} right")
    print("constant", found[0].round(2), "coefficients", found[1:].round(2).tolist())
    # All features of a source, on both images, are in the same fold.
    fold = np.unique(name, return_inverse=True)[1] % FOLDS
    p_false = 1 / (1 + np.exp(x @ found))
    for k in range(FOLDS):
        fit = regression(x[old & (fold != k)], right[old & (fold != k)], args.seeds)
        own = old & (fold == k)
        p_false[own] = 1 / (1 + np.exp(x[own] @ fit))
    rows = []
    for images in KINDS:
        for low, high in pairwise(BINS):
            own = (kind == images) & (p_false >= low) & (p_false < high)
            row = [images, f"{low:g} to {high:g}", f"{p_false[own].mean():.2f}"]
            for one in sets:
                part = own & (which == one)
                row += [part.sum(), false_share(~right[part], name[part])]
            rows.append(row)
        for most in BINS[1:-1]:
            own = (kind == images) & (which == "development") & (p_false <= most)
            own &= can_be_secure > 0
            print(
                images, "p_false <=", most, own.sum(), f"{right[own].mean():.2f} right"
            )
    header = ["images", "p_false", "predicted"]
    header += [word for one in sets for word in (one, "false")]
    write_table("features_trust", header, rows)


def regression(x, right, seeds):
    """Return the coefficients of a logistic regression, drawn towards zero."""
    sign, width = np.where(right, -1, 1), x[:, 1:].std(axis=0)

    def cost(w):
        fit = np.logaddexp(0, sign * (x @ w)).sum() / seeds
        return fit + ((w[1:] * width) ** 2).sum() / 2

    return minimize(cost, np.zeros(x.shape[1])).x


def false_share(false, source):
    """Return the share of false ones; its error is that of a mean of sources."""
    if len(false) == 0:
        return ""
    source = np.unique(source, return_inverse=True)[1]
    off = np.bincount(source, false - false.mean())
    return f"{false.mean():.2f} ± {np.sqrt(off @ off) / len(false):.2f}"


def examples(task, **options):
    """Return properties of a source's moving features, could be secure, are right."""
    import survey

    kind, _, name = task
    rows, beam = survey.read(options["shared"] / TABLE)[name], survey.beam(name)[0]
    known, found = survey.features(rows), []
    for features in features_of(kind, name, **options)[0]:
        d, motions = features.detections, features.motions
        errors = np.array([motion.speed / motion.speed_err for motion in motions])
        certain = features.same_speed, features.moved, errors, features.n_epochs
        each = features.tracks, motions, are_secure(0.0, *certain)
        for track, motion, can_be_secure in zip(*each, strict=True):
            if motion.speed > 3 * motion.speed_err:
                one = {
                    "first": d.time[track[0]],
                    "last": d.time[track[-1]],
                    "date": motion.date,
                    "place": motion.place,
                    "pm": motion.speed,
                    "err": motion.speed_err,
                }
                right = confirmed(one, known, beam)[0]
                found.append([*properties(d, track, motion), can_be_secure, right])
    return found


# -- simulated jets ----------------------------------------------------------------


def simulated(n_jets, n_jobs):
    """Write the tables of static and of moving jets."""
    seeds = range(FIRST_SEED, FIRST_SEED + n_jets)
    # False ones are rare.
    static = range(FIRST_SEED, FIRST_SEED + 3 * n_jets)
    with ProcessPoolExecutor(n_jobs) as pool:
        rows = []
        for kind in STATIC:
            found = list(pool.map(partial(secure_of, f"static-{kind}"), static))
            shares = np.mean(np.array(found) > 0, axis=0)
            rows.append([kind, len(static), *(f"{share:.3f}" for share in shares)])
        header = ["jets", "number", "with a secure feature",
                  f"that moves {FAR} beams"]  # fmt: skip
        write_table("features_static", header, rows)
        rows = []
        for kind in (*MOVING, "10 mJy"):
            each = np.array(list(pool.map(partial(compared, kind), seeds)))
            total = each.sum(axis=0)
            bright, followed, moving, right, secure, sure, inside = total
            rows.append(
                [kind, n_jets, bright, f"{followed / bright:.2f}", moving,
                 f"{right / moving:.2f}", secure, f"{sure / secure:.2f}",
                 f"{inside / secure:.2f}"]
            )  # fmt: skip
    header = ["jets", "number", "features over 10 sigma", "followed", "ours, moving",
              "right", "secure", "right too", "cover"]  # fmt: skip
    write_table("features_simulated", header, rows)


def simulated_jet(kind, seed):
    """Return a simulated jet and its cube with one beam."""
    sys.path.insert(0, str(Path(__file__).parent / "calibration"))
    import run

    from astro_scc.simulation import simulate_jet

    if kind == "10 mJy":
        jet = simulate_jet(rng=seed, dispersion=0.2, flux=0.01)
    else:
        jet = run.KINDS[kind](seed)
    return jet, jet.cube


def secure_of(kind, seed):
    """Return the number of secure features of a static jet, and of far ones."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = find_features(simulated_jet(kind, seed)[1])
    far = found.secure & (found.moved >= FAR)
    return found.secure.sum(), far.sum()


def compared(kind, seed):
    """Return how many features of a jet are followed, and how many of ours right."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        jet, cube = simulated_jet(kind, seed)
        features = find_features(cube)
    true, noise = jet.truth, cube.noise_rms().value
    group = np.asarray(true["group"])
    true = true[(group != "core") & (group != "standing") & true["visible"]]
    known = []
    for number in np.unique(true["feature"]):
        own = true[true["feature"] == number]
        epoch, place = np.asarray(own["epoch"]), [own["east"], own["north"]]
        flux = u.Quantity(own["flux"]).value
        n_bright = np.sum(flux > 10 * noise[epoch])
        known.append((epoch, u.Quantity(place).to_value(u.mas).T, n_bright))
    d, n = features.detections, np.zeros(5, dtype=int)
    got = set()
    parts = features.tracks, features.motions, features.secure
    for track, motion, secure in zip(*parts, strict=True):
        number, off, cover = nearest(track, motion, d, known, cube)
        got.add(number)
        if motion.speed > 3 * motion.speed_err:
            n += [1, off, secure, secure and off, secure and cover]
    bright = [k for k, one in enumerate(known) if one[2] >= 4]
    return len(bright), sum(k in got for k in bright), *n.tolist()


def nearest(track, motion, d, known, cube):
    """Return the true feature of a track, and whether its speed and error are right."""
    best = NEAR * d.fwhm, None
    years = cube.years.to_value(u.yr)
    for number, (epoch, place, _) in enumerate(known):
        _, one, other = np.intersect1d(d.epoch[track], epoch, return_indices=True)
        if 2 * len(one) >= len(track):
            off = np.median(np.hypot(*(d.place[track[one]] - place[other]).T))
            best = min(best, (off, number))
    if best[1] is None:
        return None, False, False
    epoch, place, _ = known[best[1]]
    seen = (epoch >= d.epoch[track[0]]) & (epoch <= d.epoch[track[-1]])
    dt = years[epoch[seen]] - years[epoch[seen]].mean()
    speed = np.hypot(*(dt @ place[seen])) / (dt @ dt)
    off = abs(motion.speed - speed)
    right = off <= max(0.2 * speed, 2 * motion.speed_err)
    return best[1], right, off <= motion.speed_err


if __name__ == "__main__":
    main()
