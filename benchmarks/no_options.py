# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure jets and other images by one command without options, with time and memory.

``astro-scc restore`` makes images of twelve jets of MOJAVE, and ``astro-scc measure
FILES --redshift Z`` measures them.  The table has the speeds beside those of
``mojave.py``, for which the direction is fitted to the mean image.  A second table has
the speeds of simulated images: jets of two streams, and the knots of HST and the Sun of
``examples``, which have no beam::

    python benchmarks/no_options.py ../shared/data/mojave_xviii
    python benchmarks/no_options.py ../shared/data/mojave_xviii --only 1641+399
    python benchmarks/no_options.py ../shared/data/mojave_xviii --only simulated
"""

import argparse
import csv
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable
from common import PM_UNIT, RESULTS, measured, plain, watch, write_table
from mojave import FEATURES, RIGHT, SOURCES

from astro_scc.simulation import (
    Flow,
    simulate_jet,
    simulate_two_fluid,
    write_simulation,
)

#: Of NED, as in Lister et al. (2021, ApJ 923, 30), Table 1.
REDSHIFTS = {
    "0003+380": 0.229, "0333+321": 1.259, "0415+379": 0.0491, "0430+052": 0.033,
    "0716+714": 0.31, "1226+023": 0.1583, "1228+126": 0.00436, "1253-055": 0.536,
    "1308+326": 0.997, "1510-089": 0.36, "1641+399": 0.593, "2200+420": 0.0686,
}  # fmt: skip
#: Not of the examples, on whose images the rule for the scales was tried.
SEED = 21
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


def write_example(name, speed, folder):
    """Write the images of an example, and return its one speed."""
    code = f"import sys; from pathlib import Path; import numpy as np; import {name}\n"
    code += f"{name}.write_images(Path(sys.argv[1]), np.random.default_rng({SEED}))"
    here = Path(__file__).parents[1] / "examples"
    subprocess.run([sys.executable, "-c", code, str(folder)], check=True, cwd=here)
    return [speed]


def write_jet(jet, folder):
    """Write a simulated jet, and return the mean speed of each of its streams."""
    write_simulation(jet, folder)
    groups = [own for own in jet.truth.group_by("group").groups if own["group"][0]]
    means = [
        [np.nanmean(own[f"pm_{axis}"]) for axis in ("east", "north")] for own in groups
    ]
    speeds = sorted(np.hypot(*mean).to_value(PM_UNIT) for mean in means)
    return [speed for speed in speeds if speed > 0]


def simulated():
    """Yield the rows of simulated images: true speeds, and those without options."""
    flow = {"n_features": 5, "dispersion": 0.1}
    streams = [Flow("slow", speed=0.3, **flow), Flow("fast", speed=0.9, **flow)]
    two = simulate_jet(streams=streams, rng=SEED)
    makers = {
        "two streams": partial(write_jet, two),
        "the paper's two fluids": partial(write_jet, simulate_two_fluid(rng=SEED)),
        # A pixel a year, and 5 km/s.
        "knots, HST": partial(write_example, "hubble", 25.0),
        "drift on the Sun": partial(write_example, "sun", 24.82),
    }
    for name, make in makers.items():
        with tempfile.TemporaryDirectory() as parent:
            folder, out = Path(parent, "images"), Path(parent, "out")
            folder.mkdir()
            true = make(folder)
            files = sorted(folder.glob("*.fits"))
            _, seconds = watch(["measure", *files, "-o", out, "--seed", "1"])
            found = QTable.read(out / "components.ecsv")
        unit = u.arcsec / u.h if "Sun" in name else PM_UNIT
        rows = [row for row in found if row["kind"] == "moving"]
        yield [
            name, len(files), str(unit), ", ".join(f"{v:.3g}" for v in true),
            ", ".join(
                measured(plain(row["pm"], unit), plain(row["pm_err"], unit), 3)
                for row in rows
            ), f"{seconds:.0f}",
        ]  # fmt: skip


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
    if args.only is None or "simulated" in args.only:
        head = ["images", "epochs", "unit", "true", "no options", "time (s)"]
        write_table("no_options_simulated", head, list(simulated()))
    experts = chosen()
    for source in SOURCES:
        if args.only is None or source.table in args.only:
            rows[source.name] = row_of(source, experts[source.name], args.folder)
            order = [s.name for s in SOURCES if s.name in rows]
            write_table("no_options", HEADER, [rows[name] for name in order])


if __name__ == "__main__":
    main()
