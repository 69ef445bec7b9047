# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Read the speeds of a jet from a sample of velocities.

The same rule is used for all packages that give vectors but not the number of speeds
among them.  It was fixed before any of them was run.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks

#: Largest speeds along and across the jet that the packages are told, in pixels.
LARGEST = 30.0
ACROSS = 10.0
#: Standard deviation of the kernel, the accuracy required, in pixels.
KERNEL = 1.0
#: Prominence of a maximum as a fraction of the highest maximum.
PROMINENCE = 0.2
#: Distance in pixels within which a bootstrap sample shows a maximum again.
AGAIN = 2.0
#: Share of bootstrap samples that must show a maximum again.
SHARE = 0.9
#: A speed is the mean of the velocities within this distance of its maximum.
AROUND = 3.0
N_DRAWN = 200
STEP = 0.1
GRID = np.arange(-LARGEST - 5, LARGEST + 5 + STEP, STEP)


@dataclass(frozen=True, eq=False)
class Sample:
    """
    Velocities in pixels per epoch, with their positions and epochs.

    Attributes
    ----------
    pair : `~numpy.ndarray` of int
        The earlier of the two epochs.
    x, y : `~numpy.ndarray`
        Positions in the earlier epoch, in pixels from 0.
    along, across : `~numpy.ndarray`
        Velocities along the jet, which is x, and across it, which is y.
    """

    pair: np.ndarray
    x: np.ndarray
    y: np.ndarray
    along: np.ndarray
    across: np.ndarray

    @classmethod
    def of(cls, parts):
        """Return the sample from (pair, x, y, along, across) of each pair of epochs."""
        columns = [[] for _ in range(5)]
        for number, *part in parts:
            arrays = [np.ravel(np.asarray(a, dtype=float)) for a in part]
            good = np.all(np.isfinite(arrays), axis=0)
            columns[0].append(np.full(good.sum(), number))
            for column, a in zip(columns[1:], arrays, strict=True):
                column.append(a[good])
        pair, *rest = (np.concatenate(c) if c else np.empty(0) for c in columns)
        return cls(pair.astype(int), *rest)

    def within_limits(self):
        """Return the velocities within ``LARGEST`` and ``ACROSS``."""
        good = (np.abs(self.along) <= LARGEST) & (np.abs(self.across) <= ACROSS)
        return Sample(
            *(a[good] for a in (self.pair, self.x, self.y, self.along, self.across))
        )


def densities(sample):
    """Return kernel densities of the speeds along the jet, a row per pair of epochs."""
    pairs = np.unique(sample.pair)
    rows = np.zeros((len(pairs), len(GRID)))
    edges = np.append(GRID, GRID[-1] + STEP) - STEP / 2
    for row, number in zip(rows, pairs, strict=True):
        row[:] = np.histogram(sample.along[sample.pair == number], edges)[0]
    return gaussian_filter1d(rows, KERNEL / STEP, axis=1, mode="constant")


def maxima(density):
    """Return the positions of the prominent maxima of a density."""
    if not density.any():
        return np.empty(0)
    found, _ = find_peaks(density, prominence=PROMINENCE * density.max())
    return GRID[found]


def read_speeds(sample, *, rng=0):
    """
    Return the speeds along the jet that are in a sample.

    They are the prominent maxima of the density of the velocities that appear
    again in bootstrap samples of the pairs of epochs.

    Parameters
    ----------
    sample : Sample
    rng : seed, optional
        Seed of the bootstrap samples.

    Returns
    -------
    `~numpy.ndarray`
        Speeds in pixels per epoch, in rising order; empty if there are none.

    Examples
    --------
    >>> import numpy as np
    >>> from comparison_reading import Sample, read_speeds
    >>> rng = np.random.default_rng(1)
    >>> v = np.concatenate([rng.normal(5, 1, 90), rng.normal(20, 1, 60)])
    >>> pair, here = np.arange(150) % 9, np.zeros(150)
    >>> read_speeds(Sample(pair, here, here, v, here)).round()
    array([ 5., 20.])
    """
    sample = sample.within_limits()
    rows = densities(sample)
    found = maxima(rows.sum(axis=0))
    if len(found) == 0:
        return found
    rng = np.random.default_rng(rng)
    again = np.zeros(len(found))
    for _ in range(N_DRAWN):
        counts = rng.multinomial(len(rows), np.full(len(rows), 1 / len(rows)))
        other = maxima(counts @ rows)
        if len(other):
            nearest = np.abs(found[:, None] - other).min(axis=1)
            again += nearest <= AGAIN
    found = found[again >= SHARE * N_DRAWN]
    return np.array(
        [sample.along[np.abs(sample.along - v) <= AROUND].mean() for v in found]
    )
