# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""One or two streams, Gaussians in speed, fitted to the equations of the spectrum."""

from dataclasses import dataclass

import numpy as np
import scipy

from astro_scc.spectrum.equations import deconvolve

#: Smallest dispersion, relative to the mean: patterns change on their way.
FLOOR = 0.1
#: Largest dispersion of one stream, relative to the mean.
WIDEST = 0.6
#: Smallest sum of the shares of a Gaussian, part of which is beyond the speeds.
LEAST_TOTAL = 0.2
#: Two streams fit better than a broad one if they explain so much more.
GAIN = 0.05


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
    """

    mean: np.ndarray
    sd: np.ndarray
    amplitude: np.ndarray
    standing: np.ndarray
    misfit: float

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


def gaussian_columns(equations, mean, sd):
    """Return Gaussians in speed as combinations of columns, and their derivatives."""
    found = shares_of(equations, mean, sd)
    pad = (0, 0), (0, len(equations.gram) - len(equations.speed))
    return tuple(np.pad(part, pad) for part in found)


def standing_columns(equations):
    """Return the columns of what stands still."""
    return np.eye(len(equations.gram))[len(equations.speed) :]


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
    better = (one.misfit - two.misfit) / max(none - two.misfit, np.finfo(float).tiny)
    slow, fast = np.abs(two.mean)
    apart = (fast - slow) / np.hypot(*two.sd)
    clear = two.share.min() > share and fast > factor * slow
    return bool(better > gain and clear and apart > distance)
