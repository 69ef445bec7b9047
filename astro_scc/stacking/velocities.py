# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Velocity samples, pairs of dates, and the grid of velocities."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

#: Most velocities along an axis of the grid; the spacing grows if there would be more.
MOST_VELOCITIES = 601


@dataclass(frozen=True, eq=False, repr=False)
class VelocitySamples:
    """
    Matched pairs of SSPs, each with a displacement between two epochs.

    A displacement divided by an interval is a sample of the velocities.  Stacks take
    the intervals from `DatePairs`, because permuted epochs have different intervals.
    Attributes that only some stages need may be None.

    Attributes
    ----------
    d1, d2 : `~numpy.ndarray`, shape (n,)
        Displacement from the SSP to its match along the first and second
        axis, in mas, or in beams along one axis and across it.
    weight : `~numpy.ndarray`, shape (n,)
        Correlation coefficient.
    reference, target : `~numpy.ndarray` of int, shape (n,)
        Epochs of the SSP and of the image in which it was matched.
    ssp, target_ssp : `~numpy.ndarray` of int, shape (n,)
        The SSP, and the SSP of the target epoch on which the match falls, or -1.
    s1, s2 : `~numpy.ndarray`, shape (n,)
        Standard errors of the displacement, SSP and target combined.
    motion : `~numpy.ndarray`, shape (n, 2)
        Displacement in the coordinates of ``position``, which may differ from
        the axes.
    n_ssps : `~numpy.ndarray` of int, shape (n_epochs,)
        Number of SSPs of each epoch that were correlated, with or without
        a match.
    position : `~numpy.ndarray`, shape (n_ssps, 2)
        Cartesian position of each SSP.
    epoch, scale : `~numpy.ndarray`, shape (n_ssps,)
    years : `~numpy.ndarray`, shape (n_epochs,)
        Dates in years, ascending.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking.velocities import VelocitySamples
    >>> one = np.ones(1)
    >>> samples = VelocitySamples(
    ...     d1=0.4 * one, d2=0 * one, weight=one, reference=np.array([0]),
    ...     target=np.array([1]), ssp=np.array([0]), target_ssp=np.array([1]),
    ...     years=np.array([2000.0, 2000.5]))
    >>> len(samples), samples.interval
    (1, array([0.5]))
    """

    d1: np.ndarray
    d2: np.ndarray
    weight: np.ndarray
    reference: np.ndarray
    target: np.ndarray
    ssp: np.ndarray
    target_ssp: np.ndarray
    s1: np.ndarray | None = None
    s2: np.ndarray | None = None
    motion: np.ndarray | None = None
    n_ssps: np.ndarray | None = None
    position: np.ndarray | None = None
    epoch: np.ndarray | None = None
    scale: np.ndarray | None = None
    years: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.d1)

    @property
    def n_epochs(self) -> int:
        """Number of epochs."""
        return len(self.n_ssps)

    @property
    def interval(self) -> np.ndarray:
        """Time from the SSP's epoch to that of its match, in years, signed."""
        return self.years[self.target] - self.years[self.reference]

    def select(self, keep: ArrayLike) -> VelocitySamples:
        """
        Return a selection of the samples, with the same SSPs and dates.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or indices

        Returns
        -------
        `VelocitySamples`
        """
        columns = [(name, getattr(self, name)) for name in COLUMNS]
        return replace(self, **{k: v[keep] for k, v in columns if v is not None})

    def of_epochs(self, epochs: slice) -> VelocitySamples:
        """
        Return the samples within a range of epochs, with the SSPs and dates of these.

        Parameters
        ----------
        epochs : slice
            Consecutive epochs.

        Returns
        -------
        `VelocitySamples`
        """
        first, last, _ = epochs.indices(len(self.years))
        inside = (self.epoch >= first) & (self.epoch < last)
        number = np.where(inside, np.cumsum(inside) - 1, -1)
        own = self.select(
            inside[self.ssp] & (self.target >= first) & (self.target < last)
        )
        there = np.where(own.target_ssp >= 0, number[own.target_ssp], -1)
        return replace(
            own,
            ssp=number[own.ssp],
            target_ssp=there,
            reference=own.reference - first,
            target=own.target - first,
            position=self.position[inside],
            epoch=self.epoch[inside] - first,
            scale=self.scale[inside],
            n_ssps=self.n_ssps[first:last],
            years=self.years[first:last],
        )

    def of_ssps(self, select: np.ndarray) -> VelocitySamples:
        """
        Return the samples that start at selected SSPs.

        Parameters
        ----------
        select : `~numpy.ndarray` of bool, shape (n_ssps,)

        Returns
        -------
        `VelocitySamples`
        """
        number = np.bincount(self.epoch[select], minlength=self.n_epochs)
        return replace(self.select(select[self.ssp]), n_ssps=number)

    def without_ssps(self, taken: np.ndarray) -> VelocitySamples:
        """
        Return the samples that neither start nor end at the ``taken`` SSPs.

        Parameters
        ----------
        taken : `~numpy.ndarray` of bool, shape (n_ssps,)

        Returns
        -------
        `VelocitySamples`
        """
        there = np.where(self.target_ssp >= 0, taken[self.target_ssp], False)
        return self.select(~(taken[self.ssp] | there))

    def within(self, pairs: DatePairs, limit: tuple[float, float]) -> VelocitySamples:
        """
        Return the samples of pairs of dates, matched in either direction.

        Parameters
        ----------
        pairs : `DatePairs`
        limit : tuple of float
            Largest velocities along the two axes, included.

        Returns
        -------
        `VelocitySamples`
        """
        paired = np.zeros((len(self.years),) * 2, dtype=bool)
        paired[pairs.first, pairs.second] = paired[pairs.second, pairs.first] = True
        some = self.select(paired[self.reference, self.target])
        speed = np.abs([some.d1, some.d2]) * (1 / np.abs(some.interval))
        return some.select((speed.T <= limit).all(axis=1))


#: Columns of `VelocitySamples` that have a value for each sample.
COLUMNS = tuple(f.name for f in fields(VelocitySamples))[:10]


@dataclass(frozen=True, eq=False)
class DatePairs:
    """
    Pairs of dates that a stack compares, the earlier date first.

    Attributes
    ----------
    first, second : `~numpy.ndarray` of int, shape (n_pairs,)
        Indices of the dates.
    interval : `~numpy.ndarray`, shape (n_pairs,)
        Time between them in years, positive.
    weight : `~numpy.ndarray`, shape (n_pairs,)
        Weight of the pair in the stack.
    n_dates : int

    Examples
    --------
    >>> from astro_scc.stacking.velocities import consecutive_pairs
    >>> pairs = consecutive_pairs([2000.0, 2000.5, 2002.0])
    >>> len(pairs), pairs.interval.tolist()
    (2, [0.5, 1.5])
    """

    first: np.ndarray
    second: np.ndarray
    interval: np.ndarray
    weight: np.ndarray
    n_dates: int

    def __len__(self) -> int:
        return len(self.first)

    def images(self, order: ArrayLike | None = None) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the ordered pairs of images for an order of the images over the dates.

        Parameters
        ----------
        order : array_like of int, shape (..., n_dates), optional
            Image at each date; by default the observed order.

        Returns
        -------
        reference, target : `~numpy.ndarray` of int, shape (..., n_pairs)
        """
        order = np.arange(self.n_dates) if order is None else np.asarray(order)
        return order[..., self.first], order[..., self.second]


def consecutive_pairs(years: ArrayLike) -> DatePairs:
    """
    Return the pairs of each date and the next one, as in the paper.

    Epochs of the same date have no interval between them and make no pair.

    Parameters
    ----------
    years : array_like, shape (n_dates,)
        Dates in years, ascending.

    Returns
    -------
    `DatePairs`

    Examples
    --------
    >>> from astro_scc.stacking.velocities import consecutive_pairs
    >>> consecutive_pairs([0.0, 0.5, 1.5]).interval
    array([0.5, 1. ])
    """
    gaps = np.diff(np.asarray(years, dtype=float))
    first = np.flatnonzero(gaps > 0)
    return DatePairs(first, first + 1, gaps[first], np.ones(len(first)), len(years))


def baseline_pairs(years: ArrayLike, shortest: float, longest: float) -> DatePairs:
    """
    Return all pairs of dates whose separation lies in a range.

    The weights are inverse variances: a displacement error sigma gives a
    velocity error sigma / interval, so pairs are weighted by the square of
    their interval, normalised to a mean of one.

    Parameters
    ----------
    years : array_like, shape (n_dates,)
        Dates in years, ascending.
    shortest, longest : float
        Range of separations in years, both included.

    Returns
    -------
    `DatePairs`

    Examples
    --------
    >>> from astro_scc.stacking.velocities import baseline_pairs
    >>> pairs = baseline_pairs([0.0, 0.5, 1.5], 0.8, 1.2)
    >>> pairs.first, pairs.second
    (array([1]), array([2]))
    """
    years = np.asarray(years, dtype=float)
    separation = years[None, :] - years[:, None]
    # Rounded limits must not lose a pair.  The slack is a third of a day, or 1% of
    # the longest separation if dates are minutes apart.
    slack = min(1e-3, 0.01 * longest)
    inside = (separation >= shortest - slack) & (separation <= longest + slack)
    first, second = np.nonzero(inside & (separation > 0))
    interval = separation[first, second]
    weight = interval**2 / np.mean(interval**2) if len(interval) else interval
    return DatePairs(first, second, interval, weight, len(years))


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
    >>> from astro_scc.stacking.velocities import VelocityGrid
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
        >>> from astro_scc.stacking.velocities import VelocityGrid
        >>> VelocityGrid.covering(2.0, 0.3).v1.round(2)
        array([-2.  , -1.71, -1.43, -1.14, -0.86, -0.57, -0.29, 0.  ,
               0.29, 0.57, 0.86, 1.14, 1.43, 1.71, 2.  ])
        """
        v_max, step = np.broadcast_to(v_max, 2), np.broadcast_to(step, 2)
        half = np.ceil(v_max / step - 1e-9).astype(int)
        half = np.clip(half, 1, MOST_VELOCITIES // 2)
        axes = zip(v_max, half, strict=True)
        return cls(*(v * (np.arange(-n, n + 1) / n) for v, n in axes))
