# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matches: the correlation peaks of SSPs between pairs of epochs, in pixels."""

from dataclasses import dataclass, fields, replace

import numpy as np

__all__ = ["Matches"]

COLUMNS = {
    "ssp": np.int32,
    "target": np.int16,
    "dy": np.float32,
    "dx": np.float32,
    "coefficient": np.float32,
    "overlap": np.float32,
    "target_snr": np.float32,
}


@dataclass(frozen=True, eq=False, repr=False)
class Matches:
    """
    Correlation peaks of SSPs with the images of other epochs.

    Displacements are in pixels and know no dates: whatever dates the
    epochs have, or are given in a trial, the matches stay the same.

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
        Share of the SSP's pixels that fall on existing pixels.
    target_snr : `~numpy.ndarray`, shape (n,)
        Largest value of the target plane beside the matched maximum, in
        units of that plane's noise.
    pairs : `~numpy.ndarray` of int, shape (n_pairs, 2)
        The ordered pairs of epochs that were correlated.
    reach : tuple of int
        Largest displacement (y, x) that was tried.
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
    reach: tuple
    kappa: float

    def __len__(self):
        return len(self.ssp)

    def __repr__(self):
        return f"<Matches: {len(self)} peaks of {len(self.pairs)} pairs of epochs>"

    @classmethod
    def from_columns(cls, columns, pairs, reach, kappa):
        """
        Join lists of column arrays.

        Parameters
        ----------
        columns : sequence of tuple of `~numpy.ndarray`
            Each the columns ``ssp`` to ``target_snr`` in order.
        pairs : array_like of int, shape (n_pairs, 2)
        reach : tuple of int
        kappa : float

        Returns
        -------
        `Matches`
        """
        joined = [
            np.concatenate(
                [np.empty(0, dtype), *(part[k] for part in columns)],
                dtype=dtype,
                casting="unsafe",
            )
            for k, dtype in enumerate(COLUMNS.values())
        ]
        pairs = np.asarray(pairs, dtype=int).reshape(-1, 2)
        return cls(*joined, pairs=pairs, reach=tuple(reach), kappa=float(kappa))

    def sorted(self):
        """
        The matches by SSP, and those of one by target.

        Returns
        -------
        `Matches`
        """
        key = self.ssp.astype(np.int64) << 16 | self.target.astype(np.int64)
        if np.all(key[1:] >= key[:-1]):
            return self
        return self.select(np.argsort(key, kind="stable"))

    def select(self, keep):
        """
        The matches of a selection.

        Parameters
        ----------
        keep : array_like of bool or int, shape (n,) or indices

        Returns
        -------
        `Matches`
        """
        chosen = {name: getattr(self, name)[keep] for name in COLUMNS}
        return replace(self, **chosen)

    def of_ssps(self, chosen):
        """
        The matches of chosen SSPs.

        Parameters
        ----------
        chosen : array_like of bool, shape (n_ssps,)

        Returns
        -------
        `Matches`
        """
        return self.select(np.asarray(chosen, dtype=bool)[self.ssp])

    def to_table(self):
        """
        The matches as a table, in pixels.

        Returns
        -------
        `~astropy.table.Table`
            One row a peak; the pairs, reach and kappa are in its meta.
        """
        from astropy.table import Table

        table = Table({name: getattr(self, name) for name in COLUMNS})
        table.meta["pairs"] = self.pairs.tolist()
        table.meta["reach"] = list(self.reach)
        table.meta["kappa"] = self.kappa
        return table

    @classmethod
    def from_table(cls, table):
        """
        Read what `to_table` wrote.

        Parameters
        ----------
        table : `~astropy.table.Table`

        Returns
        -------
        `Matches`

        Raises
        ------
        ValueError
            If a column or an entry of the meta is missing.
        """
        missing = [name for name in COLUMNS if name not in table.colnames]
        missing += [k for k in ("pairs", "reach", "kappa") if k not in table.meta]
        if missing:
            raise ValueError(f"not a table of matches: {', '.join(missing)} missing")
        columns = tuple(np.asarray(table[name]) for name in COLUMNS)
        meta = table.meta
        return cls.from_columns([columns], meta["pairs"], meta["reach"], meta["kappa"])

    def same_as(self, other):
        """
        Whether all fields equal those of other matches.

        Parameters
        ----------
        other : `Matches`

        Returns
        -------
        bool
        """
        return all(
            np.array_equal(getattr(self, f.name), getattr(other, f.name))
            for f in fields(self)
        )
