# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure the time and memory for images that are larger than the memory.

A part of 400 x 400 pixels is measured in a hundred epochs of 4096 x 4096 pixels, and in
six of 8192 x 8192::

    python benchmarks/memory.py

The files take 8 GB of disk space in total (``--folder``) and are deleted at the end.
Peak memory is that of the process and its children, including mapped files.
"""

import argparse
import shutil
import tempfile
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.table import QTable
from astropy.time import Time
from common import watch, write_table

MAS = 1 / 3.6e6
#: Side of the part that is measured and motion of its features per epoch, in pixels.
PART, STEP = 400, 1.5
DAYS = 30.0
#: Rows of an image that are written at once.
ROWS = 256


def header(size, i):
    """Return the header of epoch ``i``, with pixels of 0.1 mas."""
    middle = size // 2
    cards = {
        "OBJECT": "J0000+00", "BUNIT": "JY/BEAM", "EPOCH": 2000.0,
        "CTYPE1": "RA---SIN", "CRVAL1": 10.0, "CRPIX1": middle, "CDELT1": -0.1 * MAS,
        "CTYPE2": "DEC--SIN", "CRVAL2": 0.0, "CRPIX2": middle, "CDELT2": 0.1 * MAS,
        "BMAJ": 0.5 * MAS, "BMIN": 0.5 * MAS, "BPA": 0.0,
        "DATE-OBS": (Time("2001-01-01") + i * DAYS * u.day).isot,
    }  # fmt: skip
    shape = {"SIMPLE": True, "BITPIX": -32, "NAXIS": 2, "NAXIS1": size, "NAXIS2": size}
    return fits.Header({**shape, **cards})


def part_of(size, i, n):
    """Simulate the part: features that all move to the west, and noise."""
    y, x = np.mgrid[:PART, :PART]
    rng = np.random.default_rng([size, i])
    data = rng.normal(0, 1e-3, (PART, PART))
    places = np.random.default_rng(size).uniform(0, 1, (12, 2))
    reach = STEP * n
    for across, along in places:
        row = 40 + (PART - 80) * across
        column = 40 + (PART - 80 - reach) * along + STEP * i
        data += np.exp(-((y - row) ** 2 + (x - column) ** 2) / 2 / 2.1**2)
    return data


def write(folder, size, n):
    """Write the epochs on repeated noise; return their paths and a region file."""
    patch = np.random.default_rng(0).normal(0, 1e-3, (ROWS, size)).astype(">f4")
    first = (size - PART) // 2
    paths = []
    for i in range(n):
        part = part_of(size, i, n).astype(">f4")
        paths.append(folder / f"e{i:03d}.fits")
        with paths[-1].open("wb") as file:
            text = header(size, i).tostring(endcard=True)
            file.write(text.encode("ascii"))
            for top in range(0, size, ROWS):
                rows = np.roll(patch, 17 * (top + i), axis=1)
                low, high = max(top, first), min(top + ROWS, first + PART)
                if low < high:
                    rows[low - top : high - top, first : first + PART] = part[
                        low - first : high - first
                    ]
                file.write(rows.tobytes())
            file.write(b"\0" * (-file.tell() % 2880))
    region = folder / "part.reg"
    middle = first + PART / 2 + 0.5
    region.write_text(f"image\nbox({middle},{middle},{PART},{PART},0)\n")
    return paths, region


def measured(folder):
    """Return the velocity of the first component to the east and north, in mas/yr."""
    table = QTable.read(folder / "components.ecsv")
    return tuple(float(table[k][0].value) for k in ("pm_ra_cosdec", "pm_dec"))


def main():
    """Print the table and write it."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument("--folder", type=Path, help="for the files; default temporary")
    parser.add_argument("--series", default="100x4096,6x8192", help="epochs x pixels")
    parser.add_argument("--n-trials", default="100")
    args = parser.parse_args()
    header = ["epochs", "size", "files (GB)", "as a cube (GB)", "command", "time (s)",
              "peak memory (GB)", "east, north (mas/yr)", "true"]  # fmt: skip
    rows = []
    true = -0.1 * STEP / DAYS * 365.25
    for words in args.series.split(","):
        n, size = map(int, words.split("x"))
        folder = Path(tempfile.mkdtemp(dir=args.folder))
        try:
            paths, region = write(folder, size, n)
            out = folder / "out"
            measure = ["measure", *paths, "-o", out, "--crop", region, "--no-report",
                       "--scales", "1,2,3", "--max-speed", "4 mas/yr", "--seed", "1",
                       "--n-trials", args.n_trials]  # fmt: skip
            peak, seconds = watch(measure)
            east, north = measured(out)
            facts = [
                f"{size} x {size}",
                f"{n * paths[0].stat().st_size / 1e9:.2g}",
                f"{n * size**2 * 9 / 1e9:.2g}",
            ]
            answer = [f"{east:.2f}, {north:.2f}", f"{true:.2f}, 0.00"]
            cost = [f"{seconds:.0f}", f"{peak:.2f}"]
            rows.append([n, *facts, "measure --crop", *cost, *answer])
            peak, seconds = watch(["inspect", paths[0]])
            cost = [f"{seconds:.0f}", f"{peak:.2f}"]
            rows.append([1, facts[0], "", "", "inspect", *cost, "", ""])
        finally:
            shutil.rmtree(folder)
    write_table("memory", header, rows)


if __name__ == "__main__":
    main()
