# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features that are ejected from a core, and features that stand still."""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from astro_scc.simulation.streams import check_not_negative

__all__ = ["Flow"]

DISTRIBUTIONS = ("normal", "lognormal", "uniform")
# Slowest feature, as a fraction of the mean: slower ones would stay for ever.
SLOWEST = 0.1
# Length in beams over which features part from the axis and fade at the end.
RAMP = 2.0


@dataclass(frozen=True)
class Flow:
    """
    Features ejected from the core, each with a speed of its own about a mean.

    Lengths are in beams, times in median intervals between epochs.  A flow
    of speed zero is made of standing features.

    Parameters
    ----------
    name : str, optional
    speed : float, optional
        Mean speed in beams per interval, that at the middle of the jet if
        the flow accelerates.
    dispersion : float, optional
        Scatter of the features' speeds: the standard deviation as a fraction
        of the mean or, of a log-normal distribution, that of the logarithm.
        The mean is ``speed`` in all distributions, but for the cut at a
        tenth of it that spares the jet features which never leave.
    distribution : {'normal', 'lognormal', 'uniform'}, optional
    n_features : float, optional
        Mean number of features in view at a time; of standing features
        their number.
    positions : sequence of float, optional
        Distances of standing features from the core, instead of
        ``n_features`` random ones.
    acceleration : float, optional
        Speed at the end of the jet over that at the core.
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
        Standard deviation of the features' distances from the flow's axis.
    offset : float, optional
        Distance of the flow's axis from the jet's, to the left of the
        direction of the jet as seen on the sky (larger position angles).

    Raises
    ------
    ValueError
        If a parameter is outside its range, or positions are given to
        features that move.

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
    positions: tuple[float, ...] | None = None
    acceleration: float = 1.0
    flux: float = 0.2
    flux_scatter: float = 0.5
    fading: float = 0.8
    size: float = 0.25
    widening: float = 0.6
    width: float = 0.6
    offset: float = 0.0

    def __post_init__(self):
        if self.distribution not in DISTRIBUTIONS:
            raise ValueError(
                f"flow {self.name!r}: distribution must be one of "
                f"{', '.join(DISTRIBUTIONS)}, got {self.distribution!r}"
            )
        if self.positions is not None:
            positions = tuple(float(p) for p in self.positions)
            if self.speed != 0 or not all(p >= 0 for p in positions):
                raise ValueError(
                    f"flow {self.name!r}: positions must be zero or positive, and "
                    "the speed zero: they are those of standing features"
                )
            object.__setattr__(self, "positions", positions)
            object.__setattr__(self, "n_features", len(positions))
        check_not_negative(
            self,
            "speed dispersion n_features acceleration flux flux_scatter fading size "
            "widening width",
            f"flow {self.name!r}: ",
        )
        if self.acceleration == 0:
            raise ValueError(f"flow {self.name!r}: acceleration must be positive")

    def speeds(self, quantile):
        """
        Speeds below which a fraction of the ejected features have theirs.

        Parameters
        ----------
        quantile : array_like
            Fractions between 0 and 1.

        Returns
        -------
        `numpy.ndarray`
            In beams per interval.
        """
        quantile = np.asarray(quantile, dtype=float)
        if self.distribution == "uniform":
            factor = 1 + self.dispersion * np.sqrt(3) * (2 * quantile - 1)
        elif self.distribution == "normal":
            factor = 1 + self.dispersion * ndtri(quantile)
        else:
            factor = np.exp(self.dispersion * (ndtri(quantile) - self.dispersion / 2))
        return self.speed * np.maximum(factor, SLOWEST)

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
        """
        times, length = jet.times, jet.length
        if self.speed == 0:
            s = self.positions
            if s is None:
                s = rng.uniform(1, length, round(self.n_features))
            s = np.repeat(np.asarray(s, dtype=float)[:, None], times.size, axis=1)
        else:
            s = self._moving(times, length, rng)
        n = len(s)
        across = self.offset + self.width * rng.standard_normal((n, 1))
        flux = self.flux * np.exp(self.flux_scatter * rng.standard_normal((n, 1)))
        flux = np.nan_to_num(flux * (1 + s) ** -self.fading * _end(length - s))
        fwhm = self.size * (1 + s) ** self.widening
        return jet.place(self.name, s, across * s / (s + RAMP), flux, fwhm)

    def _moving(self, times, length, rng):
        """Distances from the core; NaN before the ejection and after the end."""
        start = 2 / (1 + self.acceleration)
        growth = start * (self.acceleration - 1) / length
        # Distance over speed of what is needed to leave the jet.
        needed = length / start
        if growth:
            needed = np.log(self.acceleration) / growth
        grid = (np.arange(1000) + 0.5) / 1000
        if self.n_features == 0:
            return np.empty((0, times.size))
        rate = self.n_features / (needed * np.mean(1 / self.speeds(grid)))
        longest = times[-1] - times[0] + needed / self.speeds(grid[0] / 1000)
        # One ejection in each interval of 1 / rate, at any time of it.
        n = int(np.ceil(rate * longest))
        ejected = times[-1] - (np.arange(n) + rng.uniform(size=n)) / rate
        path = self.speeds(rng.uniform(size=n))[:, None] * (times - ejected[:, None])
        path = np.where(path > 0, np.minimum(path, 1.5 * needed), np.nan)
        s = start * np.expm1(growth * path) / growth if growth else path
        s = np.where(s < length, s, np.nan)
        return s[np.isfinite(s).any(axis=1)]


def _end(left):
    """Fraction of the flux that is seen so far from the end: a raised cosine."""
    return 0.5 * (1 - np.cos(np.pi * np.clip(left / RAMP, 0, 1)))
