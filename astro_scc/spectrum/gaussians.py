# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""One or two streams, Gaussians in speed, fitted to the equations; their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from astro_scc.spectrum.diagram import TINY, influences
from astro_scc.spectrum.equations import deconvolve, mean_of_pairs

#: Smallest dispersion, relative to the mean: patterns change on their way.
FLOOR = 0.1
#: Largest dispersion of one stream, relative to the mean.
WIDEST = 0.6
#: Smallest sum of the shares of a Gaussian, part of which is beyond the speeds.
LEAST_TOTAL = 0.2
#: Two streams fit better than a broad one if they explain so much more.
GAIN = 0.05
#: Length of a cluster: patterns that leave within so many beams are not independent.
CLUSTER = 2.5
#: Probability up to one standard deviation of a normal distribution.
ONE_SIGMA = 0.8413447460685429


@dataclass(frozen=True, eq=False)
class StreamFit:
    """
    Streams fitted to a spectrum, the slowest first.

    Attributes
    ----------
    mean, sd, amplitude : `~numpy.ndarray`, shape (k,)
        Mean speed and dispersion in beams/yr, and amplitude.
    standing : `~numpy.ndarray`, shape (3,)
        Amplitudes of what stands still and varies.
    misfit : float
    mean_err, number : `~numpy.ndarray`, shape (k,), or None
        Standard errors of the mean speeds, and effective number of clusters of each
        stream, see `fit_errors`.
    """

    mean: np.ndarray
    sd: np.ndarray
    amplitude: np.ndarray
    standing: np.ndarray
    misfit: float
    mean_err: np.ndarray | None = None
    number: np.ndarray | None = None

    @property
    def share(self) -> np.ndarray:
        """Share of each stream in the variance that moves, NaN if nothing does."""
        return self.amplitude / (self.amplitude.sum() or np.nan)


def shares_of(equations, mean, sd):
    """
    Return the share of Gaussians at each speed, and its derivatives.

    Returns
    -------
    shares, of_mean, of_sd : `~numpy.ndarray`, shape (k, n_v)
        The derivatives by the mean and by the logarithm of the dispersion.
    """
    mean, sd = mean[:, None], sd[:, None]
    width = np.hypot(sd, 0.05 * mean)
    z = (equations.speed - mean) / width
    shares = np.exp(-0.5 * z**2) * equations.width / width / np.sqrt(2 * np.pi)
    total = shares.sum(axis=1, keepdims=True)
    shares /= np.maximum(total, LEAST_TOTAL)
    of_width = (z * z - 1) / width
    found = [shares]
    for change in (z + of_width * 0.05**2 * mean, of_width * sd**2):
        change = shares * change / width
        lost = change.sum(axis=1, keepdims=True) * (total > LEAST_TOTAL)
        found.append(change - shares * lost)
    return found


def amplitudes_of(equations, mean, sd):
    """Return a `StreamFit` with the best amplitudes for means and dispersions."""
    mean, sd = np.asarray(mean, float), np.asarray(sd, float)
    found, misfit = equations.solve(shares_of(equations, mean, sd)[0])
    k = len(mean)
    return StreamFit(mean, sd, found[:k], found[k:], misfit)


def fit_streams(equations, start, widest=WIDEST):
    """
    Fit means and dispersions of streams by least squares.

    Parameters
    ----------
    equations : ``Equations``
    start : sequence of (mean, sd)
        In beams/yr.
    widest : float, optional
        Largest dispersion relative to the mean.

    Returns
    -------
    `StreamFit`
    """
    k, square = len(start), equations.square
    first, sd = np.array(start, float).T
    sign, n = np.sign(first), len(equations.speed)

    def unpack(p):
        # Of a speed, and of the range of dispersions.
        size, part = np.exp(p[:k]), scipy.special.expit(p[k:])
        return sign * size, size * (FLOOR + (widest - FLOOR) * part), part

    def cost(p):
        mean, sd, part = unpack(p)
        shares, of_mean, of_sd = shares_of(equations, mean, sd)
        found, misfit = equations.solve(shares)
        # The amplitudes are the best ones: their changes do not count.
        of_shares = np.append(found[:k] @ shares, found[k:]) @ equations.gram[:, :n]
        of_shares = 2 * (of_shares - equations.right[:n])
        of_mean, of_sd = found[:k] * [of_mean @ of_shares, of_sd @ of_shares]
        range_of = np.abs(mean) * (widest - FLOOR) * part * (1 - part) / sd
        slope = np.concatenate([of_mean * mean + of_sd, of_sd * range_of]) / square
        slope[k:] += 2e-6 * p[k:]
        return misfit / square + 1e-6 * (p[k:] ** 2).sum(), slope

    part = np.clip((sd / np.abs(first) - FLOOR) / (widest - FLOOR), 0.05, 0.95)
    first = np.append(np.log(np.abs(first)), scipy.special.logit(part))
    speed = np.log(equations.speed[[n // 2 + 1, -1]])
    bounds = [speed] * k + [(-8, 8)] * k
    found = scipy.optimize.minimize(
        cost, first, jac=True, bounds=bounds, options={"ftol": 1e-10}
    )
    mean, sd, _ = unpack(found.x)
    order = np.argsort(np.abs(mean))
    return amplitudes_of(equations, mean[order], sd[order])


def peaks_of(equations, spectrum, least):
    """
    Return the peaks of a spectrum as (mean, sd, mass), the largest first.

    Parameters
    ----------
    equations : ``Equations``
    spectrum : `~numpy.ndarray`, shape (n_v,)
    least : float
        Slowest speed of a peak, in beams/yr.

    Returns
    -------
    list of (float, float, float)
        Of each sign apart.
    """
    v, found = equations.speed, []
    for sign in (1, -1):
        share = np.where(v * sign >= least, spectrum, 0.0)
        smooth = np.convolve(share, [0.25, 0.5, 0.25], "same")
        on = np.flatnonzero(smooth > 0.02 * smooth.max()) if smooth.max() > 0 else []
        if len(on) == 0:
            continue
        for group in np.split(on, np.flatnonzero(np.diff(on) > 1) + 1):
            mass = share[group].sum()
            if mass > 0:
                mean = share[group] @ v[group] / mass
                variance = share[group] @ (v[group] - mean) ** 2 / mass
                found.append((mean, np.sqrt(variance + (0.04 * mean) ** 2), mass))
    return sorted(found, key=lambda peak: -peak[2])


def one_stream(equations, least, sign=1, parts=(0.15, 0.4)):
    """
    Return the best fit of one stream of one sign, or None if nothing moves so.

    It starts from the best speeds with dispersions of such ``parts``: patterns at equal
    distances fill a spectrum with aliases.
    """
    v = equations.speed[equations.speed * sign >= least][::2]
    starts = [(speed, part * abs(speed)) for speed in v for part in parts]
    tried = [amplitudes_of(equations, [mean], [sd]) for mean, sd in starts]
    best = sorted(tried, key=lambda fit: fit.misfit)[:2]
    if not best or not best[0].amplitude > 0:
        return None
    fits = [fit_streams(equations, [(fit.mean[0], fit.sd[0])]) for fit in best]
    return min(fits, key=lambda fit: fit.misfit)


def two_streams(equations, one, least, tested=(), widest=0.3):
    """
    Return the best fit of two streams of one direction.

    Parameters
    ----------
    equations : ``Equations``
    one : `StreamFit`
    least : float
        Slowest speed, in beams/yr.
    tested : sequence of float, optional
        Speeds of both by the permutation test, from which the fit starts too.
    widest : float, optional
        Largest dispersion relative to the mean, that of the features of one flow.

    Returns
    -------
    `StreamFit`
    """
    first = one.mean[0]
    spectrum = deconvolve(equations)
    peaks = [p for p in peaks_of(equations, spectrum, least) if p[0] * first > 0][:3]
    speeds = [p[0] for p in peaks]
    starts = [(a, b) for k, a in enumerate(speeds) for b in speeds[:k]]
    starts += [(first, v) for v in speeds if abs(v - first) > 0.3 * abs(first)]
    starts.append((0.6 * first, 1.3 * first))
    if len(tested) == 2 and tested[0] * tested[1] > 0:
        starts.append(tuple(tested))
    starts = [[(v, 0.12 * abs(v)) for v in pair] for pair in starts]
    fits = (fit_streams(equations, s, widest) for s in starts)
    return min(fits, key=lambda f: f.misfit)


def two_are_better(
    equations, one, two, gain=GAIN, *, share=0.15, factor=1.7, distance=1.5
):
    """
    Return whether two streams fit so much better than a broad one as to be two.

    The smaller has such a ``share``, and the means differ by such a ``factor`` and
    ``distance``, in dispersions.
    """
    none = amplitudes_of(equations, np.empty(0), np.empty(0)).misfit
    better = (one.misfit - two.misfit) / max(none - two.misfit, TINY)
    slow, fast = np.abs(two.mean)
    apart = (fast - slow) / np.hypot(*two.sd)
    clear = two.share.min() > share and fast > factor * slow
    return bool(better > gain and clear and apart > distance)


# -- errors -------------------------------------------------------------------------


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
    mean_err, number : `~numpy.ndarray`, shape (k,)
        Standard errors of mean speeds, and effective number of clusters of each stream.
    clusters : list of list of `~numpy.ndarray`
        For each stream, what the clusters add to its mean speed, by their number from
        the first in time, for two divisions.
    epochs : `~numpy.ndarray`, shape (k, n_epochs)
        What each epoch adds to each mean speed.
    """
    k, standing = len(fit.mean), np.eye(len(equations.gram))[len(equations.speed) :]
    pad = (0, 0), (0, len(standing))
    of_amplitude, of_mean, of_sd = (
        np.pad(part, pad) for part in shares_of(equations, fit.mean, fit.sd)
    )
    free = fit.sd > 1.1 * FLOOR * np.abs(fit.mean)
    rows = [of_amplitude, fit.amplitude[:, None] * of_mean, standing[fit.standing > 0]]
    rows = np.concatenate([*rows, (fit.amplitude[:, None] * of_sd)[free]])
    square = rows @ equations.gram @ rows.T
    # A stream without amplitude has no other parameters.
    diagonal = np.diag(square)
    square += np.diag(np.where(diagonal > 0, 1e-8 * diagonal, 1.0))
    weights = np.linalg.solve(square, rows)
    columns = np.concatenate([of_amplitude, standing])
    model = np.concatenate([fit.amplitude, fit.standing]) @ columns
    model = np.tensordot(model, equations.design, 1)
    model /= np.sqrt(equations.number)[:, None]
    residual = diagram.means - _of_pairs(equations, model)
    asked = range(k) if stream is None else [stream]
    # The amplitudes stand before the means.
    which = [row for i in asked for row in (k + i, i)]
    functions = [_function_of(equations, weights[row]) for row in which]
    pieces = influences(flow, diagram, functions, region=region)
    errors, numbers, clusters, epochs = [], [], [], []
    for n, i in enumerate(asked):
        speed = fit.mean[i] if travel is None else travel
        sums, parts = _clusters_of(flow, pieces[2 * n : 2 * n + 2], speed)
        number = np.mean([_effective(part) for part in parts])
        factor = scipy.special.stdtrit(max(number - 1, 1.0), ONE_SIGMA)
        deleted = _of_epochs(functions[2 * n], residual)
        variance = factor**2 * np.mean([_variance(v) for v in sums])
        unequal = max(fit.sd[i] ** 2 - (FLOOR * fit.mean[i]) ** 2, 0) / max(number, 1)
        errors.append(np.sqrt(variance + (deleted**2).sum() + unequal))
        numbers.append(number)
        clusters.append([factor * v for v in sums])
        epochs.append(deleted)
    return np.array(errors), np.array(numbers), clusters, np.array(epochs)


def _function_of(equations, weights):
    """Return the function of the pairs that moves a parameter, (n, n, n_d)."""
    values = np.tensordot(weights, equations.design, 1)
    values /= np.sqrt(equations.number)[:, None]
    values -= mean_of_pairs(equations.share, values)
    values[equations.share == 0] = 0
    return _of_pairs(equations, values)


def _of_pairs(equations, values):
    """Return values of bins for each pair in either order, (n, n, n_d)."""
    bins = equations.bins
    found = np.zeros((*bins.shape, values.shape[1]), np.float32)
    found[bins >= 0] = values[bins[bins >= 0]]
    return found + found.transpose(1, 0, 2)[:, :, ::-1]


def _clusters_of(flow, pieces, speed):
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
