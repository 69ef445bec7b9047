# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Stacks of many permutations of the epochs, from one map for each pair of images."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from astro_scc.stacking.stack import REACH_SIGMA, gaussian_sum, number_of_ssps
from astro_scc.stacking.velocities import VelocitySamples

#: Spacing of the maps in units of the narrowest kernel.
STEP_SIGMA = 2 / 3
#: Margin of the maps beyond the largest velocity, in kernels: room for shifts.
MARGIN = 6.0
#: Degree of the interpolating spline; with the step above its error is 1e-4.
DEGREE = 7
#: Number of nodes beyond the shortest and the longest interval, so that the
#: ends of the spline between intervals do not matter.
BEYOND = 3
#: With more intervals, stacks are made in single precision.
FEW_INTERVALS = 8
#: Bytes of stacks that are made at once.
BLOCK_BYTES = 2**26
#: Bytes of maps that are kept; if all maps take more, they are made as needed.
MAP_BYTES = 2**28
#: Bytes of maps that are added up at once.
WORK_BYTES = 2**24
#: Largest number of points of an axis of the maps.
MAX_SIZE = 1001


def _basis(axis, positions):
    """Return the matrix from coefficients to values, zero beyond the axis."""
    knots = make_interp_spline(axis, axis, k=DEGREE).t
    inside = np.abs(positions) <= axis[-1]
    at = np.clip(positions, axis[0], axis[-1])
    basis = BSpline.design_matrix(at, knots, DEGREE).toarray()
    return np.where(inside[:, None], basis, 0.0)


@dataclass(frozen=True, eq=False, repr=False)
class PairMaps:
    """
    The correlation peaks of each ordered pair of images as a map.

    The maps are in displacement and do not depend on dates.  A stack is the
    sum, over pairs of dates, of the map of the two images at these dates,
    stretched by the interval, which is a product with two small matrices.  It
    agrees with `stack` within 1e-3 of the maximum.

    Attributes
    ----------
    samples : ``VelocitySamples``
    axis1, axis2 : `~numpy.ndarray`
        Displacements at which the maps are sampled.
    index : `~numpy.ndarray` of int, shape (n_matches,)
        Indices of the matches, sorted by pair of images.
    ends : `~numpy.ndarray` of int, shape (n_images ** 2 + 1,)
        Where the matches of images (r, t) begin, at ``r * n_images + t``.
    """

    samples: VelocitySamples
    axis1: np.ndarray
    axis2: np.ndarray
    index: np.ndarray
    ends: np.ndarray

    @classmethod
    def of(cls, samples, v_max, longest):
        """
        Prepare the maps.

        Parameters
        ----------
        samples : ``VelocitySamples``
        v_max : tuple of float
            Largest velocities of the stacks.
        longest : float
            Longest interval of a pair of dates, in years.

        Returns
        -------
        `PairMaps`
        """
        d, n, axes = samples, samples.n_epochs, []
        for position, sigma, v in ((d.d1, d.s1, v_max[0]), (d.d2, d.s2, v_max[1])):
            position, sigma = (a if len(d) else np.ones(1) for a in (position, sigma))
            narrow, farthest = sigma.min(), np.abs(position).max()
            reach = v * longest + MARGIN * narrow
            reach = min(reach, farthest + REACH_SIGMA * sigma.max())
            half = int(np.ceil(reach / (STEP_SIGMA * narrow)))
            half = min(max(half, DEGREE), MAX_SIZE // 2)
            axes.append(np.linspace(-reach, reach, 2 * half + 1))
        pair = d.reference.astype(int) * n + d.target
        order = np.argsort(pair, kind="stable")
        ends = np.searchsorted(pair[order], np.arange(n * n + 1))
        return cls(samples, *axes, order.astype(np.int32), ends)

    @cached_property
    def _rows(self):
        """Row of each pair of images in the maps, or -1 without matches."""
        used = np.diff(self.ends) > 0
        return np.where(used, np.cumsum(used) - 1, -1)

    @property
    def map_bytes(self):
        """Bytes of one map."""
        return 4 * len(self.axis1) * len(self.axis2)

    @cached_property
    def _everything(self):
        """All maps, or None if they take too much memory."""
        pairs = np.flatnonzero(self._rows >= 0)
        if len(pairs) * self.map_bytes > MAP_BYTES:
            return None
        return self._maps(pairs)

    def _maps(self, pairs):
        """
        Return the maps of pairs of images, as coefficients of splines.

        Parameters
        ----------
        pairs : `~numpy.ndarray` of int, shape (n,)
            Indices of the pairs.

        Returns
        -------
        `~numpy.ndarray`, shape (n, n2 * n1)
            In single precision.
        """
        d, axes = self.samples, (self.axis1, self.axis2)
        to1, to2 = (
            make_interp_spline(axis, np.eye(len(axis)), k=DEGREE).c.astype(np.float32)
            for axis in axes
        )
        arrays = *axes, d.d1, d.d2, d.s1, d.s2, d.weight
        axis1, axis2, *columns = (a.astype(np.float32) for a in arrays)
        maps = np.empty((len(pairs), len(axis2) * len(axis1)), dtype=np.float32)
        for own, pair in zip(maps, pairs.tolist(), strict=True):
            k = self.index[self.ends[pair] : self.ends[pair + 1]]
            values = gaussian_sum(*(a[k] for a in columns), axis1, axis2)
            own[:] = (to2 @ values.astype(np.float32) @ to1.T).ravel()
        return maps

    def stacks(self, pairs, grid, orders, *, shift=(0.0, 0.0)):
        """
        Return the stacks of many permutations of the images over the dates.

        Parameters
        ----------
        pairs : `DatePairs`
        grid : `VelocityGrid`
        orders : array_like of int, shape (n_orders, n_dates)
            Image at each date.
        shift : tuple of float, optional
            Displacement added to all matches.

        Yields
        ------
        `~numpy.ndarray`, shape (m, n2, n1)
            Blocks of stacks, in the order of ``orders``.
        """
        orders = np.asarray(orders)
        stretch = _Stretch(self, pairs, grid, shift)
        # One stack at a time stays in the cache; where maps are made again for each
        # block, blocks are large.
        size = max(1, BLOCK_BYTES // (8 * grid.shape[0] * grid.shape[1]))
        size = 1 if self._everything is not None else size
        for start in range(0, len(orders), size):
            some = orders[start : start + size]
            reference, target = pairs.images(some)
            total = np.zeros((len(some), *grid.shape))
            for maps, rows in self._parts(reference * self.samples.n_epochs + target):
                for own, row in zip(total, rows, strict=True):
                    stretch(maps, row, own)
                # Freed before the next part is made.
                del maps
            total /= number_of_ssps(self.samples, pairs, some)[:, None, None]
            yield total

    def _parts(self, images):
        """Yield as many maps as fit into memory, and the rows of the pairs in them."""
        if self._everything is not None:
            yield self._everything, self._rows[images]
            return
        used = np.unique(images)
        used = used[self._rows[used] >= 0]
        most = max(1, MAP_BYTES // self.map_bytes)
        for start in range(0, len(used), most):
            part = used[start : start + most]
            rows = np.full(len(self._rows), -1)
            rows[part] = np.arange(len(part))
            yield self._maps(part), rows[images]


class _Stretch:
    """
    The transformation of maps in displacement to stacks in velocity.

    The stack of a map is a smooth function of the interval.  Maps are therefore
    first added up at a few intervals, with the weights of a spline between
    them, and then stretched.
    """

    def __init__(self, maps, pairs, grid, shift):
        self.size = len(maps.axis2), len(maps.axis1)
        at, share = _intervals(maps, pairs, grid)
        # If dates are even or few, permutations tie, which needs double precision.
        kind = np.float32 if len(at) > FEW_INTERVALS else float
        # Spline weight of each pair of dates at the intervals, times its weight in the
        # stack, shape (n_intervals, n_pairs).
        self.share = share.astype(kind) * pairs.weight.astype(kind)
        # For each interval, the part of the map that is needed and the matrices along
        # both axes, of which the second are beside each other.
        self.steps, twos, self.ends = [], [], [0]
        for interval in at:
            one = _basis(maps.axis1, grid.v1 * interval - shift[0])
            two = _basis(maps.axis2, grid.v2 * interval - shift[1])
            part = rows, columns = _support(two), _support(one)
            to1 = np.ascontiguousarray(one[:, columns].T, dtype=kind)
            self.steps.append((part, to1))
            twos.append(two[:, rows].astype(kind))
            self.ends.append(self.ends[-1] + twos[-1].shape[1])
        self.to2 = np.concatenate(twos, axis=1)

    def __call__(self, maps, row, total):
        """Add the stack of one permutation, given the rows of its pairs, to a total."""
        slots, kind = np.flatnonzero(row >= 0), self.share.dtype
        if len(slots) == 0:
            return
        # To save memory, only a few intervals and pairs of dates at a time.
        few = max(1, WORK_BYTES // (kind.itemsize * maps.shape[1]))
        for first in range(0, len(self.share), few):
            some, added = slice(first, first + few), 0
            for start in range(0, len(slots), few):
                use = slots[start : start + few]
                values = maps[row[use]].astype(kind, copy=False)
                added = added + self.share[some, use] @ values
            added = added.reshape(-1, *self.size)
            steps = self.steps[some]
            lines = np.concatenate(
                [m[p] @ to1 for m, (p, to1) in zip(added, steps, strict=True)]
            )
            end = self.ends[first + len(steps)]
            total += self.to2[:, self.ends[first] : end] @ lines


def _support(matrix):
    """Return the columns that are not all zero."""
    used = np.flatnonzero(matrix.any(axis=0))
    return slice(used[0], used[-1] + 1) if len(used) else slice(0, 0)


def _intervals(maps, pairs, grid):
    """
    Return the intervals by which maps are stretched, and the weights of pairs in them.

    Returns
    -------
    at : `~numpy.ndarray`, shape (n,)
    share : `~numpy.ndarray`, shape (n, n_pairs)
    """
    own, kind = np.unique(np.round(pairs.interval, 9), return_inverse=True)
    d = maps.samples
    if len(own) > 1 and len(d):
        # Along the line v t the map varies on the scale of the kernel.
        fastest = np.hypot(
            np.abs(grid.v1).max() / d.s1.min(), np.abs(grid.v2).max() / d.s2.min()
        )
        number = int(np.ceil(np.ptp(own) * fastest / STEP_SIGMA)) + 1
        number = max(number + 2 * BEYOND, DEGREE + 1)
        if number < len(own):
            step = np.ptp(own) / (number - 1 - 2 * BEYOND)
            at = own[0] + step * np.arange(-BEYOND, number - BEYOND)
            return at, make_interp_spline(at, np.eye(number), k=DEGREE)(own)[kind].T
    return own, (kind == np.arange(len(own))[:, None]).astype(float)
