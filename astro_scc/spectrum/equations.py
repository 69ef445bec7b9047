# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The velocity spectrum: the diagram, deconvolved by the images' own correlation."""

from dataclasses import dataclass

import numpy as np
import scipy

from astro_scc.spectrum.diagram import LEAST_OVERLAP
from astro_scc.spectrum.permutations import (
    EVERY,
    LENGTH,
    SLOWEST,
    autocorrelation,
    fastest_speed,
    within,
)

#: Of neighbouring speeds of the spectrum, which look alike.
RATIO = 1.12
#: Memories of what stands still and varies, in whole times.
STANDING = (1 / 30, 1 / 8, 1 / 2)


@dataclass(frozen=True, eq=False, repr=False)
class Equations:
    """
    Least squares of the diagram for the share of the emission at each speed.

    Attributes
    ----------
    speed, width : `~numpy.ndarray`, shape (n_v,)
        Speeds in beams/yr, and the width of the bin of each.
    design : `~numpy.ndarray`, shape (n_columns, n_bins, n_d)
        Expected diagram of each speed, and of what stands still and varies, in bins of
        the interval, times the root of the number of pairs.
    data : `~numpy.ndarray`, shape (n_bins, n_d)
    gram : `~numpy.ndarray`, shape (n_columns, n_columns)
    right : `~numpy.ndarray`, shape (n_columns,)
        Each is that of a later epoch less an earlier one; pairs in the other order
        have the same with the other sign of d.
    bins : `~numpy.ndarray` of int, shape (n_epochs, n_epochs)
        Bin of each pair whose second epoch is later, -1 for others.
    number, interval : `~numpy.ndarray`, shape (n_bins,)
        Pairs of each bin, and their mean interval in years.
    share : `~numpy.ndarray`, shape (n_bins,)
        Share of each bin in the pairs that are used.
    square : float
        Sum of the squares of the data, as all sums over the pairs in either order.
    """

    speed: np.ndarray
    width: np.ndarray
    design: np.ndarray
    data: np.ndarray
    gram: np.ndarray
    right: np.ndarray
    bins: np.ndarray
    number: np.ndarray
    interval: np.ndarray
    share: np.ndarray
    square: float

    def solve(self, shares):
        """
        Return non-negative amplitudes of combinations of speeds, and the misfit.

        Parameters
        ----------
        shares : `~numpy.ndarray`, shape (k, n_v)

        Returns
        -------
        amplitudes : `~numpy.ndarray`, shape (k + 3,)
            Of these, and of what stands still and varies.
        misfit : float
            Sum of the squared residuals.
        """
        n, k = len(self.speed), len(shares)
        gram = np.empty((k + len(self.gram) - n,) * 2)
        of_shares = shares @ self.gram[:n]
        gram[:k, :k], gram[:k, k:] = of_shares[:, :n] @ shares.T, of_shares[:, n:]
        gram[k:, :k], gram[k:, k:] = of_shares[:, n:].T, self.gram[n:, n:]
        right = np.concatenate([shares @ self.right[:n], self.right[n:]])
        if not np.trace(gram) > 0:
            return np.zeros(len(gram)), self.square
        found = _least_squares(gram, right, 1e-9 * np.trace(gram))
        return found, self.square - 2 * found @ right + found @ gram @ found


def _least_squares(gram, right, ridge):
    """Return the non-negative solution of the normal equations."""
    factor = gram.copy()
    factor.flat[:: len(gram) + 1] += ridge
    factor = np.linalg.cholesky(factor)
    return scipy.optimize.nnls(factor.T, np.linalg.solve(factor, right))[0]


def spectrum_speeds(years, fastest=None, intervals=EVERY, *, ratio=RATIO, beyond=1.5):
    """
    Return the speeds of the spectrum, with both signs and zero, in beams/yr.

    ``ratio`` is that of neighbours; they go ``beyond`` the fastest one that is tested.
    """
    top = fastest_speed(years, intervals) if fastest is None else fastest
    top *= beyond
    low = min(SLOWEST / min(np.ptp(years), intervals[1]), top / 2)
    n = int(np.ceil(np.log(top / low) / np.log(ratio)))
    speed = low * (top / low) ** (np.arange(n + 1) / n)
    return np.concatenate([-speed[::-1], [0.0], speed])


def widths_of(speed):
    """Return the widths of the bins of speeds."""
    edges = (speed[1:] + speed[:-1]) / 2
    edges = np.concatenate(
        [[2 * speed[0] - edges[0]], edges, [2 * speed[-1] - edges[-1]]]
    )
    return np.diff(edges)


def interval_bins(years, ratio=1.04):
    """
    Return pairs of epochs in bins of their interval, of equal relative width.

    ``ratio`` is that of the intervals of neighbouring bins.

    Returns
    -------
    bins : `~numpy.ndarray` of int, shape (n_epochs, n_epochs)
        Of pairs whose second epoch is later, -1 for others.
    number, interval : `~numpy.ndarray`, shape (n_bins,)
    """
    tau = years - years[:, None]
    use = tau > 0
    key = np.floor(np.log(tau[use] / tau[use].min()) / np.log(ratio))
    _, index = np.unique(key, return_inverse=True)
    bins = np.full(tau.shape, -1)
    bins[use] = index
    number = np.bincount(index)
    return bins, number, np.bincount(index, tau[use]) / number


def pairs_by_bin(bins):
    """Return the pairs of epochs, as places in the flat array, bin by bin."""
    return np.argsort(bins, axis=None, kind="stable")[np.sum(bins < 0) :]


def set_up(diagram, *, fastest=None, intervals=EVERY):
    """
    Set up the equations of a diagram.

    .. math:: E[D_{ab}(d)] = J \\Big[\\sum_v A(v)\\, R(d - v \\tau_{ab})
              e^{-|v\\tau_{ab}|/l} \\Big] J + \\text{standing patterns},

    with the interval tau between the epochs, the images' own correlation R, the length
    l of three beams, and the projection ``J = 1 - 1/n`` on what is not constant, in
    both epochs, as the planes have no mean over the epochs.

    Parameters
    ----------
    diagram : ``Diagram``
    fastest : float, optional
        Largest speed, in beams/yr.
    intervals : (float, float), optional
        Shortest and longest interval that is used, in years.

    Returns
    -------
    `Equations`
    """
    years, x = diagram.years, diagram.displacement
    bins, number, interval = interval_bins(years)
    used = within(interval, intervals)
    speed = spectrum_speeds(years, fastest, intervals)
    alike = autocorrelation(diagram)
    # The last row is the interval zero, of each epoch with itself.
    tau, m = np.append(interval, 0.0), len(number)
    forward = len(speed) // 2
    moved = speed[forward:, None] * tau
    shape = np.interp(x - moved[..., None], x, alike, left=0, right=0)
    shape *= np.exp(-np.abs(moved) / LENGTH)[..., None]
    memory = np.exp(-tau / (np.ptp(years) * np.array(STANDING)[:, None]))
    shape = np.concatenate([shape, memory[..., None] * alike])
    shape *= diagram.overlap > LEAST_OVERLAP
    share = np.where(used, number, 0) / max(number[used].sum(), 1)
    centre = _centre(bins, number, share) * (np.sqrt(number) * used)[:, None]
    # What is seen in the other order, and what moves backward, looks the same with the
    # other sign of d.
    design = np.empty((forward + len(shape), m, len(x)))
    half = np.matmul(np.delete(centre, np.s_[m:-1], axis=1), shape, design[forward:])
    half += centre[:, m:-1] @ shape[:, :-1, ::-1]
    design[:forward] = half[forward:0:-1, :, ::-1]
    data = binned(diagram.means, bins, number, share)
    data[~used] = 0
    flat = design.reshape(len(design), -1)
    return Equations(
        speed, widths_of(speed), design, data, 2 * (flat @ flat.T),
        2 * (flat @ data.ravel()), bins, number, interval, share,
        2 * float((data**2).sum()),
    )  # fmt: skip


def _centre(bins, number, share):
    """
    Return the matrix that takes values of bins to those of a centred model.

    Its columns are the bins, the same in the other order, and pairs of one date.
    """
    n, m = len(bins), len(number)
    index = np.where(bins < 0, np.where(bins.T < 0, 2 * m, m + bins.T), bins)
    of_first, of_second = np.zeros((2, 2 * m + 1, n))
    np.add.at(of_first, (index, np.arange(n)[:, None]), 1)
    np.add.at(of_second, (index, np.arange(n)), 1)
    centre = np.eye(m, 2 * m + 1) + of_first.sum(axis=1) / n**2
    for of_epochs in (of_first, of_second):
        centre -= of_epochs[:m] / number[:, None] @ of_epochs.T / n
    mean = share @ centre
    return centre - (mean + np.concatenate([mean[m:-1], mean[:m], mean[-1:]])) / 2


def binned(values, bins, number, share):
    """Return values of pairs summed over bins, less the mean of pairs that are used."""
    pairs = pairs_by_bin(bins)
    first, second = np.divmod(pairs, len(bins))
    both = np.concatenate([pairs, second * len(bins) + first])
    starts, m = np.append(0, np.cumsum(np.tile(number, 2))), len(number)
    shape = 2 * m, bins.size
    sums = scipy.sparse.csr_array((np.ones(len(both)), both, starts), shape=shape)
    sums = sums @ values.reshape(bins.size, -1)
    sums = (sums[:m] + sums[m:, ::-1]) / 2
    sums -= number[:, None] * mean_of_pairs(share / number, sums)
    return sums / np.sqrt(number)[:, None]


def mean_of_pairs(share, values):
    """Return the mean of values of bins over the pairs in either order."""
    mean = share @ values
    return (mean + mean[::-1]) / 2


def deconvolve(equations, ridge=1e-4):
    """
    Return the velocity spectrum: the share of the variance that moves at each speed.

    Parameters
    ----------
    equations : `Equations`
    ridge : float, optional
        Part of the mean diagonal that keeps the equations apart.

    Returns
    -------
    `~numpy.ndarray`, shape (n_v,)
        Amplitudes of non-negative least squares, in the unit of the diagram.
    """
    n = len(equations.gram)
    scale = np.trace(equations.gram) / n
    if not scale > 0:
        return np.zeros(len(equations.speed))
    found = _least_squares(equations.gram, equations.right, ridge * scale)
    return found[: len(equations.speed)]


def harmonic_mean(speed, spectrum, clearest, factor):
    """
    Return the mean speed of the spectrum of one stream, and its width.

    What is the same at v and -v is noise, and so is what is far from the speed at which
    motion is clearest.  The mean is harmonic, as a fast pattern covers more of the way
    in a time.

    Parameters
    ----------
    speed, spectrum : `~numpy.ndarray`, shape (n_v,)
        Speeds of both signs, with the same numbers, and the share of each.
    clearest : float
        Speed at which motion is clearest; its sign is that of the stream.
    factor : float
        How far from it the spectrum counts.

    Returns
    -------
    mean, width : float
        Positive, or NaN if nothing is left.
    """
    half, clear = len(spectrum) // 2, abs(clearest)
    forward = speed[half + 1 :]
    share = np.sign(clearest) * (spectrum[half + 1 :] - spectrum[:half][::-1])
    used = (forward > clear / factor) & (forward < factor * clear)
    share = np.where(used, np.maximum(share, 0), 0)
    if not share.sum() > 0:
        return np.nan, np.nan
    share = share / share.sum()
    mean = 1 / (share @ (1 / forward))
    return mean, mean**2 * np.sqrt(share @ (1 / forward - 1 / mean) ** 2)
