# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Images of a jet whose features move at known velocities."""

from dataclasses import dataclass, field

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.epochs.beam import FWHM_TO_SIGMA, Beam
from astro_scc.epochs.components.gaussians import add_gaussians
from astro_scc.epochs.components.noise import correlated_noise
from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.offset_grid import offset_wcs
from astro_scc.simulation.streams import Stream

__all__ = ["JetSimulation", "SimulatedJet"]


@dataclass(frozen=True, eq=False, repr=False)
class SimulatedJet:
    """
    A simulated jet: its images and what is in them.

    Attributes
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    truth : `~astropy.table.QTable`
        A row for each feature and epoch; see `JetSimulation`.
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
    simulation: "JetSimulation"

    def __repr__(self):
        return (
            f"<SimulatedJet {self.simulation.name!r}: {len(self.cube)} epochs, "
            f"{len(set(self.truth['feature']))} features>"
        )


@dataclass(frozen=True, eq=False)
class JetSimulation:
    """
    A straight jet along +x (west), made of streams of Gaussian features.

    The defaults are those of Sect. 2.4 of Mertens & Lobanov (2016): a beam
    of 10 pixels and ten epochs, 30 days apart.  Features fade in and out at
    the two ends of the jet with a raised cosine, and there are always
    others to follow, so that the region stays populated.

    Parameters
    ----------
    streams : sequence of `Stream`
    name : str, optional
        Object name.
    n_epochs : int, optional
    interval : `~astropy.units.Quantity`, optional
        Time between epochs, to which velocities in pixels refer.
    dates : `~astropy.time.Time`, optional
        Dates of the epochs, increasing; they replace ``n_epochs`` and a
        regular series from 2000-01-01.  Velocities still refer to
        ``interval``.
    shape : tuple of int, optional
        Shape (ny, nx) of the images.
    pixel_scale : `~astropy.units.Quantity`, optional
    beams : `~astro_scc.epochs.Beam` or sequence of them, optional
        One for all epochs, or one for each.
    noise : float, optional
        Root mean square of the noise in Jy per beam, correlated by the beam.
    extent : tuple of float, optional
        x between which features are seen, in pixels from 0.
    axis : float, optional
        y of the jet axis, in pixels from 0.
    taper : float, optional
        Length of the fading at each end of ``extent``, in pixels.
    core : float, optional
        Flux density in Jy of an unresolved, stationary core at the start of
        the jet, which is the reference pixel.  None by default.

    Raises
    ------
    ValueError
        If a parameter is outside its range, or their numbers of epochs
        differ.

    Notes
    -----
    A feature of full width ``fwhm`` and peak ``p`` in the mean beam ``b``
    has the flux density ``p (b^2 + fwhm^2) / b^2``, which is the same in
    every epoch's beam.  Columns of the truth: ``feature`` (from 0),
    ``group`` (the stream), ``epoch``, ``date``; ``x``, ``y`` in pixels from
    0; ``east``, ``north`` from the reference pixel; ``flux``, fading
    included; ``fwhm``; ``visible``, whether any flux is left; ``pm_east``,
    ``pm_north``, the mean proper motion of the feature's motion to the next
    epoch (from the previous one, for the last), jitter included.

    Examples
    --------
    >>> from astro_scc.simulation import JetSimulation, Stream
    >>> sheath = Stream("sheath", dx=5.0, half_width=15.0, jitter=2.0)
    >>> jet = JetSimulation([sheath], n_epochs=4).run(rng=1)
    >>> jet.cube.shape
    (4, 128, 256)
    """

    streams: tuple[Stream, ...]
    name: str = "simulated jet"
    n_epochs: int = 10
    interval: u.Quantity = 30 * u.day
    dates: Time | None = None
    shape: tuple[int, int] = (128, 256)
    pixel_scale: u.Quantity = 0.1 * u.mas
    beams: Beam | tuple[Beam, ...] = field(
        default_factory=lambda: Beam(1 * u.mas, 1 * u.mas)
    )
    noise: float = 0.002
    extent: tuple[float, float] = (20.0, 220.0)
    axis: float = 64.0
    taper: float = 10.0
    core: float = 0.0

    def __post_init__(self):
        if isinstance(self.streams, Stream):
            raise ValueError("streams must be a sequence of Stream, got one Stream")
        if len(self.streams) == 0:
            raise ValueError("a jet needs at least one Stream")
        dates = self.dates
        if dates is None:
            if self.n_epochs < 1:
                raise ValueError(f"n_epochs must be at least 1, got {self.n_epochs}")
            dates = Time("2000-01-01") + np.arange(self.n_epochs) * self.interval
        if dates.isscalar or np.any(np.diff(dates.mjd) <= 0):
            raise ValueError("dates must be an array of increasing times")
        beams = self.beams
        beams = (beams,) * len(dates) if isinstance(beams, Beam) else tuple(beams)
        if len(beams) != len(dates):
            raise ValueError(
                f"{len(beams)} beams for {len(dates)} epochs; give one beam, "
                "or one for each epoch"
            )
        if not self.extent[0] < self.extent[1]:
            raise ValueError(f"extent must be (start, end), got {self.extent}")
        for name in ("noise", "taper", "core"):
            if not getattr(self, name) >= 0:
                raise ValueError(
                    f"{name} must be zero or positive, got {getattr(self, name)}"
                )
        object.__setattr__(self, "streams", tuple(self.streams))
        object.__setattr__(self, "dates", dates)
        object.__setattr__(self, "n_epochs", len(dates))
        object.__setattr__(self, "beams", beams)

    @property
    def velocity_unit(self):
        """Proper motion of one pixel per interval."""
        return (self.pixel_scale / self.interval).to(u.mas / u.yr)

    @property
    def beam_length(self):
        """Mean full width of the beams, ``sqrt(major minor)``, in pixels."""
        areas = [(b.major * b.minor / self.pixel_scale**2) for b in self.beams]
        return float(np.sqrt(np.mean(u.Quantity(areas).to_value(u.one))))

    def run(self, *, rng=None):
        """
        Draw one jet and make its images.

        Parameters
        ----------
        rng : `numpy.random.Generator`, seed or None, optional
            Passed to `numpy.random.default_rng`.  Features and noise have
            generators of their own: the same seed with another noise level
            has the same features.

        Returns
        -------
        `SimulatedJet`
        """
        rng = np.random.default_rng(rng)
        *stream_rngs, noise_rng = rng.spawn(len(self.streams) + 1)
        features = self._features(stream_rngs)
        wcs = offset_wcs(self.pixel_scale, (self.extent[0], self.axis))
        data = self._images(features, noise_rng)
        unit = u.Jy / u.beam
        dates = self.dates.strftime("%Y-%m-%d")
        cube = EpochCube(
            data=data,
            times=self.dates,
            wcs=wcs,
            unit=unit,
            beams=self.beams,
            noise=np.full(self.n_epochs, self.noise) * unit,
            labels=tuple(str(d) for d in dates),
            epoch_meta=tuple({"object": self.name} for _ in dates),
            meta={"object": self.name, "history": [f"simulated: {self.name}"]},
        )
        return SimulatedJet(cube, self._truth(features), self)

    def _features(self, rngs):
        """Arrays of all features, those that are never seen left out."""
        years = (self.dates - self.dates[0]).to(u.day)
        steps = np.diff((years / self.interval).to_value(u.one))
        start, end = self.extent
        parts = []
        for stream, rng in zip(self.streams, rngs, strict=True):
            stream = stream.in_pixels(self.velocity_unit)
            x, y = stream.trajectories(
                steps, self.extent, self.axis, self.beam_length, rng
            )
            n = len(x)
            fwhm = rng.uniform(*stream.fwhm, n)
            peak = rng.uniform(*stream.peak, n)
            seen = ((x >= start) & (x <= end)).any(axis=1)
            parts.append(
                (np.full(n, stream.name, dtype=object), x, y, fwhm, peak, seen)
            )
        group, x, y, fwhm, peak, seen = (
            np.concatenate(p) for p in zip(*parts, strict=True)
        )
        beam = self.beam_length
        flux = (peak * (beam**2 + fwhm**2) / beam**2)[:, None] * self._visibility(x)
        return group[seen], x[seen], y[seen], fwhm[seen], flux[seen]

    def _visibility(self, x):
        """Fraction of the flux that is seen at x: a raised cosine at both ends."""
        start, end = self.extent
        inside = np.minimum(x - start, end - x)
        if self.taper == 0:
            return np.where(inside >= 0, 1.0, 0.0)
        ramp = np.clip(np.nan_to_num(inside / self.taper), 0, 1)
        return 0.5 * (1 - np.cos(np.pi * ramp))

    def _images(self, features, rng):
        _, x, y, fwhm, flux = features
        scale = self.pixel_scale.to_value(u.mas)
        images = np.zeros((self.n_epochs, *self.shape))
        flip = np.diag([-1.0, 1.0])
        own = (FWHM_TO_SIGMA * fwhm)[:, None, None] ** 2 * np.eye(2)
        for i, (beam, noise_rng) in enumerate(
            zip(self.beams, rng.spawn(self.n_epochs), strict=True)
        ):
            covariance = flip @ beam.covariance.to_value(u.mas**2) @ flip / scale**2
            beam_area = np.sqrt(np.linalg.det(covariance))
            total = own + covariance
            peak = flux[:, i] * beam_area / np.sqrt(np.linalg.det(total))
            add_gaussians(images[i], x[:, i], y[:, i], peak, total)
            if self.core:
                at = [self.extent[0]], [self.axis]
                add_gaussians(images[i], *at, [self.core], [covariance])
            images[i] += correlated_noise(
                self.shape,
                rms=self.noise,
                beam=beam,
                pixel_scale=self.pixel_scale,
                rng=noise_rng,
            )
        return images

    def _truth(self, features):
        group, x, y, fwhm, flux = features
        n, n_epochs = x.shape
        days = (self.dates - self.dates[0]).to_value(u.yr)
        scale = self.pixel_scale.to_value(u.mas)
        if n_epochs > 1:
            step = np.diff(days)
            pm = [np.diff(a, axis=1) / step for a in (x, y)]
            pm = [np.concatenate([p, p[:, -1:]], axis=1) for p in pm]
        else:
            pm = [np.full_like(x, np.nan), np.full_like(y, np.nan)]
        feature, epoch = np.mgrid[:n, :n_epochs]
        exists = np.isfinite(x)
        rows = {
            "feature": feature[exists],
            "group": np.broadcast_to(group[:, None], x.shape)[exists].astype(str),
            "epoch": epoch[exists],
            "date": self.dates[epoch[exists]],
            "x": x[exists] * u.pix,
            "y": y[exists] * u.pix,
            "east": -(x[exists] - self.extent[0]) * scale * u.mas,
            "north": (y[exists] - self.axis) * scale * u.mas,
            "flux": flux[exists] * u.Jy,
            "fwhm": np.broadcast_to(fwhm[:, None], x.shape)[exists] * scale * u.mas,
            "visible": flux[exists] > 0,
            "pm_east": -pm[0][exists] * scale * u.mas / u.yr,
            "pm_north": pm[1][exists] * scale * u.mas / u.yr,
        }
        meta = {
            "name": self.name,
            "pixel_scale": self.pixel_scale,
            "interval": self.interval,
            "velocity_unit": self.velocity_unit,
            "extent": list(self.extent),
            "axis": self.axis,
            "noise": self.noise,
            "streams": [
                {
                    "name": s.name,
                    "motion": s.motion,
                    "dx": _plain(s.dx),
                    "dy": _plain(s.dy),
                    "jitter": s.jitter,
                }
                for s in self.streams
            ],
        }
        return QTable(rows, meta=meta)


def _plain(value):
    """A velocity as ECSV can keep it."""
    if callable(value):
        return "function"
    if isinstance(value, tuple):
        return list(value)
    return value
