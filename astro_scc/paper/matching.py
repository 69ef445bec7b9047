# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matching: the patterns of each epoch in other epochs, and their displacements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import astropy.units as u
import numpy as np

from astro_scc import patterns
from astro_scc.epochs import EpochCube
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.images.positions import beam_fwhm, position_errors, ssp_offsets
from astro_scc.paper import stack
from astro_scc.paper.correlate import Correlator, Matches, all_pairs, target_ssps
from astro_scc.parallel import Workers, workers_of
from astro_scc.plan import flow_beam, motion_of, require_pairs, scale_numbers
from astro_scc.progress import progress
from astro_scc.settings import MeasurementSettings
from astro_scc.units import PM_UNIT

__all__ = ["MatchedEpochs", "SearchPlan"]


@dataclass(frozen=True, eq=False)
class SearchPlan:
    """
    What settings mean for matches of SSPs in a cube.

    Attributes
    ----------
    scales : tuple of float
        Numbers of the scales.
    pairs : ``DatePairs``
        Pairs of dates that are compared.
    max_speed : float
        The largest speed of a match, in mas/yr.
    reach : tuple of int
        The largest displacement to match between any two epochs, along (y, x) in
        pixels.

    Examples
    --------
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> plan = StackedCrossCorrelation().plan(simulate_two_fluid(rng=1).cube)
    >>> plan.scales, len(plan.pairs), plan.reach
    ((1, 2, 3, 4), 9, (50, 50))
    """

    scales: tuple[float, ...]
    pairs: stack.DatePairs
    max_speed: float
    reach: tuple[int, int]

    @classmethod
    def of(cls, cube: EpochCube, settings: MeasurementSettings) -> SearchPlan:
        """
        Return the plan of a measurement by matches.

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`
        settings : `~astro_scc.StackedCrossCorrelation`

        Returns
        -------
        `SearchPlan`

        Raises
        ------
        ValueError
            If no two epochs make a pair, a scale does not fit the pixels, or the
            largest speed leads far out of the image even in the shortest interval, or
            hardly moves anything even in the longest.
        """
        pairs = pairs_of_dates(cube, settings.baseline)
        scales = scale_numbers(cube, settings.scales)
        beam = flow_beam(cube)
        # Four beams in the longest interval, as in the simulated jets of the paper.
        speed = 4 * beam / pairs.interval.max()
        if settings.max_speed is not None:
            speed = settings.max_speed.to_value(PM_UNIT)
        moved, most = motion_of(cube, speed, pairs.interval)
        # Pixels may not be square: (x, y) sides.
        side, shape = np.hypot(*cube.pixel_matrix.value), np.array(cube.shape[1:])
        far = np.any(most / side > (shape.max() - 1) // 2)
        if far and settings.max_speed is not None:
            warn(
                f"{moved}, more than half the image: give a smaller one, or a "
                "baseline that leaves out long intervals",
                MeasurementWarning,
            )
        # Matches a little beyond the largest speed still reach into its map.
        reach = np.ceil((most + beam) / side).astype(int)[::-1]
        reach = tuple(np.minimum(reach, shape - 1).tolist())
        return cls(scales, pairs, speed, reach)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class MatchedEpochs(patterns.DecomposedEpochs):
    """
    Decomposed and correlated epochs: their SSPs and matches.

    Attributes
    ----------
    cube, decomposer, ssps, select, region
        See `~astro_scc.patterns.DecomposedEpochs`.
    matches : `~astro_scc.paper.Matches`

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=2, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> matched = scc.match(cube)
    >>> int(matched.select.sum()) == len(matched.ssps)
    True
    """

    matches: Matches

    def __repr__(self):
        return f"{super().__repr__()[:-1]}, {len(self.matches)} matches>"


def pairs_of_dates(cube, baseline):
    """
    Return the pairs of dates that are compared.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    baseline : `~astropy.units.Quantity`, shape (2,), or None
        Shortest and longest interval; if None, consecutive epochs are paired.

    Returns
    -------
    ``DatePairs``

    Raises
    ------
    ValueError
        If no two epochs make a pair.
    """
    years = cube.years.to_value(u.yr)
    if baseline is None:
        pairs = stack.consecutive_pairs(years)
    else:
        pairs = stack.baseline_pairs(years, *baseline.to_value(u.yr))
    require_pairs(cube, baseline, len(pairs))
    return pairs


def match(
    settings: Any, cube: EpochCube, *, region: Any = None, n_workers: Workers = 1,
    progress_bar: bool = False,
) -> MatchedEpochs:  # fmt: skip
    """
    Decompose the epochs and correlate each SSP with all other epochs.

    Expansions of shells are measured from these matches; other flows need none.

    Parameters
    ----------
    settings : `~astro_scc.StackedCrossCorrelation`
    cube : `~astro_scc.epochs.EpochCube`
    region : optional
        Anything that ``cube.region_mask`` takes.  Only SSPs whose centroid
        lies inside are correlated.
    n_workers : int, str or `dask.distributed.Client`, optional
        Number of processes, or a Dask scheduler, given by its address or a
        client.  The results do not depend on it.
    progress_bar : bool, optional
        Show the progress on standard error.

    Returns
    -------
    `~astro_scc.paper.matching.MatchedEpochs`

    Raises
    ------
    TypeError
        If ``cube`` is no cube.
    ValueError
        If the beams of the epochs differ, unless ``common_beam`` is False.

    Warns
    -----
    `~astro_scc.exceptions.MeasurementWarning`
        If no SSP lies in the region, structure fills the images, the alignment
        of the epochs scatters by 0.2 beams or more, or ``max_speed`` moves by more
        than half the image.
    """
    patterns.check_cube(cube, settings.common_beam)
    found = match_epochs(
        cube, settings, settings.plan(cube), region=region, n_workers=n_workers,
        progress_bar=progress_bar,
    )  # fmt: skip
    if empty := patterns.empty_region(found, region):
        warn(empty, MeasurementWarning)
    return found


def match_epochs(
    cube, settings, plan, *, pairs=None, region=None, n_workers=1, progress_bar=False
):
    """
    Decompose epochs and correlate their SSPs.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    settings : `~astro_scc.StackedCrossCorrelation`
    plan : `SearchPlan`
        What the settings mean for this cube.
    pairs : `~numpy.ndarray` of int, shape (n, 2), optional
        Ordered pairs of epochs that are correlated, by default all.
    region, n_workers, progress_bar
        See `~astro_scc.StackedCrossCorrelation.match`.

    Returns
    -------
    `MatchedEpochs`
    """
    correlator = Correlator(settings.kappa, settings.target, settings.min_overlap)
    pairs = all_pairs(len(cube)) if pairs is None else pairs
    with workers_of(n_workers) as workers:
        found, decompositions = patterns.decompose_epochs(
            cube, settings.decomposer(cube), region=region, n_workers=workers,
            progress_bar=progress_bar,
        )  # fmt: skip
        with progress(len(cube), "Correlating", show=progress_bar) as done:
            matches = correlator(
                decompositions, pairs, plan.reach, select=found.select,
                n_workers=workers, progress=done,
            )  # fmt: skip
    return MatchedEpochs(**vars(found), matches=matches)


def matched_displacements(matched, frame, *, min_error_beams):
    """
    Return matches as displacements along the axes of a frame, in mas.

    Parameters
    ----------
    matched : `MatchedEpochs`
    frame : frame of `astro_scc.kinematics`
        Gives the two axes at the position of each SSP.
    min_error_beams : float
        Smallest standard error of a displacement, in beams.

    Returns
    -------
    `~astro_scc.paper.Displacements`
        Of the selected SSPs.  SSPs at which the frame has no axes count as
        SSPs without a match.
    """
    cube, ssps, select = matched.cube, matched.ssps, matched.select
    east, north = ssp_offsets(ssps, cube)
    axes = np.asarray(frame.matrix(east, north))
    # A radial frame has no axes at its origin.
    known = select & np.isfinite(axes).all(axis=(-2, -1))
    matches = matched.matches.select(known[matched.matches.ssp])
    owner = matches.ssp
    pixels = np.stack([matches.dx, matches.dy], axis=-1).astype(float)
    position = np.stack([east[owner], north[owner]], axis=-1)
    d = frame.displacement(position, pixels @ cube.pixel_matrix.value.T)
    # The resolution in the epochs of SSPs and of their matches.
    here = beam_fwhm(cube, ssps.epoch, ssps.scale, axes)[owner]
    axes = axes if axes.ndim == 2 else axes[owner]
    there = beam_fwhm(cube, matches.target, ssps.scale[owner], axes)
    first = position_errors(ssps.snr[owner], here, min_error_beams)
    second = position_errors(matches.target_snr, there, min_error_beams)
    s = np.sqrt(first**2 + second**2)
    return stack.Displacements(
        *d.T, *s.T, weight=(matches.coefficient * matches.overlap).astype(float),
        reference=ssps.epoch[owner].astype(np.int32),
        target=matches.target.astype(np.int32), ssp=owner.astype(np.int32),
        target_ssp=target_ssps(matches, ssps).astype(np.int32),
        n_ssps=np.bincount(ssps.epoch[select], minlength=len(cube)),
    )  # fmt: skip
