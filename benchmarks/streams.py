# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""
Count how many rows of ``streams.ecsv`` are right on the sources of a survey.

    python benchmarks/streams.py dispersion ../shared
    python benchmarks/streams.py survey ../shared FOLDER [--jobs 2] [--only NAME ...]
    python benchmarks/streams.py few ../shared FOLDER [--jobs 2] [--first SEED]

``dispersion`` prints how much the speeds of the features of one jet differ.  ``survey``
measures the images of ``features.py survey`` by ``astro-scc measure`` without options,
and compares the first row that moves with the mean of the survey's features; sources
that FOLDER holds tables of are not measured again.  ``few`` measures few of the epochs
of sources that have many, drawn at random, so that features are passed by others
between the images, and counts their secure features too.
"""

import argparse
import os
import sys
import warnings
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
from common import write_table
from features import KINDS, TABLE, images_of, source_sets

from astro_scc.cli import main as astro_scc

#: Fewest features of a jet of which the dispersion is taken.
FEWEST = 3
#: Numbers of epochs of the rows of the table.
EPOCHS = ("all", 0, np.inf), ("10 to 17", 10, 18), ("18 and more", 18, np.inf)
#: Sources with motion and so many epochs, of which so many are drawn, so often.
MANY, DRAWN, DRAWS = 60, (8, 12, 16, 24), 4
FEW = ["images", "epochs", "draws", "right", "wrong", "silent", "features agree",
       "of secure ones that move"]  # fmt: skip
HEADER = ["images", "epochs", "sources", "with motion", "right", "wrong", "silent",
          "right, without", "wrong, without", "inward"]  # fmt: skip


def main():
    """Run one of the parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("part", choices=("dispersion", "survey", "few"))
    parser.add_argument("shared", type=Path, help="data and survey tools")
    parser.add_argument("folder", type=Path, nargs="?", help="of images and tables")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", nargs="+", default=None)
    parser.add_argument("--first", type=int, default=1000, help="seed of ``few``")
    parser.add_argument("--kinds", nargs="+", default=KINDS, choices=KINDS)
    args = parser.parse_args()
    sys.path.insert(0, str(args.shared / "survey"))
    parts = {"survey": survey_rows, "dispersion": dispersion, "few": few_epochs}
    parts[args.part](args)


def moved(rows, beam):
    """Return the robust features of a source that moved by more than a beam."""
    import survey

    return [
        g
        for g in survey.features(rows)
        if g["robust"]
        and g["mu"] > 3 * g["err"]
        and g["mu"] * (g["last"] - g["first"]) > beam
    ]


def dispersion(args):
    """Print the relative dispersion of the speeds of the features of one jet."""
    import survey

    found = []
    for source, rows in survey.read(args.shared / TABLE).items():
        features = moved(rows, survey.beam(source)[0])
        if len(features) >= FEWEST:
            speed, error = (np.array([g[k] for g in features]) for k in ("mu", "err"))
            variance = max(speed.var(ddof=1) - np.mean(error**2), 0)
            found.append(np.sqrt(variance) / speed.mean())
    rms = np.sqrt(np.mean(np.square(found)))
    print(f"{len(found)} sources, median {np.median(found):.2f}, rms {rms:.2f}")


def measure(files, out):
    """Measure images by the command, unless there are tables of them."""
    if not (out / "streams.ecsv").exists():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            options = ["-o", str(out), "--no-report", "--seed", "1", "--quiet"]
            astro_scc(["measure", *files, *options])


def measured(kind, source, *, shared, folder):
    """Return a row of the table for one source, and print it."""
    import score
    import survey
    from astropy.table import QTable

    files, out = images_of(kind, source, shared, folder), folder / kind / source / "out"
    measure(files, out)
    rows, beam = survey.read(shared / TABLE)[source], survey.beam(source)[0]
    counts, _, _ = score.score(rows, out, beam)
    inward = any("towards the core" in row["caution"]
                 for row in QTable.read(out / "streams.ecsv"))  # fmt: skip
    motion = bool(moved(rows, beam))
    row = [1, motion, counts["row_right"] * motion,
           (counts["rows"] - counts["row_right"]) * motion, counts["silent"],
           counts["row_right"] * (not motion),
           (counts["rows"] - counts["row_right"]) * (not motion), inward]  # fmt: skip
    print(kind, source, len(files), *map(int, row[1:]), sep="\t", flush=True)
    return len(files), row


def survey_rows(args):
    """Measure all sources, and write a row for each kind and number of epochs."""
    import survey

    sources = [
        name
        for some in source_sets(survey.read(args.shared / TABLE)).values()
        for name in some
        if args.only is None or name in args.only
    ]
    table = []
    for kind in args.kinds:
        one = partial(measured, kind, shared=args.shared, folder=args.folder)
        with ProcessPoolExecutor(args.jobs) as pool:
            found = list(pool.map(one, sources))
        for which, least, most in EPOCHS:
            some = [row for n, row in found if least <= n < most]
            table.append([kind, which, *np.sum(some, axis=0).astype(int)])
            print(*table[-1], sep="\t", flush=True)
    if args.only is None and len(args.kinds) == len(KINDS):
        write_table("streams_survey", HEADER, table)


def drawn(case, *, shared, folder):
    """Return a row of the table for some epochs of a source, and print it."""
    import score
    import survey

    kind, source, number, seed = case
    files = images_of(kind, source, shared, folder)
    chosen = np.random.default_rng(seed).choice(files, number, replace=False)
    out = folder / kind / source / f"few_{number}_{seed}"
    measure(sorted(chosen.tolist()), out)
    rows, beam = survey.read(shared / TABLE)[source], survey.beam(source)[0]
    counts, _, _ = score.score(rows, out, beam)
    right, given = counts["row_right"], counts["rows"]
    row = [1, right, given - right, 1 - given, counts["agree"], counts["moving"]]
    print(*case, *map(int, row), sep="\t", flush=True)
    return number, row


def few_epochs(args):
    """Measure few of many epochs, and write a row for each kind and number of them."""
    import survey

    some = [
        source
        for source, rows in survey.read(args.shared / TABLE).items()
        if len(set(rows["date"])) >= MANY and moved(rows, survey.beam(source)[0])
    ]
    one, table = partial(drawn, shared=args.shared, folder=args.folder), []
    for kind in args.kinds:
        cases = [
            (kind, source, number, args.first + k)
            for number in DRAWN for source in some for k in range(DRAWS)
        ]  # fmt: skip
        with ProcessPoolExecutor(args.jobs) as pool:
            found = list(pool.map(one, cases))
        for number in DRAWN:
            rows = [row for n, row in found if n == number]
            table.append([kind, number, *np.sum(rows, axis=0).astype(int)])
            print(*table[-1], sep="\t", flush=True)
    write_table("streams_few", FEW, table)


if __name__ == "__main__":
    main()
