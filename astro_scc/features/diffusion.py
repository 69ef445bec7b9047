# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Whether features keep their speeds, or diffuse as random walks do."""

from dataclasses import dataclass

import numpy as np

from astro_scc.features.finder import LEAST_EPOCHS, Features
from astro_scc.intervals import median_interval

#: Variance of the slope of a straight line through a random walk, times its duration
#: over the variance of the walk in unit time.
SLOPE = 1.2
#: Epochs of a feature of which each half has a speed, and fewest such features.
HALVES_OF, FEWEST = 6, 10
#: Smallest random step in the median interval, in beams, change of the speeds between
#: the halves, and isotropy: what random walks have, as far as they can be followed, and
#: neither simulated jets nor those of MOJAVE have together
#: (``benchmarks/calibration/diffusion.py``).
STEP, CHANGE, ISOTROPY = 0.085, 0.7, 0.7


@dataclass(frozen=True)
class Diffusion:
    """
    Whether features keep their speeds.

    Attributes
    ----------
    n_features : int
        Those that are seen in so many epochs that each half has a speed.
    step : float
        Random step on each axis in the median interval, in beams.
    change : float
        Variance of the difference of the speeds of the halves, over that of the speeds
        of features: 0 if each keeps its own speed, 4 in a random walk.
    isotropy : float
        Scatter of the speeds across their mean direction over that along it.
    variance : float
        Variance of the speeds on each axis, times years, in mas^2/yr.

    Examples
    --------
    >>> from astro_scc.features.diffusion import Diffusion
    >>> Diffusion(30, step=0.1, change=1.5, isotropy=1.0, variance=2.0).is_walk
    True
    """

    n_features: int
    step: float = 0.0
    change: float = 0.0
    isotropy: float = 0.0
    variance: float = 0.0

    @property
    def is_walk(self) -> bool:
        """Whether the features diffuse."""
        enough = self.n_features >= FEWEST and self.step >= STEP
        return enough and self.change >= CHANGE and self.isotropy >= ISOTROPY


def measure_diffusion(features: Features) -> Diffusion:
    """
    Compare the speeds of features in both halves of their epochs.

    Parameters
    ----------
    features : `~astro_scc.features.Features`

    Returns
    -------
    `Diffusion`
    """
    d = features.detections
    each = zip(features.tracks, features.motions, strict=True)
    long = [(t.detection, motion) for t, motion in each if len(t) >= HALVES_OF]
    if len(long) < 2:
        return Diffusion(len(long))
    span = np.array([motion.span for _, motion in long])
    speed = np.array([motion.velocity for _, motion in long])
    mean = np.average(speed, axis=0, weights=span)
    length = np.hypot(*mean)
    along = mean / length if length > 0 else np.array([1.0, 0.0])
    axes = np.stack([along, along[::-1] * (-1, 1)], axis=1)
    variance = span @ ((speed - mean) @ axes) ** 2
    if not np.all(variance > 0):
        return Diffusion(len(long))
    difference = 0.0
    for years, (members, _) in zip(span, long, strict=True):
        half = len(members) // 2
        v, v_var = d.velocity(members[:half])
        w, w_var = d.velocity(members[-half:])
        difference += years * ((v - w) ** 2 - v_var - w_var).sum()
    walk = random_walk(features) * median_interval(d.time)
    return Diffusion(
        n_features=len(long), change=float(difference / variance.sum()),
        step=float(np.sqrt(walk / SLOPE) / d.fwhm),
        isotropy=float(np.sqrt(variance[1] / variance[0])),
        variance=float(variance.sum() / 2 / (len(long) - 1)),
    )  # fmt: skip


def random_walk(features: Features) -> float:
    """
    Return the variance of the speeds of features from their random walk, times years.

    The variance of a step about the motion is that of the walk plus twice that of a
    position, and neighbouring steps have minus the latter in common.  The slope of a
    straight line through a walk of variance q a year over T years has the variance
    ``SLOPE * q / T``.

    Parameters
    ----------
    features : `~astro_scc.features.Features`

    Returns
    -------
    float
        In mas^2/yr.
    """
    d, walk, years = features.detections, 0.0, 0.0
    for track, motion in zip(features.tracks, features.motions, strict=True):
        time, place = d.time[track.detection], d.place[track.detection]
        n = len(time) - 1
        if n < LEAST_EPOCHS - 1:
            continue
        step = np.diff(place, axis=0) - np.diff(time)[:, None] * motion.velocity
        square = (step**2).sum() + 2 * (step[1:] * step[:-1]).sum()
        # The straight line takes up one of the steps.
        walk += square / 2 * n / (n - 1)
        years += time[-1] - time[0]
    return SLOPE * max(walk, 0.0) / years if years else 0.0
