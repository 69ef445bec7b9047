# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Velocity components in bins of distance."""

from dataclasses import dataclass
from functools import cached_property

import astropy.units as u
import numpy as np
from astropy.table import Column, QTable, vstack

from astro_scc.kinematics import table_in_c
from astro_scc.measurement import component_table, false_discovery_rate, select_ssps
from astro_scc.settings import require

__all__ = ["Profile", "bins_of", "measure_profile"]


def bins_of(edges, *, window=None):
    """
    Limits of bins of distance.

    Parameters
    ----------
    edges : `~astropy.units.Quantity`, shape (n + 1,)
        Increasing angles.
    window : `~astropy.units.Quantity`, optional
        Width of windows that slide from one edge to the next instead of
        bins between them: each edge is the middle of one, and neighbours
        share features where they overlap.

    Returns
    -------
    `~astropy.units.Quantity`, shape (n, 2)

    Raises
    ------
    ValueError
        If the edges do not increase from 0 or more, or the window has no
        width.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.profiles import bins_of
    >>> bins_of([0.5, 1.5, 2.5] * u.mas)
    <Quantity [[0.5, 1.5],
               [1.5, 2.5]] mas>
    >>> bins_of([1, 2] * u.mas, window=1.5 * u.mas)
    <Quantity [[0.25, 1.75],
               [1.25, 2.75]] mas>
    """
    edges = require("bins", edges).to(u.mas)
    if window is None:
        if len(edges) < 2:
            raise ValueError(f"bins need 2 distances or more, got {edges}")
        return np.stack([edges[:-1], edges[1:]], axis=1)
    window = require("window", window).to(u.mas)
    low = np.maximum(edges - window / 2, 0 * u.mas)
    return np.stack([low, edges + window / 2], axis=1)


@dataclass(frozen=True, eq=False, repr=False)
class Profile:
    """
    What was measured in each bin of distance.

    Attributes
    ----------
    bins : `~astropy.units.Quantity`, shape (n, 2)
        Limits of the bins.
    results : tuple of `~astro_scc.measurement.SCCResult` or None
        One a bin; None where a bin has no SSP.
    along : {"radius", "ridge"}
        Whether distances are from the core or along its ridge line.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.profiles import measure_profile
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> matched = scc.match(cube)
    >>> profile = measure_profile(
    ...     scc, matched, [2, 10, 18] * u.mas, n_trials=20, rng=1)
    >>> len(profile), profile.components.colnames[:3]
    (2, ['r_min', 'r_max', 'r_mid'])
    """

    bins: u.Quantity
    results: tuple
    along: str = "radius"

    def __len__(self):
        return len(self.bins)

    def __repr__(self):
        return (
            f"<Profile: {len(self)} bins from {self.bins.min():g} to "
            f"{self.bins.max():g}, {len(self.components)} components>"
        )

    @cached_property
    def components(self):
        """
        The components of all bins, a `~astropy.table.QTable`.

        Columns ``r_min``, ``r_max``, ``r_mid``, those of
        `SCCResult.components <astro_scc.measurement.SCCResult.components>`
        with ``p_fdr``, which is adjusted for all bins, and ``main``: one
        component of each bin, the significant and moving one with the
        largest coefficient or, where there is none, the one with the largest
        coefficient of those that are not significant and are further from
        rest than by their error.
        """
        return self._joined([r and r.components for r in self.results])

    def components_in_c(self, *, redshift=None, cosmology=None, distance=None):
        """
        The components with apparent speeds in units of c.

        Parameters
        ----------
        redshift, cosmology, distance : optional
            As for `SCCResult.components_in_c
            <astro_scc.measurement.SCCResult.components_in_c>`.

        Returns
        -------
        `~astropy.table.QTable`
        """
        return table_in_c(
            self.components, redshift=redshift, cosmology=cosmology, distance=distance
        )

    @property
    def main(self):
        """The rows of `components` that are the ``main`` one of their bin."""
        return self.components[self.components["main"]]

    def _joined(self, tables):
        empty = component_table([])
        tables = [empty if table is None else table for table in tables]
        meta = next((t.meta for t in tables if t.meta), {})
        tables = false_discovery_rate(tables)
        parts = [
            self._placed(table, limits)
            for table, limits in zip(tables, self.bins, strict=True)
        ]
        filled = [part for part in parts if len(part)] or parts[:1]
        joined = vstack(filled, metadata_conflicts="silent")
        joined.meta.clear()
        joined.meta.update(meta)
        joined.meta.update(parts[0].meta.get("false_discovery") and {
            "false_discovery": parts[0].meta["false_discovery"]} or {})  # fmt: skip
        joined.meta["bins"] = [list(map(float, b)) for b in self.bins.to_value(u.mas)]
        joined.meta["along"] = self.along
        return joined

    @staticmethod
    def _placed(table, limits):
        n = len(table)
        low, high = limits
        columns = {
            "r_min": (low, "inner limit of the bin"),
            "r_max": (high, "outer limit of the bin"),
            "r_mid": ((low + high) / 2, "middle of the bin"),
        }
        placed = QTable(meta=table.meta)
        for name, (value, text) in columns.items():
            placed[name] = np.full(n, value.to_value(u.mas)) * u.mas
            placed[name].info.description = text
        for name in table.colnames:
            placed[name] = table[name]
        placed["main"] = Column(_main(table), description="main component of its bin")
        return placed


def _main(table):
    """Which row stands for the bin."""
    kind = np.asarray(table["kind"], dtype=str)
    chosen = np.zeros(len(table), dtype=bool)
    for wanted in ("moving", "not significant"):
        rows = np.flatnonzero((kind == wanted) & (table["pm"] > table["pm_err"]))
        if len(rows):
            best = np.asarray(table["coefficient"], dtype=float)[rows].argmax()
            chosen[rows[best]] = True
            break
    return chosen


def measure_profile(
    scc,
    matched,
    edges,
    *,
    window=None,
    ridge=None,
    n_trials=1000,
    rng=None,
    progress_bar=False,
):
    """
    Measure the velocity components in bins of distance.

    Matches are made once, of all epochs; each bin is a stack of those of
    its SSPs.

    Parameters
    ----------
    scc : `~astro_scc.StackedCrossCorrelation`
        The settings.
    matched : `~astro_scc.measurement.MatchedEpochs` or cube
        ``scc.match(cube)``; of a cube the matches are made.
    edges : `~astropy.units.Quantity`, shape (n + 1,)
        Limits of the bins, see `bins_of`.
    window : `~astropy.units.Quantity`, optional
        Width of sliding windows.
    ridge : `~astro_scc.kinematics.RidgeLine`, optional
        Distances are along this line instead of from the reference pixel.
    n_trials : int, optional
    rng : None, int or `~numpy.random.Generator`, optional
        The trials of each bin are independent.
    progress_bar : bool, optional

    Returns
    -------
    `Profile`

    Raises
    ------
    ValueError
        If the bins make no sense, or none of them has an SSP.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.profiles import measure_profile
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> scc = StackedCrossCorrelation(scales=[1, 2], max_speed=36 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> profile = measure_profile(scc, cube, [0, 10, 20] * u.mas, n_trials=50, rng=1)
    >>> profile.components.colnames[:4]
    ['r_min', 'r_max', 'r_mid', 'component']
    """
    bins = bins_of(edges, window=window)
    if not hasattr(matched, "matches"):
        matched = scc.match(matched, progress_bar=progress_bar)
    seed = int(rng) if isinstance(rng, int | np.integer) else None
    results = []
    for (low, high), own in zip(
        bins, np.random.default_rng(rng).spawn(len(bins)), strict=True
    ):
        part = select_ssps(matched, r_min=low, r_max=high, ridge=ridge)
        result = None
        if part.select.any():
            result = scc.stack(
                part, n_trials=n_trials, rng=own, progress_bar=progress_bar
            )
            result.meta["seed"] = seed
        results.append(result)
    if not any(results):
        raise ValueError(
            f"no SSP lies in the bins, {bins.min():g} to {bins.max():g} from the core: "
            "choose others, or fainter thresholds"
        )
    return Profile(bins, tuple(results), "radius" if ridge is None else "ridge")
