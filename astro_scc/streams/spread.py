# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Mean and scatter of the speeds of features."""

from dataclasses import dataclass

import numpy as np

#: Scatter of the speeds of features to which theirs is drawn, relative to their mean,
#: and the number of features that it counts as.
SCATTER, PRIOR = 0.3, 2.0


@dataclass(frozen=True)
class SpeedMean:
    """
    Mean speed of features.

    Attributes
    ----------
    mean, error : float
    dispersion, dispersion_err : float
        Scatter beyond the errors; NaN with fewer than two features.
    """

    mean: float
    error: float
    dispersion: float
    dispersion_err: float


def separation(speed):
    """
    Return how well speeds divide into two groups.

    It is the largest share of the variance of their logarithms that lies between two
    groups (Otsu 1979, IEEE Trans. SMC 9, 62): 0.64 for a normal distribution, 0.75 for
    a uniform one, and 1 for two speeds.

    Parameters
    ----------
    speed : array_like, shape (n,)
        Positive.

    Returns
    -------
    float
    """
    return float(_separation(np.log(np.asarray(speed, float))[None])[0])


def chance_of_separation(speed, n_trials, rng):
    """
    Return the probability that the speeds of one stream are as separate.

    They are drawn from a uniform distribution: of all distributions without a gap, it
    looks most like two.

    Parameters
    ----------
    speed : array_like, shape (n,)
        Positive.
    n_trials : int
    rng : `~numpy.random.Generator`

    Returns
    -------
    float
    """
    found = separation(speed)
    trials = _separation(rng.uniform(size=(n_trials, len(speed))))
    return float((1 + np.sum(trials >= found)) / (1 + n_trials))


def _separation(y):
    """Return the separation of each row of values."""
    y = np.sort(y, axis=1)
    n, low = y.shape[1], np.cumsum(y, axis=1)[:, :-1]
    number = np.arange(1, n)
    apart = (low[:, -1:] + y[:, -1:] - low) / (n - number) - low / number
    between = (number * (n - number) / n**2 * apart**2).max(axis=1, initial=0.0)
    total = y.var(axis=1)
    return np.divide(between, total, out=np.zeros(len(y)), where=total > 0)


def unknown_scatter(mean, number):
    """
    Return the part of the error of a mean speed that few features cannot show.

    Their scatter is drawn to three tenths of the mean as in `mean_speed`, of which this
    is the part beyond what is seen,

    .. math:: \\sigma^2 = \\frac{1}{n} \\frac{2}{n + 2} (0.3 \\bar v)^2.

    Parameters
    ----------
    mean, number : array_like
        Mean speed, and number of features.

    Returns
    -------
    `~numpy.ndarray`

    Examples
    --------
    >>> from astro_scc.streams.spread import unknown_scatter
    >>> unknown_scatter(1.0, [1, 4, 20]).round(3)
    array([0.245, 0.087, 0.02 ])
    """
    number = np.maximum(number, 1.0)
    return SCATTER * np.abs(mean) * np.sqrt(PRIOR / (number + PRIOR) / number)


def mean_speed(speed, error, weight):
    """
    Return the mean speed of features, weighted by the number of their epochs.

    Its error holds the features' own errors and their scatter, which for few features
    is drawn to three tenths of the mean,

    .. math:: s^2 = \\frac{\\sum w (v - \\bar v)^2 n / \\sum w + 2 (0.3 \\bar v)^2}
                          {n - 1 + 2}.

    Parameters
    ----------
    speed, error, weight : array_like, shape (n,)

    Returns
    -------
    `SpeedMean`

    Examples
    --------
    >>> from astro_scc.streams.spread import mean_speed
    >>> found = mean_speed([0.9, 1.0, 1.1], [0.02] * 3, [5, 10, 5])
    >>> float(found.mean.round(2)), float(found.error.round(2))
    (1.0, 0.14)
    """
    speed, error, weight = (np.asarray(v, float) for v in (speed, error, weight))
    share, n = weight / weight.sum(), len(speed)
    mean = share @ speed
    square = n * share @ (speed - mean) ** 2
    variance = (square + PRIOR * (SCATTER * mean) ** 2) / (n - 1 + PRIOR)
    total = (share**2).sum() * variance + (share**2) @ error**2
    dispersion = dispersion_err = np.nan
    if n > 1:
        noise = share @ error**2
        dispersion = np.sqrt(max(square / (n - 1) - noise, 0.0))
        width = np.sqrt(max(square / (n - 1), noise))
        dispersion_err = width / np.sqrt(2 * (n - 1))
    return SpeedMean(mean, np.sqrt(total), dispersion, dispersion_err)
