# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Read real image files, including some that break naive readers, and show the results.

Each file is read alone and with the three epochs of 0506+056, as if a pattern matched
all four::

    python benchmarks/files.py ../shared/data
"""

import argparse
import warnings
from pathlib import Path

from common import write_table

from astro_scc import EpochCube

SERIES = "0506+056"
HEADER = ["file", "alone", f"among the epochs of {SERIES}"]


def main():
    """Read each file twice and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("folder", type=Path, help="of all test data")
    args = parser.parse_args()
    series = sorted((args.folder / SERIES).glob("*.fits"))
    rows = []
    for path in series:
        rows.append([path.name, outcome([path], path.parent), ""])
    rows.append([f"all three of {SERIES}", outcome(series, series[0].parent), ""])
    for path in sorted((args.folder / "quirks").glob("*.fits")):
        rows.append(
            [
                path.name,
                outcome([path], path.parent),
                outcome([*series, path], path.parent),
            ]
        )
    dateless = args.folder / "quirks" / "sampling_mean.fits"
    rows.append(
        [
            f"{dateless.name} with times=",
            outcome([dateless], dateless.parent, times=["2017-04-11"]),
            "",
        ]
    )
    write_table("files", HEADER, rows)


def outcome(paths, folder, **options):
    """Return the cube as one line, or the error, and the warnings."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            text = repr(EpochCube.read(paths, **options))[1:-1]
        except (OSError, ValueError) as error:
            text = f"refused: {error}"
    texts = [text, *(f"warning: {item.message}" for item in caught)]
    return "; ".join(texts).replace(f"{folder}/", "")


if __name__ == "__main__":
    main()
