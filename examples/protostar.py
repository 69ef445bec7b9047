# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure knots of a protostellar jet that are aligned on the stars of the field.

    python examples/protostar.py
"""

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time
from common import brief, run
from regions import PixCoord, RectanglePixelRegion

from astro_scc import EpochCube, StackedCrossCorrelation
from astro_scc.features import find_features

DATES = [
    "2002-02-05",
    "2004-01-20",
    "2006-02-11",
    "2008-01-28",
    "2010-02-02",
    "2012-01-17",
]
DISTANCE = 140 * u.pc
SPEEDS = [125, 102, 111, 131, 92, 142, 138, 106, 130] * u.km / u.s
PIXEL = 0.1 * u.arcsec
NY, NX = 120, 240
#: The jet leaves a star at the left to the west, 24 pixels wide.
AXIS, WIDTH = 60, 24


def simulate(dates, rng):
    """Return images of nine knots of these `SPEEDS` and twenty stars, in counts."""
    scene = np.random.default_rng(5)
    knots = np.linspace(30, 190, 9) + scene.uniform(-4, 4, 9)
    across = AXIS + scene.normal(0, 2, 9)
    motion = (SPEEDS / DISTANCE).to(u.arcsec / u.yr, u.dimensionless_angles())
    pixels = (motion / PIXEL).to_value(1 / u.yr)
    stars = scene.uniform([5, 5], [NX - 5, AXIS - WIDTH], (20, 2))
    stars[::2, 1] += AXIS + 0.6 * WIDTH
    flux = scene.uniform(300, 3000, len(stars))
    y, x = np.mgrid[:NY, :NX]

    def blobs(x0, y0, peaks, width):
        away = (x - np.c_[x0][..., None]) ** 2 + (y - np.c_[y0][..., None]) ** 2
        return np.tensordot(peaks, np.exp(-away / (2 * width**2)), 1)

    images = []
    for year in Time(dates).jyear - 2002:
        # The pointing is known to a pixel, and knots fade and brighten.
        dx, dy = rng.normal(0, 0.7, 2)
        peaks = 150 * np.exp(rng.normal(0, 0.2, len(knots)))
        places = knots + pixels * year
        image = 50 + blobs(places + dx, across + dy, peaks, 2.5)
        image += blobs(*(stars + [dx, dy]).T, flux, 1.0)
        images.append(rng.poisson(image).astype(float))
    return EpochCube.from_arrays(images, dates, pixel_scale=PIXEL, unit="electron")


def speed(motion):
    """Return the speed at the distance of the jet."""
    return (motion * DISTANCE).to(u.km / u.s, u.dimensionless_angles())


def measure(n_trials=200):
    """Return the mean speed by both methods, and a figure of the knots."""
    strip = RectanglePixelRegion(PixCoord(NX / 2, AXIS), NX - 4, WIDTH)
    scc = StackedCrossCorrelation(
        scales=[1, 2], max_speed=0.5 * u.arcsec / u.yr, position_angle=270 * u.deg,
        detection=6, segmentation=4,
    )  # fmt: skip
    cube = simulate(DATES, np.random.default_rng(1))
    # The stars beside the jet stand still.
    cube = cube.align("correlate", region=~cube.region_mask(strip))
    result = scc(cube, region=strip, n_trials=n_trials, rng=1)
    stream = result.components[0]

    four = cube[:4]
    patterns = scc.decompose(four, region=strip).ssps
    single = find_features(four, ssps=patterns, region=strip).table["pm"]
    error = single.std(ddof=1) / len(single) ** 0.5
    table = QTable({
        "method": ["streams", "features"],
        "n_epochs": [len(cube), len(four)],
        "n_features": [stream["n_features"], len(single)],
        "pm": u.Quantity([stream["pm"], single.mean()]),
        "pm_err": u.Quantity([stream["pm_err"], error]),
        "p_global": [stream["p_global"], np.nan],
    })  # fmt: skip
    table["speed"], table["speed_err"] = speed(table["pm"]), speed(table["pm_err"])
    table["true_speed"] = SPEEDS.mean()
    columns = "pm", "pm_err", "speed", "speed_err", "true_speed", "p_global"
    table = brief(table, "method", "n_epochs", "n_features", *columns, digits=0)
    return table, result.plot("tracks")


if __name__ == "__main__":
    run(measure, __doc__)
