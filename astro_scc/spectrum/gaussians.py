# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""One or two streams, Gaussians in speed, fitted to the equations of the spectrum."""

from dataclasses import dataclass

import numpy as np
import scipy

from astro_scc.spectrum.equations import deconvolve

#: Smallest dispersion, relative to the mean: patterns change on their way.
FLOOR = 0.1
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
    """Return the share of Gaussians at each speed, and distances from their means."""
    sd = np.hypot(sd, 0.05 * np.abs(mean))[:, None]
    z = (equations.speed - mean[:, None]) / sd
    shares = np.exp(-0.5 * z**2) * equations.width / sd / np.sqrt(2 * np.pi)
    shares /= np.maximum(shares.sum(axis=1, keepdims=True), 0.2)
    return shares, z, sd


def gaussian_columns(equations, mean, sd):
    """Return Gaussians in speed as combinations of columns, and their derivatives."""
    shares, z, sd = shares_of(equations, mean, sd)
    pad = (0, 0), (0, len(equations.gram) - shares.shape[1])
    both = shares * z / sd, shares * (z * z - 1)
    return tuple(np.pad(part, pad) for part in (shares, *both))


def standing_columns(equations):
    """Return the columns of what stands still."""
    return np.eye(len(equations.gram))[len(equations.speed) :]


def amplitudes_of(equations, mean, sd):
    """Return a `StreamFit` with the best amplitudes for means and dispersions."""
    mean, sd = np.asarray(mean, float), np.asarray(sd, float)
    found, misfit = equations.solve(shares_of(equations, mean, sd)[0])
    k = len(mean)
    return StreamFit(mean, sd, found[:k], found[k:], misfit)


def fit_streams(equations, start, widest=0.6):
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
    top = equations.speed[-1]
    square = equations.square
    sign = np.sign([mean for mean, _ in start])

    def unpack(p):
        mean = sign * np.exp(p[::2])
        low, high = FLOOR * np.abs(mean), widest * np.abs(mean)
        return mean, low + (high - low) / (1 + np.exp(-p[1::2]))

    def cost(p):
        mean, sd = unpack(p)
        if np.abs(mean).max() > top:
            return 2 * square
        penalty = 1e-6 * square * (p[1::2] ** 2).sum()
        return amplitudes_of(equations, mean, sd).misfit + penalty

    first = []
    for mean, sd in start:
        part = np.clip((sd / abs(mean) - FLOOR) / (widest - FLOOR), 0.05, 0.95)
        first += [np.log(abs(mean)), np.log(part / (1 - part))]
    first = np.array(first)
    steps = np.tile([0.06, 1.0], len(start))
    simplex = np.vstack([first, first + np.diag(steps)])
    options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-7 * square}
    options["maxiter"] = 150 * len(start)
    found = scipy.optimize.minimize(cost, first, method="Nelder-Mead", options=options)
    mean, sd = unpack(found.x)
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


def one_stream(equations, least, sign=1):
    """Return the best fit of one stream of one sign, or None without a peak."""
    spectrum = deconvolve(equations)
    peaks = [p for p in peaks_of(equations, spectrum, least) if p[0] * sign > 0]
    if not peaks:
        return None
    mass = sum(p[2] for p in peaks)
    mean = sum(p[0] * p[2] for p in peaks) / mass
    starts = [(mean, 0.2 * abs(mean)), *((p[0], p[1]) for p in peaks[:2])]
    # Patterns at equal distances fill a spectrum with aliases: the best single speed.
    v = equations.speed[equations.speed * sign >= least]
    fits = [amplitudes_of(equations, [speed], [0.2 * abs(speed)]) for speed in v]
    best = min(fits, key=lambda fit: fit.misfit)
    starts.append((best.mean[0], best.sd[0]))
    return min((fit_streams(equations, [s]) for s in starts), key=lambda f: f.misfit)


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
