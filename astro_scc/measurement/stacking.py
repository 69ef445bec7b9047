# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""From matched epochs to velocity components."""

import math
import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np

from astro_scc.config.settings import require
from astro_scc.exceptions import MeasurementWarning
from astro_scc.kinematics import (
    PositionAngleFrame,
    RadialFrame,
    SkyFrame,
    find_ridge_line,
    fit_position_angle,
)
from astro_scc.measurement.errors import angular_displacements
from astro_scc.measurement.plan import flow_direction, map_grid, mean_fwhm
from astro_scc.measurement.result import SCCResult
from astro_scc.measurement.tables import versions
from astro_scc.measurement.velocity_error import (
    VelocityError,
    alignment_errors,
    sampling_error,
)
from astro_scc.progress import progress
from astro_scc.stacking import (
    NULL_HYPOTHESES,
    PairMaps,
    alignment_scatter,
    component_near,
    epoch_scatter,
    feature_scatter,
    find_velocities,
    jitter_positions,
    sampling_scatter,
    shuffle_epochs,
    stack,
)

__all__ = ["stack_matches", "velocity_frame"]

#: No level asks for more epochs than these.
MANY = 100
#: Shift of the paper's correction for small displacements, in beams.
SMALL_SHIFT = 0.2


def stack_matches(
    matched,
    pairs,
    *,
    speed,
    fwhm,
    position_angle=None,
    kernel=0.2,
    level=0.05,
    nulls=("scramble", "shuffle"),
    alignment_error=None,
    small_displacement_correction=False,
    n_trials=1000,
    rng=None,
    progress_bar=False,
    settings=None,
):
    """
    Stack the matches of epochs and measure the velocity components.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
    pairs : `~astro_scc.stacking.DatePairs`
    speed : float
        Largest velocity along either axis, in mas/yr.
    fwhm : float
        Resolution in mas.
    position_angle : `~astropy.units.Quantity`, str, frame or None
        Of the velocity axes, see `~astro_scc.StackedCrossCorrelation`.
    kernel : float
        Smallest standard error of a displacement, in beams.
    level : float
        Largest ``p_global`` of a component.
    nulls : sequence of str
        Names of `astro_scc.stacking.NULL_HYPOTHESES`.
    alignment_error : `~astropy.units.Quantity`, optional
        See `alignment_errors`.
    small_displacement_correction : bool
        Shift the shuffled images of the z-score by a fifth of the beam.
    n_trials : int
    rng : None, int or `~numpy.random.Generator`
    progress_bar : bool
    settings : dict, optional
        Kept in the meta of the result.

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
        If the trials or the epochs are so few that no ``p_global`` can be as
        small as ``level``, or the matches so few that a velocity has no error.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.measurement import stack_matches
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> matched = scc.match(cube)
    >>> result = stack_matches(matched, scc.date_pairs(cube), speed=36.0, fwhm=1.0,
    ...                        n_trials=20, rng=1)
    >>> result.components["pm"].unit
    Unit("mas / yr")
    """
    n_trials = require("n_trials", n_trials)
    _warn_of_limits(pairs.n_dates, n_trials, level, nulls)
    if rng is None:
        rng = int(np.random.SeedSequence().entropy % 2**63)
    seed = int(rng) if isinstance(rng, (int, np.integer)) else None
    paper_rng, search_rng, error_rng = np.random.default_rng(rng).spawn(3)
    cube = matched.cube
    frame, angle = velocity_frame(matched, position_angle)
    displacements = angular_displacements(
        matched.matches, matched.ssps, cube, frame, kernel, select=matched.select
    )
    grid = map_grid(displacements, pairs, speed)
    scc = stack(displacements, pairs, grid)
    maps = PairMaps.of(displacements, grid.v_max, pairs.interval.max())
    shift = (SMALL_SHIFT * fwhm,) * 2 if small_displacement_correction else None
    with progress(n_trials, "Shuffling", show=progress_bar) as done:
        shuffled = shuffle_epochs(
            maps, pairs, grid, scc, n_trials, rng=paper_rng, shift=shift, progress=done
        )
    with progress(None, "Searching", show=progress_bar) as done:
        findings = find_velocities(
            displacements,
            pairs,
            cube.years.to_value(u.yr),
            grid.v_max,
            n_trials=n_trials,
            level=level,
            rng=search_rng,
            nulls=[NULL_HYPOTHESES[name] for name in nulls],
            progress=done,
        )
    box = (fwhm / np.average(pairs.interval, weights=pairs.weight),) * 2
    misaligned = alignment_errors(cube, alignment_error)
    sampled = sampling_error(cube, mean_fwhm(cube, min(matched.scales)))
    maxima, jitters, errors = [], [], []
    for finding, own in zip(findings, error_rng.spawn(len(findings)), strict=True):
        # What earlier components explain would pull at the maximum.
        rest = finding.displacements
        peak = component_near(
            stack(rest, pairs, grid), grid, box, finding.v1, finding.v2
        )
        jitters.append(jitter_positions(rest, pairs, peak, box, n_trials, rng=own))
        where = pairs, peak, grid
        errors.append(
            VelocityError(
                features=feature_scatter(rest, pairs, finding.group, peak, grid),
                alignment=alignment_scatter(rest, *where, misaligned),
                epochs=epoch_scatter(rest, *where),
                sampling=sampling_scatter(rest, *where, sampled),
            )
        )
        maxima.append(replace(peak, coefficient=float(scc[peak.row, peak.column])))
    _warn_of_unknown_errors(errors)
    return SCCResult(
        matched=matched,
        frame=frame,
        position_angle=angle,
        pairs=pairs,
        displacements=displacements,
        grid=grid,
        coefficient=scc,
        z_score=shuffled.z_score(scc),
        shuffled=shuffled,
        findings=tuple(findings),
        maxima=tuple(maxima),
        error_parts=tuple(errors),
        jitters=tuple(jitters),
        meta={
            "settings": {**(settings or {}), "level": level},
            "n_trials": int(n_trials),
            "seed": seed,
            "versions": versions(),
            "jet_position_angle": angle,
            "misalignment_beams": cube.misalignment,
        },
    )


def _warn_of_limits(n_epochs, n_trials, level, nulls):
    """Tell when no probability can be as small as the level."""
    orders = {n: getattr(NULL_HYPOTHESES[n], "orders", None) for n in nulls}
    least = {n: 1 / max(o.number(n_epochs), 1) for n, o in orders.items() if o}
    name = max(least, key=least.get, default=None)
    if name is not None and least[name] > level:
        number = orders[name].number
        enough = (str(n) for n in range(n_epochs, MANY) if number(n) * level >= 1)
        why = "2/N!" if name == "shuffle" else f"the orders of {name!r} are so few"
        what = (
            f"{n_epochs} epochs allow no p_global below {least[name]:.2g} ({why}), "
            f"so nothing that moves can reach level {level:g}: measure "
            f"{next(enough, MANY)} epochs or more"
        )
    elif 1 / (n_trials + 1) > level:
        enough = math.ceil(1 / level) - 1
        enough += 1 / (enough + 1) > level
        what = (
            f"{n_trials} trials allow no p_global below {1 / (n_trials + 1):.2g}, "
            f"so no component can reach level {level:g}: give n_trials of {enough} "
            "or more"
        )
    else:
        return
    warnings.warn(what, MeasurementWarning, stacklevel=5)


def _warn_of_unknown_errors(errors):
    """Tell which components have no error, and what gives them one."""
    without = [
        str(number)
        for number, parts in enumerate(errors, start=1)
        if not np.all(np.isfinite(parts.total))
    ]
    if without:
        warnings.warn(
            f"component {', '.join(without)}: too few matches for an error of the "
            "velocity, pm_err is NaN; measure more scales, a larger region, more "
            "epochs or a wider baseline",
            MeasurementWarning,
            stacklevel=5,
        )


def velocity_frame(matched, position_angle):
    """
    The velocity axes of a measurement.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
    position_angle : `~astropy.units.Quantity`, str, frame or None
        See `~astro_scc.StackedCrossCorrelation`.

    Returns
    -------
    frame : frame of `astro_scc.kinematics`
    angle : `~astropy.units.Quantity`
        Direction of the jet.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.measurement import velocity_frame
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=2, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> matched = scc.match(cube)
    >>> frame, angle = velocity_frame(matched, 270 * u.deg)
    >>> frame.axis_names, angle
    (('parallel', 'transverse'), <Quantity 270. deg>)
    """
    if isinstance(position_angle, str) and position_angle == "fit":
        position_angle, _ = fit_position_angle(matched.cube)
    if isinstance(position_angle, u.Quantity):
        return PositionAngleFrame(position_angle), position_angle
    if isinstance(position_angle, PositionAngleFrame):
        return position_angle, position_angle.pa
    angle = flow_direction(matched)
    if position_angle is None:
        return SkyFrame(), angle
    if not isinstance(position_angle, str):
        return position_angle, angle
    if position_angle == "ridge":
        return find_ridge_line(matched.cube), angle
    return RadialFrame(), angle
