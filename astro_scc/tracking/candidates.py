# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Candidates: which SSP of a later epoch each SSP may have become."""

from dataclasses import dataclass, fields

import numpy as np

from astro_scc.epochs.positions import beam_fwhm, ssp_offsets

__all__ = ["Candidates", "core_ssps", "find_candidates"]

#: Features are told apart from the core beyond this part of a beam, its half width.
CORE_RADIUS = 0.5


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

    def select(self, keep):
        """
        Some of the candidates.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or of int

        Returns
        -------
        `Candidates`
        """
        return Candidates(*(getattr(self, f.name)[keep] for f in fields(self)))


def find_candidates(
    matches, landed, ssps, years, *, place=None, max_gap=1, most=12, inside=None
):
    """
    Candidates out of the correlation peaks.

    A peak is a candidate if it falls on an SSP of the same scale of a later
    epoch.  Of several peaks of one SSP on the same other one the highest
    counts.

    Parameters
    ----------
    matches : `~astro_scc.correlation.Matches`
    landed : array_like of int, shape (n_matches,)
        The SSP that each match falls on, or -1, see
        `~astro_scc.correlation.target_ssps`.
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    years : array_like, shape (n_epochs,)
        Dates in order, not decreasing.
    place : array_like of int, shape (n_epochs,), optional
        Place in time of each image, of a shuffled order; their own one by
        default.
    max_gap : int, optional
        Most epochs between source and target.
    most : int, optional
        Of each SSP's candidates for an epoch, those of the highest
        coefficients.
    inside : callable, optional
        Given `Candidates`, says which of them move as fast as they may.

    Returns
    -------
    `Candidates`
        Ordered by source and target.

    Raises
    ------
    ValueError
        If ``max_gap`` is negative, ``most`` not positive, or the dates
        decrease.

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
    if max_gap < 0 or most < 1:
        raise ValueError(
            f"max_gap must be 0 or more and most 1 or more, got {max_gap} and {most}"
        )
    if np.any(np.diff(years) < 0):
        raise ValueError("the dates of the epochs must not decrease")
    place = np.arange(len(years)) if place is None else np.asarray(place)
    source, target = matches.ssp.astype(int), np.asarray(landed, dtype=int)
    at, to = place[ssps.epoch[source]], place[matches.target]
    use = (target >= 0) & (to > at) & (to - at <= max_gap + 1) & (years[to] > years[at])
    source, target, at, to = source[use], target[use], at[use], to[use]
    coefficient = matches.coefficient[use].astype(float)
    # The best peak of each pair of SSPs.
    order = np.lexsort((-coefficient, target, source))
    order = order[_first_of(source[order], target[order])]
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
    # The best ones of each SSP and epoch.
    order = np.lexsort((-found.coefficient, found.gap, found.source))
    start = np.flatnonzero(_first_of(found.source[order], found.gap[order]))
    size = np.diff([*start, len(order)])[: len(start)]
    rank = np.arange(len(order)) - np.repeat(start, size)
    return found.select(np.sort(order[rank < most]))


def core_ssps(ssps, cube):
    """
    The SSPs that are the core of a jet.

    On each scale and at each epoch the nearest one to the reference pixel,
    if it is no farther from it than half the width of the beam; on scales
    on which there is one at half of the epochs at least, because what
    passes by is no core.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    cube : `~astro_scc.epochs.EpochCube`
        Aligned on the core, if it has one.

    Returns
    -------
    `~numpy.ndarray` of int, shape (n_ssps,)
        Number of the scale for the core's SSPs, from 0, and -1 for others.

    Examples
    --------
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import core_ssps
    >>> cube = simulate_two_fluid(n_epochs=3, core=5.0, rng=1).cube
    >>> ssps = SSPs.of_epochs([Decomposer(scales=[2])(image) for image in cube.data])
    >>> (core_ssps(ssps, cube) == 0).sum().item()
    3
    """
    offset = np.stack(ssp_offsets(ssps, cube), axis=1)
    distance = np.hypot(*offset.T)
    away = np.arctan2(*offset.T)
    axis = np.stack([np.sin(away), np.cos(away)], axis=1)
    distance /= beam_fwhm(cube, ssps.epoch, ssps.scale, axis[:, None])[:, 0]
    order = np.lexsort((distance, ssps.epoch, ssps.scale))
    nearest = order[_first_of(ssps.scale[order], ssps.epoch[order])]
    nearest = nearest[distance[nearest] <= CORE_RADIUS]
    _, number, count = np.unique(
        ssps.scale[nearest], return_inverse=True, return_counts=True
    )
    core = np.full(len(ssps), -1)
    core[nearest] = np.where(2 * count >= len(cube), np.arange(len(count)), -1)[number]
    return core


def _first_of(*keys):
    """Which entries of sorted keys differ from the one before."""
    new = np.zeros(len(keys[0]), bool)
    new[:1] = True
    for key in keys:
        new[1:] |= key[1:] != key[:-1]
    return new
