# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Simulate jets that are resolved across: layers of overlapping clumps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import astropy.units as u
import numpy as np

from astro_scc.images.beam import FWHM_TO_SIGMA, Beam
from astro_scc.quantities import Seed, one_quantity
from astro_scc.simulation import streams
from astro_scc.simulation.jets import JetSimulation, SimulatedJet, centred
from astro_scc.simulation.streams import Features

# The beam of the VLBA at 43 GHz in M 87.
BEAM = Beam(0.43 * u.mas, 0.21 * u.mas, -16 * u.deg)
#: Epochs, images and fluxes of it.
M87 = {
    "n_epochs": 11, "interval": 21 * u.day, "beam": BEAM, "pixel_scale": 0.06 * u.mas,
    "core": 0.5, "noise": 0.0003, "flux_variation": 0.4, "position_angle": 288 * u.deg,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Layer:
    """
    Clumps of a resolved jet that have one speed at each distance from the core.

    ``distance``, ``speed``, ``half_width`` and ``brightness`` are the columns of a
    table, linear between its rows.  Clumps appear anywhere between the first and the
    last distance, at all times, and keep their place across the jet in units of its
    half width, so that they follow its shape.

    Parameters
    ----------
    name : str
    distance : `~astropy.units.Quantity`
        Distances from the core along the axis, zero or positive and increasing.
    speed : `~astropy.units.Quantity`
        Speeds along the axis as proper motions, all positive, or all zero.
    half_width : `~astropy.units.Quantity`
        Half widths of the jet.
    brightness : `~astropy.units.Quantity`
        Median peak of a clump in the image, per beam.
    across : sequence of float, optional
        Places across the jet in half widths, such as (-1, 1) for its two limbs and
        (0,) for a spine.
    scatter : float, optional
        Standard deviation of the clumps' places about these, in half widths.
    n_clumps : float, optional
        Mean number of clumps at a time.
    size : `~astropy.units.Quantity`, shape (2,), optional
        Limits of the clumps' full widths at half maximum, uniform.
    life : `~astropy.units.Quantity`, optional
        Time from the appearance of a clump to its end; it brightens in the first
        quarter and fades in the last.  Infinite for a layer that does not move: its
        clumps are there at all epochs.
    flux_scatter : float, optional
        Standard deviation of the logarithm of the flux densities between clumps.

    Raises
    ------
    ValueError
        If a parameter is outside its range, the columns differ in length, or a layer
        that moves has clumps without an end.
    `~astropy.units.UnitConversionError`
        If a unit does not fit.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.simulation import Layer
    >>> spine = Layer("spine", distance=[0, 2, 8] * u.mas,
    ...               speed=[1, 8, 10] * u.mas / u.yr,
    ...               half_width=[0.1, 0.4, 0.9] * u.mas,
    ...               brightness=[50, 20, 5] * u.mJy / u.beam)
    >>> spine.n_clumps, spine.across
    (100, (0.0,))
    """

    name: str
    distance: u.Quantity
    speed: u.Quantity
    half_width: u.Quantity
    brightness: u.Quantity
    across: Sequence[float] = (0.0,)
    scatter: float = 0.1
    n_clumps: float = 100
    size: u.Quantity = (0.1, 0.3) * u.mas
    life: u.Quantity = 0.5 * u.yr
    flux_scatter: float = 0.5

    def __post_init__(self):
        whose, life = f"layer {self.name!r}: ", u.Quantity(self.life).to_value(u.yr)
        size = u.Quantity(self.size).to_value(u.mas)
        units = {
            "distance": u.mas, "speed": u.mas / u.yr, "half_width": u.mas,
            "brightness": u.Jy / u.beam,
        }  # fmt: skip
        columns = {k: u.Quantity(getattr(self, k)).to_value(units[k]) for k in units}
        numbers = "scatter n_clumps flux_scatter size"
        streams.check_not_negative(self, f"{numbers} {' '.join(columns)}", whose)
        distance, speed = columns["distance"], columns["speed"]
        if any(column.shape != (distance.size,) for column in columns.values()):
            raise ValueError(f"{whose}{', '.join(columns)} must have one length")
        if distance.size < 2 or not np.all(np.diff(distance) > 0):
            raise ValueError(f"{whose}distance must increase, got {self.distance}")
        if speed.min() == 0 < speed.max():
            raise ValueError(f"{whose}speed must be positive, or zero everywhere")
        if size.shape != (2,) or np.diff(size) < 0:
            raise ValueError(f"{whose}size must be two limits, got {self.size}")
        if len(self.across) == 0:
            raise ValueError(f"{whose}across needs one place or more")
        if life.shape or not 0 < life or (np.isinf(life) and speed.any()):
            wanted = "life must be positive, and finite for a layer that moves"
            raise ValueError(f"{whose}{wanted}, got {self.life}")

    def features(self, jet: JetSimulation, rng: np.random.Generator) -> Features:
        """
        Draw the clumps and follow them over the epochs.

        Parameters
        ----------
        jet : `JetSimulation`
        rng : `numpy.random.Generator`

        Returns
        -------
        Features
        """
        scale, interval = jet.pixel_scale.to_value(u.mas), jet.interval.to_value(u.yr)
        table = self.distance.to_value(u.mas)
        times, life = jet.times * interval, self.life.to_value(u.yr)
        span = times[-1] if np.isfinite(life) else 0.0
        # Clumps are born in the series of epochs, and in a life before it.
        share = 1 + span / life
        n = rng.poisson(self.n_clumps * share)
        age = np.zeros((n, times.size))
        if np.isfinite(life):
            age = times - rng.uniform(-1, span / life, (n, 1)) * life
        r = self._moved(rng.uniform(table[0], table[-1], (n, 1)), age)
        if np.isfinite(life):
            r = np.where((age > 0) & (age < life), r, np.nan)
        place = rng.choice(self.across, (n, 1)) + self.scatter * rng.normal(size=(n, 1))
        fwhm = rng.uniform(*self.size.to_value(u.mas), (n, 1))
        fading = streams.RAMP * jet.beam_length * scale
        there = streams.raised_cosine((table[-1] - r) / fading)
        if np.isfinite(life):
            # It appears in the first quarter of its life, and fades in the last.
            part = np.minimum(age, life - age) / (0.25 * life)
            there = there * streams.raised_cosine(part)
        peak = np.interp(r, table, self.brightness.to_value(u.Jy / u.beam)) * there
        peak = peak * np.exp(self.flux_scatter * rng.standard_normal((n, 1)))
        beams = np.mean([b.covariance.to_value(u.mas**2) for b in jet.beams], axis=0)
        total = beams + (FWHM_TO_SIGMA * fwhm)[..., None, None] ** 2 * np.eye(2)
        flux = peak * np.sqrt(np.linalg.det(total) / np.linalg.det(beams))
        y = place * np.interp(r, table, self.half_width.to_value(u.mas))
        flux = np.nan_to_num(flux)
        seen = (flux > 0).any(axis=1)
        x, y = jet.extent[0] + r / scale, jet.axis + y / scale
        return streams.in_view(self.name, seen, x, y, flux, fwhm / scale)

    def _moved(self, start, age):
        """Return distances at ages in years of clumps that were born at ``start``."""
        table, speed = self.distance.to_value(u.mas), self.speed.to_value(u.mas / u.yr)
        if not speed.any():
            return start + np.zeros_like(age)
        rows = np.arange(len(table))
        # Steps in which clumps move, 50 for each interval of the table.
        grid = np.interp(np.linspace(0, rows[-1], 50 * rows[-1] + 1), rows, table)
        slowness = 1 / np.interp(grid, table, speed)
        steps = 0.5 * (slowness[1:] + slowness[:-1]) * np.diff(grid)
        passed = np.concatenate([[0], np.cumsum(steps)])
        return np.interp(np.interp(start, grid, passed) + age, passed, grid)


def m87_layers(*, length: u.Quantity = 10 * u.mas) -> tuple[Layer, Layer]:
    """
    Return two layers after the inner jet of M 87 at 43 GHz.

    Its limbs move with 0.3 c, and the layer between them with 0.3 c at 0.5 mas, 2.3 c
    at 2 mas and 2.7 c at 20 mas; 1 mas/yr is 0.264 c.  The half width of the jet grows
    with the distance to the power 0.6.

    Parameters
    ----------
    length : `~astropy.units.Quantity`, optional

    Returns
    -------
    tuple of `Layer`
        ``slow`` and ``fast``.

    Raises
    ------
    ValueError
        If the length is no angle of more than 0.5 mas.

    Examples
    --------
    >>> from astro_scc.simulation import m87_layers
    >>> slow, fast = m87_layers()
    >>> fast.speed[[0, -1]].round(1)
    <Quantity [1.1, 9.4] mas / yr>
    """
    length = one_quantity(length, "an angle", "10 mas").to_value(u.mas)
    if length <= 0.5:
        raise ValueError(f"length must be above 0.5 mas, got {length:g} mas")
    r = np.geomspace(0.1, length, 100)
    slow = 0.3 / 0.264
    fast = np.interp(r, [0.5, 2.0, 20.0], np.array([0.3, 2.3, 2.7]) / 0.264)
    shape = {
        "distance": r * u.mas, "half_width": 0.2 * r**0.6 * u.mas,
        "brightness": 40 * (1 + r / 0.5) ** -0.9 * u.mJy / u.beam,
    }  # fmt: skip
    return (
        Layer("slow", speed=np.full(100, slow) * u.mas / u.yr, across=(-1, 1),
              n_clumps=12 * length, life=1.5 * u.yr, **shape),
        Layer("fast", speed=fast * u.mas / u.yr, scatter=0.4, n_clumps=8 * length,
              life=0.4 * u.yr, **shape),
    )  # fmt: skip


def simulate_resolved_jet(
    *, layers: Sequence[Layer] | None = None, memory: u.Quantity = 0.3 * u.yr,
    rng: Seed | None = None, **options: Any,
) -> SimulatedJet:  # fmt: skip
    """
    Simulate a jet that is resolved across, of layers that move at different speeds.

    The clumps of a layer overlap, live and fade.  The defaults are those of M 87 at
    43 GHz in 11 epochs; it has also been observed in 14 epochs at 5 days, 24 at 8 days
    and 17 yearly ones.

    Parameters
    ----------
    layers : sequence of `Layer`, optional
        By default those of `m87_layers`.
    memory : `~astropy.units.Quantity`, optional
        Correlation time of the variations of flux densities; at 0, they are white.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.
    **options
        Of `JetSimulation`, with other defaults: ``n_epochs`` 11, ``interval`` 21 d, or
        ``dates``, ``beam`` that of the VLBA at 43 GHz, ``pixel_scale`` 0.06 mas,
        ``core`` 0.5 Jy, ``noise`` 0.0003 Jy per beam, ``flux_variation`` 0.4, and
        ``position_angle`` 288 deg.

    Returns
    -------
    ``SimulatedJet``
        Its ``cube``, and ``truth`` with a row for each clump and epoch; the group
        of a clump is its layer.

    Raises
    ------
    ValueError
        If a parameter is outside its range.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_resolved_jet
    >>> jet = simulate_resolved_jet(n_epochs=3, rng=1)
    >>> len(jet.cube), sorted(set(jet.truth["group"].tolist()))
    (3, ['core', 'fast', 'slow'])

    Nothing moves in a movie of the same layers without speeds:

    >>> from dataclasses import replace
    >>> from astro_scc.simulation import m87_layers
    >>> still = [replace(layer, speed=0 * layer.speed) for layer in m87_layers()]
    >>> jet = simulate_resolved_jet(layers=still, n_epochs=3, rng=1)
    """
    layers = m87_layers() if layers is None else layers
    if isinstance(layers, Layer) or len(layers) == 0:
        raise ValueError("layers: give a sequence of Layer, at least one Layer")
    given = M87 | options
    given["memory"] = (memory / given["interval"]).to_value(u.one)
    jet = JetSimulation(layers, "resolved jet", beams=given.pop("beam"), **given)
    ends = [u.Quantity([a.distance[-1], a.half_width.max()]) for a in layers]
    end, width = (u.Quantity(ends) / jet.pixel_scale).to_value(u.one).max(axis=0)
    return centred(jet, end, margin=width + 4 * jet.beam_length).run(rng=rng)
