# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The error of a stream's velocity: scatter of features, alignment, jackknife."""

from dataclasses import dataclass

import numpy as np

from astro_scc.streams.dispersion import feature_speeds


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
    response = alignment_response(stream, len(misaligned))
    sense = np.sign(stream.along.mean) * beam[0]
    own_speeds = np.array([f.speed * sense for f in stream.features] or [np.nan])
    return StreamVelocity(
        value=to_frame @ own,
        features=to_frame @ np.diag(errors**2) @ to_frame.T,
        alignment=np.diag(response**2 @ misaligned**2),
        dispersion=stream.along.dispersion * beam[0],
        dispersion_error=stream.along.dispersion_error * beam[0],
        slowest=float(own_speeds.min()),
        fastest=float(own_speeds.max()),
    )


def alignment_response(stream, n_epochs):
    """
    Return the change of a stream's mean speed per displacement of each epoch.

    Parameters
    ----------
    stream : ``Stream``
    n_epochs : int

    Returns
    -------
    `~numpy.ndarray`, shape (n_epochs,)
        In 1/yr.
    """
    response = np.zeros(n_epochs)
    for feature, w in zip(stream.features, feature_weights(stream), strict=True):
        response[feature.epoch] += w * feature.response
    return response


def feature_weights(stream):
    """Return the weights of a stream's features in its mean speed; their sum is 1."""
    _, error = feature_speeds(stream.features)
    weight = 1 / (error**2 + np.nan_to_num(stream.along.dispersion) ** 2)
    return weight / weight.sum()


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
