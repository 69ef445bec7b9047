# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure knots in HST-like images: counts, no beam, dates in EXPSTART.

    python examples/hubble.py
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import astropy.units as u
import numpy as np
from astropy.io import fits
from astropy.time import Time
from common import brief, run

from astro_scc import EpochCube, StackedCrossCorrelation

YEARS = np.arange(0, 12, 2)
PIXEL = 25 * u.mas


def write_images(folder, rng):
    """Write drizzled images of twelve knots that move west by a pixel a year."""
    places = np.random.default_rng(7).uniform([15, 20], [113, 200], size=(12, 2))
    y, x = np.mgrid[:128, :256]
    for year in YEARS:
        rate = np.full(x.shape, 4.0)
        for y0, x0 in places:
            rate += 60 * np.exp(-((x - x0 - year) ** 2 + (y - y0) ** 2) / 18)
        primary = fits.PrimaryHDU()
        primary.header.update(
            TELESCOP="HST", INSTRUME="ACS", TARGNAME="SIMULATED", FILTER1="CLEAR1L",
            FILTER2="F658N", EXPSTART=Time(2000.0 + year, format="jyear").mjd,
            D001SCAL=PIXEL.to_value(u.arcsec),
        )  # fmt: skip
        science = fits.ImageHDU(rng.poisson(rate).astype(np.float32), name="SCI")
        size = PIXEL.to_value(u.deg)
        science.header.update(
            CTYPE1="RA---TAN", CRVAL1=84.1, CRPIX1=128.0, CD1_1=-size, CD1_2=0.0,
            CTYPE2="DEC--TAN", CRVAL2=-6.8, CRPIX2=64.0, CD2_1=0.0, CD2_2=size,
            BUNIT="ELECTRONS",
        )  # fmt: skip
        weight = fits.ImageHDU(np.ones(x.shape, dtype=np.float32), name="WHT")
        hdus = fits.HDUList([primary, science, weight])
        hdus.writeto(folder / f"{2000 + year}_drc.fits")


def measure(n_trials=200):
    """Return the motion of the knots, and the velocity spectrum."""
    with TemporaryDirectory() as folder:
        write_images(Path(folder), np.random.default_rng(1))
        cube = EpochCube.read(f"{folder}/*_drc.fits", frame="absolute")
    scc = StackedCrossCorrelation(
        scales=[1, 2], max_speed=100 * u.mas / u.yr, detection=6, segmentation=4
    )
    result = scc(cube, n_trials=n_trials, rng=1)
    columns = "pm_ra_cosdec", "pm_dec", "pm", "pm_err", "pm_pa", "p_global"
    table = brief(result.components, "kind", *columns, "n_features", digits=1)
    return table, result.plot("spectrum")


if __name__ == "__main__":
    run(measure, __doc__)
