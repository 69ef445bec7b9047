# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Along rays of the diagram: maps of velocities, speeds across, correlation kept."""

from dataclasses import dataclass

import numpy as np
import scipy

from astro_scc.spectrum.diagram import TINY
from astro_scc.spectrum.equations import interval_bins, pairs_by_bin
from astro_scc.spectrum.permutations import LENGTH, autocorrelation

#: Smallest error relative to the speed along the flow.
LEAST_ERROR = 0.05
#: Displacements in beams at which patterns keep their correlation along the lines of a
#: flow, and not along others.
FROM, TO = 0.3, 4.0


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
    values /= max(diagram.power, TINY)
    flat = values.reshape(n * n, -1)
    # The map has 61 points on either axis.
    v = fastest * np.arange(-30, 31) / 30
    along = np.cos(angle) * v + np.sin(angle) * v[:, None]
    across = -np.sin(angle) * v + np.cos(angle) * v[:, None]
    shape = len(number), *values.shape[2:]
    to_map = _rays(along, across, interval, number, aside, x, shape)
    first, second = np.divmod(pairs_by_bin(bins), n)
    each = np.repeat(1 / number, number).astype(np.float32)
    starts = np.append(0, np.cumsum(number))

    def stacked(order):
        images = order[first] * n + order[second]
        mean = scipy.sparse.csr_array((each, images, starts), (len(number), n * n))
        return (to_map @ (mean @ flat).ravel()).reshape(along.shape)

    observed = stacked(np.arange(n))
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
    weight /= np.maximum(weight.sum(axis=0), TINY)
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


def transverse_speed(sheet, aside, speed):
    r"""
    Return the speed of a stream across the grid, and its error.

    The diagram is compared at displacements h and -h across the flow.  Along the ray of
    the stream its expectation is ``A R(h - u tau)``, so the difference of both is to
    first order proportional to the transverse speed u and the interval,

    .. math:: D(h) - D(-h) = 2 A \frac{h}{s^2} R(h)\, u \tau ,

    for a Gaussian R with the standard deviation s.

    Parameters
    ----------
    sheet : sequence of ``Diagram``
        At displacements -h, 0 and h across the flow; empty if it is too narrow.
    aside : float
        The displacement h in beams.
    speed : float
        Along the grid, in beams/yr.

    Returns
    -------
    speed, error : float
        In beams/yr, the error from the deletion of epochs; 0 and NaN if it is not
        known to the speed along the grid.
    """
    if len(sheet) < 3:
        return 0.0, np.nan
    middle = len(sheet) // 2
    below, on, above = sheet[middle - 1 : middle + 2]
    years, x = on.years, on.displacement
    tau = years - years[:, None]
    top, beside = on.power, (above.power + below.power) / 2
    if not 0 < beside < top:
        return 0.0, np.nan
    variance = aside**2 / (2 * np.log(top / beside))
    moved = (speed * tau)[..., None]
    ray = np.interp(x - moved, x, autocorrelation(on), left=0, right=0)
    ray *= on.overlap * np.exp(-np.abs(moved) / LENGTH)
    odd = (ray * (above.sums - below.sums)).sum(axis=2) * tau
    even = (ray * (on.sums - on.sums.mean(axis=(0, 1)))).sum(axis=2) * tau**2
    np.fill_diagonal(even, 0.0)
    gain = 2 * aside / variance * beside / top
    parts, ratio = without_each(even), without_each(odd) / gain
    if not (parts > 0).all():
        return 0.0, np.nan
    found = ratio / parts
    error = deletion_error(found)
    if not error < abs(speed):
        return 0.0, np.nan
    return float(found[0]), float(np.hypot(error, LEAST_ERROR * abs(speed)))


def correlation_kept(diagram, speed):
    """
    Return the mean correlation of patterns that move at a speed, over that at rest.

    Parameters
    ----------
    diagram : ``Diagram``
    speed : float
        In beams/yr.

    Returns
    -------
    `~numpy.ndarray`, shape (n_epochs + 1,)
        Of all epochs, and of all but each of them.
    """
    n, x = len(diagram.years), diagram.displacement
    tau = diagram.years - diagram.years[:, None]
    moved = speed * tau
    odd = diagram.means - diagram.means[:, :, ::-1]
    where = *np.indices((n, n)), (moved - x[0]) / (x[1] - x[0])
    found = scipy.ndimage.map_coordinates(odd, where, order=1)
    far = np.abs(moved)
    weight = np.exp(-far / LENGTH) * ((far > FROM) & (far < TO) & (tau > 0))
    power = np.diagonal(diagram.sums[:, :, diagram.zero])
    rest = without_each(np.diag(power)) / np.append(n, np.full(n, n - 1))
    total = without_each(weight) * rest
    return without_each(weight * found) / np.maximum(total, TINY)


def without_each(pairs):
    """
    Return the sum over all pairs of epochs, and over those without each epoch.

    Parameters
    ----------
    pairs : `~numpy.ndarray`, shape (n_epochs, n_epochs)

    Returns
    -------
    `~numpy.ndarray`, shape (n_epochs + 1,)
    """
    pairs = np.asarray(pairs, dtype=float)
    each = pairs.sum(axis=0) + pairs.sum(axis=1) - np.diagonal(pairs)
    return pairs.sum() - np.append(0.0, each)


def deletion_error(values):
    """Return the standard error of the first value from those without each epoch."""
    n = len(values) - 1
    return np.sqrt((n - 1) * values[1:].var())
