# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speed against distance from the core, by the tracks near each distance."""

import numpy as np

from astro_scc.tracking.fits import fit_motion

__all__ = ["average_with_scatter", "track_profile"]


def track_profile(
    time, distance, error, track, radii, *, half_width, min_epochs=3, scale=None
):
    """
    Mean radial speed of the features near each distance.

    At each radius a straight line is fitted to the distances of every track,
    with its features within ``half_width`` of the radius alone, and the
    slopes are averaged (Mertens & Lobanov 2016, Sect. 3.3).

    Parameters
    ----------
    time, distance, error : array_like, shape (n,)
        Of the features; ``error`` is that of the distance.
    track : array_like of int, shape (n,)
    radii : array_like, shape (n_radii,)
    half_width : float
    min_epochs : int, optional
        Tracks with fewer features there do not count.
    scale : array_like, shape (n,), optional
        Of the features.  One feature makes tracks on several scales, which
        are not independent: errors grow by the root of the number
        of scales that count.

    Returns
    -------
    speed, speed_err : `~numpy.ndarray`, shape (n_radii,)
        Means and their standard errors, see `average_with_scatter`; zero
        where no track counts.
    n_tracks : `~numpy.ndarray` of int, shape (n_radii,)

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking import track_profile
    >>> time = np.arange(2000.0, 2010.0)
    >>> speed, error, n = track_profile(
    ...     time, 0.5 * (time - 2000), np.full(10, 0.1), np.zeros(10, int), [2.0],
    ...     half_width=1.5)
    >>> speed.round(6), n
    (array([0.5]), array([1]))
    """
    time, distance, error = (np.asarray(a, dtype=float) for a in
                             (time, distance, error))  # fmt: skip
    track, radii = np.asarray(track), np.asarray(radii, dtype=float)
    speed, speed_err = np.zeros((2, len(radii)))
    n_tracks = np.zeros(len(radii), dtype=int)
    for k, radius in enumerate(radii):
        slopes, errors, scales = [], [], set()
        near = np.abs(distance - radius) <= half_width
        for number in np.unique(track[near]):
            own = np.flatnonzero(near & (track == number))
            if len(np.unique(time[own])) < max(min_epochs, 2):
                continue
            fit = fit_motion(time[own], distance[None, own], error[None, own])
            if scale is not None:
                scales.add(float(scale[own[0]]))
            slopes.append(fit.coefficients[0, 1])
            errors.append(fit.errors[0, 1])
        n_tracks[k] = len(slopes)
        if slopes:
            speed[k], mean_err = average_with_scatter(slopes, errors)
            speed_err[k] = mean_err * np.sqrt(len(scales) or 1)
    return speed, speed_err, n_tracks


def average_with_scatter(values, errors):
    """
    Weighted mean of values that scatter by more than their errors.

    Weights are ``1 / (error^2 + s^2)`` with the scatter s that the values
    have beyond their errors (DerSimonian & Laird 1986).

    Parameters
    ----------
    values, errors : array_like, shape (n,)

    Returns
    -------
    mean, error : float

    Examples
    --------
    >>> from astro_scc.tracking import average_with_scatter
    >>> mean, error = average_with_scatter([1.0, 3.0], [0.1, 0.1])
    >>> round(mean, 6), round(error, 6)
    (2.0, 1.0)
    """
    values, weight = np.asarray(values, float), 1 / np.asarray(errors, float) ** 2
    mean = np.average(values, weights=weight)
    free = len(values) - 1
    spare = weight.sum() - np.sum(weight**2) / weight.sum()
    excess = np.sum(weight * (values - mean) ** 2) - free
    extra = max(excess / spare, 0.0) if free else 0.0
    weight = 1 / (1 / weight + extra)
    return float(np.average(values, weights=weight)), float(weight.sum() ** -0.5)
