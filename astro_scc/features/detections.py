# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Detections of all epochs, from which features are made."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

#: Distance from the origin within which the core lies if the epochs are not aligned,
#: and its scatter if they are, in beams.
FARTHEST_CORE, ALIGNED = 0.7, 0.08


@dataclass(frozen=True, eq=False)
class Detections:
    """
    Compact emission in the images of all epochs, ordered by epoch.

    Attributes
    ----------
    epoch : `~numpy.ndarray` of int, shape (n,)
    place, place_error : `~numpy.ndarray`, shape (n, 2)
        Offsets from the core on two axes, in mas, with standard errors.
    flux : `~numpy.ndarray`, shape (n,)
        Positive.
    size : `~numpy.ndarray`, shape (n,)
        Full width at half maximum, in mas.
    years : `~numpy.ndarray`, shape (n_epochs,)
        Dates in order.
    beam : `~numpy.ndarray`, shape (2, 2)
        Covariance of the beam on the two axes, in mas^2.
    number : `~numpy.ndarray` of int, shape (n,), optional
        Number of each within its epoch.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.features.detections import Detections
    >>> d = Detections(
    ...     epoch=np.arange(3), place=np.array([[1.0, 0.0], [1.5, 0.0], [2.0, 0.0]]),
    ...     place_error=np.full((3, 2), 0.01), flux=np.ones(3), size=np.zeros(3),
    ...     years=np.array([2000.0, 2001.0, 2002.0]), beam=np.eye(2) / 5.545)
    >>> d.in_beams[:, 0].round(2), d.time
    (array([1. , 1.5, 2. ]), array([2000., 2001., 2002.]))
    """

    epoch: np.ndarray
    place: np.ndarray
    place_error: np.ndarray
    flux: np.ndarray
    size: np.ndarray
    years: np.ndarray
    beam: np.ndarray
    number: np.ndarray | None = None

    def __post_init__(self):
        if self.number is None:
            first = np.searchsorted(self.epoch, self.epoch)
            object.__setattr__(self, "number", np.arange(len(self.epoch)) - first)

    def __len__(self) -> int:
        return len(self.epoch)

    def select(self, keep: ArrayLike) -> Detections:
        """
        Return some of the detections.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or of int

        Returns
        -------
        `Detections`
        """
        each = [f.name for f in fields(self) if f.name not in ("years", "beam")]
        return replace(self, **{name: getattr(self, name)[keep] for name in each})

    @property
    def time(self) -> np.ndarray:
        """Date of each, in years."""
        return self.years[self.epoch]

    @property
    def fwhm(self) -> float:
        """Geometric mean of the beam's full widths at half maximum, in mas."""
        return float(np.sqrt(8 * np.log(2)) * np.linalg.det(self.beam) ** 0.25)

    @property
    def major(self) -> float:
        """Full width at half maximum of the beam's major axis, in mas."""
        return float(np.sqrt(8 * np.log(2) * np.linalg.eigvalsh(self.beam)[-1]))

    @cached_property
    def in_beams(self) -> np.ndarray:
        """Places in full widths of the beam along its axes, shape (n, 2)."""
        return self.to_beams(self.place)

    def to_beams(self, offset: ArrayLike) -> np.ndarray:
        """
        Return offsets in full widths of the beam along its axes.

        Parameters
        ----------
        offset : array_like, shape (..., 2)
            In mas.

        Returns
        -------
        `~numpy.ndarray`, shape (..., 2)
            Its length is that of the offset in full widths of the beam along it.
        """
        variance, axes = np.linalg.eigh(self.beam)
        return offset @ axes / np.sqrt(8 * np.log(2) * variance)

    def core(self, radius: float) -> np.ndarray:
        """
        Return which detections are the core.

        Parameters
        ----------
        radius : float
            Largest distance from the origin in beams.

        Returns
        -------
        `~numpy.ndarray` of bool, shape (n,)
            The nearest to the origin of each epoch, if it is as near as that.
        """
        distance = np.hypot(*self.in_beams.T)
        order = np.lexsort((distance, self.epoch))
        first = order[np.unique(self.epoch[order], return_index=True)[1]]
        core = np.zeros(len(self), dtype=bool)
        core[first] = distance[first] <= radius
        return core

    def aligned(self) -> Detections:
        """
        Return the detections with offsets from the core of their own epoch.

        This is done if the core is seen in at least nine of ten epochs and scatters
        more than epochs do that are aligned on it; epochs without it are left out.
        Otherwise the detections stay as they are: the fitted place of a core then
        varies with what emerges from it rather than with the alignment.

        Returns
        -------
        `Detections`
        """
        core = self.core(FARTHEST_CORE)
        seen, place = self.epoch[core], self.place[core]
        scatter = np.sqrt((self.in_beams[core] ** 2).mean()) if len(seen) else 0.0
        if scatter <= ALIGNED or len(seen) < 0.9 * len(self.years):
            return self
        offset = np.zeros((len(self.years), 2))
        offset[seen] = place
        shifted = replace(self, place=self.place - offset[self.epoch])
        return shifted.select(np.isin(self.epoch, seen))
