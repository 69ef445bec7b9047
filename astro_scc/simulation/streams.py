# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Groups of features that share one law of motion."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import astropy.units as u
import numpy as np

__all__ = ["Features", "Stream", "check_not_negative"]

MOTIONS = ("steady", "random", "unrelated")


class Features(NamedTuple):
    """
    Features of a jet along x, at every epoch.

    Attributes
    ----------
    group : `numpy.ndarray` of str, shape (n,)
    x, y : `numpy.ndarray`, shape (n, n_epochs)
        Pixels from 0; NaN where a feature does not exist.
    flux : `numpy.ndarray`, shape (n, n_epochs)
        In Jy.
    fwhm : `numpy.ndarray`, shape (n, n_epochs)
        In pixels.
    """

    group: np.ndarray
    x: np.ndarray
    y: np.ndarray
    flux: np.ndarray
    fwhm: np.ndarray


def check_not_negative(owner, names, whose=""):
    """
    Refuse negative and infinite parameters.

    Parameters
    ----------
    owner : object
    names : str
        Attributes, separated by blanks; None is left alone.
    whose : str, optional
        What the message begins with.

    Raises
    ------
    ValueError
        If one of them is not finite, or negative.
    """
    for name in names.split():
        value = getattr(owner, name)
        for number in np.atleast_1d([] if value is None else value):
            if not 0 <= number < np.inf:
                raise ValueError(
                    f"{whose}{name} must be zero or positive, got {number}"
                )


@dataclass(frozen=True)
class Stream:
    """
    A group of features with one law of motion.

    Pixels are those of the simulated image, x along the jet.

    Parameters
    ----------
    name : str
    dx, dy : float, (float, float), callable or `~astropy.units.Quantity`
        Motion along and across the jet in pixels per interval between
        epochs: one number for all, the limits of a uniform distribution,
        or a function of the positions (x, y), evaluated at every epoch.  A
        Quantity, scalar or of two limits, is a proper motion.
    motion : {'steady', 'random', 'unrelated'}, optional
        What a distribution is drawn for: each feature once, which then keeps
        its own velocity; each feature at every epoch; or, 'unrelated', the
        features themselves are new at every epoch and do not move.
    density : float, optional
        Features per beam length along the jet.
    half_width : float, optional
        Features start uniformly within this distance of the axis, in pixels.
    sigma : float, optional
        Features start with this normal deviation from the axis, in pixels;
        instead of ``half_width``.
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
        If a parameter is outside its range, or both or none of
        ``half_width`` and ``sigma`` are given.

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
        if self.motion not in MOTIONS:
            raise ValueError(
                f"stream {self.name!r}: motion must be one of "
                f"{', '.join(MOTIONS)}, got {self.motion!r}"
            )
        if (self.half_width is None) == (self.sigma is None):
            raise ValueError(
                f"stream {self.name!r} needs one of half_width and sigma, "
                "the width over which features start"
            )
        check_not_negative(
            self, "density half_width sigma jitter", f"stream {self.name!r}: "
        )
        for name in ("fwhm", "peak"):
            low, high = getattr(self, name)
            if not 0 <= low <= high < np.inf:
                raise ValueError(
                    f"stream {self.name!r}: {name} must be two limits "
                    f"0 <= low <= high, got {getattr(self, name)}"
                )
        for name in ("dx", "dy"):
            value = getattr(self, name)
            if callable(value):
                continue
            limits = np.atleast_1d(getattr(value, "value", value))
            if limits.size > 2 or not np.all(np.isfinite(limits)):
                raise ValueError(
                    f"stream {self.name!r}: {name} must be a number, two limits "
                    f"or a function of (x, y), got {value}"
                )

    def features(self, jet, rng):
        """
        Draw the features and follow them over the epochs.

        Parameters
        ----------
        jet : `JetSimulation`
        rng : `numpy.random.Generator`

        Returns
        -------
        `Features`
            Those that are seen at some epoch.
        """

        def convert(value):
            if not isinstance(value, u.Quantity):
                return value
            pixels = (value / jet.velocity_unit).to_value(u.one)
            return tuple(pixels) if pixels.ndim else float(pixels)

        stream = replace(self, dx=convert(self.dx), dy=convert(self.dy))
        beam = jet.beam_length
        start, end = jet.extent
        x, y = stream.trajectories(np.diff(jet.times), jet.extent, jet.axis, beam, rng)
        fwhm = rng.uniform(*self.fwhm, len(x))
        peak = rng.uniform(*self.peak, len(x))
        flux = (peak * (beam**2 + fwhm**2) / beam**2)[:, None] * jet.visibility(x)
        fwhm = np.repeat(fwhm[:, None], x.shape[1], axis=1)
        seen = ((x >= start) & (x <= end)).any(axis=1)
        group = np.full(seen.sum(), self.name)
        return Features(group, x[seen], y[seen], flux[seen], fwhm[seen])

    def trajectories(self, steps, region, axis, beam_length, rng):
        """
        Positions of the stream's features at every epoch.

        Features start over the whole stretch from which they can reach the
        region, so that its density stays the same on average.

        Parameters
        ----------
        steps : array_like, shape (n_epochs - 1,)
            Times between epochs in units of the interval.
        region : tuple of float
            Limits in x between which features are seen.
        axis : float
            y of the jet axis.
        beam_length : float
            Beam length in pixels that ``density`` refers to.
        rng : `numpy.random.Generator`

        Returns
        -------
        x, y : `numpy.ndarray`, shape (n_features, n_epochs)
            NaN at the epochs at which a feature does not exist.
        """
        steps = np.asarray(steps, dtype=float)
        n_epochs = steps.size + 1
        start, end = region
        if self.motion == "unrelated":
            return self._unrelated(n_epochs, region, axis, beam_length, rng)

        low, high = self._limits(region)
        reach = 3 * self.jitter * np.sqrt(steps.size)
        start = start - max(high, 0) * steps.sum() - reach
        end = end - min(low, 0) * steps.sum() + reach
        n = round(self.density * (end - start) / beam_length)
        x = np.empty((n, n_epochs))
        y = np.empty((n, n_epochs))
        x[:, 0] = rng.uniform(start, end, n)
        y[:, 0] = self._across(n, axis, rng)
        own = self._draw(x[:, 0], y[:, 0], rng)
        for i, step in enumerate(steps):
            dx, dy = own
            if self.motion == "random":
                dx, dy = self._draw(x[:, i], y[:, i], rng)
            elif callable(self.dx) or callable(self.dy):
                # A field of velocities is followed; drawn ones are kept.
                field = self._draw(x[:, i], y[:, i], None)
                dx = field[0] if callable(self.dx) else dx
                dy = field[1] if callable(self.dy) else dy
            x[:, i + 1] = x[:, i] + dx * step + rng.normal(0, self.jitter, n)
            y[:, i + 1] = y[:, i] + dy * step + rng.normal(0, self.jitter, n)
        return x, y

    def _unrelated(self, n_epochs, region, axis, beam_length, rng):
        start, end = region
        n = round(self.density * (end - start) / beam_length)
        x = np.full((n * n_epochs, n_epochs), np.nan)
        y = np.full((n * n_epochs, n_epochs), np.nan)
        for i in range(n_epochs):
            rows = slice(i * n, (i + 1) * n)
            x[rows, i] = rng.uniform(start, end, n)
            y[rows, i] = self._across(n, axis, rng)
        return x, y

    def _across(self, n, axis, rng):
        if self.sigma is not None:
            return rng.normal(axis, self.sigma, n)
        return rng.uniform(axis - self.half_width, axis + self.half_width, n)

    def _draw(self, x, y, rng):
        drawn = []
        for value in (self.dx, self.dy):
            if callable(value):
                drawn.append(np.broadcast_to(value(x, y), x.shape))
            elif rng is None or np.ndim(value) == 0:
                drawn.append(value)
            else:
                drawn.append(rng.uniform(*value, x.size))
        return drawn

    def _limits(self, region):
        if callable(self.dx):
            x = np.linspace(*region, 200)
            speeds = self.dx(x, np.zeros_like(x))
        else:
            speeds = self.dx
        return np.min(speeds), np.max(speeds)
