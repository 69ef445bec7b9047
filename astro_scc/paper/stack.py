# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stack of the paper: displacements of matches, velocities, and their sum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from astro_scc.paper.trials import DatePairs

#: Most velocities along an axis of the grid; the spacing grows if there would be more.
MOST_VELOCITIES = 301
#: Matches that are summed at once, to limit memory.
BLOCK = 16384
#: Gaussians are neglected beyond this many standard deviations.
REACH_SIGMA = 5.0


@dataclass(frozen=True, eq=False, repr=False)
class Displacements:
    """
    Displacements of matches along two axes, with their errors.

    Attributes
    ----------
    d1, d2 : `~numpy.ndarray`, shape (n,)
        Displacement from the SSP to its match along the first and the second axis.
    s1, s2 : `~numpy.ndarray`, shape (n,)
        Their standard errors, SSP and match combined, above 0.
    weight : `~numpy.ndarray`, shape (n,)
        Correlation coefficient.
    reference, target : `~numpy.ndarray` of int, shape (n,)
        Epochs of the SSP and of the image in which it was matched.
    ssp, target_ssp : `~numpy.ndarray` of int, shape (n,)
        The SSP, and the SSP on which the match falls, or -1.
    n_ssps : `~numpy.ndarray` of int, shape (n_epochs,)
        Number of SSPs of each epoch that were correlated, with or without a match.

    Raises
    ------
    ValueError
        If the columns differ in length, an error is not above 0, or an epoch does not
        exist.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.paper import Displacements
    >>> one, number = np.ones(2), np.array([0, 1])
    >>> there_and_back = Displacements(
    ...     d1=np.array([0.5, -0.5]), d2=0 * one, s1=0.2 * one, s2=0.2 * one,
    ...     weight=0.9 * one, reference=number, target=number[::-1], ssp=number,
    ...     target_ssp=number[::-1], n_ssps=np.array([1, 1]))
    >>> len(there_and_back)
    2
    """

    d1: np.ndarray
    d2: np.ndarray
    s1: np.ndarray
    s2: np.ndarray
    weight: np.ndarray
    reference: np.ndarray
    target: np.ndarray
    ssp: np.ndarray
    target_ssp: np.ndarray
    n_ssps: np.ndarray

    def __post_init__(self):
        lengths = {k: len(v) for k, v in vars(self).items() if k != "n_ssps"}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"displacements need columns of one length, got {lengths}")
        for name in ("s1", "s2"):
            if not np.all(getattr(self, name) > 0):
                raise ValueError(f"{name} must be above 0 for all displacements")
        for name in ("reference", "target"):
            if not np.isin(getattr(self, name), np.arange(len(self.n_ssps))).all():
                last = len(self.n_ssps) - 1
                raise ValueError(f"{name} names epochs outside 0 to {last}")

    def __len__(self) -> int:
        return len(self.d1)


@dataclass(frozen=True, eq=False)
class VelocityGrid:
    """
    A regular grid of velocities along two axes, symmetric about zero.

    Attributes
    ----------
    v1, v2 : `~numpy.ndarray`, shapes (n1,) and (n2,)
        Velocities along the first and second axis.  Maps on the grid have
        shape (n2, n1).

    Examples
    --------
    >>> from astro_scc.paper.stack import VelocityGrid
    >>> grid = VelocityGrid.covering(2.0, 0.5)
    >>> grid.shape, grid.v1.tolist()[:3]
    ((9, 9), [-2.0, -1.5, -1.0])
    """

    v1: np.ndarray
    v2: np.ndarray

    @property
    def shape(self) -> tuple[int, int]:
        """Shape of a map, (n2, n1)."""
        return len(self.v2), len(self.v1)

    @property
    def step(self) -> tuple[float, float]:
        """Spacing of the velocities along both axes."""
        return self.v1[1] - self.v1[0], self.v2[1] - self.v2[0]

    @property
    def v_max(self) -> tuple[float, float]:
        """Largest velocity along both axes."""
        return self.v1[-1], self.v2[-1]

    @classmethod
    def covering(cls, v_max: ArrayLike, step: ArrayLike) -> VelocityGrid:
        """
        Return the grid that reaches a velocity in every direction.

        Parameters
        ----------
        v_max : float or array_like, shape (2,)
            Largest velocity, above 0; two numbers are for the two axes.
        step : float or array_like, shape (2,)
            Largest spacing, above 0.

        Returns
        -------
        `VelocityGrid`

        Examples
        --------
        >>> from astro_scc.paper.stack import VelocityGrid
        >>> VelocityGrid.covering(2.0, 0.3).v1.round(2)
        array([-2.  , -1.71, -1.43, -1.14, -0.86, -0.57, -0.29, 0.  ,
               0.29, 0.57, 0.86, 1.14, 1.43, 1.71, 2.  ])
        """
        v_max, step = np.broadcast_to(v_max, 2), np.broadcast_to(step, 2)
        half = np.ceil(v_max / step - 1e-9).astype(int)
        half = np.clip(half, 1, MOST_VELOCITIES // 2)
        axes = zip(v_max, half, strict=True)
        return cls(*(v * (np.arange(-n, n + 1) / n) for v, n in axes))


def gaussian_sum(x, y, sx, sy, weight, grid_x, grid_y):
    """
    Return the weighted sum of axis-parallel Gaussians of unit height on a grid.

    A Gaussian is the product of its profiles, so the sum over K Gaussians
    is one matrix product, (ny x K) (K x nx).

    Parameters
    ----------
    x, y, sx, sy, weight : `~numpy.ndarray`, shape (k,)
        Centres, standard deviations, and weights.
    grid_x, grid_y : `~numpy.ndarray`, shapes (nx,) and (ny,)

    Returns
    -------
    `~numpy.ndarray`, shape (ny, nx)
    """
    total = np.zeros((len(grid_y), len(grid_x)))
    for start in range(0, len(x), BLOCK):
        k = slice(start, start + BLOCK)
        profile_x = np.exp(-0.5 * ((grid_x - x[k, None]) / sx[k, None]) ** 2)
        profile_y = np.exp(-0.5 * ((grid_y - y[k, None]) / sy[k, None]) ** 2)
        total += (profile_y * weight[k, None]).T @ profile_x
    return total


class Stacker:
    """
    Stacks of displacements for any order of the epochs.

    Parameters
    ----------
    displacements : `Displacements`
    pairs : ``DatePairs``
    """

    def __init__(self, displacements: Displacements, pairs: DatePairs):
        self.displacements, self.pairs = displacements, pairs
        n = pairs.n_dates
        # Where matches of the ordered pair of images (r, t) begin, at r * n + t.
        number = displacements.reference.astype(int) * n + displacements.target
        self._index = np.argsort(number, kind="stable")
        self._begin = np.searchsorted(number[self._index], np.arange(n * n + 1))

    def velocities(self, order=None):
        """
        Return the matches of an order of the epochs as velocities.

        Parameters
        ----------
        order : `~numpy.ndarray` of int, shape (n_dates,), optional
            Image at each date; by default the observed order.

        Returns
        -------
        index, pair : `~numpy.ndarray` of int, shape (k,)
            Indices of the match and of its pair of dates.  A match enters at most
            once.
        columns : `~numpy.ndarray`, shape (5, k)
            Velocities and their errors on both axes, and weights.
        """
        d, (reference, target) = self.displacements, self.pairs.images(order)
        number = reference * self.pairs.n_dates + target
        begin, end = self._begin[number], self._begin[number + 1]
        pair = np.repeat(np.arange(len(number)), end - begin)
        ends = zip(begin.tolist(), end.tolist(), strict=True)
        index = np.concatenate([self._index[a:b] for a, b in ends])
        rate = 1 / self.pairs.interval[pair]
        moved = [column[index] * rate for column in (d.d1, d.d2, d.s1, d.s2)]
        weight = d.weight[index] * self.pairs.weight[pair]
        return index, pair, np.array([*moved, weight])

    def stack(
        self, grid: VelocityGrid, *, order: ArrayLike | None = None,
        shift: tuple[float, float] = (0.0, 0.0), kind: type = float,
    ) -> np.ndarray:  # fmt: skip
        r"""
        Stack the correlation peaks of all SSPs and pairs of epochs.

        .. math:: C_\mathrm{SCC}(v) = \frac{\sum_t w_t \sum_j \sum_i \sum_p
                  \gamma_{i,j,t}(p)\, g(v - p / \Delta t,\ \sigma / \Delta t)}
                  {\sum_t w_t \sum_j N^t_{\mathrm{SSP},j}},

        where g is a Gaussian of unit height and w the weights of the pairs of dates
        (Mertens & Lobanov 2016, Eqs. 5 and 6).  SSPs without a peak count in the
        denominator.

        Parameters
        ----------
        grid : `VelocityGrid`
            In the unit of the displacements per year.
        order : array_like of int, shape (n_dates,), optional
            Image at each date, to stack another order of the epochs.
        shift : tuple of float, optional
            Displacement that is added to all matches.
        kind : type, optional
            Of the numbers that are summed.

        Returns
        -------
        `~numpy.ndarray`, shape ``grid.shape``
            Zero where there are no SSPs.
        """
        _, pair, (v1, v2, s1, s2, weight) = self.velocities(order)
        rate = 1 / self.pairs.interval[pair]
        v1, v2 = v1 + shift[0] * rate, v2 + shift[1] * rate
        near = np.abs(v1) < grid.v_max[0] + REACH_SIGMA * s1
        near &= np.abs(v2) < grid.v_max[1] + REACH_SIGMA * s2
        columns = (v1, v2, s1, s2, weight, grid.v1, grid.v2)
        columns = [a.astype(kind, copy=False) for a in columns]
        total = gaussian_sum(*(a[near] for a in columns[:5]), *columns[5:])
        reference, _ = self.pairs.images(order)
        number = (self.displacements.n_ssps[reference] * self.pairs.weight).sum()
        return total / number if number > 0 else total
