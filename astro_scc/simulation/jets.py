# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images of features that move at known velocities in a jet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

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
from astro_scc.simulation.streams import Flow, Stream, check_not_negative
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
    direction = np.array([-np.sin(angle), np.cos(angle)])
    tip = ahead * direction
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
