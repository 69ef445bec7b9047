# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Simulators: the paper's jets, those of surveys and of M 87, an expanding shell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from types import SimpleNamespace
from typing import Any, NamedTuple

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.restoring import add_gaussians
from astro_scc.images.beam import FWHM_TO_SIGMA, Beam
from astro_scc.quantities import Seed, random_generator
from astro_scc.simulation.jets import (
    JetSimulation,
    SimulatedJet,
    centred,
    require_epochs,
)
from astro_scc.simulation.streams import (
    Flow,
    Layer,
    Stream,
    check_not_negative,
    m87_layers,
)

#: Epochs, fluxes and beam (about that of the VLBA at 15 GHz) of a jet as surveys of
#: blazars see it.
SURVEYED = {
    "n_epochs": 15, "interval": 0.2 * u.yr, "beam": Beam(0.8 * u.mas, 0.8 * u.mas),
    "core_flux": 1.0, "noise": 0.0003, "flux_variation": 0.35, "memory": 3.0,
}  # fmt: skip
#: Those of a jet resolved across, as the VLBA sees M 87 at 43 GHz.
M87 = {
    "n_epochs": 11, "interval": 21 * u.day, "pixel_scale": 0.06 * u.mas,
    "beam": Beam(0.43 * u.mas, 0.21 * u.mas, -16 * u.deg),
    "core": 0.5, "noise": 0.0003, "flux_variation": 0.4, "position_angle": 288 * u.deg,
}  # fmt: skip


def _run(name, rng, options, *streams):
    return JetSimulation(streams, **{"name": name, **options}).run(rng=rng)


def simulate_two_fluid(
    *, slow: float | u.Quantity = 5.0, fast: float | u.Quantity = 20.0,
    densities: tuple[float, float] | None = None, dense: bool = False,
    jitter: float = 2.0, rng: Seed | None = None, **options: Any,
) -> SimulatedJet:  # fmt: skip
    """
    Simulate the paper's two-fluid jet, a slow sheath around a fast spine.

    Parameters
    ----------
    slow, fast : float or `~astropy.units.Quantity`, optional
        Speeds of the two streams, in pixels per interval or as proper
        motions.
    densities : (float, float), optional
        Features per beam length of the slow and of the fast stream: (1.0,
        0.8) by default, (1.0, 1.2) in a dense jet.
    dense : bool, optional
        Make the sheath wider (25 instead of 15 pixels on each side of the axis)
        and give the spine more and brighter features.
    jitter : float, optional
        Random walk per epoch and axis, in pixels.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.
    **options
        Further parameters of `JetSimulation`: epochs, dates, noise, beams...

    Returns
    -------
    ``SimulatedJet``
        Its ``cube``, and ``truth`` with a row for each feature and epoch.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> jet = simulate_two_fluid(rng=1)
    >>> jet.cube.shape
    (10, 128, 256)
    """
    half_width, peak = (25.0, (0.8, 1.5)) if dense else (15.0, (0.3, 1.5))
    of_slow, of_fast = densities or (1.0, 1.2 if dense else 0.8)
    slow = Stream("slow", slow, density=of_slow, half_width=half_width, jitter=jitter)
    fast = Stream("fast", fast, density=of_fast, sigma=4.0, peak=peak, jitter=jitter)
    return _run("two-fluid", rng, options, slow, fast)


def simulate_random_velocity(
    *, dx: tuple[float, float] = (0.0, 40.0), dy: tuple[float, float] = (-5.0, 5.0),
    density: float = 1.8, rng: Seed | None = None, **options: Any,
) -> SimulatedJet:  # fmt: skip
    """
    Simulate features that take a new random velocity at every epoch.

    This is the paper's second test: nothing moves at a common speed.

    Parameters
    ----------
    dx, dy : (float, float), optional
        Limits of the uniform distributions of the motion along and across
        the jet, in pixels per interval.
    density : float, optional
        Features per beam length.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.
    **options
        Further parameters of `JetSimulation`: epochs, dates, noise, beams...

    Returns
    -------
    ``SimulatedJet``
        Its ``cube``, and ``truth`` with a row for each feature and epoch.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_random_velocity
    >>> simulate_random_velocity(n_epochs=3, rng=1).cube.shape
    (3, 128, 256)
    """
    stream = Stream("random", dx, dy, "random", density, half_width=12.0)
    return _run("random velocity", rng, options, stream)


def simulate_ballistic(
    *, dx: tuple[float, float] = (0.0, 40.0), dy: tuple[float, float] = (-5.0, 5.0),
    density: float = 1.8, rng: Seed | None = None, **options: Any,
) -> SimulatedJet:  # fmt: skip
    """
    Simulate features that each keep a random velocity of their own.

    All of them move, but they have no common velocity.

    Parameters
    ----------
    dx, dy : (float, float), optional
        Limits of the uniform distributions of the motion along and across
        the jet, in pixels per interval.
    density : float, optional
        Features per beam length.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.
    **options
        Further parameters of `JetSimulation`: epochs, dates, noise, beams...

    Returns
    -------
    ``SimulatedJet``
        Its ``cube``, and ``truth`` with a row for each feature and epoch.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_ballistic
    >>> simulate_ballistic(n_epochs=3, rng=1).cube.shape
    (3, 128, 256)
    """
    stream = Stream("ballistic", dx, dy, density=density, half_width=12.0)
    return _run("ballistic", rng, options, stream)


def simulate_static(
    *, density: float = 1.8, rng: Seed | None = None, **options: Any
) -> SimulatedJet:
    """
    Simulate features that stand still, with noise that differs at every epoch.

    Parameters
    ----------
    density : float, optional
        Features per beam length.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.
    **options
        Further parameters of `JetSimulation`: epochs, dates, noise, beams...

    Returns
    -------
    ``SimulatedJet``
        Its ``cube``, and ``truth`` with a row for each feature and epoch.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_static
    >>> simulate_static(n_epochs=3, rng=1).cube.shape
    (3, 128, 256)
    """
    stream = Stream("static", density=density, half_width=12.0)
    return _run("static", rng, options, stream)


def simulate_unrelated(
    *, density: float = 1.8, rng: Seed | None = None, **options: Any
) -> SimulatedJet:
    """
    Simulate unrelated epochs.

    Every epoch has features of its own, drawn from the same distributions.

    Parameters
    ----------
    density : float, optional
        Features per beam length.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.
    **options
        Further parameters of `JetSimulation`: epochs, dates, noise, beams...

    Returns
    -------
    ``SimulatedJet``
        Its ``cube``, and ``truth`` with a row for each feature and epoch.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_unrelated
    >>> simulate_unrelated(n_epochs=3, rng=1).cube.shape
    (3, 128, 256)
    """
    stream = Stream("unrelated", motion="unrelated", density=density, half_width=12.0)
    return _run("unrelated", rng, options, stream)


def simulate_jet(
    *, streams: Sequence[Flow] | None = None, standing: int | Sequence[float] = 0,
    length: float = 16.0, shape: tuple[int, int] | None = None,
    interval_scatter: float = 0.8, noise_scatter: float = 0.3,
    rng: Seed | None = None, **options: Any,
) -> SimulatedJet:  # fmt: skip
    """
    Simulate a jet as surveys of blazars see it.

    Features are ejected from a variable core and move, each at a speed of its
    own that scatters about the speed of the flow; they fade and widen.  Epochs
    are uneven.  Lengths are in beams (``sqrt(major minor)``), times in median
    intervals.  Without moving features (``n_features=0``), the jet is static and
    consists of ``standing`` features, whose fluxes may vary.

    Parameters
    ----------
    streams : sequence of `Flow`, optional
        Flows that replace the one flow.
    standing : int or sequence of float, optional
        Number of standing features at random distances from the core, or
        their distances.
    length : float, optional
        Length of the jet.
    shape : tuple of int, optional
        Shape (ny, nx) of the images; by default they reach 8 beams beyond the
        jet on all sides.
    interval_scatter, noise_scatter : float, optional
        Standard deviation of the logarithms of the intervals, which are log-normal,
        and of the noise between epochs.
    rng : `numpy.random.Generator`, seed or None, optional
        Passed to `numpy.random.default_rng`.
    **options
        Parameters of the one flow (``speed``, ``dispersion``, ``distribution``,
        ``n_features``, ``acceleration`` and the others of `Flow`) and of
        `JetSimulation`, with other defaults: ``n_epochs`` 15, the median ``interval``
        0.2 yr, or ``dates``, ``beam`` 0.8 mas, ``core_flux`` 1 Jy, the median
        ``noise`` 0.0003 Jy per beam, ``flux_variation`` 0.35, and ``memory`` 3.

    Returns
    -------
    ``SimulatedJet``
        Its ``cube``, and ``truth`` with a row for each feature and epoch.

    Raises
    ------
    ValueError
        If a parameter is outside its range, or if parameters of the one flow
        are given with ``streams``.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_jet
    >>> jet = simulate_jet(rng=1)
    >>> jet.cube.shape
    (15, 128, 256)
    """
    given = {"length": length, "interval_scatter": interval_scatter}
    given = SimpleNamespace(**given, noise_scatter=noise_scatter)
    check_not_negative(given, "length interval_scatter noise_scatter")
    rng = random_generator(rng)
    date_rng, noise_rng = rng.spawn(2)
    of_flow = {one.name for one in fields(Flow)}
    flow = {name: options.pop(name) for name in [*options] if name in of_flow}
    jet = SURVEYED | options
    n_epochs, noise = jet.pop("n_epochs"), jet.pop("noise")
    if jet.setdefault("dates") is None:
        require_epochs(n_epochs)
        steps = np.exp(interval_scatter * date_rng.standard_normal(n_epochs - 1))
        jet["dates"] = Time("2000-01-01") + np.cumsum([0, *steps]) * jet["interval"]
    if streams is None:
        streams = [Flow(**flow)]
    elif flow:
        raise ValueError(f"{', '.join(flow)}: give them to each of the streams")
    kind = "n_features" if np.ndim(standing) == 0 else "positions"
    streams = [*streams, Flow("standing", speed=0.0, **{kind: standing})]
    noise = noise * np.exp(noise_scatter * noise_rng.standard_normal(len(jet["dates"])))
    jet = {"beams": jet.pop("beam"), "core": jet.pop("core_flux")} | jet
    jet = JetSimulation(streams, "jet", **jet | {"noise": noise})
    ahead = length * jet.beam_length
    return centred(jet, ahead, margin=8 * jet.beam_length, shape=shape).run(rng=rng)


class SimulatedShell(NamedTuple):
    """
    A simulated shell: its images and the features in them.

    Attributes
    ----------
    cube : `~astro_scc.epochs.EpochCube`
        Images in counts, without a beam.
    truth : `~astropy.table.QTable`
        One row per feature: ``group`` ("knots" or "ring"), ``east`` and
        ``north`` from the centre at the first epoch, ``fwhm``, ``rate``.
    centre : `~astropy.units.Quantity`, shape (2,)
        (east, north) from the reference pixel.
    radius : `~astropy.units.Quantity`
    """

    cube: EpochCube
    truth: QTable
    centre: u.Quantity
    radius: u.Quantity


def simulate_shell(
    *, knot_rate: u.Quantity = 0.11 * u.percent / u.yr,
    ring_rate: u.Quantity = 0.07 * u.percent / u.yr, n_epochs: int = 6,
    interval: u.Quantity = 5 * u.yr, n_knots: int = 50, n_clumps: int = 24,
    radius: u.Quantity = 100 * u.arcsec, pixel_scale: u.Quantity = 1 * u.arcsec,
    centre: u.Quantity = (6.0, -4.0) * u.arcsec, size: int = 288, counts: float = 400.0,
    background: float = 20.0, rng: Seed | None = None,
) -> SimulatedShell:  # fmt: skip
    """
    Simulate a shell of small knots and large clumps that expand at two rates.

    Cassiopeia A is an example: its radio ring expands at 0.07 per cent per
    year, small structure in it at 0.11.  The clumps form a ring.  Features keep
    their size, the noise is that of Poisson counts, and there is no beam.

    Parameters
    ----------
    knot_rate, ring_rate : `~astropy.units.Quantity`, optional
        Expansion rates at the first epoch: motion per time as a fraction of the
        distance from the centre.  As the motion is uniform, the rate e becomes
        ``e / (1 + e t)`` at the time t after the first epoch.
    n_epochs : int, optional
    interval : `~astropy.units.Quantity`, optional
    n_knots, n_clumps : int, optional
    radius : `~astropy.units.Quantity`, optional
        Radius of the ring; knots are at 0.6 to 1.05 of it.
    pixel_scale : `~astropy.units.Quantity`, optional
    centre : `~astropy.units.Quantity`, shape (2,), optional
        (east, north) from the reference pixel, the middle of the image.
    size : int, optional
        Pixels on a side of the image.
    counts, background : float, optional
        Counts per pixel: the maxima of knots have 0.4 to 1 of ``counts``, those
        of clumps 0.6 to 1; ``background`` is added everywhere.
    rng : None, int or `~numpy.random.Generator`, optional

    Returns
    -------
    SimulatedShell
        With ``cube``, ``truth``, ``centre`` and ``radius``.

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
    require_epochs(n_epochs, 2)
    step, r = (u.Quantity(v).to_value(u.mas) for v in (pixel_scale, radius))
    middle = u.Quantity(centre).to(u.mas)
    if 1.2 * r + np.abs(middle.value).max() > 0.5 * size * step:
        raise ValueError(f"a shell of {radius} is larger than {size} pixels can show")
    rng, n = random_generator(rng), n_knots + n_clumps
    knot, angle = np.arange(n) < n_knots, rng.uniform(0, 2 * np.pi, n)
    angle[~knot] = 2 * np.pi * (np.arange(n_clumps) + rng.uniform(0, 0.7, n_clumps))
    angle[~knot] /= n_clumps
    # Knots are distributed evenly over an area.
    of_knots = r * np.sqrt(rng.uniform(0.6**2, 1.05**2, n))
    distance = np.where(knot, of_knots, r * rng.normal(1, 0.03, n))
    east, north = distance * np.sin(angle), distance * np.cos(angle)
    fwhm = np.where(knot, rng.uniform(3, 5, n), rng.uniform(16, 24, n))
    peak = counts * np.where(knot, rng.uniform(0.4, 1.0, n), rng.uniform(0.6, 1.0, n))
    rate = np.where(knot, knot_rate, ring_rate).to_value(1 / u.yr)
    times = Time("1980-01-01") + np.arange(n_epochs) * interval
    images = np.full((n_epochs, size, size), float(background))
    covariance = (FWHM_TO_SIGMA * fwhm)[:, None, None] ** 2 * np.eye(2)
    origin = (size - 1) / 2
    for image, year in zip(images, (times - times[0]).to_value(u.yr), strict=True):
        grown = 1 + rate * year
        x = origin - (middle[0].value + grown * east) / step
        y = origin + (middle[1].value + grown * north) / step
        image[:] = rng.poisson(add_gaussians(image, x, y, peak, covariance))
    cube = EpochCube.from_arrays(images, times, pixel_scale=pixel_scale)
    truth = QTable({
        "group": np.where(knot, "knots", "ring"), "east": east * u.mas,
        "north": north * u.mas, "fwhm": fwhm * step * u.mas,
        "rate": (rate / u.yr).to(u.percent / u.yr),
    })  # fmt: skip
    return SimulatedShell(cube, truth, middle, r * u.mas)


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
