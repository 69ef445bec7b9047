# Licensed under a 3-clause BSD style license - see LICENSE.rst
# ruff: noqa: E402
"""
Count the secure features of jets whose core and knots are elongated.

    python benchmarks/elongated.py [--jets 100] [--seed 0] [--jobs 2]

Each jet has a core and five knots that move by a third of a beam between two of seven
epochs.  All are Gaussians of one shape, 1 to 2 times as long as the beam along its
major axis or across it (``total``), or of their own shape, 1 to 2 times as long as wide
at any angle (``intrinsic``); ``beam`` are points in images whose headers have a beam
that is up to 4% too large or too small on each axis.  The third brightest knot has 20
to 2000 times the noise.  A jet is right if it has as many secure features as knots, and
the speed of each is within 10% or two errors of the true one.
"""

import argparse
import os
import warnings
from concurrent.futures import ProcessPoolExecutor
from functools import partial

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import astropy.units as u
import numpy as np
from common import print_table
from scipy.ndimage import gaussian_filter

from astro_scc import Beam, EpochCube
from astro_scc.features import find_features

KINDS = "total", "intrinsic", "beam"
N_EPOCHS, SHAPE, CORE = 7, (112, 176), (34.0, 56.0)
#: Places of the knots in beams along the jet and across it, and their fluxes.
KNOTS = np.array(
    [(2, -0.5, 0.5), (5, 0.7, 0.35), (7.8, -0.7, 0.3), (11, 0.3, 0.25), (14, -0.3, 0.2)]
)
PIXEL, FWHM = 0.1 * u.mas, np.sqrt(8 * np.log(2))
#: Signal-to-noise ratios and elongations at which the table is divided.
RATIOS, ELONGATIONS = (20, 93, 431, 2000), (1, 1.33, 1.67, 2)


def jet(kind, seed):
    """Return a cube, the speed of its knots in mas/yr, and what the table divides."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    ratio, elongation = 20 * 100 ** rng.random(), 1 + rng.random()
    # Along y, the major axis, and along x, the direction of the jet.
    beam = np.array([[6.0, 6.0], [10.0, 5.5]][rng.integers(2)])
    shape, given = np.diag(beam**2), beam
    if kind == "total":
        axis = rng.integers(2)
        shape[axis, axis] *= elongation**2
    elif kind == "intrinsic":
        size, angle = rng.uniform(0.25, 0.8) * beam.min(), rng.uniform(0, np.pi)
        long, wide = np.array([np.sin(angle), np.cos(angle)]), size / elongation
        shape += wide**2 * np.eye(2) + (size**2 - wide**2) * np.outer(long, long)
    else:
        given = beam * rng.uniform(0.96, 1.04, 2)
        elongation = 1.0
    step = rng.uniform(0.3, 0.4) * beam[1]
    noise, inverse = KNOTS[2, 2] / ratio, np.linalg.inv(shape / FWHM**2)
    place = KNOTS[:, 1::-1] * (beam[0], 6.0) + rng.uniform(-1, 1, (5, 2))
    data, offset = np.zeros((N_EPOCHS, *SHAPE)), np.indices(SHAPE) - 0.0
    for k, image in enumerate(data):
        fluxes = KNOTS[:, 2] * rng.normal(1, 0.1, 5)
        places = np.vstack([(0, 0), place + (0, step * k)]) + CORE[::-1]
        for (y, x), flux in zip(places, (1, *fluxes), strict=True):
            off = offset - np.array([y, x])[:, None, None]
            image += flux * np.exp(-np.einsum("iyx,ij,jyx->yx", off, inverse, off) / 2)
        error = gaussian_filter(rng.normal(size=SHAPE), beam / FWHM)
        image += noise * error / error.std()
    cube = EpochCube.from_arrays(
        data, [f"{2000 + k}-01-01" for k in range(N_EPOCHS)], pixel_scale=PIXEL,
        reference_pixel=CORE, unit=u.Jy / u.beam,
        beams=Beam(*sorted(given * PIXEL, reverse=True),
                   (0 if given[0] >= given[1] else 90) * u.deg),
    )  # fmt: skip
    return cube, step * PIXEL.value, ratio, elongation


def counted(kind, seed):
    """Return what the table divides, the number of secure features, of right ones."""
    cube, speed, ratio, elongation = jet(kind, seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        features = find_features(cube)
    own = [m for m, is_secure in zip(features.motions, features.secure, strict=True)
           if is_secure]  # fmt: skip
    right = [abs(m.speed - speed) <= max(0.1 * speed, 2 * m.speed_err) for m in own]
    return ratio, elongation, len(own), sum(right)


def main():
    """Write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("--jets", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    rows, seeds = [], range(args.seed, args.seed + args.jets)
    with ProcessPoolExecutor(args.jobs) as pool:
        for kind in KINDS:
            each = np.array(list(pool.map(partial(counted, kind), seeds)))
            ratio, elongation, secure, right = each.T
            good = (secure == len(KNOTS)) & (right == secure)
            row = [kind, args.jets, f"{good.mean():.2f}", f"{secure.mean():.2f}",
                   f"{right.sum() / secure.sum():.2f}"]  # fmt: skip
            for value, edges in ((ratio, RATIOS), (elongation, ELONGATIONS)):
                part = np.clip(np.searchsorted(edges, value) - 1, 0, 2)
                row += [f"{good[part == k].mean():.2f}" if np.any(part == k) else ""
                        for k in range(3)]  # fmt: skip
            rows.append(row)
    header = ["jets", "number", "right", "secure features of 5", "right features"]
    for word, edges in (("S/N", RATIOS), ("elongation", ELONGATIONS)):
        header += [f"{word} {edges[k]} to {edges[k + 1]}" for k in range(3)]
    print_table(header, rows)


if __name__ == "__main__":
    main()
