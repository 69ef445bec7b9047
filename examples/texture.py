# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Measure the known shift of a random texture that moves as a whole.

    python examples/texture.py
"""

import astropy.units as u
import numpy as np
from astropy.time import Time, TimeDelta
from common import brief, run
from scipy.ndimage import gaussian_filter, shift

from astro_scc import EpochCube, StackedCrossCorrelation

#: Motion to the west and to the north per image, in pixels.
STEP = np.array([1.3, 0.4])
PIXEL = 0.5 * u.arcsec
CADENCE = 1 * u.h
#: Noise, in units of the scatter of the texture.
NOISE = 0.2
SIZE, MARGIN = 80, 16


def simulate(rng, n_epochs=6):
    """Return noisy images of a texture that moves by `STEP` from each to the next."""
    texture = gaussian_filter(rng.normal(size=[SIZE + 2 * MARGIN] * 2), 2.5)
    texture /= texture.std()
    images = [shift(texture, k * STEP[::-1]) for k in range(n_epochs)]
    images = np.array(images)[:, MARGIN:-MARGIN, MARGIN:-MARGIN]
    return EpochCube.from_arrays(
        images + rng.normal(0, NOISE, images.shape),
        Time("2024-05-10") + TimeDelta(np.arange(n_epochs) * CADENCE),
        pixel_scale=PIXEL, unit="adu", noise=np.full(n_epochs, NOISE) * u.adu,
    )  # fmt: skip


def measure(n_trials=200):
    """Return the motion beside the true one, and a figure of all velocities."""
    # No part of the images is empty, so their noise is not measured in them.
    scc = StackedCrossCorrelation(max_speed=3 * PIXEL / CADENCE, noise="propagated")
    result = scc(simulate(np.random.default_rng(1)), n_trials=n_trials, rng=1)
    found = result.components
    motion = STEP * PIXEL / CADENCE
    table = found["kind", "p_global", "n_features"]
    for name, sign, column, true in (
        ("west", -1, "pm_ra_cosdec", motion[0]),
        ("north", 1, "pm_dec", motion[1]),
    ):
        table[f"true_{name}"] = true
        table[name] = (sign * found[column]).to(true.unit)
        table[f"{name}_err"] = found[f"{column}_err"].to(true.unit)
    columns = "true_west", "west", "west_err", "true_north", "north", "north_err"
    table = brief(table, "kind", *columns, "p_global", "n_features", digits=3)
    return table, result.plot("velocity_map")


if __name__ == "__main__":
    run(measure, __doc__)
