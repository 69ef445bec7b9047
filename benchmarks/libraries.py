# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Compare core positions and detected features of the package with those of photutils.

Cores of 1 Jy in a beam of 9 x 6 pixels have a feature of several flux densities at
several distances downstream and fainter features beyond; the signal-to-noise ratio is
300.  Patterns are those of the wavelet planes of the paper's two-fluid jet, whose
features are known::

    python benchmarks/libraries.py
"""

import time
import warnings

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time
from common import write_table
from photutils.centroids import centroid_2dg, centroid_com, centroid_quadratic
from photutils.detection import find_peaks
from photutils.psf import GaussianPSF, PSFPhotometry
from photutils.segmentation import SourceCatalog, deblend_sources, detect_sources
from scipy.spatial import KDTree

from astro_scc.decomposition import Decomposer
from astro_scc.decomposition.segmentation import find_ssps
from astro_scc.epochs import Beam, ComponentList, core_positions, restore
from astro_scc.simulation import simulate_two_fluid

BEAM = Beam(0.9 * u.mas, 0.6 * u.mas, -10 * u.deg)
PIXEL = 0.1 * u.mas
N_CORES = 20
#: Distance in beams and flux density in Jy of the feature nearest to the core.
NEIGHBOURS = ((1.0, 0.0), (0.5, 0.3), (0.5, 1.0), (0.7, 2.0), (1.0, 1.0), (1.2, 4.0))
#: Largest distance of a match in pixels, half the beam of the two-fluid jet.
NEAR = 5.0


def cores(distance, flux, rng):
    """Simulate images of cores at random subpixel positions; return both."""
    pa = rng.uniform(0, 2 * np.pi, N_CORES)
    core = rng.uniform(-0.05, 0.05, (2, N_CORES))
    fwhm = BEAM.fwhm_along(pa * u.rad).value
    r = fwhm * np.add.outer(
        [0, distance, distance + 2, distance + 4], np.zeros(N_CORES)
    )
    r[0] = 0
    listed = ComponentList(
        times=Time(2000 + 0.1 * np.arange(N_CORES), format="jyear"),
        epoch=np.tile(np.arange(N_CORES), 4),
        flux=np.repeat([1, flux, 0.15, 0.08], N_CORES) * u.Jy,
        east=(core[0] + r * np.sin(pa)).ravel() * u.mas,
        north=(core[1] + r * np.cos(pa)).ravel() * u.mas,
    )
    noise = 1 / 300 * u.Jy / u.beam
    grid = {"shape": (128, 128), "reference_pixel": (64, 64)}
    cube = restore(listed, beam=BEAM, pixel_scale=PIXEL, noise=noise, rng=rng, **grid)
    return cube, pa, core, fwhm


def psf_of(cube):
    """Return the beam as a photutils model, and its major axis in pixels."""
    to_pixels = np.linalg.inv(cube.pixel_matrix.to_value(u.mas))
    covariance = to_pixels @ BEAM.covariance.to_value(u.mas**2) @ to_pixels.T
    variance, axes = np.linalg.eigh(covariance)
    minor, major = np.sqrt(8 * np.log(2) * variance)
    theta = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
    return GaussianPSF(x_fwhm=major, y_fwhm=minor, theta=theta), major


def by_photutils(image, start, direction, psf, fwhm):
    """Return functions that measure the core's position, one per method."""
    x, y = np.rint(start).astype(int)
    half = int(np.ceil(1.5 * fwhm))
    box = image[y - half : y + half + 1, x - half : x + half + 1]
    corner = np.array([x - half, y - half])
    fit = PSFPhotometry(psf, (2 * half + 1,) * 2, aperture_radius=fwhm / 2)

    def fitted(guess):
        guess = np.array(guess)
        n = len(guess)
        init = QTable({"x": guess[:, 0], "y": guess[:, 1], "group_id": np.ones(n, int)})
        found = fit(image, init_params=init)
        place = np.stack([found["x_fit"], found["y_fit"]], axis=1)
        bright = found["flux_fit"] >= 0.1 * np.max(found["flux_fit"])
        return place[np.argmin(np.where(bright, place @ direction, np.inf))]

    step = fwhm * direction
    return {
        "centroid_com": lambda: centroid_com(box) + corner,
        "centroid_quadratic": lambda: centroid_quadratic(image, xpeak=x, ypeak=y),
        "centroid_2dg": lambda: centroid_2dg(box) + corner,
        "PSFPhotometry": lambda: fitted([start]),
        "PSFPhotometry of two": lambda: fitted(
            [start - 0.1 * step, start + 0.4 * step]
        ),
    }


def core_table():
    """Return errors and times of all methods, one row each."""
    errors, spent = {}, {}
    for distance, flux in NEIGHBOURS:
        cube, pa, core, fwhm = cores(distance, flux, np.random.default_rng(1))
        true = np.stack(cube.offset_to_pixel(*core * u.mas), axis=1)
        psf, width = psf_of(cube)
        found = {}
        for i, image in enumerate(cube.data):
            start = time.perf_counter()
            row = core_positions(cube[i : i + 1], jet_pa=pa[i] * u.rad)[0]
            spent.setdefault("core_positions", []).append(time.perf_counter() - start)
            place = np.array(cube.offset_to_pixel(row["east"], row["north"]))
            found.setdefault("core_positions", []).append(place)
            peak = np.unravel_index(np.argmax(image), image.shape)[::-1]
            found.setdefault("brightest pixel", []).append(peak)
            direction = np.array([-np.sin(pa[i]), np.cos(pa[i])])
            # Like core_positions, start from the maximum farthest upstream.
            maxima = find_peaks(image, 0.1 * image.max(), box_size=5)
            maxima = np.stack([maxima["x_peak"], maxima["y_peak"]], axis=1).astype(
                float
            )
            first = maxima[np.argmin(maxima @ direction)]
            ways = by_photutils(image, first, direction, psf, width)
            for name, way in ways.items():
                start = time.perf_counter()
                found.setdefault(name, []).append(way())
                spent.setdefault(name, []).append(time.perf_counter() - start)
        for name, places in found.items():
            off = np.hypot(*(np.array(places, dtype=float) - true).T)
            off = off * PIXEL.to_value(u.mas) / fwhm
            errors.setdefault(name, []).append(
                f"{np.median(off):.3f} ({off.max():.2f})"
            )
    head = ["way", *(f"{f:g} Jy at {d:g}" for d, f in NEIGHBOURS), "time (ms)"]
    rows = [
        [name, *values, f"{1e3 * np.median(spent[name]):.1f}" if name in spent else "0"]
        for name, values in errors.items()
    ]
    return head, rows


def segments(plane, noise):
    """Return the maxima of the segments that photutils detects and deblends."""
    found = detect_sources(plane, 3 * noise, 5, connectivity=4)
    found = deblend_sources(plane, found, 5, connectivity=4, progress_bar=False)
    catalogue = SourceCatalog(plane, found)
    return catalogue.max_value_index[catalogue.max_value >= 4 * noise]


def ssps(scale):
    """Return a function that finds the maxima of the SSPs of a plane."""

    def find(plane, noise):
        found = find_ssps(plane, scale, noise)
        return np.stack([found.y, found.x], axis=1)

    return find


def pattern_table():
    """Return the features of the two-fluid jet found, a row per method and scale."""
    jet = simulate_two_fluid(rng=1)
    head = ["way", "scale", "patterns an epoch", "features found",
            "patterns at a feature", "distance (pixels)", "time (ms)"]  # fmt: skip
    rows = []
    for scale in (1, 2, 3):
        ways = {"find_ssps": ssps(scale), "detect_sources, deblend_sources": segments}
        for name, way in ways.items():
            found = []
            for epoch, image in enumerate(jet.cube.data):
                result = Decomposer(scales=[scale])(image)
                here = jet.truth[(jet.truth["epoch"] == epoch) & jet.truth["visible"]]
                true = np.stack([here["y"], here["x"]], axis=1)
                start = time.perf_counter()
                place = way(result.planes[0].astype(float), float(result.noise[0]))
                spent = 1e3 * (time.perf_counter() - start)
                off, _ = KDTree(place).query(true)
                back, _ = KDTree(true).query(place)
                near = off < NEAR
                shares = near.mean(), np.mean(back < NEAR), np.median(off[near])
                found.append([len(place), *shares, spent])
            n, complete, pure, off, spent = np.median(found, axis=0)
            rows.append(
                [name, scale, f"{n:.0f}", f"{complete:.0%}", f"{pure:.0%}",
                 f"{off:.1f}", f"{spent:.0f}"]
            )  # fmt: skip
    return head, rows


def main():
    """Measure, print and write both tables."""
    with warnings.catch_warnings():
        # Failed fits of photutils, of which it warns, show up in the errors.
        warnings.simplefilter("ignore")
        for name, rows in (
            ("libraries_cores", core_table()),
            ("libraries_patterns", pattern_table()),
        ):
            write_table(name, *rows)


if __name__ == "__main__":
    main()
