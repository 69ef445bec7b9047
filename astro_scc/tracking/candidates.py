# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Candidates: which SSP of a later epoch each SSP may have become."""

from dataclasses import dataclass, fields

import numpy as np

from astro_scc.epochs.positions import beam_fwhm, ssp_offsets

#: Features are distinguished from the core beyond this part of a beam, its half width.
CORE_RADIUS = 0.5
#: Candidates of one SSP for one epoch that are kept, those of highest correlation.
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
        From maximum to maximum, in pixels.
    interval : `~numpy.ndarray`, shape (n,)
        Time from source to target, positive.
    gap : `~numpy.ndarray` of int, shape (n,)
        Epochs between the two, 0 for consecutive ones.
    coefficient : `~numpy.ndarray`, shape (n,)
        Correlation of the source with the image of the target there.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.tracking import Candidates
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

    def __len__(self):
        return len(self.source)

    def __repr__(self):
        return f"<Candidates: {len(self)} of {len(np.unique(self.source))} SSPs>"

    @property
    def motion(self):
        """Displacements (y, x), shape (n, 2)."""
        return np.stack([self.dy, self.dx], axis=1)

    def select(self, keep):
        """
        Return some of the candidates.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or of int

        Returns
        -------
        `Candidates`
            Of links, `Links`.
        """
        return type(self)(*(getattr(self, f.name)[keep] for f in fields(self)))


def find_candidates(
    matches, target_ssp, ssps, years, *, place=None, max_gap=1, inside=None
):
    """
    Return the candidates among the correlation peaks.

    A peak is a candidate if it falls on an SSP of the same scale of a later
    epoch.  Of several peaks of one SSP on the same other one the highest
    counts, and of the candidates of one SSP for one epoch the twelve highest.

    Parameters
    ----------
    matches : `~astro_scc.correlation.Matches`
    target_ssp : array_like of int, shape (n_matches,)
        The SSP that each match falls on, or -1, see
        `~astro_scc.correlation.target_ssps`.
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    years : array_like, shape (n_epochs,)
        Dates in order, not decreasing.
    place : array_like of int, shape (n_epochs,), optional
        Place in time of each image, of a permutation of the epochs; their own
        one by default.
    max_gap : int, optional
        Most epochs between source and target, 0 or more.
    inside : callable, optional
        Given `Candidates`, says which of them are within the limits of speed.

    Returns
    -------
    `Candidates`
        Ordered by source and target.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.correlation import Correlator, all_pairs, target_ssps
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.tracking import find_candidates
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
    place = np.arange(len(years)) if place is None else np.asarray(place)
    source, target = matches.ssp.astype(int), np.asarray(target_ssp, dtype=int)
    at, to = place[ssps.epoch[source]], place[matches.target]
    use = (target >= 0) & (to > at) & (to - at <= max_gap + 1) & (years[to] > years[at])
    source, target, at, to = source[use], target[use], at[use], to[use]
    coefficient = matches.coefficient[use].astype(float)
    # The best peak of each pair of SSPs.
    order = np.lexsort((-coefficient, target, source))
    order = order[rank_in_group(source[order], target[order]) == 0]
    source, target, at, to = source[order], target[order], at[order], to[order]
    found = Candidates(
        source=source,
        target=target,
        dy=ssps.y[target] - ssps.y[source],
        dx=ssps.x[target] - ssps.x[source],
        interval=years[to] - years[at],
        gap=to - at - 1,
        coefficient=coefficient[order],
    )
    if inside is not None:
        found = found.select(inside(found))
    order = np.lexsort((-found.coefficient, found.gap, found.source))
    rank = rank_in_group(found.source[order], found.gap[order])
    return found.select(np.sort(order[rank < MAX_CANDIDATES]))


def core_ssps(ssps, cube):
    """
    Return the number of the scale of the SSPs that are the core of a jet.

    The core is, on each scale and at each epoch, the nearest SSP to the
    reference pixel of the cube, if it is no farther from it than half the
    width of the beam; on scales on which there is one at half of the epochs at
    least, because what passes by is no core.  Scales count from 0; all other
    SSPs have -1.
    """
    offset = np.stack(ssp_offsets(ssps, cube), axis=1)
    distance = np.hypot(*offset.T)
    away = np.arctan2(*offset.T)
    axis = np.stack([np.sin(away), np.cos(away)], axis=1)
    distance /= beam_fwhm(cube, ssps.epoch, ssps.scale, axis[:, None])[:, 0]
    order = np.lexsort((distance, ssps.epoch, ssps.scale))
    nearest = order[rank_in_group(ssps.scale[order], ssps.epoch[order]) == 0]
    nearest = nearest[distance[nearest] <= CORE_RADIUS]
    _, number, count = np.unique(
        ssps.scale[nearest], return_inverse=True, return_counts=True
    )
    core = np.full(len(ssps), -1)
    core[nearest] = np.where(2 * count >= len(cube), np.arange(len(count)), -1)[number]
    return core


def rank_in_group(*keys):
    """Return the place of each entry of sorted keys among those equal to it."""
    new = np.ones(len(keys[0]), bool)
    new[1:] = np.any([key[1:] != key[:-1] for key in keys], axis=0)
    return np.arange(len(new)) - np.flatnonzero(new)[np.cumsum(new) - 1]


def equal_pairs(one, other):
    """Return all (i, k) with ``one[i] == other[k]``, by k and then by i."""
    order = np.argsort(one, kind="stable")
    ends = [np.searchsorted(one[order], other, side=s) for s in ("left", "right")]
    count = ends[1] - ends[0]
    k = np.repeat(np.arange(len(other)), count)
    return order[ends[0][k] + rank_in_group(k)], k
