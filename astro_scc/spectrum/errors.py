# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Errors of speeds, from what each pattern and each epoch adds to them."""

from dataclasses import dataclass

import numpy as np
import scipy

from astro_scc.spectrum.diagram import influences
from astro_scc.spectrum.equations import mean_of_pairs
from astro_scc.spectrum.gaussians import FLOOR, gaussian_columns, standing_columns

#: Length of a cluster: patterns that leave within so many beams are not independent.
CLUSTER = 2.5
#: Probability up to one standard deviation of a normal distribution.
ONE_SIGMA = 0.8413447460685429


@dataclass(frozen=True, eq=False)
class SpeedErrors:
    """
    Errors of the parameters of a fit of streams.

    Attributes
    ----------
    mean : `~numpy.ndarray`, shape (k,)
        Standard errors of mean speeds.
    number : `~numpy.ndarray`, shape (k,)
        Effective number of clusters of each stream.
    clusters : list of `~numpy.ndarray`
        For each stream, what the clusters add to its mean speed, by their number from
        the first in time, for two divisions: shape (2, n_clusters).
    epochs : `~numpy.ndarray`, shape (k, n_epochs)
        What each epoch adds to each mean speed.
    """

    mean: np.ndarray
    number: np.ndarray
    clusters: list
    epochs: np.ndarray


def fit_errors(flow, diagram, equations, fit, *, region=None, travel=None, stream=None):
    """
    Return the errors of a fit of streams.

    A parameter is a linear function of the diagram near its best value.  What each
    place and epoch adds to it is summed over clusters that move along with the stream,
    2.5 beams of ejection each, and their scatter gives the error, with Student's factor
    for their number; to it are added the deletion of epochs and the scatter of
    features of unequal weight.

    Parameters
    ----------
    flow : ``FlowPlanes``
    diagram : ``Diagram``
    equations : ``Equations``
    fit : ``StreamFit``
    region : `~numpy.ndarray`, optional
        As for the diagram.
    travel : float, optional
        Speed at which clusters move, by default that of each stream.
    stream : int, optional
        The only stream whose errors are asked for.

    Returns
    -------
    `SpeedErrors`
    """
    k = len(fit.mean)
    of_amplitude, of_mean, of_sd = gaussian_columns(equations, fit.mean, fit.sd)
    on = [i for i in range(len(fit.standing)) if fit.standing[i] > 0]
    standing = standing_columns(equations)[on]
    free = [i for i in range(k) if fit.sd[i] > 1.1 * FLOOR * abs(fit.mean[i])]
    rows = [of_amplitude, fit.amplitude[:, None] * of_mean, standing]
    rows.append(fit.amplitude[free, None] * of_sd[free])
    rows = np.concatenate(rows)
    square = rows @ equations.gram @ rows.T
    # A stream without amplitude has no other parameters.
    diagonal = np.diag(square)
    square += np.diag(np.where(diagonal > 0, 1e-8 * diagonal, 1.0))
    weights = np.linalg.solve(square, rows)
    all_rows = np.concatenate([of_amplitude, standing_columns(equations)])
    model = np.concatenate([fit.amplitude, fit.standing]) @ all_rows
    model = np.tensordot(model, equations.design, 1)
    residual = diagram.means - unbinned(equations, model)
    asked = range(k) if stream is None else [stream]
    # The amplitudes stand before the means.
    which = [row for i in asked for row in (k + i, i)]
    functions = [function_of(equations, weights[row]) for row in which]
    pieces = influences(flow, diagram, functions, region=region)
    errors, numbers, clusters, epochs = [], [], [], []
    for n, i in enumerate(asked):
        speed = fit.mean[i] if travel is None else travel
        sums, parts = clusters_of(flow, pieces[2 * n : 2 * n + 2], speed)
        number = np.mean([_effective(part) for part in parts])
        factor = scipy.special.stdtrit(max(number - 1, 1.0), ONE_SIGMA)
        deleted = _of_epochs(functions[2 * n], residual)
        variance = factor**2 * np.mean([_variance(v) for v in sums])
        unequal = max(fit.sd[i] ** 2 - (FLOOR * fit.mean[i]) ** 2, 0) / max(number, 1)
        errors.append(np.sqrt(variance + (deleted**2).sum() + unequal))
        numbers.append(number)
        clusters.append([factor * v for v in sums])
        epochs.append(deleted)
    epochs = np.reshape(epochs, (len(asked), -1))
    return SpeedErrors(np.array(errors), np.array(numbers), clusters, epochs)


def function_of(equations, weights):
    """Return the function of the pairs that moves a parameter, (n, n, n_d)."""
    values = np.tensordot(weights, equations.design, 1)
    values /= np.sqrt(equations.number)[:, None]
    values -= mean_of_pairs(equations.share, values)
    values[equations.share == 0] = 0
    return _spread(equations, values)


def unbinned(equations, model):
    """Return a model of the binned data for each pair, (n, n, n_d)."""
    return _spread(equations, model / np.sqrt(equations.number)[:, None])


def _spread(equations, values):
    bins = equations.bins
    found = np.zeros((*bins.shape, values.shape[1]), np.float32)
    found[bins >= 0] = values[bins[bins >= 0]]
    return found + found.transpose(1, 0, 2)[:, :, ::-1]


def clusters_of(flow, pieces, speed):
    """
    Return sums of influences over clusters that move along at a speed.

    Parameters
    ----------
    flow : ``FlowPlanes``
    pieces : sequence of `~numpy.ndarray`, shape (n_epochs, n_along)
    speed : float
        In beams/yr.

    Returns
    -------
    list of list of `~numpy.ndarray`
        For each influence, two divisions into clusters, half a length apart, from one
        beginning for all flows of the same epochs.
    """
    start = flow.along[None] - speed * (flow.years - flow.years.mean())[:, None]
    longest = abs(speed) * np.ptp(flow.years) / CLUSTER + 1
    found = [[] for _ in pieces]
    for offset in (0.0, 0.5):
        number = np.floor(start / CLUSTER + offset + np.ceil(longest)).astype(int)
        number -= min(number.min(), 0)
        for sums, piece in zip(found, pieces, strict=True):
            sums.append(np.bincount(number.ravel(), piece.ravel()))
    return found


def _variance(sums):
    """Return the variance of a sum over independent clusters."""
    used = sums[sums != 0]
    m = len(used)
    if m < 2:
        return float((used**2).sum())
    return float(((used - used.mean()) ** 2).sum() * m / (m - 1))


def _effective(parts):
    """Return the effective number of clusters from their shares of an amplitude."""
    parts = np.maximum(parts, 0)
    square = (parts**2).sum()
    return parts.sum() ** 2 / square if square > 0 else 1.0


def _of_epochs(function, residual):
    """Return what all pairs with an epoch add, beyond the model."""
    n = len(function)
    each = (function * residual).sum(axis=2)
    each = each.sum(axis=0) + each.sum(axis=1)
    return (each - each.mean()) * np.sqrt((n - 1) / n / 2) * n / max(n - 2, 1)
