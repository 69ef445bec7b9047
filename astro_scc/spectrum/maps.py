# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The velocity map: correlation along rays of all velocities, and its significance."""

from dataclasses import dataclass

import numpy as np
import scipy

from astro_scc.spectrum.equations import interval_bins
from astro_scc.spectrum.permutations import LENGTH


@dataclass(frozen=True, eq=False, repr=False)
class VelocityMap:
    """
    Correlation of the images along all velocities.

    Attributes
    ----------
    v1, v2 : `~numpy.ndarray`, shapes (n1,) and (n2,)
        Velocities along the first and the second axis.
    coefficient : `~numpy.ndarray`, shape (n2, n1)
        Mean correlation coefficient along the ray of each velocity, less that of
        permuted epochs.
    z_score : `~numpy.ndarray`, shape (n2, n1)
        The same in standard deviations of the permutations.
    """

    v1: np.ndarray
    v2: np.ndarray
    coefficient: np.ndarray
    z_score: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of the maps, (n2, n1)."""
        return len(self.v2), len(self.v1)

    @property
    def step(self) -> tuple[float, float]:
        """Spacing of the velocities along both axes."""
        return self.v1[1] - self.v1[0], self.v2[1] - self.v2[0]


def velocity_map(sheet, aside, fastest, *, angle=0.0, beam=1.0, n_trials=60, rng):
    """
    Return the map of velocities along and across the flow.

    Parameters
    ----------
    sheet : sequence of ``Diagram``
        Diagrams at displacements across the flow.
    aside : `~numpy.ndarray`, shape (n,)
        These displacements in beams, evenly spaced.
    fastest : float
        Largest velocity of the map, in beams/yr.
    angle : float, optional
        Direction of the flow from the first axis of the map, in radians.
    beam : float, optional
        Length of a beam in the unit of the axes.
    n_trials : int, optional
        Permutations of the epochs from which its significance follows.
    rng : `~numpy.random.Generator`

    Returns
    -------
    `VelocityMap`
    """
    diagram = sheet[len(sheet) // 2]
    years, x = diagram.years, diagram.displacement
    n = len(years)
    bins, number, interval = interval_bins(years)
    values = np.stack([d.sums for d in sheet], axis=2)
    epochs = np.arange(n)
    values /= max(diagram.power, np.finfo(float).tiny)
    flat = values.reshape(n * n, -1)
    # The map has 61 points on either axis.
    v = fastest * np.arange(-30, 31) / 30
    along = np.cos(angle) * v + np.sin(angle) * v[:, None]
    across = -np.sin(angle) * v + np.cos(angle) * v[:, None]
    shape = len(number), *values.shape[2:]
    to_map = _rays(along, across, interval, number, aside, x, shape)
    first, second = np.nonzero(bins >= 0)
    by_bin = np.argsort(bins[first, second], kind="stable")
    first, second = first[by_bin], second[by_bin]
    each = np.repeat(1 / number, number).astype(np.float32)
    starts = np.append(0, np.cumsum(number))

    def stacked(order):
        images = order[first] * n + order[second]
        mean = scipy.sparse.csr_array(
            (each, images, starts), shape=(len(number), n * n)
        )
        return (to_map @ (mean @ flat).ravel()).reshape(along.shape)

    observed = stacked(epochs)
    trials = np.array([stacked(rng.permutation(n)) for _ in range(n_trials)])
    scatter = trials.std(axis=0)
    scatter = scatter + 0.1 * scatter.mean()
    excess = observed - trials.mean(axis=0)
    z_score = np.divide(excess, scatter, out=np.zeros_like(excess), where=scatter > 0)
    return VelocityMap(v * beam, v * beam, excess, z_score)


def _rays(along, across, interval, number, aside, x, shape):
    """Return the matrix that takes means over bins of the interval to a map."""
    h = (across[None] * interval[:, None, None] - aside[0]) / (aside[1] - aside[0])
    d = (along[None] * interval[:, None, None] - x[0]) / (x[1] - x[0])
    inside = (h >= 0) & (h <= shape[1] - 1) & (d >= 0) & (d <= shape[2] - 1)
    way = np.hypot(along, across)[None] * interval[:, None, None]
    weight = inside * number[:, None, None] * np.exp(-way / LENGTH)
    weight /= np.maximum(weight.sum(axis=0), np.finfo(float).tiny)
    k, row = np.nonzero(inside.reshape(len(interval), -1))
    h, d, weight = (a.reshape(len(interval), -1)[k, row] for a in (h, d, weight))
    low_h = np.minimum(h.astype(int), shape[1] - 2)
    low_d = np.minimum(d.astype(int), shape[2] - 2)
    parts, columns = [], []
    for i in (0, 1):
        for j in (0, 1):
            part = np.abs(1 - i - (h - low_h)) * np.abs(1 - j - (d - low_d))
            parts.append(weight * part)
            columns.append((k * shape[1] + low_h + i) * shape[2] + low_d + j)
    where = np.tile(row, 4), np.concatenate(columns)
    size = along.size, int(np.prod(shape))
    return scipy.sparse.csr_array((np.concatenate(parts), where), shape=size)
