# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Candidates for links: pairs of SSPs that may be one feature at two epochs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from astro_scc.correlation import Matches
from astro_scc.decomposition import SSPs
from astro_scc.images.positions import beam_fwhm, ssp_offsets

#: Distance in beams beyond which features are distinguished from the core.
CORE_RADIUS = 0.5
#: Candidates kept for one SSP and one later epoch, those of highest correlation.
MAX_CANDIDATES = 12


@dataclass(frozen=True, eq=False, repr=False)
class Candidates:
    """
    Pairs of SSPs of one scale that may be the same feature at two dates.

    Attributes
    ----------
    source, target : `~numpy.ndarray` of int, shape (n,)
        Indices in the catalogue of the SSPs of all epochs.
    dy, dx : `~numpy.ndarray`, shape (n,)
        Displacement from maximum to maximum, in pixels.
    interval : `~numpy.ndarray`, shape (n,)
        Time from source to target, positive.
    gap : `~numpy.ndarray` of int, shape (n,)
        Number of epochs between the two, 0 for consecutive ones.
    coefficient : `~numpy.ndarray`, shape (n,)
        Correlation of the source with the target's image at that displacement.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking.candidates import Candidates
    >>> found = Candidates(
    ...     source=np.array([0, 1]), target=np.array([2, 2]), dy=np.zeros(2),
    ...     dx=np.array([5.0, -3.0]), interval=np.full(2, 0.1), gap=np.zeros(2, int),
    ...     coefficient=np.array([0.95, 0.7]))
    >>> len(found.select(found.coefficient > 0.8))
    1
    """

    source: np.ndarray
    target: np.ndarray
    dy: np.ndarray
    dx: np.ndarray
    interval: np.ndarray
    gap: np.ndarray
    coefficient: np.ndarray

    def __len__(self) -> int:
        return len(self.source)

    def __repr__(self):
        return f"<Candidates: {len(self)} of {len(np.unique(self.source))} SSPs>"

    @property
    def motion(self) -> np.ndarray:
        """Displacements (y, x), shape (n, 2)."""
        return np.stack([self.dy, self.dx], axis=1)

    def select(self, keep: ArrayLike) -> Candidates:
        """
        Return some of the candidates.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or of int

        Returns
        -------
        `Candidates`
            Or `Links`, if these are links.
        """
        return type(self)(*(getattr(self, f.name)[keep] for f in fields(self)))


def find_candidates(
    matches: Matches, target_ssp: ArrayLike, ssps: SSPs, years: ArrayLike, *,
    max_gap: int = 1, inside: Callable | None = None,
) -> Candidates:  # fmt: skip
    """
    Return the candidates among the correlation peaks.

    A peak is a candidate if it falls on an SSP of the same scale at a later
    epoch.  If several peaks connect the same two SSPs, the highest is used.
    Each SSP keeps its twelve highest candidates for each later epoch.

    Parameters
    ----------
    matches : `~astro_scc.correlation.Matches`
    target_ssp : array_like of int, shape (n_matches,)
        The SSP that each match falls on, or -1, see
        ``target_ssps``.
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    years : array_like, shape (n_epochs,)
        Dates in order, not decreasing.
    max_gap : int, optional
        Most epochs between source and target, 0 or more.
    inside : callable, optional
        Takes `Candidates` and returns which are within the limits of speed.

    Returns
    -------
    `Candidates`
        Ordered by source and target.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.correlation import Correlator, all_pairs
    >>> from astro_scc.correlation.matches import target_ssps
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.tracking.candidates import find_candidates
    >>> y, x = np.mgrid[:64, :96]
    >>> def image(x0):
    ...     return np.exp(-((x - x0) ** 2 + (y - 32) ** 2) / 30)
    >>> decompose = Decomposer(scales=[2])
    >>> epochs = [decompose(image(x0)) for x0 in (40, 46, 52)]
    >>> ssps = SSPs.of_epochs(epochs)
    >>> matches = Correlator()(epochs, all_pairs(3), 14)
    >>> found = find_candidates(
    ...     matches, target_ssps(matches, ssps), ssps, [2000.0, 2000.5, 2001.0])
    >>> found.source.tolist(), found.target.tolist(), found.dx.round(1).tolist()
    ([0, 0, 1], [1, 2, 2], [6.0, 12.0, 6.0])
    """
    years = np.asarray(years, dtype=float)
    source, target = matches.ssp.astype(int), np.asarray(target_ssp, dtype=int)
    at, to = ssps.epoch[source], matches.target.astype(int)
    use = np.flatnonzero(
        (target >= 0) & (to > at) & (to - at <= max_gap + 1) & (years[to] > years[at])
    )
    # Keep the highest peak of each pair of SSPs.
    use = use[lowest(-matches.coefficient[use], source[use], target[use])]
    source, target, at, to = source[use], target[use], at[use], to[use]
    found = Candidates(
        source=source,
        target=target,
        dy=ssps.y[target] - ssps.y[source],
        dx=ssps.x[target] - ssps.x[source],
        interval=years[to] - years[at],
        gap=to - at - 1,
        coefficient=matches.coefficient[use].astype(float),
    )
    if inside is not None:
        found = found.select(inside(found))
    best = lowest(-found.coefficient, found.source, found.gap, n=MAX_CANDIDATES)
    return found.select(np.sort(best))


def core_ssps(ssps, cube):
    """
    Return which SSPs are the core of a jet.

    On each scale and at each epoch, the core is the SSP nearest to the reference
    pixel of the cube, if it is within half the width of the beam.  A scale has a
    core only if there is such an SSP in at least half of the epochs, because a
    feature that passes by is no core.
    """
    offset = np.stack(ssp_offsets(ssps, cube), axis=1)
    distance = np.hypot(*offset.T)
    away = np.arctan2(*offset.T)
    axis = np.stack([np.sin(away), np.cos(away)], axis=1)
    distance /= beam_fwhm(cube, ssps.epoch, ssps.scale, axis[:, None])[:, 0]
    nearest = lowest(distance, ssps.scale, ssps.epoch)
    nearest = nearest[distance[nearest] <= CORE_RADIUS]
    _, number, count = np.unique(
        ssps.scale[nearest], return_inverse=True, return_counts=True
    )
    core = np.zeros(len(ssps), bool)
    core[nearest] = 2 * count[number] >= len(cube)
    return core


def rank_in_group(*keys):
    """Return the rank of each entry of sorted keys among the equal ones, from 0."""
    new = np.ones(len(keys[0]), bool)
    new[1:] = np.any([key[1:] != key[:-1] for key in keys], axis=0)
    return np.arange(len(new)) - np.flatnonzero(new)[np.cumsum(new) - 1]


def lowest(value, *keys, n=1):
    """Return the indices of the n lowest values for equal keys, sorted by the keys."""
    order = np.lexsort((value, *keys[::-1]))
    return order[rank_in_group(*(key[order] for key in keys)) < n]


def equal_pairs(one, other):
    """Return all (i, k) with ``one[i] == other[k]``, by k and then by i."""
    order = np.argsort(one, kind="stable")
    first, end = (np.searchsorted(one[order], other, side=s) for s in ("left", "right"))
    k = np.repeat(np.arange(len(other)), end - first)
    return order[first[k] + rank_in_group(k)], k
