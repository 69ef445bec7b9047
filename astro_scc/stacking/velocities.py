# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Velocity samples."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from astro_scc.paper.stack import VelocityGrid
from astro_scc.paper.trials import DatePairs, baseline_pairs, consecutive_pairs

__all__ = [
    "DatePairs",
    "VelocityGrid",
    "VelocitySamples",
    "baseline_pairs",
    "consecutive_pairs",
]


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
