# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The displacement-interval diagram: correlation of all pairs of epochs."""

from dataclasses import dataclass

import numpy as np

#: Points of the diagram in a beam, at most.
POINTS = 6.0
#: Displacements at which fewer pairs of places than this share are inside the mask are
#: left out, and sums are divided by at least the other share.
LEAST_OVERLAP, LEAST_NORM = 0.05, 0.15


@dataclass(frozen=True, eq=False, repr=False)
class Diagram:
    """
    Correlation of every epoch with every other at displacements along the flow.

    Attributes
    ----------
    sums : `~numpy.ndarray`, shape (n_epochs, n_epochs, n_d)
        ``sum_x q_a(x - d/2) q_b(x + d/2)``, the mean over scales, over the number of
        places x; symmetric: ``sums[a, b, d] = sums[b, a, -d]``.
    overlap : `~numpy.ndarray`, shape (n_d,)
        Share of places for which both ends are inside the mask.
    displacement : `~numpy.ndarray`, shape (n_d,)
        In beams, evenly spaced and symmetric about zero.
    years : `~numpy.ndarray`, shape (n_epochs,)
    """

    sums: np.ndarray
    overlap: np.ndarray
    displacement: np.ndarray
    years: np.ndarray

    @property
    def means(self) -> np.ndarray:
        """The sums over the number of pairs of places, shape of ``sums``."""
        known = self.overlap > LEAST_OVERLAP
        norm = np.where(known, 1 / np.maximum(self.overlap, LEAST_NORM), 0.0)
        return self.sums * norm.astype(np.float32)

    @property
    def power(self) -> float:
        """Mean correlation of an epoch with itself, at zero displacement."""
        epochs = np.arange(len(self.years))
        return float(self.sums[epochs, epochs, self.zero].mean())

    @property
    def zero(self) -> int:
        """Index of the displacement zero."""
        return len(self.displacement) // 2


def lags(flow):
    """Return the displacements of a diagram in points of the grid, from zero."""
    step = max(1, int(1 / (POINTS * flow.step)))
    most = min(int(np.ceil(flow.reach / flow.step)), len(flow.along) - 2)
    return np.arange(0, max(most, step) + 1, step)


def ends(lag, n):
    """Return the slices of the earlier and later ends of displacements by a lag."""
    return (slice(0, n - lag), slice(lag, n)) if lag >= 0 else ends(-lag, n)[::-1]


def middles(weight, lag):
    """Return the weight of places at the middles of displacements by a lag >= 0."""
    low = weight[lag // 2 :][: len(weight) - lag]
    high = weight[(lag + 1) // 2 :][: len(weight) - lag]
    return (low + high) / 2


def correlate(flow, *, region=None, across=0):
    """
    Correlate all pairs of epochs at all displacements along the flow.

    Parameters
    ----------
    flow : ``FlowPlanes``
    region : `~numpy.ndarray`, shape (n_along, n_across), optional
        Weight of places.  A displacement belongs to the place of its middle, so that
        the ends of a region do not favour one speed.
    across : int, optional
        Displacement across the flow, in points of the grid.

    Returns
    -------
    `Diagram`
    """
    n, mask = len(flow.years), flow.mask.astype(np.float32)
    weight = mask if region is None else np.asarray(region, np.float32)
    total = max((mask * weight).sum(), 1.0)
    steps, half = lags(flow), len(lags(flow)) - 1
    sums = np.zeros((n, n, 2 * half + 1), np.float32)
    overlap = np.zeros(2 * half + 1)
    left, right = ends(across, mask.shape[1])
    for k, lag in enumerate(steps):
        here, there = ends(lag, len(mask))
        inside = mask[here, left] * mask[there, right]
        at = middles(weight, lag)[:, left] * inside
        overlap[half + k] = at.sum() / total
        if overlap[half + k] <= LEAST_OVERLAP / 2:
            continue
        # Planes are zero outside the mask.
        points = np.flatnonzero(inside if region is None else at)
        found = np.zeros((n, n), np.float32)
        for plane in flow.values:
            first = plane[:, here, left].reshape(n, -1)[:, points]
            if region is not None:
                first *= at.flat[points]
            found += first @ plane[:, there, right].reshape(n, -1)[:, points].T
        sums[:, :, half + k] = found / (total * len(flow.values))
    if across == 0:
        sums[:, :, :half] = sums[:, :, :half:-1].transpose(1, 0, 2)
        overlap[:half] = overlap[:half:-1]
    return Diagram(sums, overlap, _displacements(steps, flow.step), flow.years)


def correlate_aside(flow, lags_across, *, region=None):
    """
    Return diagrams at displacements across the flow, for both signs of these.

    Parameters
    ----------
    flow, region
        As in `correlate`.
    lags_across : sequence of int
        From 1, in points of the grid.

    Returns
    -------
    list of `Diagram`
        From the most negative displacement to the most positive one.
    """
    middle = correlate(flow, region=region)
    low, high, zero = [], [], middle.zero
    for lag in lags_across:
        pair = [correlate(flow, region=region, across=k) for k in (lag, -lag)]
        filled = []
        for one, other in (pair, pair[::-1]):
            # Negative displacements are those to the other side, seen from there.
            back = other.sums[:, :, :zero:-1].transpose(1, 0, 2)
            sums = np.concatenate([back, one.sums[:, :, zero:]], axis=2)
            overlap = np.concatenate([other.overlap[:zero:-1], one.overlap[zero:]])
            filled.append(Diagram(sums, overlap, one.displacement, one.years))
        high.append(filled[0])
        low.append(filled[1])
    return [*low[::-1], middle, *high]


def _displacements(steps, step):
    return np.concatenate([-steps[:0:-1], steps]) * step


def influence(flow, diagram, function, *, region=None):
    """
    Return what each place of each epoch adds to a linear function of the diagram.

    .. math:: I_a(x) = q_a(x) \\sum_b \\sum_d h_{ab}(d)\\, q_b(x + d)

    Parameters
    ----------
    flow, region
        As in `correlate`.
    diagram : `Diagram`
    function : `~numpy.ndarray`, shape (n_epochs, n_epochs, n_d)
        The function h of the ``means``, symmetric as the diagram is.

    Returns
    -------
    `~numpy.ndarray`, shape (n_epochs, n_along)
        Summed across the flow; half of each product is counted at either end.
    """
    n, mask = len(flow.years), flow.mask
    weight = mask if region is None else region
    weight = np.asarray(weight, np.float32)
    total = max((mask * weight).sum(), 1.0) * len(flow.values)
    known = diagram.overlap > LEAST_OVERLAP
    norm = np.where(known, 1 / np.maximum(diagram.overlap, LEAST_NORM), 0.0) / total
    half, found = diagram.zero, np.zeros((n, len(mask)))
    for k, lag in enumerate(lags(flow)):
        if norm[half + k] == 0:
            continue
        here, there = ends(lag, len(mask))
        inside = mask[here] * mask[there]
        at = middles(weight, lag) * inside
        points = np.flatnonzero(inside if region is None else at)
        rows = points // mask.shape[1]
        starts = np.flatnonzero(np.diff(rows, prepend=-1))
        h = np.asarray(function[:, :, half + k] * norm[half + k], np.float32)
        # The negative displacements are the same products.
        both = 1 if k else 0.5
        for plane in flow.values:
            first = plane[:, here].reshape(n, -1)[:, points]
            second = plane[:, there].reshape(n, -1)[:, points]
            if region is not None:
                first *= at.flat[points]
            for end, at_end, other in (
                (here, first, h @ second), (there, second, h.T @ first),
            ):  # fmt: skip
                added = np.add.reduceat(at_end * other, starts, axis=1)
                found[:, end][:, rows[starts]] += both * added
    return found
