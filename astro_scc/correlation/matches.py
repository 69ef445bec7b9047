# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matches: the correlation peaks of SSPs between pairs of epochs, in pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from astro_scc.decomposition import SSPs
from astro_scc.decomposition.wavelet import scale_size

COLUMNS = {
    "ssp": np.int32,
    "target": np.int16,
    "dy": np.float32,
    "dx": np.float32,
    "coefficient": np.float32,
    "overlap": np.float32,
    "target_snr": np.float32,
}


def join_columns(parts):
    """Join tuples of the columns ``ssp`` to ``target_snr``, each in its type."""
    columns = zip(*parts, strict=True) if parts else [()] * len(COLUMNS)
    return [
        np.concatenate([np.empty(0, kind), *column], dtype=kind, casting="unsafe")
        for kind, column in zip(COLUMNS.values(), columns, strict=True)
    ]


@dataclass(frozen=True, eq=False, repr=False)
class Matches:
    """
    Correlation peaks of SSPs with the images of other epochs.

    Displacements are in pixels and do not depend on dates: the matches stay
    the same whatever dates the epochs have or are given in a trial.

    Attributes
    ----------
    ssp : `~numpy.ndarray` of int, shape (n,)
        Index in the catalogue of the SSPs of all epochs.
    target : `~numpy.ndarray` of int, shape (n,)
        Epoch of the image that the SSP was correlated with.
    dy, dx : `~numpy.ndarray`, shape (n,)
        Displacement in pixels from the SSP to its match, sub-pixel.
    coefficient : `~numpy.ndarray`, shape (n,)
        Zero-mean normalised cross-correlation of the peak.
    overlap : `~numpy.ndarray`, shape (n,)
        Fraction of the SSP's pixels that fall on valid pixels.
    target_snr : `~numpy.ndarray`, shape (n,)
        Largest value of the target plane in 3 x 3 pixels around the matched
        position, in units of that plane's noise.
    pairs : `~numpy.ndarray` of int, shape (n_pairs, 2)
        The ordered pairs of epochs that were correlated.
    search_radius : tuple of int
        Largest displacement (y, x) that was searched.
    kappa : float
        Smallest coefficient that was kept.

    Examples
    --------
    >>> from astro_scc.correlation import Correlator
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> images = simulate_two_fluid(n_epochs=2, rng=1).cube.data
    >>> epochs = [Decomposer(scales=[2])(image) for image in images]
    >>> matches = Correlator()(epochs, [(0, 1), (1, 0)], (8, 25))
    >>> forward = matches.select(matches.target == 1)
    >>> len(forward) < len(matches), matches.pairs.tolist()
    (True, [[0, 1], [1, 0]])
    """

    ssp: np.ndarray
    target: np.ndarray
    dy: np.ndarray
    dx: np.ndarray
    coefficient: np.ndarray
    overlap: np.ndarray
    target_snr: np.ndarray
    pairs: np.ndarray
    search_radius: tuple[int, int]
    kappa: float

    def __len__(self) -> int:
        return len(self.ssp)

    def __repr__(self):
        return f"<Matches: {len(self)} peaks of {len(self.pairs)} pairs of epochs>"

    @classmethod
    def from_columns(
        cls, columns: Sequence[tuple[np.ndarray, ...]], pairs: ArrayLike,
        search_radius: tuple[int, int], kappa: float,
    ) -> Matches:  # fmt: skip
        """
        Join tuples of the columns ``ssp`` to ``target_snr``.

        Parameters
        ----------
        columns : sequence of tuple of `~numpy.ndarray`
        pairs : array_like of int, shape (n_pairs, 2)
        search_radius : tuple of int
        kappa : float

        Returns
        -------
        `~astro_scc.correlation.Matches`
        """
        pairs = np.asarray(pairs, dtype=int).reshape(-1, 2)
        return cls(*join_columns(columns), pairs, tuple(search_radius), float(kappa))

    def sorted(self) -> Matches:
        """
        Return the matches sorted by SSP, then by target.

        Returns
        -------
        `~astro_scc.correlation.Matches`
        """
        return self.select(np.lexsort((self.target, self.ssp)))

    def select(self, keep: ArrayLike) -> Matches:
        """
        Return the matches at some indices, or where ``keep`` is true.

        Parameters
        ----------
        keep : array_like of bool, shape (n,), or of int

        Returns
        -------
        `~astro_scc.correlation.Matches`
        """
        return replace(self, **{name: getattr(self, name)[keep] for name in COLUMNS})

    def of_ssps(self, chosen: ArrayLike) -> Matches:
        """
        Return the matches of SSPs for which ``chosen`` is true.

        Parameters
        ----------
        chosen : array_like of bool, shape (n_ssps,)

        Returns
        -------
        `~astro_scc.correlation.Matches`
        """
        return self.select(np.asarray(chosen, dtype=bool)[self.ssp])

    def same_as(self, other: Matches) -> bool:
        """
        Return whether all fields equal those of other matches.

        Parameters
        ----------
        other : `~astro_scc.correlation.Matches`

        Returns
        -------
        bool
        """
        return all(
            np.array_equal(getattr(self, f.name), getattr(other, f.name))
            for f in fields(self)
        )


def target_ssps(matches: Matches, ssps: SSPs) -> np.ndarray:
    """
    Find the SSP of the target epoch that is nearest to each match.

    Parameters
    ----------
    matches : `~astro_scc.correlation.Matches`
    ssps : `~astro_scc.decomposition.SSPs`
        The SSPs of all epochs.

    Returns
    -------
    `~numpy.ndarray` of int, shape (n_matches,)
        Index in ``ssps`` of the SSP of the same scale whose maximum is
        nearest to the maximum of the matched SSP plus the displacement, if
        they are within one scale; otherwise -1.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.correlation import Correlator, all_pairs
    >>> from astro_scc.correlation.matches import target_ssps
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> y, x = np.mgrid[:64, :96]
    >>> def image(x0):
    ...     return np.exp(-((x - x0) ** 2 + (y - 32) ** 2) / 30)
    >>> decompose = Decomposer(scales=[2])
    >>> epochs = [decompose(image(x0)) for x0 in (40, 46.5)]
    >>> matches = Correlator()(epochs, all_pairs(2), 12)
    >>> target_ssps(matches, SSPs.of_epochs(epochs)).tolist()
    [1, 0]
    """
    scales, level = np.unique(ssps.scale, return_inverse=True)
    size = np.array([scale_size(scale) for scale in scales])
    n_epochs = 1 + max(ssps.epoch.max(initial=0), matches.target.max(initial=0))
    # On a third axis, SSPs of other scales and epochs are farther than any match.
    apart, own = 2 * size.max(initial=0.0), matches.ssp
    there = ssps.y, ssps.x, apart * (level * n_epochs + ssps.epoch)
    y, x = ssps.y[own] + matches.dy, ssps.x[own] + matches.dx
    here = y, x, apart * (level[own] * n_epochs + matches.target)
    tree = cKDTree(np.stack(there, axis=1))
    distance, nearest = tree.query(np.stack(here, axis=1), distance_upper_bound=apart)
    return np.where(distance <= size[level[own]], nearest, -1)
