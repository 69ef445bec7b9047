# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Stacks of many orders of the epochs, from one map for each pair of images."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline

from astro_scc.stacking.stack import (
    REACH_SIGMA,
    gaussian_sum,
    number_of_ssps,
    stack,
)

__all__ = ["PairMaps"]

#: Spacing of the maps in units of the narrowest kernel.
STEP_SIGMA = 0.5
#: Degree of the interpolating spline; with the step above its error is 1e-4.
DEGREE = 5
#: Bytes of stacks that are made at once.
BLOCK_BYTES = 2**28
#: Largest number of points of an axis of the maps.
MAX_SIZE = 1001


def _axis(reach, sigma):
    half = int(np.ceil(reach / (STEP_SIGMA * sigma)))
    half = min(max(half, DEGREE), MAX_SIZE // 2)
    return np.linspace(-reach, reach, 2 * half + 1)


def _interpolation(axis, positions):
    """Matrix from values on an axis to values at positions, zero outside."""
    basis = make_interp_spline(axis, np.eye(len(axis)), k=DEGREE)
    inside = np.abs(positions) <= axis[-1]
    return np.where(inside[:, None], basis(np.clip(positions, axis[0], axis[-1])), 0.0)


@dataclass(frozen=True, eq=False, repr=False)
class PairMaps:
    """
    The correlation peaks of each ordered pair of images as a map.

    The maps are in displacement and know no dates.  A stack is a sum over
    pairs of dates of the map of the two images laid on them, stretched by
    the interval, which is a product with two small matrices.  Equivalent
    to `stack` within 1e-3 of the maximum.

    Attributes
    ----------
    displacements : `Displacements`
    axis1, axis2 : `~numpy.ndarray`
        Displacements at which the maps are sampled.
    maps : `~numpy.ndarray`, shape (n_images ** 2, n2, n1)
        In single precision, that of images (r, t) at ``r * n_images + t``.
    """

    displacements: object
    axis1: np.ndarray
    axis2: np.ndarray
    maps: np.ndarray

    @classmethod
    def of(cls, displacements, v_max, longest):
        """
        Make the maps.

        Parameters
        ----------
        displacements : `Displacements`
        v_max : tuple of float
            Largest velocities that will be asked for.
        longest : float
            Longest interval that a pair of dates has, in years.

        Returns
        -------
        `PairMaps`
        """
        d = displacements
        n = d.n_epochs
        axes = []
        for position, sigma, v in ((d.d1, d.s1, v_max[0]), (d.d2, d.s2, v_max[1])):
            narrow = sigma.min() if len(d) else 1.0
            wide = sigma.max() if len(d) else 1.0
            farthest = np.abs(position).max() if len(d) else 1.0
            reach = min(v * longest, farthest) + REACH_SIGMA * wide
            axes.append(_axis(reach, narrow))
        pair = d.reference.astype(int) * n + d.target
        order = np.argsort(pair, kind="stable")
        ends = np.searchsorted(pair[order], np.arange(n * n + 1))
        maps = np.zeros((n * n, len(axes[1]), len(axes[0])), dtype=np.float32)
        for p in np.flatnonzero(np.diff(ends)):
            k = order[ends[p] : ends[p + 1]]
            maps[p] = gaussian_sum(
                d.d1[k], d.d2[k], d.s1[k], d.s2[k], d.weight[k], *axes
            )
        return cls(displacements, *axes, maps)

    def both_ways(self):
        """
        The maps of the matches and, turned round, of the same from the target.

        Returns
        -------
        `PairMaps`
            Those of ``displacements.both_ways()``.
        """
        n = self.displacements.n_epochs
        square = self.maps.reshape(n, n, *self.maps.shape[1:])
        turned = square.transpose(1, 0, 2, 3)[:, :, ::-1, ::-1]
        return PairMaps(
            self.displacements.both_ways(),
            self.axis1,
            self.axis2,
            (square + turned).reshape(self.maps.shape),
        )

    def stacks(self, pairs, grid, orders, *, shift=(0.0, 0.0)):
        """
        The stacks of many orders of the images over the dates.

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
        size = max(1, BLOCK_BYTES // (8 * grid.shape[0] * grid.shape[1]))
        for start in range(0, len(orders), size):
            yield self._block(pairs, grid, orders[start : start + size], shift)

    def _block(self, pairs, grid, orders, shift):
        n = self.displacements.n_epochs
        reference, target = pairs.images(orders)
        images = reference * n + target
        total = np.zeros((len(orders), *grid.shape))
        intervals, kind = np.unique(np.round(pairs.interval, 9), return_inverse=True)
        for k, interval in enumerate(intervals):
            slots = np.flatnonzero(kind == k)
            to1 = _interpolation(self.axis1, grid.v1 * interval - shift[0])
            to2 = _interpolation(self.axis2, grid.v2 * interval - shift[1])
            used, place = np.unique(images[:, slots], return_inverse=True)
            place = place.reshape(len(orders), len(slots))
            weight = pairs.weight[slots]
            few = len(used) <= min(place.size // 2, BLOCK_BYTES // total[0].nbytes)
            if few or len(slots) == 1:
                # Stretch each pair of images once, then add, one trial at a
                # time: that stays in the processor's cache.
                stretched = to2 @ self.maps[used] @ to1.T
                weighted = np.empty(grid.shape)
                for trial, pair in enumerate(place):
                    for slot, w in zip(pair, weight, strict=True):
                        np.multiply(stretched[slot], w, out=weighted)
                        total[trial] += weighted
            else:
                for trial, pair in enumerate(images[:, slots]):
                    added = np.tensordot(weight, self.maps[pair], axes=1)
                    total[trial] += to2 @ added @ to1.T
        number = number_of_ssps(self.displacements, pairs, orders)
        return total / number[:, None, None]

    def stack(self, pairs, grid, order=None):
        """
        The exact stack of one order, see `~astro_scc.stacking.stack`.

        Parameters
        ----------
        pairs : `DatePairs`
        grid : `VelocityGrid`
        order : array_like of int, optional

        Returns
        -------
        `~numpy.ndarray`, shape ``grid.shape``
        """
        return stack(self.displacements, pairs, grid, order=order)
