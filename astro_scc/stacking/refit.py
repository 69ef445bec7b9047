# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A maximum of the stack fitted again, without some matches or with some moved."""

from dataclasses import dataclass, replace

import numpy as np

from astro_scc.stacking.components import fit_gaussian
from astro_scc.stacking.stack import velocities

__all__ = ["Refit"]

#: Matches further than this many standard errors from the box add nothing.
NEAR = 5.0


@dataclass(frozen=True, eq=False, repr=False)
class Refit:
    """
    The matches near a maximum, and the grid points that it is fitted to.

    Attributes
    ----------
    index : `~numpy.ndarray` of int, shape (k,)
        The matches.
    x, y, sx, sy, weight : `~numpy.ndarray`, shape (k,)
        Their velocities, standard errors and weights in the stack.
    v1, v2 : `~numpy.ndarray`
        Velocities of the columns and rows of the box.
    used : `~numpy.ndarray` of bool, shape (n2, n1)
        Points that take part in the fit.
    """

    index: np.ndarray
    x: np.ndarray
    y: np.ndarray
    sx: np.ndarray
    sy: np.ndarray
    weight: np.ndarray
    v1: np.ndarray
    v2: np.ndarray
    used: np.ndarray

    @classmethod
    def of(cls, displacements, pairs, component, grid):
        """
        The matches near a fitted component.

        Parameters
        ----------
        displacements : `~astro_scc.stacking.Displacements`
        pairs : `~astro_scc.stacking.DatePairs`
        component : `~astro_scc.stacking.Component`
        grid : `~astro_scc.stacking.VelocityGrid`
            That the component was found on.

        Returns
        -------
        `Refit` or None
            None if the component was not fitted, or there is no match.
        """
        index, x, y, sx, sy, weight = velocities(displacements, pairs)
        if not component.fitted or len(index) == 0:
            return None
        columns, rows, used = component.points
        v1, v2 = grid.v1[columns], grid.v2[rows]
        near = (
            (x >= v1[0] - NEAR * sx)
            & (x <= v1[-1] + NEAR * sx)
            & (y >= v2[0] - NEAR * sy)
            & (y <= v2[-1] + NEAR * sy)
        )
        columns = (a[near] for a in (index, x, y, sx, sy, weight))
        return cls(*columns, v1, v2, used)

    def moved(self, dx, dy):
        """
        The same with the matches moved.

        Parameters
        ----------
        dx, dy : array_like, shape (k,)

        Returns
        -------
        `Refit`
        """
        return replace(self, x=self.x + dx, y=self.y + dy)

    def map(self, of=slice(None)):
        """
        The stack in the box, not divided by the number of SSPs.

        Parameters
        ----------
        of : optional
            Which matches; all of them by default.

        Returns
        -------
        `~numpy.ndarray`, shape (n2, n1)
        """
        x, y, sx, sy, weight = (
            a[of, None] for a in (self.x, self.y, self.sx, self.sy, self.weight)
        )
        profile1 = np.exp(-0.5 * ((self.v1 - x) / sx) ** 2)
        profile2 = np.exp(-0.5 * ((self.v2 - y) / sy) ** 2)
        return (profile2 * weight).T @ profile1

    def fit(self, values):
        """
        The maximum of a stack in the box.

        Parameters
        ----------
        values : `~numpy.ndarray`, shape (n2, n1)

        Returns
        -------
        `~numpy.ndarray`, shape (2,), or None
            None if there is none any more; one outside is put to the side.
        """
        found = fit_gaussian(np.where(self.used, values, 0.0), self.v1, self.v2)
        if found is None:
            return None
        low, high = (self.v1[0], self.v2[0]), (self.v1[-1], self.v2[-1])
        return np.clip(found[:2], low, high)

    def jackknife(self, parts):
        r"""
        Covariance of the maximum from leaving out parts in turn.

        Parameters
        ----------
        parts : sequence of `~numpy.ndarray` of bool, shape (k,)
            The matches of each part; n of them, at least two.

        Returns
        -------
        `~numpy.ndarray`, shape (2, 2)
            ``(n - 1) / n`` times the sum of the squares.  A maximum that is
            none any more without a part counts as half a box away.
        """
        total, n = self.map(), len(parts)
        found = [self.fit(total - self.map(of)) for of in parts]
        kept = [v for v in found if v is not None]
        half = 0.5 * np.array([np.ptp(self.v1), np.ptp(self.v2)])
        squares = (n - len(kept)) * np.diag(half**2)
        if kept:
            apart = np.array(kept) - np.mean(kept, axis=0)
            squares += apart.T @ apart
        return (n - 1) / n * squares
