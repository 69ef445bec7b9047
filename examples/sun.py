# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure features that drift over the Sun, in one helioprojective image a minute.

    python examples/sun.py
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.time import Time
from common import brief, run

from astro_scc import EpochCube, StackedCrossCorrelation

PIXEL = 0.5 * u.arcsec
CADENCE = 60 * u.s
SPEED = 5 * u.km / u.s
SIZE = 128


def per_distance(speed):
    """Return the angular speed of a motion on the Sun, as seen from the Earth."""
    return (speed / u.au).to(u.arcsec / u.hour, u.dimensionless_angles())


def write_images(folder, rng, n_epochs=10, n_features=160):
    """Write images of features that live ten minutes and drift to solar west."""
    start = Time("2024-05-10T12:00:00")
    seconds = np.arange(n_epochs) * CADENCE.to_value(u.s)
    pixels = (per_distance(1 * u.km / u.s) / PIXEL).to_value(1 / u.s)
    x, y = rng.uniform(-20, SIZE + 20, (2, n_features))
    born = rng.uniform(-600, seconds[-1], n_features)
    vx, vy = rng.normal(0, 0.3, (2, n_features)) + [[SPEED.value], [0.0]]
    peak = rng.uniform(150, 450, n_features)
    rows, columns = np.mgrid[:SIZE, :SIZE]
    for k, second in enumerate(seconds):
        age = (second - born) / 600
        image = np.full((SIZE, SIZE), 1000.0)
        for i in np.flatnonzero((age > 0) & (age < 1)):
            dx, dy = np.array([vx[i], vy[i]]) * pixels * (second - born[i])
            away = (columns - x[i] - dx) ** 2 + (rows - y[i] - dy) ** 2
            image += peak[i] * np.sqrt(np.sin(np.pi * age[i])) * np.exp(-away / 8)
        hdu = fits.PrimaryHDU(rng.poisson(image).astype(np.float32))
        step = PIXEL.to_value(u.arcsec)
        hdu.header.update(
            CTYPE1="HPLN-TAN", CUNIT1="arcsec", CRVAL1=120.0, CRPIX1=64.5, CDELT1=step,
            CTYPE2="HPLT-TAN", CUNIT2="arcsec", CRVAL2=-60.0, CRPIX2=64.5, CDELT2=step,
            BUNIT="DN", HGLN_OBS=0.0, HGLT_OBS=-3.0, DSUN_OBS=u.au.to(u.m),
        )  # fmt: skip
        hdu.header["DATE-OBS"] = (start + second * u.s).isot
        hdu.writeto(folder / f"sun_{k:02d}.fits")


def measure(n_trials=200):
    """Return the drift in arcsec per hour and in km/s, and a figure of the features."""
    with TemporaryDirectory() as folder:
        write_images(Path(folder), np.random.default_rng(4))
        cube = EpochCube.read(f"{folder}/sun_*.fits", frame="absolute")
    scc = StackedCrossCorrelation(
        scales=[1, 2],
        max_speed=per_distance(12 * u.km / u.s),
        detection=6,
        segmentation=4,
    )
    result = scc(cube, n_trials=n_trials, rng=1)
    table = result.components_in_c(distance=1 * u.au)
    table["west"] = table["pm_lon_coslat"].to(u.arcsec / u.hour)
    table["north"] = table["pm_lat"].to(u.arcsec / u.hour)
    for name in ("", "_err"):
        table[f"speed{name}"] = table[f"v_app{name}"]
    columns = "west", "north", "speed", "speed_err", "p_global", "n_features"
    table = brief(table, "kind", *columns)
    return table, result.plot("tracks")


if __name__ == "__main__":
    run(measure, __doc__)
