# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Completeness: how often motion injected into epochs is found."""

import math
import warnings
from concurrent.futures import ThreadPoolExecutor
from itertools import count, islice, product
from typing import Any

import astropy.units as u
import numpy as np
from astropy.stats import binom_conf_interval
from astropy.table import QTable
from threadpoolctl import threadpool_limits

from astro_scc.columns import build_table
from astro_scc.epochs import EpochCube
from astro_scc.exceptions import MeasurementWarning
from astro_scc.kinematics import PositionAngleFrame
from astro_scc.measurement.stacking import seeded
from astro_scc.measurement.tables import versions
from astro_scc.progress import progress
from astro_scc.quantities import finite_quantities, named, one_quantity
from astro_scc.recovery import injection
from astro_scc.scc import StackedCrossCorrelation
from astro_scc.units import PM_UNIT

#: Largest difference of a component's velocity from that of the features, in beams
#: over the median interval.
TOLERANCE = 0.2
#: Confidence level of the intervals of shares.
CONFIDENCE = 0.95
#: Beginning of the warning of a region without SSPs.
NOTHING_THERE = ".*: no significant pattern has its centroid inside"


def completeness(
    cube: EpochCube, scc: StackedCrossCorrelation, *, speeds: u.Quantity,
    fluxes: u.Quantity | float, position_angle: u.Quantity | str | None = None,
    region: Any = None, n_features: float = 10, n_injections: int = 30,
    n_trials: int = 200, scatter: float = 0.1, tolerance: u.Quantity | None = None,
    fwhm: u.Quantity | None = None, rng: np.random.Generator | int | None = None,
    n_workers: int = 1, progress_bar: bool = False,
) -> QTable:  # fmt: skip
    """
    Inject moving features into epochs and count how often they are found.

    The epochs keep their images, dates, noise, masks and beams.  Features with
    the shape of the beam, on straight lines at one speed, are added to them
    (`draw_paths`, `inject`), and the sum is measured with the settings that
    are used for the epochs themselves.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    scc : `~astro_scc.StackedCrossCorrelation`
    speeds : `~astropy.units.Quantity`, scalar or shape (n,)
        Proper motions of the features.
    fluxes : `~astropy.units.Quantity` or float, scalar or shape (n,)
        Peaks of the features in the unit of the cube (equal to their flux
        densities, as they have the size of the beam), or, as plain numbers, in
        multiples of the median noise of the epochs.
    position_angle : `~astropy.units.Quantity` or "radial", optional
        Direction in which the features move, by default that of ``scc``.
    region : optional
        Anything that ``cube.region_mask`` takes.  SSPs inside are correlated,
        and features are injected there.  Without it, everything is correlated
        and features are injected where the epochs have SSPs, or anywhere if
        they have none.
    n_features : float, optional
        Mean number of features in the region at a time.
    n_injections : int, optional
        Number of measurements at each speed and flux.
    n_trials : int, optional
        Number of trials of each measurement.
    scatter : float, optional
        Standard deviation of a feature's position around its line at each
        epoch, on each axis, in beams.
    tolerance : `~astropy.units.Quantity`, optional
        Largest distance of a component's velocity from the true one, by
        default 0.2 beams over the median interval of the pairs of epochs.
    fwhm : `~astropy.units.Quantity`, optional
        Full width of the features, which replaces the beam in the lengths
        above.  Needed if the cube has no beams.
    rng : None, int or `~numpy.random.Generator`, optional
        Every measurement has a generator of its own, so the table is the same
        for any ``n_workers``.
    n_workers : int, optional
        Number of threads.
    progress_bar : bool, optional

    Returns
    -------
    `~astropy.table.QTable`
        One row per speed and flux: ``speed``, ``flux``, ``snr``,
        ``n_injected``, ``n_found``, ``fraction`` with the limits
        ``fraction_low`` and ``fraction_high`` of its 95% interval (Jeffreys);
        ``bias``, ``bias_err``, ``scatter`` and ``coverage`` of those found,
        masked if there are too few (``bias_err`` and ``scatter`` need two);
        and ``own``.  The meta holds the settings, the velocities of the epochs'
        own components, the seed and the versions.

    Raises
    ------
    ValueError
        If an argument is out of its range, if the velocity axes of ``scc``
        are neither radial nor of a single direction, if there are too few
        epochs or trials to find anything, if a speed is beyond the largest
        that ``scc`` searches, or if the cube has no beams and ``fwhm`` is not
        given.
    `~astropy.units.UnitConversionError`
        If a unit cannot be converted.

    Notes
    -----
    The features are found if there is a component that

    1. is "moving" with ``p_global <= scc.alpha``,
    2. lies within the tolerance of the features' velocity,
    3. is not one of the epochs' own components: the epochs are first measured
       without features, and each moving component found there claims the
       nearest one within the tolerance.  At a speed that the epochs already
       show (``own``), a second component is therefore needed, and
    4. has most of its SSPs within half a beam of injected features.

    The epochs are measured ``1 + len(speeds) len(fluxes) n_injections``
    times.  Features change the planes of every epoch and the noise that is
    measured on them, so every measurement decomposes and correlates everything
    again.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.recovery import completeness
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=5, shape=(64, 128), extent=(10, 120), axis=32,
    ...                        rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=20 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> table = completeness(cube, scc, speeds=12 * u.mas / u.yr, fluxes=2 * u.Jy,
    ...                      n_injections=3, n_trials=30, rng=1)
    >>> table["speed", "flux", "n_injected"].pprint()
     speed     flux   n_injected
    mas / yr Jy / beam
    -------- --------- ----------
        12.0       2.0          3
    """
    smallest = smallest_p(len(cube))
    if smallest > scc.alpha:
        raise ValueError(
            f"{len(cube)} epochs allow no p_global below {smallest:.2g} (2/N!), so "
            f"nothing that moves can be found at level {scc.alpha:g}: "
            f"{epochs_needed(scc.alpha)} epochs or more are needed"
        )
    check_trials(n_trials, scc.alpha)
    position_angle, largest_part = _direction(position_angle, scc.position_angle)
    plan = scc.plan(cube)
    if fwhm is not None:
        how = one_quantity, fwhm, "an angle", "1 mas"
        width = named("fwhm", *how).to_value(u.mas)
    elif cube.beams is not None:
        width = plan.fwhm
    else:
        raise ValueError(injection.NO_BEAMS)
    if tolerance is None:
        tolerance = TOLERANCE * width / np.median(plan.pairs.interval)
    else:
        how = one_quantity, tolerance, "a proper motion", "2 mas/yr"
        tolerance = named("tolerance", *how).to_value(PM_UNIT)
    region = None if region is None else cube.region_mask(region)
    limit = plan.speed_limit(cube).to_value(PM_UNIT)
    # The component along the axis must be searched.
    speeds = positive_quantities("speeds", speeds, "2 mas/yr").to_value(PM_UNIT)
    if np.any(speeds * largest_part > limit):
        raise ValueError(
            f"speed {speeds.max():.4g} mas/yr is beyond the largest that is searched, "
            f"{limit:.4g} mas/yr: give StackedCrossCorrelation a larger max_speed"
        )
    noise = float(np.median(cube.noise_rms().value))
    peaks = _peaks(fluxes, cube.unit, noise)
    for name, value in (("n_injections", n_injections), ("n_features", n_features)):
        if not 1 <= value < np.inf:
            raise ValueError(f"{name} must be at least 1, got {value}")
    if not 0 <= scatter < np.inf:
        raise ValueError(f"scatter must be zero or positive, got {scatter}")
    rng, seed = seeded(rng)
    own_rng, root = np.random.default_rng(rng).spawn(2)

    def measure(cube, rng):
        matched = scc.match(cube, region=region)
        return scc.stack(matched, n_trials=n_trials, rng=rng)

    with warnings.catch_warnings():
        # Features are injected even if the region has no SSP.
        warnings.filterwarnings("ignore", NOTHING_THERE, MeasurementWarning)
        bare = measure(cube, own_rng)
    area = injection.area_for_features(bare.matched, region)
    numbers = injection.moving_components(bare, scc.alpha)
    own = np.reshape([bare.velocities[k - 1].value for k in numbers], (-1, 2))
    axis = injection.velocity_along(bare.frame, position_angle)
    flow = {"position_angle": position_angle, "n_features": n_features}
    flow["scatter"] = scatter * width * u.mas
    rule = {"tolerance": tolerance, "level": scc.alpha, "fwhm": width}

    def recover(cell, rng):
        (speed, peak), (path_rng, trial_rng) = cell, rng.spawn(2)
        how = {"speed": speed * PM_UNIT, "rng": path_rng}
        paths = injection.draw_paths(cube, area, **flow, **how)
        fuller = injection.inject(cube, paths, peak * cube.unit, fwhm=fwhm)
        result, velocity = measure(fuller, trial_rng), speed * axis
        number = injection.recovered(result, own, velocity, paths=paths, **rule)
        if number is None:
            return None
        velocity, error = result.velocities[number - 1], np.inf
        if np.all(np.isfinite(velocity.covariance)):
            error = np.sqrt(axis @ velocity.covariance @ axis)
        return axis @ velocity.value - speed, error

    cells = list(product(speeds.tolist(), peaks))
    outcomes = run_all(recover, cells, n_injections, root, n_workers, progress_bar)
    rows = []
    for (speed, peak), found in zip(cells, outcomes, strict=True):
        snr = peak / noise if noise > 0 else None
        away = np.hypot(*(own - speed * axis).T)
        row = {"speed": speed, "snr": snr, **_counted(found)}
        rows.append(row | {"own": bool(np.any(away <= tolerance))})
    peaks = np.array([peak for _, peak in cells]) * cube.unit
    table = build_table("completeness", rows, flux=peaks)
    table.meta = {
        "settings": scc.to_dict(),
        "position_angle": position_angle,
        "tolerance": tolerance * PM_UNIT,
        "alpha": scc.alpha,
        "n_features": n_features,
        "n_trials": n_trials,
        "scatter": scatter,
        "own_velocities": own * PM_UNIT,
        "seed": seed,
        "versions": versions(),
    }
    return table


def _direction(position_angle, axis):
    """Return the direction of motion, and the fraction of a speed along the axis."""
    axis = axis.pa if isinstance(axis, PositionAngleFrame) else axis
    radial = isinstance(axis, str) and axis == "radial"
    if not (radial or axis is None or isinstance(axis, u.Quantity)):
        raise ValueError(
            "features move on straight lines, so the measurement needs velocity axes "
            f"of one direction, or 'radial', not {axis}: give StackedCrossCorrelation "
            "an angle as position_angle"
        )
    position_angle = axis if position_angle is None else position_angle
    if position_angle is None:
        raise ValueError(
            "position_angle is missing: give the direction in which features move, an "
            "angle or 'radial'"
        )
    if radial != (isinstance(position_angle, str) and position_angle == "radial"):
        raise ValueError(
            f"position_angle {position_angle} does not go with that of the "
            f"measurement, {axis}: either both are 'radial', or none"
        )
    if radial:
        return position_angle, 1.0
    how = one_quantity, position_angle, "an angle", "65 deg", False
    angle = named("position_angle", *how).to(u.deg)
    return angle, 1.0 if axis is None else float(abs(np.cos(angle - axis)))


def _peaks(fluxes, unit, noise):
    """Return peaks of features as numbers in the unit of a cube."""
    if isinstance(fluxes, u.Quantity):
        # The flux density of a feature of the size of the beam equals its peak.
        per_beam = fluxes / u.beam
        fluxes = per_beam if per_beam.unit.is_equivalent(unit) else fluxes
        how = unit, f"must be one or more numbers from 0 in a unit like {unit}"
        values = named("fluxes", finite_quantities, fluxes, *how).to_value(unit)
    elif noise == 0:
        raise ValueError(
            "fluxes in multiples of the noise need epochs with noise, theirs is 0: "
            "give fluxes in the unit of the cube"
        )
    else:
        values = np.asarray(fluxes, dtype=float) * noise
    values = np.atleast_1d(values)
    good = np.all((values >= 0) & np.isfinite(values))
    if values.ndim != 1 or values.size == 0 or not good:
        raise ValueError(f"fluxes must be one or more numbers from 0, got {fluxes}")
    return values.tolist()


def _counted(outcomes):
    """Return how many injections were found, and how well (None if unknown)."""
    found = [outcome for outcome in outcomes if outcome is not None]
    n = len(found)
    fraction, low, high = share(n, len(outcomes))
    off, error = np.array(found).reshape(-1, 2).T
    spread = float(off.std(ddof=1)) if n > 1 else None
    return {
        "n_injected": len(outcomes),
        "n_found": n,
        "fraction": fraction,
        "fraction_low": low,
        "fraction_high": high,
        "bias": float(off.mean()) if n else None,
        "bias_err": spread / np.sqrt(n) if n > 1 else None,
        "scatter": spread,
        "coverage": float(np.mean(np.abs(off) <= error)) if n else None,
    }


def positive_quantities(name, value, example):
    """Return one or more positive quantities in the unit of an example."""
    wanted = f"must be positive and finite, with a unit, such as {example!r}"

    def check(value):
        found = finite_quantities(value, u.Quantity(example).unit, wanted)
        if not np.all(found.value > 0):
            raise ValueError(wanted)
        return np.atleast_1d(found)

    return named(name, check, value)


def check_trials(n_trials, level):
    """Refuse too few trials for a p-value as small as a level."""
    if not n_trials >= 2:
        raise ValueError(f"n_trials must be at least 2, got {n_trials}")
    if 1 / (n_trials + 1) > level:
        raise ValueError(
            f"{n_trials} trials allow no p_global below {1 / (n_trials + 1):.2g}, so "
            f"nothing can be found at level {level:g}: give more n_trials"
        )


def smallest_p(n_epochs):
    """Return the smallest ``p_global`` of motion, 2 / N! (:ref:`significance`)."""
    # The factorial of 171 overflows a float.
    return min(1.0, 2 / math.factorial(min(n_epochs, 170)))


def epochs_needed(level):
    """Return the fewest epochs with which a moving component can reach a level."""
    return next(n for n in count(2) if smallest_p(n) <= level)


def share(number, of):
    """Return a share with the limits of its 95% interval (Jeffreys)."""
    low, high = binom_conf_interval(number, of, CONFIDENCE, interval="jeffreys")
    return number / of, float(low), float(high)


def run_all(function, cells, number, rng, n_workers=1, progress_bar=False):
    """
    Call a function with each cell and each of its generators; return lists by cell.

    Each cell has ``number`` generators of its own, so the outcome is the same for any
    number of threads.  Warnings about what the data support are not repeated.
    """
    if n_workers < 1:
        raise ValueError(f"n_workers must be at least 1, got {n_workers}")
    jobs = [
        (cell, own)
        for cell, root in zip(cells, rng.spawn(len(cells)), strict=True)
        for own in root.spawn(number)
    ]
    with (
        # Each measurement limits the threads of matrix products by itself; limits
        # that overlap in time would be restored in the wrong order.
        threadpool_limits(1),
        warnings.catch_warnings(),
        progress(len(jobs), "Recovering", show=progress_bar) as done,
        ThreadPoolExecutor(n_workers) as pool,
    ):
        warnings.simplefilter("ignore", MeasurementWarning)

        def work(job):
            result = function(*job)
            done(1)
            return result

        found = map(work, jobs) if n_workers == 1 else pool.map(work, jobs)
        return [list(islice(found, number)) for _ in cells]
