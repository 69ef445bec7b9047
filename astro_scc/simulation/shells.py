# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images of a shell that expands at one rate on small scales and another on large."""

from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.restoring import add_gaussians

__all__ = ["SimulatedShell", "simulate_shell"]

FWHM_TO_SIGMA = 1 / np.sqrt(8 * np.log(2))


@dataclass(frozen=True, eq=False, repr=False)
class SimulatedShell:
    """
    A simulated shell: its images and what is in them.

    Attributes
    ----------
    cube : `~astro_scc.epochs.EpochCube`
        Counts, without beam.
    truth : `~astropy.table.QTable`
        A row for each feature: ``group`` ("knots" or "ring"), ``east`` and
        ``north`` from the centre at the first epoch, ``fwhm``, ``rate``.
    centre : `~astropy.units.Quantity`, shape (2,)
        (east, north) from the reference pixel.
    radius : `~astropy.units.Quantity`

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.simulation import simulate_shell
    >>> shell = simulate_shell(n_epochs=2, radius=30 * u.arcsec, size=128, rng=1)
    >>> len(shell.cube), shell.radius, shell.truth["rate"].unit
    (2, <Quantity 30000. mas>, Unit("% / yr"))
    """

    cube: EpochCube
    truth: QTable
    centre: u.Quantity
    radius: u.Quantity

    def __repr__(self):
        return f"<SimulatedShell: {len(self.cube)} epochs, {len(self.truth)} features>"


def simulate_shell(
    *,
    knot_rate=0.11 * u.percent / u.yr,
    ring_rate=0.07 * u.percent / u.yr,
    n_epochs=6,
    interval=5 * u.yr,
    n_knots=50,
    n_clumps=24,
    radius=100 * u.arcsec,
    pixel_scale=1 * u.arcsec,
    centre=(6.0, -4.0) * u.arcsec,
    size=288,
    counts=400.0,
    background=20.0,
    rng=None,
):
    """
    A shell with small knots and a ring of large clumps, each at its own rate.

    Cassiopeia A is like this: its radio ring expands at 0.07 per cent a
    year, small structure in it at 0.11.  Features keep their size; noise is
    that of Poisson counts, and there is no beam.

    Parameters
    ----------
    knot_rate, ring_rate : `~astropy.units.Quantity`, optional
        Part of the distance from the centre that is moved in a time, at the
        first epoch; motion is uniform, so at the mean of two dates, t after
        the first, the rate e is ``e / (1 + e t)``.
    n_epochs : int, optional
    interval : `~astropy.units.Quantity`, optional
    n_knots, n_clumps : int, optional
    radius : `~astropy.units.Quantity`, optional
        Of the ring; knots are at 0.6 to 1.05 of it.
    pixel_scale : `~astropy.units.Quantity`, optional
    centre : `~astropy.units.Quantity`, shape (2,), optional
        (east, north) from the reference pixel, the middle of the image.
    size : int, optional
        Pixels on a side of the image.
    counts, background : float, optional
        Counts in a pixel: knots have 0.4 to 1 of them at their maximum,
        clumps 0.6 to 1; and everywhere.
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    `SimulatedShell`

    Raises
    ------
    ValueError
        If there are fewer than two epochs, or the shell is larger than the
        image.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_shell
    >>> simulate_shell(n_epochs=2, rng=1).cube.shape
    (2, 288, 288)
    """
    if n_epochs < 2:
        raise ValueError(f"n_epochs must be at least 2, got {n_epochs}")
    step = u.Quantity(pixel_scale).to_value(u.mas)
    r = u.Quantity(radius).to_value(u.mas)
    middle = u.Quantity(centre).to(u.mas)
    if 1.2 * r + np.abs(middle.value).max() > 0.5 * size * step:
        raise ValueError(f"a shell of {radius} is larger than {size} pixels can show")
    rng = np.random.default_rng(rng)
    n = n_knots + n_clumps
    knot = np.arange(n) < n_knots
    angle = rng.uniform(0, 2 * np.pi, n)
    angle[~knot] = 2 * np.pi * (np.arange(n_clumps) + rng.uniform(0, 0.7, n_clumps))
    angle[~knot] /= n_clumps
    # Evenly over the area of the ring, for knots.
    inner, outer = 0.6**2, 1.05**2
    distance = np.where(
        knot, r * np.sqrt(rng.uniform(inner, outer, n)), r * rng.normal(1, 0.03, n)
    )
    east, north = distance * np.sin(angle), distance * np.cos(angle)
    fwhm = np.where(knot, rng.uniform(3, 5, n), rng.uniform(16, 24, n))
    peak = counts * np.where(knot, rng.uniform(0.4, 1.0, n), rng.uniform(0.6, 1.0, n))
    per_year = 1 / u.yr
    rate = np.where(
        knot,
        u.Quantity(knot_rate).to_value(per_year),
        u.Quantity(ring_rate).to_value(per_year),
    )
    times = Time("1980-01-01") + np.arange(n_epochs) * interval
    years = (times - times[0]).to_value(u.yr)
    images = np.empty((n_epochs, size, size))
    covariance = (FWHM_TO_SIGMA * fwhm)[:, None, None] ** 2 * np.eye(2)
    origin = (size - 1) / 2
    for image, year in zip(images, years, strict=True):
        image[:] = background
        grown = 1 + rate * year
        x = origin - (middle[0].value + grown * east) / step
        y = origin + (middle[1].value + grown * north) / step
        add_gaussians(image, x, y, peak, covariance)
        image[:] = rng.poisson(image)
    cube = EpochCube.from_arrays(images, times, pixel_scale=pixel_scale)
    truth = QTable(
        {
            "group": np.where(knot, "knots", "ring"),
            "east": east * u.mas,
            "north": north * u.mas,
            "fwhm": fwhm * step * u.mas,
            "rate": (rate * per_year).to(u.percent / u.yr),
        }
    )
    return SimulatedShell(cube, truth, middle, r * u.mas)
