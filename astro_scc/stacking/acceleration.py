# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Acceleration of a flow, from the speeds and the bends of its features."""

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from astro_scc.stacking.search import DEFAULT
from astro_scc.stacking.streams import feature_speeds, scattered_fit

__all__ = ["Acceleration", "fit_acceleration"]

#: The core pulls at features that are nearer, in beams.
CORE = 2.0
#: Relative gradient of the speed that blends leave on jets without acceleration, per
#: beam (``benchmarks/calibration/design.py``).
BLENDS = 0.009
#: Fewest features whose speeds have a gradient, and whose bends have a mean.
FEWEST_SPEEDS, FEWEST_BENDS = 4, 2


@dataclass(frozen=True)
class Acceleration:
    """
    Gradient of the speed along a flow.

    Attributes
    ----------
    gradient, error : float
        Of the speed with distance over the mean speed, in 1/beam; NaN if too
        few features are seen.
    p_value : float
        Of as large a gradient, of either sign, if there is none.
    speed : float
        Mean speed of the features, in beams a year.
    centre : float
        Their mean distance, in beams.
    n_features : int

    Examples
    --------
    >>> from astro_scc.stacking import Acceleration, fit_acceleration
    >>> found = fit_acceleration([])
    >>> isinstance(found, Acceleration), found.n_features
    (True, 0)
    """

    gradient: float
    error: float
    p_value: float
    speed: float
    centre: float
    n_features: int


def fit_acceleration(features):
    """
    Fit the gradient of the speed of features that pass through a flow.

    Two estimates are combined, weighted by their errors: the slope of the
    features' speeds against distance, and the mean of their own
    accelerations a, as a flow with the speed v(x) has ``a = v dv/dx``.  Both
    are random-effects models (see `random_effects`).

    Parameters
    ----------
    features : sequence of `~astro_scc.stacking.Feature`
        Those within two beams of the origin, where the core pulls at them,
        do not count.

    Returns
    -------
    `Acceleration`

    Examples
    --------
    Features that speed up by a tenth in each beam:

    >>> import numpy as np
    >>> from astro_scc.stacking import Feature, fit_acceleration
    >>> years, features = np.arange(6.0), []
    >>> for start in (1.5, 3.0, 5.0, 7.0, 9.0):
    ...     along = (start + 10) * np.exp(0.05 * years) - 10
    ...     place = np.stack([along, np.zeros(6)], axis=1)
    ...     features.append(Feature.through(np.arange(6), years, place))
    >>> found = fit_acceleration(features)
    >>> found.p_value < 0.05, round(found.gradient * found.speed, 2)
    (True, 0.05)
    """
    ways = np.sign([f.speed for f in features])
    beyond = [f for f, way in zip(features, ways, strict=True) if f.place * way > CORE]
    n = len(beyond)
    unknown = Acceleration(np.nan, np.nan, np.nan, np.nan, np.nan, n)
    if n < FEWEST_BENDS:
        return unknown
    place = np.array([f.place for f in beyond])
    v, error = feature_speeds(beyond)
    speed, centre = v.mean(), place.mean()
    found = []
    if n >= FEWEST_SPEEDS:
        design = np.stack([np.ones(n), place - centre], axis=1)
        (_, slope), covariance, _, _ = scattered_fit(design, v, error)
        found.append((slope, covariance[1, 1], n - 2))
    bent = [f for f in beyond if np.isfinite(f.acceleration)]
    if len(bent) >= FEWEST_BENDS:
        own = np.array([f.acceleration / f.speed for f in bent])
        error = np.array([f.acceleration_error / abs(f.speed) for f in bent])
        error *= DEFAULT.error_inflation
        (mean,), covariance, _, _ = scattered_fit(np.ones((len(bent), 1)), own, error)
        found.append((mean, covariance[0, 0], len(bent) - 1))
    if not found:
        return unknown
    values, variances, freedom = np.array(found).T
    weight = 1 / variances
    gradient = (weight * values).sum() / weight.sum() / abs(speed)
    error = np.hypot(1 / np.sqrt(weight.sum()) / abs(speed), BLENDS)
    p_value = 2 * stdtr(freedom.sum(), -abs(gradient) / error)
    return Acceleration(
        float(gradient), float(error), float(p_value), float(speed), float(centre), n
    )
