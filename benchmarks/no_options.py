# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure twelve jets of MOJAVE by one command without options, with time and memory.

``astro-scc restore`` makes the images, and ``astro-scc measure FILES --redshift Z``
measures them.  The table has the speeds beside those of ``mojave.py``, for which the
direction is fitted to the patterns::

    python benchmarks/no_options.py ../shared/data/mojave_xviii
    python benchmarks/no_options.py ../shared/data/mojave_xviii --only 1641+399
"""

import argparse
import csv
import tempfile
from pathlib import Path

import numpy as np
from astropy.table import QTable
from common import PM_UNIT, RESULTS, measured, plain, watch, write_table
from mojave import FEATURES, RIGHT, SOURCES

#: Of NED, as in Lister et al. (2021, ApJ 923, 30), Table 1.
REDSHIFTS = {
    "0003+380": 0.229, "0333+321": 1.259, "0415+379": 0.0491, "0430+052": 0.033,
    "0716+714": 0.31, "1226+023": 0.1583, "1228+126": 0.00436, "1253-055": 0.536,
    "1308+326": 0.997, "1510-089": 0.36, "1641+399": 0.593, "2200+420": 0.0686,
}  # fmt: skip
HEADER = ["jet", "epochs", "features' mean (mas/yr)", "no options (mas/yr)", "kind",
          "chosen settings (mas/yr)", "right", "time (s)", "memory (GB)"]  # fmt: skip


def chosen():
    """Return the first row of each whole jet in the table of ``mojave.py``."""
    with open(RESULTS / "mojave.csv", newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["ring (mas)"] == "all"]
    return {row["jet"]: row for row in reversed(rows)}


def row_of(source, expert, tables):
    """Return the row of a jet."""
    beam = source.beam
    size = f"{beam.major.value} mas {beam.minor.value} mas {beam.pa.value} deg"
    with tempfile.TemporaryDirectory() as folder:
        images, out = Path(folder, "images"), Path(folder, "out")
        watch([
            "restore", tables / f"{source.table}.ecsv", "-o", images, "--beam", size,
            "--pixel", "0.1 mas", "--noise", "0.3 mJy/beam", "--seed", "1", "--quiet",
        ])  # fmt: skip
        files = sorted(images.glob("*.fits"))
        redshift = REDSHIFTS[source.table]
        memory, seconds = watch(
            ["measure", *files, "--redshift", redshift, "-o", out, "--seed", "1"],
            kind="Pss",
        )
        components = QTable.read(out / "components.ecsv")
    first = components[components["kind"] != "stationary"][:1]
    if len(first):
        speed, error = (plain(first[c][0], PM_UNIT) for c in ("pm", "pm_err"))
        text, kind = measured(speed, error, 3), first["kind"][0]
    else:
        speed, error, text, kind = np.nan, np.nan, "", "nothing"
    mean = float(expert["their mean (mas/yr)"])
    right = abs(speed - mean) <= max(RIGHT * mean, 2 * np.nan_to_num(error))
    few = int(expert["features"].split(" of ")[1]) < FEATURES
    verdict = "few features" if few else "yes" if right else "no"
    own = f"{expert['speed (mas/yr)']} ({expert['kind']})"
    return [source.name, len(files), f"{mean:.3f}", text, kind, own, verdict,
            f"{seconds:.0f}", f"{memory:.1f}"]  # fmt: skip


def main():
    """Measure the jets, and write their rows beside those there are."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("folder", type=Path, help="of the tables of features")
    parser.add_argument("--only", nargs="+", metavar="TABLE", help="as 1641+399")
    args = parser.parse_args()
    rows, path = {}, RESULTS / "no_options.csv"
    if path.exists():
        with open(path, newline="", encoding="utf-8") as file:
            rows = {row[0]: row for row in list(csv.reader(file))[1:]}
    experts = chosen()
    for source in SOURCES:
        if args.only is None or source.table in args.only:
            rows[source.name] = row_of(source, experts[source.name], args.folder)
            order = [s.name for s in SOURCES if s.name in rows]
            write_table("no_options", HEADER, [rows[name] for name in order])


if __name__ == "__main__":
    main()
