# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The error budget: scatter of features, alignment, position errors, jackknife."""

from dataclasses import dataclass

import numpy as np

from astro_scc.decomposition.segmentation import quadratic_peak
from astro_scc.stacking.stack import gaussian_sum, sample_velocities
from astro_scc.stacking.streams import feature_speeds

#: Grid points of a box on each axis.
POINTS = 25


@dataclass(frozen=True, eq=False)
class StreamVelocity:
    """
    A stream's velocity in the axes of the frame.

    Attributes
    ----------
    value : `~numpy.ndarray`, shape (2,)
        In mas/yr.
    features : `~numpy.ndarray`, shape (2, 2)
        Covariance by the scatter and the errors of its features, in
        (mas/yr)^2; NaN where it has none.
    alignment : `~numpy.ndarray`, shape (2, 2)
        Covariance by what moves all features of an epoch together.
    dispersion, dispersion_error : float
        Of the features' speeds along the stream, in mas/yr.
    """

    value: np.ndarray
    features: np.ndarray
    alignment: np.ndarray
    dispersion: float
    dispersion_error: float

    @property
    def covariance(self):
        """The covariance that is quoted."""
        return self.features + self.alignment


def velocity_of(stream, beam, misaligned, epoch):
    """
    A stream's velocity in mas/yr on the axes of the frame.

    Parameters
    ----------
    stream : `~astro_scc.stacking.Stream`
    beam : array_like, shape (2,)
        Width of the beam along the stream and across it, in mas.
    misaligned : `~numpy.ndarray`, shape (n_epochs, 2)
        Standard error of the alignment of each epoch, in mas.
    epoch : `~numpy.ndarray` of int, shape (n_ssps,)

    Returns
    -------
    `StreamVelocity`
    """
    cos, sin = np.cos(stream.angle), np.sin(stream.angle)
    to_frame = np.array([[cos, -sin], [sin, cos]])
    own = np.array([stream.along.mean, stream.across.mean]) * beam
    errors = np.array([stream.along.error, stream.across.error]) * beam
    response = alignment_response(stream, epoch, len(misaligned))
    return StreamVelocity(
        value=to_frame @ own,
        features=to_frame @ np.diag(errors**2) @ to_frame.T,
        alignment=np.diag(response**2 @ misaligned**2),
        dispersion=stream.along.dispersion * beam[0],
        dispersion_error=stream.along.dispersion_error * beam[0],
    )


def alignment_response(stream, epoch, n_epochs):
    """
    Change of a stream's mean speed for a displacement of whole epochs.

    Parameters
    ----------
    stream : `~astro_scc.stacking.Stream`
    epoch : `~numpy.ndarray` of int, shape (n_ssps,)
    n_epochs : int

    Returns
    -------
    `~numpy.ndarray`, shape (n_epochs,)
        In 1/yr.
    """
    response = np.zeros(n_epochs)
    if not stream.features:
        return response
    _, error = feature_speeds(stream.features)
    weight = 1 / (error**2 + np.nan_to_num(stream.along.dispersion) ** 2)
    for feature, w in zip(stream.features, weight / weight.sum(), strict=True):
        response[epoch[feature.ssp]] += w * feature.response
    return response


def jackknife_covariance(estimates):
    """
    Return the covariance of an estimate by those without one part of the data each.

    Infinite with fewer than four parts.
    """
    n = len(estimates)
    if n < 4:
        return np.full((np.shape(estimates)[-1],) * 2, np.inf)
    apart = np.asarray(estimates) - np.mean(estimates, axis=0)
    return (n - 1) / n * apart.T @ apart


@dataclass(frozen=True, eq=False)
class JitteredVelocity:
    """
    Outcome of the velocity-jitter test: a peak while SSPs are shifted by their errors.

    Attributes
    ----------
    covariance : `~numpy.ndarray`, shape (2, 2)
        Of the velocity peak over the trials.
    bias : `~numpy.ndarray`, shape (2,)
        Mean of the trials minus the observed velocity, that of the maximum
        in the box without shifts.
    gaussian_p : float
        Smaller p-value of the two axes of D'Agostino and Pearson's test
        that the trials are Gaussian.
    share : float
        Share of the trials that have a maximum in the box.
    """

    covariance: np.ndarray
    bias: np.ndarray
    gaussian_p: float
    share: float


def _ends(samples, index):
    """
    Which of n positions each match starts from and which it ends at.

    An SSP is one position, whatever it is matched with and whichever of the
    two ends of a displacement it is; an end without an SSP is one of its own.
    """
    start, end = samples.ssp[index], samples.target_ssp[index]
    end = np.where(end < 0, -1 - np.arange(len(end)), end)
    positions, number = np.unique(np.concatenate([start, end]), return_inverse=True)
    return number[: len(start)], number[len(start) :], len(positions)


def jitter_positions(samples, pairs, peak, box, n_trials, *, rng):
    """
    Shift the SSPs by their position errors and follow a velocity peak.

    Each trial draws one shift for every SSP from a normal distribution
    (paper, Sect. 2.4), stacks the matches around the peak again and
    takes its maximum.

    Parameters
    ----------
    samples : `~astro_scc.stacking.VelocitySamples`
    pairs : `~astro_scc.stacking.DatePairs`
    peak : `~astro_scc.stacking.VelocityPeak`
    box : tuple of float
        Sides of the box around the peak in which the maximum is
        looked for.
    n_trials : int
    rng : `~numpy.random.Generator`

    Returns
    -------
    `JitteredVelocity`
        Its covariance is NaN if fewer than 3 trials have a maximum.
    """
    index, *columns = sample_velocities(samples, pairs)
    # Velocities and their errors on both axes, and weights.
    columns, half = np.array(columns), np.array(box) / 2
    centre = np.array([peak.v1, peak.v2])
    apart = np.abs(columns[:2] - centre[:, None])
    near = np.all(apart < half[:, None] + 5 * columns[2:4], axis=0)
    index, columns = index[near], columns[:, near]
    grid1, grid2 = (
        np.linspace(v - h, v + h, POINTS) for v, h in zip(centre, half, strict=True)
    )
    observed = _maximum(gaussian_sum(*columns, grid1, grid2), grid1, grid2)
    # Single precision is enough for places in units of the box.
    columns[:2] -= centre[:, None]
    columns[:4] /= half[[0, 1, 0, 1], None]
    x, y, sx, sy, w = columns.astype(np.float32)
    unit_grid = np.linspace(-1, 1, POINTS, dtype=np.float32)
    start, end, n = _ends(samples, index)
    found = []
    for _ in range(n_trials):
        # Half the variance of a displacement belongs to either end.
        unit = rng.standard_normal((2, n)) / np.sqrt(2)
        shift = (unit[:, end] - unit[:, start]).astype(np.float32)
        local = gaussian_sum(
            x + sx * shift[0], y + sy * shift[1], sx, sy, w, unit_grid, unit_grid
        )
        place = _maximum(local, grid1, grid2)
        if place is not None:
            found.append(place)
    share = len(found) / n_trials if n_trials else 0.0
    if len(found) < 3:
        unknown = np.full((2, 2), np.nan)
        return JitteredVelocity(unknown, unknown[0], np.nan, share)
    return JitteredVelocity(
        covariance=np.cov(np.transpose(found)),
        bias=np.mean(found, axis=0) - (centre if observed is None else observed),
        gaussian_p=_gaussian_p(np.array(found)),
        share=share,
    )


def _maximum(scc, grid1, grid2):
    """Return the position of the largest value, None if it is on the border."""
    row, column = np.unravel_index(np.argmax(scc), scc.shape)
    if not (0 < row < len(grid2) - 1 and 0 < column < len(grid1) - 1):
        return None
    dy, dx, _ = quadratic_peak(scc[row - 1 : row + 2, column - 1 : column + 2])
    return (
        grid1[column] + dx * (grid1[1] - grid1[0]),
        grid2[row] + dy * (grid2[1] - grid2[0]),
    )


def _gaussian_p(found):
    from scipy.stats import normaltest

    # The test's kurtosis part is not valid for fewer.
    if len(found) < 20 or np.any(np.ptp(found, axis=0) == 0):
        return float("nan")
    return float(np.min(normaltest(found, axis=0).pvalue))
