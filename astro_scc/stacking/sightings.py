# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Sightings: correlation peaks as things seen to move at a time and a place."""

from dataclasses import dataclass, fields

import numpy as np

__all__ = ["Sightings"]


@dataclass(frozen=True, eq=False, repr=False)
class Sightings:
    """
    Correlation peaks of the pairs of dates, read forward in time.

    A peak of an SSP of the later image in the earlier one is turned round,
    so that both directions say the same thing in the same way.

    Attributes
    ----------
    v1, v2 : `~numpy.ndarray`, shape (n,)
        Velocity along the axes of the frame.
    s1, s2 : `~numpy.ndarray`, shape (n,)
        Standard errors of the velocity.
    weight : `~numpy.ndarray`, shape (n,)
        Correlation coefficient.
    time, interval : `~numpy.ndarray`, shape (n,)
        Mean date of the pair, and the time between its images, in years.
    middle : `~numpy.ndarray`, shape (n, 2)
        Where the feature was at the mean date, Cartesian.
    velocity : `~numpy.ndarray`, shape (n, 2)
        Velocity in the same coordinates as ``middle``.
    sigma : `~numpy.ndarray`, shape (n,)
        Standard error of the displacement, mean of both axes.
    first : `~numpy.ndarray` of int, shape (n,)
        Earlier date of the pair.
    ssp : `~numpy.ndarray` of int, shape (n,)
        The SSP that was correlated.
    match : `~numpy.ndarray` of int, shape (n,)
        Index of the match in the displacements.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Displacements, consecutive_pairs
    >>> from astro_scc.stacking import Sightings
    >>> rng = np.random.default_rng(1)
    >>> years, n, one = np.array([0.0, 1.0, 2.0]), 40, np.ones(40)
    >>> first = np.repeat([0, 1], 20)
    >>> d = Displacements(
    ...     d1=3 + rng.normal(0, 0.2, n), d2=rng.normal(0, 0.2, n), s1=0.3 * one,
    ...     s2=0.3 * one, weight=0.8 * one, reference=first, target=first + 1,
    ...     ssp=np.arange(n), target_ssp=np.full(n, -1), n_ssps=np.full(3, 20),
    ...     position=rng.uniform(0, 50, (n, 2)), motion=np.tile([3.0, 0.0], (n, 1)))
    >>> pairs = consecutive_pairs(years)
    >>> seen = Sightings.of(d, pairs, years, (9.0, 9.0))
    >>> len(seen), bool((seen.interval > 0).all())
    (40, True)
    """

    v1: np.ndarray
    v2: np.ndarray
    s1: np.ndarray
    s2: np.ndarray
    weight: np.ndarray
    time: np.ndarray
    interval: np.ndarray
    middle: np.ndarray
    velocity: np.ndarray
    sigma: np.ndarray
    first: np.ndarray
    ssp: np.ndarray
    match: np.ndarray

    def __len__(self):
        return len(self.v1)

    def select(self, keep):
        """
        A selection of the sightings.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or indices

        Returns
        -------
        `Sightings`
        """
        return Sightings(**{f.name: getattr(self, f.name)[keep] for f in fields(self)})

    def near(self, v1, v2, reach):
        """
        Sightings of a velocity.

        Parameters
        ----------
        v1, v2 : float
        reach : float
            In standard errors of each sighting.

        Returns
        -------
        `~numpy.ndarray` of bool, shape (n,)
        """
        return np.hypot((self.v1 - v1) / self.s1, (self.v2 - v2) / self.s2) <= reach

    @classmethod
    def of(cls, displacements, pairs, years, limit):
        """
        The sightings of the pairs of dates of a stack.

        Parameters
        ----------
        displacements : `~astro_scc.stacking.Displacements`
            With ``position`` and ``motion``.
        pairs : `~astro_scc.stacking.DatePairs`
        years : array_like, shape (n_dates,)
            Dates in years.
        limit : tuple of float
            Largest velocities along the two axes.

        Returns
        -------
        `Sightings`

        Raises
        ------
        ValueError
            If the displacements hold no positions.
        """
        d = displacements
        if d.position is None or d.motion is None:
            raise ValueError("sightings need displacements with position and motion")
        years = np.asarray(years, dtype=float)
        n = d.n_epochs
        slot = np.full((n, n), -1)
        slot[pairs.first, pairs.second] = np.arange(len(pairs))
        ahead = slot[d.reference, d.target]
        back = slot[d.target, d.reference]
        which = np.maximum(ahead, back)
        paired = which >= 0
        rate = np.zeros(len(d))
        rate[paired] = 1 / pairs.interval[which[paired]]
        rate[paired & (ahead < 0)] *= -1
        v1, v2 = d.d1 * rate, d.d2 * rate
        s1, s2 = d.s1 * np.abs(rate), d.s2 * np.abs(rate)
        use = np.flatnonzero(
            paired & (np.abs(v1) <= limit[0]) & (np.abs(v2) <= limit[1])
        )
        which = which[use]
        first, second = pairs.first[which], pairs.second[which]
        return cls(
            v1=v1[use],
            v2=v2[use],
            s1=s1[use],
            s2=s2[use],
            weight=d.weight[use],
            time=0.5 * (years[first] + years[second]),
            interval=pairs.interval[which],
            middle=d.position[use] + 0.5 * d.motion[use],
            velocity=d.motion[use] * rate[use, None],
            sigma=np.sqrt(d.s1[use] * d.s2[use]),
            first=first,
            ssp=d.ssp[use],
            match=use,
        )
