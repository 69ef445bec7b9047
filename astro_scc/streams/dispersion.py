# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Mean, dispersion and error of the speeds of features, and how many streams."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import ndtr

from astro_scc.streams.diagram import DEFAULT, SearchSettings

#: Relative error of a feature's speed from the remaining pull of the core, on simulated
#: jets.
CORE_BIAS = 0.02
#: Relative error of the speed of a feature that is always near a standing one.  On
#: simulated jets such speeds are 13% too small, and scatter by 14%
#: (``benchmarks/calibration/followed.py``).
PULLED_ERROR = 0.2
#: Fewest features with which two streams can be distinguished.
FEWEST_OF_TWO = 4
#: Dispersions, relative to the mean, that are tried for one stream.
ONE_DISPERSIONS = (
    0.01, 0.03, 0.05, 0.08, 0.1, 0.13, 0.16, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6,
    0.7, 0.8, 1.0,
)  # fmt: skip
#: Those that are tried for each of two streams.
TWO_DISPERSIONS = (0.05, 0.12, 0.25)
#: Far below any density of speeds that counts, and its square is not zero.
TINY = 1e-150
#: Number of dispersions that are tried, from zero to four standard deviations.
TAUS = 80


@dataclass(frozen=True)
class Population:
    """
    Speeds of features with the distribution N(mean, dispersion^2 + error^2).

    Attributes
    ----------
    mean, error : float
        ``error`` is the half-width of the 68% interval.
    dispersion, dispersion_error : float
        NaN for a single feature.

    Examples
    --------
    >>> from astro_scc.streams.dispersion import random_effects
    >>> random_effects([1.0, 1.1, 0.9, 1.0], [0.05] * 4).mean
    1.0
    """

    mean: float
    error: float
    dispersion: float
    dispersion_error: float


def random_effects(
    values: ArrayLike, errors: ArrayLike, settings: SearchSettings = DEFAULT
) -> Population:
    """
    Return the mean and dispersion of values that differ by more than their errors.

    Mean and dispersion have a Bayesian random-effects model: values are normal about
    the mean with the variance ``tau^2 + e^2``, the prior of the mean is flat, and that
    of tau half-normal (Gelman 2006, Bayesian Anal. 1, 515; Roever 2020, J. Stat. Softw.
    93, 6) with a standard deviation of ``lone_dispersion`` times the median.  The
    features are a sample of the flow, and their variance counts in full: one alone
    knows the mean of the others no better than the prior does.

    Parameters
    ----------
    values, errors : array_like, shape (n,)
    settings : `~astro_scc.streams.SearchSettings`, optional

    Returns
    -------
    ``Population``

    Examples
    --------
    >>> from astro_scc.streams.dispersion import random_effects
    >>> stream = random_effects([0.8, 1.0, 1.2, 0.9, 1.1], [0.01] * 5)
    >>> round(stream.mean, 2), round(stream.dispersion, 2)
    (1.0, 0.2)
    """
    x, e = np.asarray(values, dtype=float), np.asarray(errors, dtype=float)
    scale = settings.lone_dispersion * max(abs(np.median(x)), np.sqrt(np.mean(e**2)))
    tau = 4 * scale * (np.arange(TAUS) + 0.5) / TAUS
    w = 1 / (e**2 + tau[:, None] ** 2)
    total = w.sum(axis=1)
    means = (w @ x) / total
    squares = (w * (x - means[:, None]) ** 2).sum(axis=1)
    log = 0.5 * (np.log(w).sum(axis=1) - np.log(total) - squares - (tau / scale) ** 2)
    posterior = np.exp(log - log.max())
    posterior /= posterior.sum()
    mean, width = posterior @ means, 1 / np.sqrt(total)

    def outside(half):
        below = ndtr((mean - half - means) / width)
        above = ndtr((means - mean - half) / width)
        return posterior @ (below + above) - 2 * ndtr(-1)

    widest = 2 * (width.max() + np.ptp(means))
    error = brentq(outside, 0, widest, xtol=1e-4 * widest)
    if len(x) == 1:
        return Population(float(mean), error, np.nan, np.nan)
    spread = posterior @ tau
    deviation = np.sqrt(posterior @ (tau - spread) ** 2)
    return Population(float(mean), error, float(spread), float(deviation))


def scattered_fit(design, values, errors):
    """
    Fit a linear model to values that scatter by more than their errors.

    Parameters
    ----------
    design : `~numpy.ndarray`, shape (n, k)
    values, errors : `~numpy.ndarray`, shape (n,)
        n must be larger than k.

    Returns
    -------
    coefficients : `~numpy.ndarray`, shape (k,)
    covariance : `~numpy.ndarray`, shape (k, k)
        By Hartung & Knapp, for Student's t of n - k degrees of freedom.
    tau : float
        Scatter beyond the errors, by Paule & Mandel.
    weight : `~numpy.ndarray`, shape (n,)

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.streams.dispersion import scattered_fit
    >>> x = np.arange(4.0)
    >>> design = np.stack([np.ones(4), x], axis=1)
    >>> scattered_fit(design, 1 + 2 * x, np.full(4, 0.1))[0].round(6).tolist()
    [1.0, 2.0]
    """
    freedom = len(values) - design.shape[1]

    def fit(tau2):
        w = 1 / (errors**2 + tau2)
        inverse = np.linalg.inv((design.T * w) @ design)
        found = inverse @ (design.T @ (w * values))
        return found, inverse, w, (w * (values - design @ found) ** 2).sum()

    tau2, most = 0.0, 10 * values.var() + 1e-30
    if fit(0.0)[3] > freedom:
        tau2 = brentq(lambda t: fit(t)[3] - freedom, 0, most, xtol=1e-12 * most)
    found, inverse, w, squares = fit(tau2)
    # If values agree by chance, the error is still half of that from their errors.
    return found, inverse * max(squares / freedom, 0.25), np.sqrt(tau2), w


def feature_speeds(features, settings=DEFAULT, pulled_error=PULLED_ERROR):
    """Return speeds of features, with errors that include blends and the core."""
    speed = np.array([f.speed for f in features])
    error = error_of_speed(speed, np.array([f.error for f in features]), settings)
    pulled = np.array([f.pulled for f in features])
    return speed, np.hypot(error, pulled * pulled_error * speed)


def error_of_speed(speed, error, settings=DEFAULT):
    """Return errors of features' speeds from those of their straight lines."""
    return np.hypot(settings.error_inflation * error, CORE_BIAS * speed)


def separate_streams(features, n_trials, rng, settings=DEFAULT):
    """
    Test whether the speeds of features are those of two streams rather than one.

    The statistic is the ratio of the largest likelihood of a mixture of two
    log-normal distributions, each with a dispersion of at most 25%, to that
    of one normal or log-normal distribution of any dispersion.  Its
    distribution for one stream is simulated by drawing as many features, with
    the same errors, from the one stream that fits (parametric bootstrap;
    McLachlan 1987, Appl. Stat. 36, 318), but uniformly: of all distributions of one
    mean and dispersion without a gap, it looks most like two.

    Parameters
    ----------
    features : sequence of ``Feature``
        Features that move in one direction.
    n_trials : int
    rng : `~numpy.random.Generator`
    settings : `~astro_scc.streams.SearchSettings`, optional

    Returns
    -------
    p_value : float
        1 with fewer than four features.
    second : `~numpy.ndarray` of bool, shape (n,)
        Whether a feature belongs to the faster one of the two streams.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.streams.chains import Feature
    >>> from astro_scc.streams.dispersion import separate_streams
    >>> epoch = np.arange(4)
    >>> features = [
    ...     Feature.through(epoch, epoch, epoch, np.outer(epoch, [speed, 0]))
    ...     for speed in [0.3, 1.05, 0.32, 0.33, 1.0, 0.98]]
    >>> p_value, second = separate_streams(features, 99, np.random.default_rng(1))
    >>> p_value < 0.05, second
    (True, array([False,  True, False, False,  True,  True]))
    """
    # The pull of standing features does not make two streams one.
    speed, error = feature_speeds(features, settings, pulled_error=0.0)
    if len(speed) < FEWEST_OF_TWO:
        return 1.0, np.zeros(len(speed), dtype=bool)
    order = np.argsort(np.abs(speed))
    y, e = np.log(np.abs(speed))[order], (error / np.abs(speed))[order]
    # Larger errors tell as little, and their exponentials overflow.
    e = np.minimum(e, 10.0)
    one, mean, tau, linear = (v[0] for v in _one(y[None], e[None]))
    two, split = (v[0] for v in _two(y[None], e[None]))
    width = np.sqrt(tau**2 * len(y) / (len(y) - 1) + e**2)
    trials = width * rng.uniform(-(3**0.5), 3**0.5, size=(n_trials, len(y)))
    # The speeds of a stream have one direction.
    trials = np.log(np.abs(1 + trials)) if linear else trials
    trials += mean
    sort = np.argsort(trials, axis=1)
    trials = np.take_along_axis(trials, sort, axis=1)
    errors = np.take_along_axis(np.broadcast_to(e, trials.shape), sort, axis=1)
    ratios = _two(trials, errors)[0] - _one(trials, errors)[0]
    p_value = ((ratios >= two - one - 1e-9).sum() + 1) / (n_trials + 1)
    second = np.zeros(len(y), dtype=bool)
    second[order[split:]] = True
    return float(p_value), second


def _one(y, e):
    """
    Return the largest log-likelihood of one stream, normal or log-normal, per trial.

    The logarithm of its mean, its relative dispersion and whether it is normal
    are returned as well.
    """
    found, v = [], np.exp(y)
    size = v.mean(axis=1, keepdims=True)
    for tau in ONE_DISPERSIONS:
        w = 1 / (e**2 + tau**2)
        m = np.average(y, axis=1, weights=w)
        variance = e**2 + tau**2
        value = -0.5 * ((y - m[:, None]) ** 2 / variance + np.log(variance))
        found.append(np.broadcast_arrays(value.sum(axis=1), m, tau, 0.0))
        # The normal distribution, also as a density of the logarithm.
        w = 1 / ((e * v) ** 2 + (tau * size) ** 2)
        m = np.average(v, axis=1, weights=w, keepdims=True)
        value = y - 0.5 * (w * (v - m) ** 2 - np.log(w))
        found.append(np.broadcast_arrays(value.sum(axis=1), np.log(m[:, 0]), tau, 1.0))
    found = np.array(found)
    return found[found[:, 0].argmax(axis=0), :, np.arange(len(y))].T


def _two(y, e):
    """Return the largest log-likelihood of two streams, and where they split."""
    n = y.shape[1]
    best, where = np.full(len(y), -np.inf), np.zeros(len(y), dtype=int)
    weights = [1 / (e**2 + tau**2) for tau in TWO_DISPERSIONS]
    each = [(w, np.sqrt(w)) for w in weights]

    def mean(w, part):
        return np.average(y[:, part], axis=1, weights=w[:, part], keepdims=True)

    for split in range(1, n):
        parts = (slice(split), split / n), (slice(split, n), 1 - split / n)
        slow, fast = (
            [s * r * np.exp(-0.5 * w * (y - mean(w, part)) ** 2) for w, r in each]
            for part, s in parts
        )
        for a, b in product(slow, fast):
            density = a + b + TINY
            # Logarithms take longest: one of each product of two.
            value = np.log(density[:, : n // 2] * density[:, -(n // 2) :]).sum(axis=1)
            if n % 2:
                value += np.log(density[:, n // 2])
            better = value > best
            best[better], where[better] = value[better], split
    return best, where


@dataclass(frozen=True, eq=False)
class StreamVelocity:
    """
    A stream's velocity in the axes of the frame.

    Attributes
    ----------
    value : `~numpy.ndarray`, shape (2,)
        In mas/yr.
    features : `~numpy.ndarray`, shape (2, 2)
        Covariance from the scatter and the errors of its features, in
        (mas/yr)^2; NaN without features.
    alignment : `~numpy.ndarray`, shape (2, 2)
        Covariance from alignment errors, which shift all features of an
        epoch together.
    dispersion, dispersion_error : float
        Dispersion of the features' speeds along the stream, in mas/yr.
    slowest, fastest : float
        Speeds along the stream of its slowest and its fastest feature, in mas/yr.
    choices : float or `~numpy.ndarray`, shape (2, 2)
        Covariance from the parts of the data that give different speeds.
    """

    value: np.ndarray
    features: np.ndarray
    alignment: np.ndarray
    dispersion: float
    dispersion_error: float
    slowest: float = np.nan
    fastest: float = np.nan
    choices: float | np.ndarray = 0.0

    @property
    def covariance(self):
        """Total covariance, which is quoted."""
        return self.features + self.alignment + self.choices


def velocity_of(stream, beam, misaligned):
    """
    Return a stream's velocity in mas/yr on the axes of the frame.

    Parameters
    ----------
    stream : ``Stream``
    beam : array_like, shape (2,)
        Width of the beam along the stream and across it, in mas.
    misaligned : `~numpy.ndarray`, shape (n_epochs, 2)
        Standard error of the alignment of each epoch, in mas.

    Returns
    -------
    `StreamVelocity`
    """
    cos, sin = np.cos(stream.angle), np.sin(stream.angle)
    to_frame = np.array([[cos, -sin], [sin, cos]])
    own = np.array([stream.along.mean, stream.across.mean]) * beam
    errors = np.array([stream.along.error, stream.across.error]) * beam
    # Change of the mean speed for a displacement of each epoch, in 1/yr.
    response, (_, error) = np.zeros(len(misaligned)), feature_speeds(stream.features)
    weight = 1 / (error**2 + np.nan_to_num(stream.along.dispersion) ** 2)
    for feature, w in zip(stream.features, weight / weight.sum(), strict=True):
        response[feature.epoch] += w * feature.response
    sense = np.sign(stream.along.mean) * beam[0]
    own_speeds = np.array([f.speed * sense for f in stream.features] or [np.nan])
    return StreamVelocity(
        value=to_frame @ own, features=to_frame @ np.diag(errors**2) @ to_frame.T,
        alignment=np.diag(response**2 @ misaligned**2),
        dispersion=stream.along.dispersion * beam[0],
        dispersion_error=stream.along.dispersion_error * beam[0],
        slowest=float(own_speeds.min()), fastest=float(own_speeds.max()),
    )  # fmt: skip


def jackknife_covariance(estimates):
    """
    Return the jackknife covariance of estimates that each leave out a part of the data.

    It is infinite for fewer than four parts.
    """
    n = len(estimates)
    if n < 4:
        return np.full((np.shape(estimates)[-1],) * 2, np.inf)
    apart = np.asarray(estimates) - np.mean(estimates, axis=0)
    return (n - 1) / n * apart.T @ apart
