# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure two speeds along simulated jets that bend by 70 degrees.

``profiles.py --only bent`` runs this module.
"""

from dataclasses import replace

import astropy.units as u
import numpy as np
from common import PM_UNIT, measured, plain, write_table

from astro_scc import Beam, EpochCube, StackedCrossCorrelation
from astro_scc.components.restoring import add_gaussians
from astro_scc.epochs import distance_mask
from astro_scc.kinematics import find_ridge_line

RADIUS, SPEEDS = 16.0, (0.5, 1.4)
NAMES = ("ridge line", "position angle")


def bent_jets(args):
    """Measure the speeds along the ridge line and along one position angle."""
    found = {name: [] for name in NAMES}
    for seed in range(args.seed, args.seed + args.n_jets):
        cube = bent_images(seed)
        scc = StackedCrossCorrelation(scales=[1, 2], max_speed=2.2 * PM_UNIT)
        line = find_ridge_line(
            cube, position_angle=270 * u.deg, half_width=2 * u.mas,
            smoothing=3 * u.mas,
        )  # fmt: skip
        part = distance_mask(cube, 2 * u.mas, 17 * u.mas)
        cells = [seed]
        for name, axes in zip(NAMES, (line, 300 * u.deg), strict=True):
            own = replace(scc, position_angle=axes)
            table = own(cube, region=part, n_trials=args.n_trials, rng=seed).streams
            moving = table[table["kind"] == "moving"]
            each = [_nearest(moving, speed) for speed in SPEEDS]
            found[name].append(each)
            cells += ["" if np.isnan(v) else measured(v, e) for v, e in each]
        print(*cells, sep="  ", flush=True)
    summary(found)


def _nearest(table, speed):
    """Return the moving component nearest to a speed, if within a third of it."""
    values = [
        (plain(row["pm_parallel"], PM_UNIT), plain(row["pm_parallel_err"], PM_UNIT))
        for row in table
        if abs(plain(row["pm_parallel"], PM_UNIT) - speed) < speed / 3
    ]
    return min(values, key=lambda p: abs(p[0] - speed), default=(np.nan, np.nan))


def summary(found):
    """Write how often each stream is found, and with which errors."""
    rows = []
    for name in NAMES:
        values = np.array(found[name])
        for k, speed in enumerate(SPEEDS):
            v, e = values[:, k].T
            seen = np.isfinite(v)
            cells = [name, speed, f"{seen.sum()} of {len(v)}"]
            if seen.sum() > 1:
                v, e = v[seen], e[seen]
                pull = (v - speed) / e
                cells += [
                    measured(v.mean(), v.std(ddof=1) / np.sqrt(len(v)), 3),
                    f"{v.std(ddof=1):.3f}", f"{np.median(e):.3f}",
                    f"{pull.mean():+.2f}", f"{np.sqrt((pull**2).mean()):.2f}",
                    f"{np.mean(np.abs(pull) <= 1):.2f}",
                    f"{np.mean(np.abs(pull) <= 2):.2f}",
                ]  # fmt: skip
            rows.append(cells + [""] * (10 - len(cells)))
    header = ["axes", "put in (mas/yr)", "found", "mean (mas/yr)", "scatter",
              "median error", "off / error, mean", "rms", "within 1",
              "within 2"]  # fmt: skip
    write_table("profile_bent_summary", header, rows)


def bent_images(seed, n_epochs=10):
    """Simulate features at two speeds along a circle from west to north."""
    rng = np.random.default_rng(seed)
    beam = Beam(1 * u.mas, 1 * u.mas)
    cube = EpochCube.from_arrays(
        np.zeros((n_epochs, 200, 220)),
        [f"{2000 + i}-01-01" for i in range(n_epochs)],
        pixel_scale=0.1 * u.mas, unit=u.Jy / u.beam, beams=beam,
        noise=0.002 * u.Jy / u.beam, reference_pixel=(25, 25),
    )  # fmt: skip
    end = RADIUS * np.radians(70)
    years = cube.years.to_value(u.yr)
    for speed, spread in zip(SPEEDS, (0.9, 0.3), strict=True):
        n = int(1.0 * (end + speed * years[-1]))
        start = rng.uniform(-speed * years[-1], end, n)
        off, peak = rng.normal(0, spread, n), rng.uniform(0.3, 1.5, n)
        for image, year in zip(cube.data, years, strict=True):
            s = start + speed * year + rng.normal(0, 0.05, n)
            seen = (s > 0) & (s < end)
            t, r = s / RADIUS, RADIUS - off
            x, y = cube.offset_to_pixel(-r * np.sin(t) * u.mas,
                                        (RADIUS - r * np.cos(t)) * u.mas)  # fmt: skip
            covariance = np.broadcast_to(4.6**2 * np.eye(2), (seen.sum(), 2, 2))
            add_gaussians(image, x[seen], y[seen], peak[seen], covariance)
    cube.data[:] += rng.normal(0, 0.002, cube.data.shape)
    return cube
