# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images of features that move at known velocities in a jet or a shell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.restoring import add_gaussians, correlated_noise, in_pixels
from astro_scc.epochs.serialize import write_epochs
from astro_scc.images.beam import FWHM_TO_SIGMA, Beam
from astro_scc.images.series import as_beams, as_epoch_tuple
from astro_scc.quantities import Seed, random_generator
from astro_scc.simulation.streams import (
    Flow,
    Layer,
    Stream,
    check_not_negative,
    m87_layers,
)
from astro_scc.writing import replace_when_complete


@dataclass(frozen=True, eq=False, repr=False)
class SimulatedJet:
    """
    A simulated jet: its images and the features in them.

    Attributes
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    truth : `~astropy.table.QTable`
        One row per feature and epoch, see `JetSimulation`.
    simulation : `JetSimulation`

    Examples
    --------
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> jet = simulate_two_fluid(n_epochs=3, rng=1)
    >>> len(jet.cube), sorted(set(jet.truth["group"].tolist()))
    (3, ['fast', 'slow'])
    """

    cube: EpochCube
    truth: QTable
    simulation: JetSimulation

    def __repr__(self):
        n, n_features = len(self.cube), len(set(self.truth["feature"]))
        what = f"{n} epochs, {n_features} features"
        return f"<SimulatedJet {self.simulation.name!r}: {what}>"


@dataclass(eq=False)
class JetSimulation:
    """
    A straight jet, along +x (west) by default, made of streams of features.

    The defaults are those of Sect. 2.4 of Mertens & Lobanov (2016): a beam
    of 10 pixels and ten epochs, 30 days apart.  Features fade in and out at
    the two ends of the jet with a raised cosine, and new ones follow, so that
    the jet stays populated.

    Parameters
    ----------
    streams : sequence of `Stream`, `Flow` or `Layer`
    name : str, optional
        Object name.
    n_epochs : int, optional
    interval : `~astropy.units.Quantity`, optional
        Time between epochs, to which velocities in pixels refer.
    dates : `~astropy.time.Time`, optional
        Dates of the epochs, increasing, instead of ``n_epochs`` regular dates
        from 2000-01-01.  Velocities still refer to ``interval``.
    shape : tuple of int, optional
        Shape (ny, nx) of the images.
    pixel_scale : `~astropy.units.Quantity`, optional
    beams : `~astro_scc.epochs.Beam` or sequence of them, optional
        One for all epochs, or one for each.
    noise : float or sequence of float, optional
        Root mean square of the noise in Jy per beam, correlated by the beam;
        one for all epochs, or one for each.
    extent : tuple of float, optional
        Limits in x between which features are seen, in pixels from 0.
    axis : float, optional
        y of the jet axis, in pixels from 0.
    core : float, optional
        Flux density in Jy of an unresolved, stationary core at the start of
        the jet, which is the reference pixel.  There is none by default.
    position_angle : `~astropy.units.Quantity`, optional
        Direction of the jet, north through east; the jet is turned about
        its start.
    flux_variation : float, optional
        Standard deviation in time of the logarithms of all flux densities.
    memory : float, optional
        Correlation time of the variations, in intervals: the correlation of
        two epochs t apart is ``exp(-t / memory)``.  At 0, variations are white.
    alignment_error : float, optional
        Standard deviation per axis, in beams, of a shift of each image.
    ripple : float, optional
        Amplitude, as a fraction of the image's maximum, of a wave around the
        core that differs from epoch to epoch.  Its wavelength is 1.5 to 4
        beams, and its amplitude falls to a half at 5 beams.
    bowl : float, optional
        Depth of the negative bowl around every feature, six times as wide
        as its image, as a fraction of its peak.

    Raises
    ------
    ValueError
        If a parameter is outside its range, or the numbers of dates, beams
        and noise levels differ.

    Notes
    -----
    A feature of full width ``fwhm`` and peak ``p`` in the mean beam ``b``
    has the flux density ``p (b^2 + fwhm^2) / b^2``, which is the same in
    every epoch's beam.

    Columns of the truth: ``feature`` (from 0), ``group`` (the stream, or
    ``core``), ``epoch``, ``date``; ``x``, ``y`` in the image, in pixels from 0;
    ``east``, ``north`` from the start of the jet, without errors of alignment;
    ``flux``, including fading; ``fwhm``; ``visible``, whether any flux is left;
    ``pm_east``, ``pm_north``, the mean proper motion to the next epoch (for
    the last epoch, from the previous one), including jitter.  For each stream,
    the meta holds the mean and the standard deviation of the speeds, outward
    along the jet, of the features that are visible at two epochs or more.

    Examples
    --------
    >>> from astro_scc.simulation import JetSimulation, Stream
    >>> sheath = Stream("sheath", dx=5.0, half_width=15.0, jitter=2.0)
    >>> jet = JetSimulation([sheath], n_epochs=4).run(rng=1)
    >>> jet.cube.shape
    (4, 128, 256)
    """

    streams: Sequence[Stream | Flow]
    name: str = "simulated jet"
    n_epochs: int = 10
    interval: u.Quantity = 30 * u.day
    dates: Time | None = None
    shape: tuple[int, int] = (128, 256)
    pixel_scale: u.Quantity = 0.1 * u.mas
    beams: Beam | Sequence[Beam] = Beam(1 * u.mas, 1 * u.mas)
    noise: float | Sequence[float] = 0.002
    extent: tuple[float, float] = (20.0, 220.0)
    axis: float = 64.0
    core: float | None = None
    position_angle: u.Quantity = 270 * u.deg
    flux_variation: float | None = None
    memory: float | None = None
    alignment_error: float | None = None
    ripple: float | None = None
    bowl: float | None = None

    def __post_init__(self):
        if isinstance(self.streams, Stream | Flow) or len(self.streams) == 0:
            raise ValueError("streams: give a sequence of Stream, at least one Stream")
        dates = self.dates
        if dates is None:
            require_epochs(self.n_epochs)
            dates = Time("2000-01-01") + np.arange(self.n_epochs) * self.interval
        if dates.isscalar or not np.all(np.diff(dates.mjd) > 0):
            raise ValueError("dates must be an array of increasing times")
        if not self.extent[0] < self.extent[1]:
            raise ValueError(f"extent must be (start, end), got {self.extent}")
        names = "noise core flux_variation memory alignment_error ripple bowl"
        check_not_negative(self, names)
        n = self.n_epochs = len(dates)
        noise = (self.noise,) * n if np.ndim(self.noise) == 0 else self.noise
        self.noise = as_epoch_tuple(noise, n, "noise levels", float)
        self.streams, self.dates = tuple(self.streams), dates
        self.beams = as_beams(self.beams, n)
        if not (self.beams and self.noise):
            raise ValueError("beams and noise need one value, or one for each epoch")

    @property
    def velocity_unit(self) -> u.Quantity:
        """Return the proper motion of one pixel per interval."""
        return (self.pixel_scale / self.interval).to(u.mas / u.yr)

    @property
    def beam_length(self) -> float:
        """Return the mean full width of the beams, ``sqrt(major minor)``, in pixels."""
        areas = [(b.major * b.minor / self.pixel_scale**2) for b in self.beams]
        return float(np.sqrt(np.mean(u.Quantity(areas).to_value(u.one))))

    @property
    def times(self) -> np.ndarray:
        """Return the dates in intervals from the first."""
        return ((self.dates - self.dates[0]).to(u.day) / self.interval).to_value(u.one)

    def run(self, *, rng: Seed | None = None) -> SimulatedJet:
        """
        Draw one jet and make its images.

        Parameters
        ----------
        rng : `numpy.random.Generator`, seed or None, optional
            Passed to `numpy.random.default_rng`.  Features and noise have
            generators of their own, so the same seed gives the same features
            for any noise level.

        Returns
        -------
        ``SimulatedJet``
            Its ``cube``, and ``truth`` with a row for each feature and epoch.
        """
        rng = random_generator(rng)
        *stream_rngs, noise_rng = rng.spawn(len(self.streams) + 1)
        flux_rng, shift_rng, ripple_rng = rng.spawn(3)
        features = self._features(stream_rngs, flux_rng)
        shift = self.beam_length * (self.alignment_error or 0.0)
        dx, dy = shift * shift_rng.standard_normal((2, self.n_epochs))
        seen = features | {"x": features["x"] + dx, "y": features["y"] + dy}
        unit = u.Jy / u.beam
        # The noise of images with artefacts must be measured.
        noise = None if self.ripple or self.bowl else self.noise * unit
        cube = EpochCube.from_arrays(
            self._images(seen, noise_rng, ripple_rng), self.dates, unit=unit,
            pixel_scale=self.pixel_scale, reference_pixel=(self.extent[0], self.axis),
            beams=self.beams, noise=noise,
            epoch_meta=[{"object": self.name}] * self.n_epochs,
            meta={"object": self.name, "history": [f"simulated: {self.name}"]},
        )  # fmt: skip
        return SimulatedJet(cube, self._truth(features, seen), self)

    def _features(self, rngs, flux_rng):
        """Return all features, turned to the jet's direction, with the core last."""
        pairs = zip(self.streams, rngs, strict=True)
        parts = [stream.features(self, rng) for stream, rng in pairs]
        if self.core:
            still = np.zeros((1, self.n_epochs))
            core = {"x": self.extent[0], "y": self.axis, "flux": self.core, "fwhm": 0.0}
            core = {name: still + value for name, value in core.items()}
            parts.append(core | {"group": np.array(["core"])})
        features = {k: np.concatenate([part[k] for part in parts]) for k in parts[0]}
        if self.flux_variation:
            series = self._series(len(features["x"]), flux_rng)
            features["flux"] *= np.exp(self.flux_variation * series)
        turn = (self.position_angle - 270 * u.deg).to_value(u.rad)
        if turn:
            x0, y0 = self.extent[0], self.axis
            place = (features["x"] - x0) + 1j * (features["y"] - y0)
            place = place * np.exp(1j * turn)
            features |= {"x": place.real + x0, "y": place.imag + y0}
        return features

    def _series(self, n, rng):
        """Draw autoregressive series of unit variance over the epochs."""
        series = rng.standard_normal((n, self.n_epochs))
        if self.memory:
            for i, kept in enumerate(np.exp(-np.diff(self.times) / self.memory), 1):
                series[:, i] *= np.sqrt(1 - kept**2)
                series[:, i] += kept * series[:, i - 1]
        return series

    def _images(self, features, rng, ripple_rng):
        images = np.zeros((self.n_epochs, *self.shape))
        sizes = (FWHM_TO_SIGMA * features["fwhm"])[..., None, None] ** 2 * np.eye(2)
        rngs = rng.spawn(self.n_epochs)
        epochs = zip(images, self.beams, self.noise, rngs, strict=True)
        for i, (image, beam, noise, noise_rng) in enumerate(epochs):
            covariance = in_pixels(beam, self.pixel_scale)
            beam_area = np.sqrt(np.linalg.det(covariance))
            there = features["flux"][:, i] > 0
            x, y, flux = (features[k][there, i] for k in ("x", "y", "flux"))
            total = sizes[there, i] + covariance
            peak = flux * beam_area / np.sqrt(np.linalg.det(total))
            add_gaussians(image, x, y, peak, total)
            if self.bowl:
                add_gaussians(image, x, y, -self.bowl * peak, 6**2 * total)
            if self.ripple:
                image += self._ripple(self.ripple * image.max(), ripple_rng)
            if noise:
                image += correlated_noise(
                    self.shape, rms=noise, beam=beam, pixel_scale=self.pixel_scale,
                    rng=noise_rng,
                )  # fmt: skip
        return images

    def _ripple(self, peak, rng):
        """Draw a wave around the core with random direction, wavelength and phase."""
        beam = self.beam_length
        wave = 2 * np.pi / (beam * rng.uniform(1.5, 4.0))
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        y, x = np.ogrid[: self.shape[0], : self.shape[1]]
        x, y = x - self.extent[0], y - self.axis
        along = x * np.cos(angle) + y * np.sin(angle)
        falling = 1 / (1 + np.hypot(x, y) / (5 * beam))
        return peak * falling * np.cos(wave * along + phase)

    def _truth(self, features, seen):
        scale = self.pixel_scale.to_value(u.mas)
        east = -(features["x"] - self.extent[0]) * scale
        north = (features["y"] - self.axis) * scale
        # The motion is to the next epoch, or from the previous one for the last.
        pm = np.full((2, *east.shape), np.nan)
        years = (self.dates - self.dates[0]).to_value(u.yr)
        pm[..., :-1] = np.diff([east, north], axis=-1) / np.diff(years)
        pm[..., 1:] = np.where(np.isnan(pm[..., 1:]), pm[..., :-1], pm[..., 1:])
        visible = features["flux"] > 0
        feature, epoch = np.indices(east.shape)
        columns = {
            "feature": feature, "group": features["group"][feature].astype(str),
            "epoch": epoch, "date": self.dates[epoch], "x": seen["x"] * u.pix,
            "y": seen["y"] * u.pix, "east": east * u.mas, "north": north * u.mas,
            "flux": features["flux"] * u.Jy, "fwhm": features["fwhm"] * scale * u.mas,
            "visible": visible, "pm_east": pm[0] * u.mas / u.yr,
            "pm_north": pm[1] * u.mas / u.yr,
        }  # fmt: skip
        facts = "name pixel_scale interval velocity_unit extent axis position_angle"
        meta = {k: _plain(getattr(self, k)) for k in (*facts.split(), "noise")}
        angle = self.position_angle
        outward = pm[0] * np.sin(angle).value + pm[1] * np.cos(angle).value
        outward = np.where(visible, outward, np.nan)
        speeds = [outward[features["group"] == stream.name] for stream in self.streams]
        meta["streams"] = [*map(_stream_facts, self.streams, speeds)]
        exists = np.isfinite(east)
        return QTable({k: v[exists] for k, v in columns.items()}, meta=meta)


def _stream_facts(stream, outward):
    """Return the parameters of a stream and the speeds of its visible features."""
    outward = outward[np.isfinite(outward).sum(axis=1) >= 2]
    speeds = np.nanmean(outward, axis=1) * u.mas / u.yr
    return {f.name: _plain(getattr(stream, f.name)) for f in fields(stream)} | {
        "n_seen": len(speeds),
        "mean_speed": np.mean(speeds) if len(speeds) else None,
        "std_speed": np.std(speeds, ddof=1) if len(speeds) > 1 else None,
    }


def _plain(value):
    """Return a parameter in a form that ECSV can keep."""
    if callable(value):
        return "function"
    return list(value) if isinstance(value, tuple) else value


def require_epochs(n_epochs, least=1):
    """Refuse too few epochs."""
    if n_epochs < least:
        raise ValueError(f"n_epochs must be at least {least}, got {n_epochs}")


def centred(jet, ahead, *, margin, shape=None):
    """
    Return a simulation whose jet is centred in the image.

    ``ahead`` is the length of the jet, and ``margin`` the width around it, in pixels;
    an image of another ``shape`` has other margins.
    """
    angle = u.Quantity(jet.position_angle).to_value(u.rad)
    tip = ahead * np.array([-np.sin(angle), np.cos(angle)])
    if shape is None:
        shape = np.round(np.abs(tip) + 2 * margin).astype(int).tolist()[::-1]
    x0, y0 = np.floor((np.array(shape[::-1]) - tip) / 2)
    return replace(jet, shape=tuple(shape), extent=(x0, x0 + ahead), axis=y0)


def write_simulation(
    jet: SimulatedJet, directory: Path | str, *, overwrite: bool = False
) -> list[Path]:
    """
    Write a simulated jet: one FITS image per epoch, and ``truth.ecsv``.

    Parameters
    ----------
    jet : ``SimulatedJet``
    directory : path
        Made if needed.
    overwrite : bool, optional
        Replace files that exist.

    Returns
    -------
    list of `~pathlib.Path`
        The images, then the table.

    Raises
    ------
    OSError
        If a file exists and ``overwrite`` is False, or cannot be written.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from astro_scc.simulation import simulate_two_fluid, write_simulation
    >>> jet = simulate_two_fluid(n_epochs=2, rng=1)
    >>> with TemporaryDirectory() as folder:
    ...     [path.name for path in write_simulation(jet, folder)]
    ['two-fluid_00_2000-01-01.fits', 'two-fluid_01_2000-01-31.fits', 'truth.ecsv']
    """
    table = Path(directory) / "truth.ecsv"
    if table.exists() and not overwrite:
        raise OSError(f"{table}: exists already; choose another folder, or overwrite")
    paths = write_epochs(jet.cube, directory, overwrite=overwrite)
    with replace_when_complete(table, overwrite=True) as part:
        jet.truth.write(part, format="ascii.ecsv")
    return [*paths, table]


# -- simulators --------------------------------------------------------------------

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
