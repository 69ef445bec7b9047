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

    The widths are those of features and of chance pairs in simulated jets of
    two streams; see the documentation.

    Parameters
    ----------
    tolerance : float, optional
        Standard deviation of a displacement in pixels, on each axis, about
        steady motion.
    decorrelation, chance_decorrelation : float, optional
        Means of one minus the correlation coefficient, taken as
        exponential, of the same feature and of chance pairs.
    variability, diversity : float, optional
        Half width of the Lorentzian of the logarithm of the ratio of peaks
        of the same feature; standard deviation of that of chance pairs.
    missing : float, optional
        Cost of an epoch at which the feature is not seen.
    follow : float, optional
        Probability that a pattern moves with the larger one that it lies in.
    floor : float, optional
        No single piece of evidence counts less than this.

    Raises
    ------
    ValueError
        If a width is not positive, ``follow`` no probability below 1, or
        ``floor`` or ``missing`` of the wrong sign.

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
    diversity: float = 1.0
    missing: float = 2.0
    follow: float = 0.5
    floor: float = -6.0

    def __post_init__(self):
        for name in ("tolerance", "decorrelation", "chance_decorrelation",
                     "variability", "diversity"):  # fmt: skip
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, got {getattr(self, name)}")
        if not 0 <= self.follow < 1:
            raise ValueError(f"follow must be 0 or more, below 1, got {self.follow}")
        if not (self.missing >= 0 and self.floor <= 0):
            raise ValueError(
                "missing must be 0 or more and floor 0 or less, "
                f"got {self.missing} and {self.floor}"
            )

    def looks(self, candidates, ssps):
        """
        Evidence of shape and brightness, and the cost of gaps.

        With correlation coefficients c and ratios r of the peaks, the sum of
        ``ln(b/a) - (1 - c)(1/a - 1/b)``, the ratio of two exponentials of
        means a and b; of a Lorentzian over a normal distribution in
        ``ln r``; and of ``-missing`` an epoch.

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
        light = self.brightness(
            np.log(ssps.peak[candidates.target] / ssps.peak[candidates.source])
        )
        return (
            np.maximum(shape, self.floor)
            + np.maximum(light, self.floor)
            - self.missing * candidates.gap
        )

    def brightness(self, log_ratio):
        """
        Evidence of a change of brightness alone.

        Parameters
        ----------
        log_ratio : array_like
            Natural logarithm of the ratio of two brightnesses.

        Returns
        -------
        `~numpy.ndarray`
        """
        w, s = self.variability, self.diversity
        same = -np.log(np.pi * w * (1 + (log_ratio / w) ** 2))
        chance = -0.5 * (log_ratio / s) ** 2 - 0.5 * np.log(2 * np.pi) - np.log(s)
        return same - chance

    def steadiness(self, step, interval, density):
        """
        Evidence of a difference between two velocities.

        The density of a two-dimensional normal distribution of the
        difference over that of chance landings.

        Parameters
        ----------
        step : `~numpy.ndarray`, shape (2, n, 2)
            Displacements (y, x) before and after.
        interval : `~numpy.ndarray`, shape (2, n)
            Their times.
        density : `~numpy.ndarray`, shape (n,)
            SSPs per square pixel where the second one lands.

        Returns
        -------
        `~numpy.ndarray`, shape (n,)
        """
        # As a place where the second displacement leads to.
        ahead = interval[1] / interval[0]
        variance = self.tolerance**2 * (1 + ahead**2)
        away = np.sum((step[1] - ahead[:, None] * step[0]) ** 2, axis=1)
        value = -0.5 * away / variance - np.log(2 * np.pi * variance * density)
        return np.maximum(value, self.floor)

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
