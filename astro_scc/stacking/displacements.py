# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Displacements: the matches as angles along the two axes of a frame."""

from dataclasses import dataclass, fields, replace

import numpy as np

__all__ = ["Displacements"]


@dataclass(frozen=True, eq=False, repr=False)
class Displacements:
    """
    Matches as displacements along two axes, with their errors, in mas.

    They know no dates: a velocity is a displacement over the interval of
    the pair of dates that the two images are laid on.

    Attributes
    ----------
    d1, d2 : `~numpy.ndarray`, shape (n,)
        Displacement along the first and second axis.
    s1, s2 : `~numpy.ndarray`, shape (n,)
        Standard errors of the displacement, of SSP and target combined.
    weight : `~numpy.ndarray`, shape (n,)
        Weight of the match, its correlation coefficient.
    reference, target : `~numpy.ndarray` of int, shape (n,)
        Epochs of the SSP and of the image it was matched in.
    ssp : `~numpy.ndarray` of int, shape (n,)
        The SSP.
    target_ssp : `~numpy.ndarray` of int, shape (n,)
        The SSP of the target epoch that the match falls on, or -1.
    n_ssps : `~numpy.ndarray` of int, shape (n_epochs,)
        Number of SSPs of each epoch that were correlated, with or without
        a match.
    position, motion : `~numpy.ndarray`, shape (n, 2), optional
        Position of the SSP and displacement in Cartesian coordinates, which
        the axes of the frame need not be.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> rng = np.random.default_rng(1)
    >>> years, n, one = np.array([0.0, 1.0, 2.0]), 40, np.ones(40)
    >>> first = np.repeat([0, 1], 20)
    >>> d = Displacements(
    ...     d1=3 + rng.normal(0, 0.2, n), d2=rng.normal(0, 0.2, n), s1=0.3 * one,
    ...     s2=0.3 * one, weight=0.8 * one, reference=first, target=first + 1,
    ...     ssp=np.arange(n), target_ssp=np.full(n, -1), n_ssps=np.full(3, 20))
    >>> pairs = consecutive_pairs(years)
    >>> len(d), d.n_epochs
    (40, 3)
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
    position: np.ndarray | None = None
    motion: np.ndarray | None = None

    def __len__(self):
        return len(self.d1)

    @property
    def n_epochs(self):
        """Number of epochs."""
        return len(self.n_ssps)

    def select(self, keep):
        """
        A selection of the matches; the number of SSPs stays.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or indices

        Returns
        -------
        `Displacements`
        """
        columns = {
            f.name: getattr(self, f.name) for f in fields(self) if f.name != "n_ssps"
        }
        return replace(
            self, **{k: v[keep] for k, v in columns.items() if v is not None}
        )

    def both_ways(self):
        """
        The matches and, turned round, the same from the target's side.

        Returns
        -------
        `Displacements`
            Twice as many; without ``position`` and ``motion``.
        """
        swapped = {
            "d1": -self.d1,
            "d2": -self.d2,
            "reference": self.target,
            "target": self.reference,
        }
        names = [
            f.name
            for f in fields(self)
            if f.name not in ("n_ssps", "position", "motion")
        ]
        doubled = {
            name: np.concatenate(
                [getattr(self, name), swapped.get(name, getattr(self, name))]
            )
            for name in names
        }
        return Displacements(**doubled, n_ssps=self.n_ssps)
