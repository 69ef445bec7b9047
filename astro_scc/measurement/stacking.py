# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""From matched epochs to velocity components."""

import astropy.units as u
import numpy as np

from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.matching.plan import SearchPlan, flow_direction, map_grid
from astro_scc.measurement import sensitivity
from astro_scc.measurement.result import SCCResult
from astro_scc.measurement.search import search_matches
from astro_scc.progress import progress
from astro_scc.quantities import random_generator
from astro_scc.settings import require
from astro_scc.stacking.pair_maps import PairMaps
from astro_scc.stacking.stack import (
    jitter_positions,
    number_of_permutations,
    permute_stacks,
    stack,
    velocity_peak_near,
)
from astro_scc.stacking.velocities import baseline_pairs
from astro_scc.streams.diagram import DEFAULT
from astro_scc.writing import versions

#: Shift of the paper's correction for small displacements, in beams.
SMALL_SHIFT = 0.2
#: Extent of the map, in units of the largest speed found.
MAP_SPEEDS = 3.0
#: Most permutations for the paper's z-score and trials for its error: they are standard
#: deviations, known to 5% from 200.
PAPER_TRIALS = 200
#: Fewest pairs of dates of a map.
FEWEST_PAIRS = 3


def stack_matches(
    matched, settings, *, n_trials=1000, rng=None, n_workers=1, progress_bar=False
):
    """
    Search the matches of epochs for streams, and stack them.

    Without a baseline in the settings, if the first stream moves, the paper's stack is
    of the pairs of dates in which it moves 0.2 to 1 beam.

    Parameters
    ----------
    matched : `~astro_scc.matching.MatchedEpochs`
    settings : `~astro_scc.StackedCrossCorrelation`
    n_trials : int
        The paper's z-score and error take at most 200.
    rng : None, int or `~numpy.random.Generator`
    n_workers : int, str or `dask.distributed.Client`
    progress_bar : bool

    Returns
    -------
    `~astro_scc.measurement.SCCResult`

    Raises
    ------
    ValueError
        If ``n_trials`` is below 2.

    Warns
    -----
    `~astro_scc.exceptions.MeasurementWarning`
        If there are so few trials or epochs that no ``p_global`` can be as
        small as ``alpha``.
    """
    n_trials = require("n_trials", n_trials)
    rng, seed = seeded(rng)
    paper_rng, search_rng, error_rng, choice_rng = random_generator(rng).spawn(4)
    cube, alpha = matched.cube, settings.alpha
    plan = SearchPlan.of(cube, settings)
    pairs, max_speed, fwhm = plan.pairs, plan.max_speed, plan.fwhm
    with progress(None, "Searching", show=progress_bar):
        of = matched, settings, plan
        found = search_matches(*of, n_trials=n_trials, rng=search_rng)
        choices = sensitivity.sensitivity_rows(found, *of, choice_rng, n_workers)
    search, velocities, samples = found.search, found.velocities, found.samples
    frame = found.frame
    if choices:
        first = sensitivity.with_choices(velocities[0], choices)
        velocities = (first, *velocities[1:])
    angle = flow_direction(matched, frame)
    _warn_of_limits(search.permutations.smallest_p, len(cube), n_trials, alpha)
    if settings.baseline is None and any(
        s.kind == "moving" for s in search.streams[:1]
    ):
        pairs = _pairs_of_speed(cube, pairs, fwhm / np.hypot(*velocities[0].value))
    fastest = max((np.hypot(*v.value) for v in velocities), default=0.0)
    limit = plan.radius * fwhm / np.median(pairs.interval)
    if max_speed is not None:
        limit = max_speed
    elif fastest > 0:
        limit = min(limit, MAP_SPEEDS * fastest)
    # The stack of the paper, its z-score and its peaks.
    grid = map_grid(samples, pairs, max(limit, 1.2 * fastest))
    maps = PairMaps.of(samples, grid.v_max, pairs.interval.max())
    few, small = min(n_trials, PAPER_TRIALS), settings.small_displacement_correction
    shift = (SMALL_SHIFT * fwhm,) * 2 if small else None
    with progress(few, "Permuting", show=progress_bar) as done:
        how = {"rng": paper_rng, "shift": shift, "progress": done}
        permuted = permute_stacks(maps, pairs, grid, few, **how)
    scc = stack(samples, pairs, grid)
    box = (fwhm / np.average(pairs.interval, weights=pairs.weight),) * 2
    peaks = tuple(velocity_peak_near(scc, grid, box, *v.value) for v in velocities)
    jitters = tuple(
        jitter_positions(samples, pairs, peak, box, few, rng=own)
        for peak, own in zip(peaks, error_rng.spawn(len(peaks)), strict=True)
    )
    return SCCResult(
        matched=matched,
        choices=choices,
        frame=frame,
        position_angle=angle,
        pairs=pairs,
        displacements=samples,
        grid=grid,
        coefficient=scc,
        z_score=permuted.z_score(scc),
        permuted=permuted,
        search=search,
        velocities=velocities,
        maxima=peaks,
        jitters=jitters,
        meta={
            "settings": settings.to_dict(),
            "n_trials": int(n_trials),
            "seed": seed,
            "versions": versions(),
            "jet_position_angle": angle,
            "misalignment_beams": cube.misalignment,
        },
    )


def seeded(rng):
    """Return ``rng``, or a random seed for None, and the seed if it is an integer."""
    if rng is None:
        rng = int(np.random.SeedSequence().entropy % 2**63)
    return rng, int(rng) if isinstance(rng, (int, np.integer)) else None


def _pairs_of_speed(cube, pairs, years):
    """Return the pairs of dates that suit a motion of one beam in ``years``."""
    limits = DEFAULT.nearest * years, DEFAULT.farthest * years
    found = baseline_pairs(cube.years.to_value(u.yr), *limits)
    return found if len(found) >= FEWEST_PAIRS else pairs


def _warn_of_limits(smallest, n_epochs, n_trials, level):
    """Warn if no p-value can be as small as the level."""
    if smallest <= level:
        return
    if 1 / number_of_permutations(n_epochs) <= level:
        what = (
            f"{n_trials} trials allow no p_global below {1 / (n_trials + 1):.2g}, "
            f"so no stream can reach level {level:g}: give n_trials of "
            f"{int(np.ceil(1 / level))} or more"
        )
    else:
        what = (
            f"{n_epochs} epochs allow no p_global below {smallest:.2g} (2/N!), so "
            f"nothing that moves can reach level {level:g}: measure more epochs"
        )
    warn(what, MeasurementWarning)
