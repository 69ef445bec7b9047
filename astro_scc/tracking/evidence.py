# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What speaks for a candidate: its looks, and the steadiness of its motion."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from astro_scc.decomposition import scale_size

__all__ = ["Evidence", "chance_density"]


@dataclass(frozen=True)
class Evidence:
    """
    Log-likelihood ratios of candidates: the same feature against chance.

    The widths are those of features in simulated jets of two streams; what
    chance gives is measured on the SSPs themselves, but for the correlation.
    See the documentation.

    Parameters
    ----------
    tolerance : float, optional
        Standard deviation of a displacement in pixels, on each axis, about
        steady motion.
    decorrelation, chance_decorrelation : float, optional
        Means of one minus the correlation coefficient, taken as
        exponential, of the same feature and of chance pairs.
    variability : float, optional
        Half width of the Lorentzian of the logarithm of the ratio of peaks
        of the same feature.
    missing : float, optional
        Cost of an epoch at which the feature is not seen.
    follow : float, optional
        Probability that a pattern moves with the larger one that it lies in.

    Raises
    ------
    ValueError
        If a width is not positive, ``follow`` no probability below 1, or
        ``missing`` negative.

    Examples
    --------
    >>> from astro_scc.tracking import Evidence
    >>> evidence = Evidence(variability=0.3)
    >>> evidence.variability > Evidence().variability
    True
    >>> bool(evidence.brightness(0.0) > evidence.brightness(1.0))
    True
    """

    tolerance: float = 2.0
    decorrelation: float = 0.06
    chance_decorrelation: float = 0.15
    variability: float = 0.15
    missing: float = 2.0
    follow: float = 0.5

    def __post_init__(self):
        for name in ("tolerance", "decorrelation", "chance_decorrelation",
                     "variability"):  # fmt: skip
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, got {getattr(self, name)}")
        if not 0 <= self.follow < 1:
            raise ValueError(f"follow must be 0 or more, below 1, got {self.follow}")
        if not self.missing >= 0:
            raise ValueError(f"missing must be 0 or more, got {self.missing}")

    def looks(self, candidates, ssps):
        """
        Evidence of shape and brightness, and the cost of gaps.

        With correlation coefficients c and ratios r of the peaks, the sum of
        ``ln(b/a) - (1 - c)(1/a - 1/b)``, the ratio of two exponentials of
        means a and b; of `brightness` less the logarithm of the density that
        ``ln r`` has between any two SSPs of the scale, so that a core and a
        feature a hundred times fainter are no likely pair; and of
        ``-missing`` an epoch.

        Parameters
        ----------
        candidates : `Candidates`
        ssps : `~astro_scc.decomposition.SSPs`

        Returns
        -------
        `~numpy.ndarray`, shape (n,)
        """
        a, b = self.decorrelation, self.chance_decorrelation
        shape = np.log(b / a) - (1 - candidates.coefficient) * (1 / a - 1 / b)
        log_ratio = np.log(ssps.peak[candidates.target] / ssps.peak[candidates.source])
        light = self.brightness(log_ratio)
        scale = ssps.scale[candidates.source]
        for value in np.unique(scale):
            own = scale == value
            light[own] -= np.log(
                self._chance(log_ratio[own], np.log(ssps.peak[ssps.scale == value]))
            )
        return shape + light - self.missing * candidates.gap

    def _chance(self, log_ratio, log_peak):
        """Density of ratios between any two peaks, as variable as features are."""
        step = self.variability / 4
        place = np.rint((log_peak - log_peak.min()) / step).astype(int)
        share = np.bincount(place) / len(place)
        pairs = np.convolve(share, share[::-1])
        lags = np.arange(len(pairs)) - len(share) + 1
        kernel = np.exp(
            self.brightness(step * np.arange(2 * lags[0], 2 * lags[-1] + 1))
        )
        return np.interp(
            log_ratio / step, lags, np.convolve(pairs, kernel, mode="valid")
        )

    def brightness(self, log_ratio):
        """
        Log-likelihood of a change of brightness of one feature.

        Parameters
        ----------
        log_ratio : array_like
            Natural logarithm of the ratio of two brightnesses.

        Returns
        -------
        `~numpy.ndarray`
        """
        w = self.variability
        return -np.log(np.pi * w * (1 + (log_ratio / w) ** 2))

    def steadiness(self, motion, interval, velocity, weight, density):
        """
        Evidence of a displacement, given the mean velocity of the rest of a track.

        The density of a two-dimensional normal distribution about the
        displacement that the mean velocity predicts, over that of chance
        landings.  Displacements have the standard deviation ``tolerance``
        each, whatever their times t, so that the mean weights them by
        ``t^2``, and has the variance ``tolerance^2`` over the sum of these.

        Parameters
        ----------
        motion : `~numpy.ndarray`, shape (n, 2)
            Displacements (y, x).
        interval : `~numpy.ndarray`, shape (n,)
            Their times.
        velocity : `~numpy.ndarray`, shape (n, 2)
            Mean velocities of the tracks that they continue.
        weight : `~numpy.ndarray`, shape (n,)
            Sums of the squares of the times of these.
        density : `~numpy.ndarray`, shape (n,)
            SSPs per square pixel where the displacement leads to.

        Returns
        -------
        `~numpy.ndarray`, shape (n,)
        """
        variance = self.tolerance**2 * (1 + interval**2 / weight)
        away = np.sum((motion - interval[:, None] * velocity) ** 2, axis=1)
        return -0.5 * away / variance - np.log(2 * np.pi * variance * density)

    def guidance(self, away, width, density):
        """
        Evidence of a larger pattern's motion for the smaller ones in it.

        Parameters
        ----------
        away : `~numpy.ndarray`, shape (n, 2)
            Displacement from that of the larger pattern, in pixels.
        width : float
            Standard deviation of that, about the size of the larger scale.
        density : `~numpy.ndarray`, shape (n,)

        Returns
        -------
        `~numpy.ndarray`, shape (n,)
            Never below ``ln(1 - follow)``.
        """
        near = np.exp(-0.5 * np.sum(away**2, axis=1) / width**2)
        ratio = near / (2 * np.pi * width**2 * density)
        return np.log(1 - self.follow + self.follow * ratio)


def chance_density(ssps):
    """
    How many SSPs of its scale and epoch there are about each SSP.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.

    Returns
    -------
    `~numpy.ndarray`, shape (n,)
        Per square pixel: the median, over the SSPs of the scale and epoch,
        of k over the area to the k-th neighbour, k = 3 or as many as there
        are.  One SSP alone counts as one in a circle of ten scales.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.tracking import chance_density
    >>> y, x = np.mgrid[:64, :96]
    >>> def image(*centres):
    ...     return sum(np.exp(-((x - x0) ** 2 + (y - 32) ** 2) / 30) for x0 in centres)
    >>> decompose = Decomposer(scales=[2])
    >>> ssps = SSPs.of_epochs([decompose(image(30, 60))])
    >>> chance_density(ssps).round(5).tolist()
    [0.00035, 0.00035]
    """
    density = np.empty(len(ssps))
    for scale in np.unique(ssps.scale):
        alone = 1 / (np.pi * (10 * scale_size(scale)) ** 2)
        for epoch in np.unique(ssps.epoch[ssps.scale == scale]):
            own = np.flatnonzero((ssps.scale == scale) & (ssps.epoch == epoch))
            k = min(3, len(own) - 1)
            density[own] = alone
            if k > 0:
                at = np.stack([ssps.y[own], ssps.x[own]], axis=1)
                distance = cKDTree(at).query(at, k + 1)[0][:, k]
                found = k / (np.pi * np.median(distance) ** 2)
                density[own] = max(found, alone)
    return density
