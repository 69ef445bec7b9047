# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Groups of features that share one law of motion, those of M 87 among them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import astropy.units as u
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from astro_scc.images.beam import FWHM_TO_SIGMA
from astro_scc.quantities import check_choice, named, one_quantity

# Length in beams over which features move off the axis, and fade at the end.
RAMP = 2.0


def in_view(name, seen, **columns):
    """
    Return the features of a jet along x that are seen at any epoch, as columns.

    These are positions ``x`` and ``y`` in pixels from 0 (NaN where a feature does not
    exist), ``flux`` densities in Jy and widths ``fwhm`` in pixels, shape (n, n_epochs),
    and the name of the ``group``, shape (n,).
    """
    shape = columns["x"].shape
    found = {k: np.broadcast_to(v, shape)[seen] for k, v in columns.items()}
    return found | {"group": np.full(seen.sum(), name)}


def raised_cosine(part):
    """Return the fraction of the flux that is seen, from 0 to 1 as ``part`` goes."""
    return 0.5 * (1 - np.cos(np.pi * np.clip(np.nan_to_num(part), 0, 1)))


def check_not_negative(record, names, whose=""):
    """
    Refuse negative and infinite fields of a record; None is accepted.

    ``names`` are those of the fields, separated by blanks.  ``whose`` is the beginning
    of the message of the ValueError.
    """
    for name in names.split():
        value = getattr(record, name)
        for number in np.ravel([] if value is None else getattr(value, "value", value)):
            if not 0 <= number < np.inf:
                what = f"{whose}{name} must be zero or positive, got {number}"
                raise ValueError(what)


@dataclass(frozen=True)
class Stream:
    """
    A group of features with one law of motion.

    Lengths are in pixels of the simulated image, with x along the jet.

    Parameters
    ----------
    name : str
    dx, dy : float, (float, float), callable or `~astropy.units.Quantity`
        Motion along and across the jet in pixels per interval between
        epochs: one number for all, the limits of a uniform distribution,
        or a function of the positions (x, y), evaluated at every epoch.  A
        Quantity, scalar or of two limits, is a proper motion.
    motion : {'steady', 'random', 'unrelated'}, optional
        How velocities are drawn from a distribution: 'steady', once for each
        feature, which keeps its velocity; 'random', for each feature at every
        epoch.  With 'unrelated', every epoch has new features, which do not
        move.
    density : float, optional
        Features per beam length along the jet.
    half_width : float, optional
        Features start uniformly within this distance of the axis, in pixels.
    sigma : float, optional
        Features start at normally distributed distances from the axis with
        this standard deviation, in pixels, instead of ``half_width``.
    fwhm : (float, float), optional
        Limits of the features' own widths in pixels, uniform.
    peak : (float, float), optional
        Limits of the peak flux densities in Jy per beam, uniform.
    jitter : float, optional
        Standard deviation, per axis and epoch, of the random walk added to
        the motion, in pixels.

    Raises
    ------
    ValueError
        If a parameter is outside its range, or if not exactly one of
        ``half_width`` and ``sigma`` is given.

    Examples
    --------
    >>> from astro_scc.simulation import Stream
    >>> spine = Stream("spine", dx=20.0, sigma=4.0, density=0.8, jitter=2.0)
    >>> spine.dx, spine.motion
    (20.0, 'steady')
    """

    name: str
    dx: float | tuple[float, float] | Callable | u.Quantity = 0.0
    dy: float | tuple[float, float] | Callable | u.Quantity = 0.0
    motion: str = "steady"
    density: float = 1.0
    half_width: float | None = None
    sigma: float | None = None
    fwhm: tuple[float, float] = (2.0, 6.0)
    peak: tuple[float, float] = (0.3, 1.5)
    jitter: float = 0.0

    def __post_init__(self):
        whose = f"stream {self.name!r}"
        motions = "steady", "random", "unrelated"
        named(f"{whose}: motion", check_choice, self.motion, *motions)
        if (self.half_width is None) == (self.sigma is None):
            raise ValueError(f"{whose} needs one of half_width and sigma, its width")
        check_not_negative(self, "density half_width sigma jitter", f"{whose}: ")
        for name, (low, high) in (("fwhm", self.fwhm), ("peak", self.peak)):
            if not 0 <= low <= high < np.inf:
                wanted = "must be two limits 0 <= low <= high"
                raise ValueError(f"{whose}: {name} {wanted}, got {(low, high)}")
        for name, value in (("dx", self.dx), ("dy", self.dy)):
            # What a function returns is not known here.
            limits = 0 if callable(value) else getattr(value, "value", value)
            if np.size(limits) > 2 or not np.all(np.isfinite(limits)):
                wanted = "must be a number, two limits or a function of (x, y)"
                raise ValueError(f"{whose}: {name} {wanted}, got {value}")

    def features(self, jet: Any, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """
        Draw the features, and follow the visible ones over the epochs.

        Parameters
        ----------
        jet : `JetSimulation`
        rng : `numpy.random.Generator`

        Returns
        -------
        dict of `~numpy.ndarray`
            See ``in_view``.
        """
        beam, (start, end) = jet.beam_length, jet.extent
        x, y = self._trajectories(jet, rng)
        fwhm = rng.uniform(*self.fwhm, (len(x), 1))
        peak = rng.uniform(*self.peak, (len(x), 1))
        visible = raised_cosine(np.minimum(x - start, end - x) / 10)
        flux = peak * (beam**2 + fwhm**2) / beam**2 * visible
        seen = ((x >= start) & (x <= end)).any(axis=1)
        return in_view(self.name, seen, x=x, y=y, flux=flux, fwhm=fwhm)

    def _trajectories(self, jet, rng):
        """
        Draw positions of the features at every epoch, NaN where one does not exist.

        Features start anywhere from where they can reach the visible region, so
        that its mean density is constant.
        """
        # Motions in pixels per interval.
        laws = [
            (v / jet.velocity_unit).to_value(u.one) if isinstance(v, u.Quantity) else v
            for v in (self.dx, self.dy)
        ]
        (start, end), steps = jet.extent, np.diff(jet.times)
        if self.motion != "unrelated":
            dx, across = laws[0], np.linspace(start, end, 200)
            limits = dx(across, np.zeros(200)) if callable(dx) else dx
            margin = 3 * self.jitter * np.sqrt(steps.size)
            start = start - max(np.max(limits), 0) * steps.sum() - margin
            end = end - min(np.min(limits), 0) * steps.sum() + margin
        n = round(self.density * (end - start) / jet.beam_length)

        def begin():
            x = rng.uniform(start, end, n)
            if self.sigma is not None:
                return x, rng.normal(jet.axis, self.sigma, n)
            low, high = jet.axis - self.half_width, jet.axis + self.half_width
            return x, rng.uniform(low, high, n)

        if self.motion == "unrelated":
            places = np.full((2, jet.n_epochs, n, jet.n_epochs), np.nan)
            for i in range(jet.n_epochs):
                places[:, i, :, i] = begin()
            return places.reshape(2, -1, jet.n_epochs)
        places = np.empty((2, n, jet.n_epochs))
        places[:, :, 0] = begin()
        speeds = [_draw(law, *places[:, :, 0], rng) for law in laws]
        for i, step in enumerate(steps):
            for k, law in enumerate(laws):
                # Velocities from a function depend on position; drawn ones are kept.
                if self.motion == "random" or callable(law):
                    speeds[k] = _draw(law, *places[:, :, i], rng)
            for at, speed in zip(places, speeds, strict=True):
                at[:, i + 1] = at[:, i] + speed * step + rng.normal(0, self.jitter, n)
        return places


def _draw(value, x, y, rng):
    """Return the motions of features: from a function, a number, or drawn."""
    if callable(value):
        return np.broadcast_to(value(x, y), x.shape)
    return value if np.ndim(value) == 0 else rng.uniform(*value, x.size)


@dataclass
class Flow:
    """
    Features ejected from the core, whose speeds scatter about a mean.

    Lengths are in beams, times in median intervals between epochs.  A flow
    of speed zero consists of standing features.

    Parameters
    ----------
    name : str, optional
    speed : float, optional
        Mean speed in beams per interval; if the flow accelerates, the mean
        speed at the middle of the jet.
    dispersion : float, optional
        Scatter of the features' speeds: the standard deviation as a fraction
        of the mean, or that of the logarithm for a log-normal distribution.
        The mean is ``speed`` in all distributions, except that speeds are cut
        off at a tenth of it so that all features leave the jet.
    distribution : {'normal', 'lognormal', 'uniform'}, optional
    n_features : float, optional
        Mean number of features in view at a time; for standing features,
        their number.
    positions : sequence of float, optional
        Distances of standing features from the core, instead of
        ``n_features`` random ones.
    acceleration : float, optional
        Ratio of the speeds at the end of the jet and at the core.
    flux : float, optional
        Median flux density in Jy at ejection.
    flux_scatter : float, optional
        Standard deviation of its logarithm between features.
    fading : float, optional
        Flux densities fall as ``(1 + s)**-fading`` with the distance s.
    size : float, optional
        Full width at half maximum at the core.
    widening : float, optional
        Full widths grow as ``(1 + s)**widening``.
    width : float, optional
        Standard deviation of the features' distances from the jet's axis.

    Raises
    ------
    ValueError
        If a parameter is outside its range, or if positions are given for
        moving features.

    Examples
    --------
    >>> from astro_scc.simulation import Flow
    >>> spine = Flow("spine", speed=0.9, dispersion=0.2, size=0.2)
    >>> comb = Flow("comb", speed=0.0, positions=(2.0, 4.0, 6.0))
    >>> spine.distribution, comb.n_features
    ('normal', 3)
    """

    name: str = "flow"
    speed: float = 0.6
    dispersion: float = 0.1
    distribution: str = "normal"
    n_features: float = 8
    positions: Sequence[float] | None = None
    acceleration: float = 1.0
    flux: float = 0.2
    flux_scatter: float = 0.5
    fading: float = 0.8
    size: float = 0.25
    widening: float = 0.6
    width: float = 0.6

    def __post_init__(self):
        whose = f"flow {self.name!r}: "
        distributions = "normal", "lognormal", "uniform"
        named(f"{whose}distribution", check_choice, self.distribution, *distributions)
        if self.positions is not None:
            self.positions = tuple(float(p) for p in self.positions)
            self.n_features = len(self.positions)
            if self.speed != 0 or not all(p >= 0 for p in self.positions):
                raise ValueError(
                    f"{whose}positions must be zero or positive, and the speed zero: "
                    "they are those of standing features"
                )
        names = "speed dispersion n_features acceleration flux flux_scatter fading size"
        check_not_negative(self, f"{names} widening width", whose)
        if self.acceleration == 0:
            raise ValueError(f"{whose}acceleration must be positive")

    def speeds(self, quantile: ArrayLike) -> np.ndarray:
        """
        Return the speeds in beams per interval at quantiles of the features.

        Parameters
        ----------
        quantile : array_like
            Between 0 and 1.

        Returns
        -------
        `~numpy.ndarray`
        """
        quantile = np.asarray(quantile, dtype=float)
        if self.distribution == "uniform":
            factor = 1 + self.dispersion * np.sqrt(3) * (2 * quantile - 1)
        elif self.distribution == "normal":
            factor = 1 + self.dispersion * ndtri(quantile)
        else:
            factor = np.exp(self.dispersion * (ndtri(quantile) - self.dispersion / 2))
        # Slower features would stay for ever.
        return self.speed * np.maximum(factor, 0.1)

    def features(self, jet: Any, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """
        Draw the features and follow them over the epochs.

        Parameters
        ----------
        jet : `JetSimulation`
        rng : `numpy.random.Generator`

        Returns
        -------
        dict of `~numpy.ndarray`
            See ``in_view``.
        """
        times, beam = jet.times, jet.beam_length
        length = np.ptp(jet.extent) / beam
        if self.speed != 0:
            s = self._moving(times, length, rng)
        else:
            s = self.positions
            if s is None:
                s = rng.uniform(1, length, round(self.n_features))
            s = np.repeat(np.asarray(s, dtype=float)[:, None], times.size, axis=1)
        n = len(s)
        across = self.width * rng.standard_normal((n, 1)) * s / (s + RAMP)
        flux = self.flux * np.exp(self.flux_scatter * rng.standard_normal((n, 1)))
        flux = flux * (1 + s) ** -self.fading * raised_cosine((length - s) / RAMP)
        fwhm = self.size * (1 + s) ** self.widening
        x, y = jet.extent[0] + beam * s, jet.axis + beam * across
        every = np.ones(n, dtype=bool)
        flux = np.nan_to_num(flux)
        return in_view(self.name, every, x=x, y=y, flux=flux, fwhm=beam * fwhm)

    def _moving(self, times, length, rng):
        """Return distances from the core; NaN before the ejection and after the end."""
        start = 2 / (1 + self.acceleration)
        growth = start * (self.acceleration - 1) / length
        # Product of speed and time at which a feature leaves the jet.
        needed = np.log(self.acceleration) / growth if growth else length / start
        if self.n_features == 0:
            return np.empty((0, times.size))
        grid = (np.arange(1000) + 0.5) / 1000
        rate = self.n_features / (needed * np.mean(1 / self.speeds(grid)))
        longest = times[-1] - times[0] + needed / self.speeds(grid[0] / 1000)
        # One ejection in each interval of 1 / rate, at a random time in it.
        n = int(np.ceil(rate * longest))
        ejected = times[-1] - (np.arange(n) + rng.uniform(size=n)) / rate
        path = self.speeds(rng.uniform(size=n))[:, None] * (times - ejected[:, None])
        path = np.where(path > 0, np.minimum(path, 1.5 * needed), np.nan)
        s = start * np.expm1(growth * path) / growth if growth else path
        s = np.where(s < length, s, np.nan)
        return s[np.isfinite(s).any(axis=1)]


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
        check_not_negative(self, f"{numbers} {' '.join(columns)}", whose)
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

    def features(self, jet: Any, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """
        Draw the clumps and follow them over the epochs.

        Parameters
        ----------
        jet : `JetSimulation`
        rng : `numpy.random.Generator`

        Returns
        -------
        dict of `~numpy.ndarray`
            See ``in_view``.
        """
        scale, interval = jet.pixel_scale.to_value(u.mas), jet.interval.to_value(u.yr)
        table = self.distance.to_value(u.mas)
        times, life = jet.times * interval, self.life.to_value(u.yr)
        # Clumps are born in the series of epochs, and in a life before it.
        n = rng.poisson(self.n_clumps * (1 + times[-1] / life))
        age = np.zeros((n, times.size))
        if np.isfinite(life):
            age = times - rng.uniform(-1, times[-1] / life, (n, 1)) * life
        r = self._moved(rng.uniform(table[0], table[-1], (n, 1)), age)
        place = rng.choice(self.across, (n, 1)) + self.scatter * rng.normal(size=(n, 1))
        fwhm = rng.uniform(*self.size.to_value(u.mas), (n, 1))
        fading = RAMP * jet.beam_length * scale
        there = raised_cosine((table[-1] - r) / fading)
        if np.isfinite(life):
            r = np.where((age > 0) & (age < life), r, np.nan)
            # It appears in the first quarter of its life, and fades in the last.
            there = there * raised_cosine(np.minimum(age, life - age) / (0.25 * life))
        peak = np.interp(r, table, self.brightness.to_value(u.Jy / u.beam)) * there
        peak = peak * np.exp(self.flux_scatter * rng.standard_normal((n, 1)))
        beams = np.mean([b.covariance.to_value(u.mas**2) for b in jet.beams], axis=0)
        total = beams + (FWHM_TO_SIGMA * fwhm)[..., None, None] ** 2 * np.eye(2)
        flux = peak * np.sqrt(np.linalg.det(total) / np.linalg.det(beams))
        y = place * np.interp(r, table, self.half_width.to_value(u.mas))
        flux = np.nan_to_num(flux)
        seen = (flux > 0).any(axis=1)
        x, y = jet.extent[0] + r / scale, jet.axis + y / scale
        return in_view(self.name, seen, x=x, y=y, flux=flux, fwhm=fwhm / scale)

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
