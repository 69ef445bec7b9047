# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure the error of a displacement that is the same for all pairs of epochs.

Six epochs show four features that move by half of their width and a fraction of a
pixel from each to the next, with hardly any noise, for features of several widths::

    python benchmarks/subpixel.py
"""

import warnings

import astropy.units as u
import numpy as np
from astropy.time import Time
from common import write_table

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.exceptions import MeasurementWarning

PIXEL, DAYS, N = 0.1, 30.0, 6
FRACTIONS = np.arange(1, 11) / 10
#: Width of the features in pixels, and the scales that see them.
WIDTHS = {3: [1], 4: [1, 2], 5: [1, 2], 7: [2, 3], 10: [2, 3]}


def images(step, fwhm, rng):
    """Yield epochs whose features move ``step`` pixels to the right."""
    size = 18 * fwhm + 20
    y, x = np.mgrid[:size, : size * 5 // 4]
    phases = rng.uniform(size=(4, 2))
    for i in range(N):
        data = rng.normal(0, 1e-3, x.shape)
        for k, (up, right) in enumerate(phases):
            y0 = size * (0.25 + 0.16 * k) + up
            x0 = size * (0.3 + 0.35 * (k % 2)) + right + step * i
            width = fwhm * (1 + 0.05 * k)
            r2 = (x - x0) ** 2 + (y - y0) ** 2
            data += (1 - 0.15 * k) * np.exp(-4 * np.log(2) * r2 / width**2)
        yield data


def measured(fwhm, scales, step):
    """Return the measured minus the true displacement, and its error, in pixels."""
    times = Time(2451910.5 + DAYS * np.arange(N), format="jd", scale="tai")
    data = np.array(list(images(step, fwhm, np.random.default_rng(1))))
    cube = EpochCube.from_arrays(data, times=times, pixel_scale=PIXEL * u.mas)
    scc = StackedCrossCorrelation(scales=scales, position_angle=270 * u.deg)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeasurementWarning)
        row = scc(cube, n_trials=2, rng=1).components[0]
    to_pixels = DAYS / 365.25 / PIXEL
    found = -row["pm_ra_cosdec"].value * to_pixels
    return found - step, row["pm_ra_cosdec_err"].value * to_pixels


def main():
    """Print the table and write it."""
    header = ["width (pixels)", "largest error", "over width", "at", "its pm_err"]
    rows = []
    for fwhm, scales in WIDTHS.items():
        steps = fwhm // 2 + FRACTIONS
        off, error = np.array([measured(fwhm, scales, step) for step in steps]).T
        k = np.abs(off).argmax()
        rows.append([fwhm, f"{off[k]:+.3f}", f"{off[k] / fwhm:+.3f}",
                     f"{steps[k]:.1f}", f"{error[k]:.3f}"])  # fmt: skip
    write_table("subpixel", header, rows)


if __name__ == "__main__":
    main()
