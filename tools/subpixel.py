# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
How far the displacement is off where all pairs of epochs have the same one.

Five epochs of two features, 3.8 and 4.2 pixels wide, that move by the same part of a
pixel each, with hardly any noise::

    python tools/subpixel.py benchmarks/results/subpixel.csv
"""

import csv
import sys
import warnings

import astropy.units as u
import numpy as np
from astropy.time import Time

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.exceptions import MeasurementWarning

PIXEL, DAYS, N = 0.1, 30.0, 5


def images(step):
    """Epochs whose features move ``step`` pixels to the right."""
    y, x = np.mgrid[:40, :48]
    for i in range(N):
        data = np.random.default_rng(i).normal(0, 1e-3, x.shape)
        for north, west, peak, width in ((22, 14, 1, 1.8), (16, 26, 0.6, 1.6)):
            r2 = (x - west - step * i) ** 2 + (y - north) ** 2
            data += peak * np.exp(-r2 / 2 / width**2)
        yield data


def main():
    """Print the table and write it."""
    times = Time(2451910.5 + DAYS * np.arange(N), format="jd", scale="tai")
    scc = StackedCrossCorrelation(scales=[1, 2], max_speed=5 * u.mas / u.yr)
    to_pixels = DAYS / 365.25 / PIXEL
    rows = [["displacement (pixels)", "measured less true", "its pm_err"]]
    for step in np.arange(1, 11) / 10:
        cube = EpochCube.from_arrays(
            np.array(list(images(step))), times=times, pixel_scale=PIXEL * u.mas
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeasurementWarning)
            row = scc(cube, n_trials=2, rng=1).components[0]
        found = -row["pm_ra_cosdec"].value * to_pixels
        error = row["pm_ra_cosdec_err"].value * to_pixels
        rows.append([f"{step:.1f}", f"{found - step:+.3f}", f"{error:.3f}"])
        print(*rows[-1], flush=True)
    with open(sys.argv[1], "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main()
