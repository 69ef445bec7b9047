# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Completeness: how often motion that is injected into epochs is found."""

import math
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import astropy.units as u
import numpy as np
from astropy.stats import binom_conf_interval
from astropy.table import QTable
from astropy.utils.masked import Masked

from astro_scc.exceptions import MeasurementWarning
from astro_scc.kinematics import PositionAngleFrame
from astro_scc.measurement import versions
from astro_scc.measurement.plan import mean_fwhm
from astro_scc.measurement.tables import PM_UNIT
from astro_scc.progress import progress
from astro_scc.quantities import named, one_quantity, shortened, to_quantity
from astro_scc.recovery.injection import (
    area_for_features,
    draw_paths,
    inject,
    moving_components,
    recovered,
    velocity_along,
)

#: A component is that of the features within this part of the beam over the
#: median interval.
TOLERANCE = 0.2
#: Of the intervals of shares.
CONFIDENCE = 0.95
#: Beginning of the warning of a region without SSPs.
NOTHING_THERE = ".*: no significant pattern has its centroid inside"

DESCRIPTIONS = {
    "speed": "speed of the features that were injected",
    "flux": "their peak",
    "snr": "their peak over the median noise of the epochs",
    "n_injected": "measurements with features injected",
    "n_found": "measurements that found them",
    "fraction": "n_found / n_injected",
    "fraction_low": "lower limit of the 95% interval of fraction (Jeffreys)",
    "fraction_high": "upper limit of the 95% interval of fraction (Jeffreys)",
    "bias": "mean of measured minus true speed, where found",
    "bias_err": "standard error of bias",
    "scatter": "standard deviation of the measured speed, where found",
    "coverage": "share of the found whose standard error reaches the true speed",
    "own": "whether the epochs have a component within the tolerance already",
}


def completeness(
    cube,
    scc,
    *,
    speeds,
    fluxes,
    position_angle=None,
    region=None,
    n_features=10,
    n_injections=30,
    n_trials=200,
    scatter=0.1,
    tolerance=None,
    fwhm=None,
    rng=None,
    n_workers=1,
    progress_bar=False,
):
    """
    Inject moving features into epochs and count how often they are found.

    The epochs keep their images, dates, noise, masks and beams; features of
    the shape of the beam, on straight lines at one speed, are added to them
    (`draw_paths`, `inject`), and everything is measured with the settings
    that measured the epochs themselves.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    scc : `~astro_scc.StackedCrossCorrelation`
    speeds : `~astropy.units.Quantity`, scalar or shape (n,)
        Proper motions of the features.
    fluxes : `~astropy.units.Quantity` or float, scalar or shape (n,)
        Peaks of the features in the unit of the cube (their flux densities,
        as they are as small as the beam), or as plain numbers in multiples
        of the median noise of the epochs.
    position_angle : `~astropy.units.Quantity` or "radial", optional
        Direction in which they move, by default that of ``scc``.
    region : optional
        Anything that ``cube.region_mask`` takes: SSPs inside are
        correlated, and features put there.  Without it everything is
        correlated and features are put where the epochs have SSPs, or
        anywhere if they have none.
    n_features : float, optional
        Mean number of features in the region at a time.
    n_injections : int, optional
        Measurements at each speed and flux.
    n_trials : int, optional
        Of each measurement.
    scatter : float, optional
        Standard deviation of the position of a feature at an epoch about
        its line, on each axis, in beams.
    tolerance : `~astropy.units.Quantity`, optional
        Largest distance of a component's velocity from the true one, by
        default 0.2 beams over the median interval of the pairs of epochs.
    fwhm : `~astropy.units.Quantity`, optional
        Full width of the features and of what counts as a beam above.
        Needed if the cube has no beams.
    rng : None, int or `~numpy.random.Generator`, optional
        Every measurement has a generator of its own: the table is the same
        for any ``n_workers``.
    n_workers : int, optional
        Number of threads.
    progress_bar : bool, optional

    Returns
    -------
    `~astropy.table.QTable`
        One row a speed and flux: ``speed``, ``flux``, ``snr``,
        ``n_injected``, ``n_found``, ``fraction`` with the limits
        ``fraction_low`` and ``fraction_high`` of its 95% interval (Jeffreys),
        ``bias``, ``bias_err``, ``scatter`` and ``coverage`` of those that
        were found, masked where none was (of ``bias_err`` and ``scatter``:
        fewer than two), and ``own``.  Its meta holds the settings, the
        velocities of the epochs' own components, the seed and the versions.

    Raises
    ------
    ValueError
        If an argument is out of its range, the velocity axes of ``scc`` have
        no one direction and are not radial, the epochs or the trials are so
        few that nothing can be found, a speed is beyond the largest that
        ``scc`` searches, or the cube has no beams and ``fwhm`` is not
        given.
    `~astropy.units.UnitConversionError`
        If a unit does not fit.

    Notes
    -----
    The features are found if there is a component that

    1. is "moving" with ``p_global <= scc.level``,
    2. lies within the tolerance of their velocity,
    3. is not one of the epochs' own: the epochs are measured without
       features first, and each moving component of theirs takes the one
       nearest to it within the tolerance; so at a speed that the epochs have
       already (``own``) a second component beside it is needed, and
    4. has most of its SSPs within half a beam of injected features.

    The epochs are measured ``1 + len(speeds) len(fluxes) n_injections``
    times.  Features change the planes of every epoch, and the noise that is
    measured on them, so each time everything is decomposed and correlated
    anew.

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
    injection = _injection_of(
        cube, scc, position_angle, region, n_trials, fwhm, tolerance
    )
    speeds = injection.checked_speeds(speeds)
    noise = float(np.median(cube.noise_rms().value))
    peaks = _peaks(fluxes, cube.unit, noise)
    for name, value in (("n_injections", n_injections), ("n_features", n_features)):
        if not 1 <= value < np.inf:
            raise ValueError(f"{name} must be at least 1, got {value}")
    if not 0 <= scatter < np.inf:
        raise ValueError(f"scatter must be zero or positive, got {scatter}")
    rng, seed = seeded(rng)
    own_rng, root = np.random.default_rng(rng).spawn(2)
    with warnings.catch_warnings():
        # Features are injected where there were none as well.
        warnings.filterwarnings("ignore", NOTHING_THERE, MeasurementWarning)
        bare = injection.measure(cube, own_rng)
    area = area_for_features(bare.matched, injection.region)
    numbers = moving_components(bare, scc.level)
    own = np.reshape([bare.velocities[k - 1].value for k in numbers], (-1, 2))
    axis = velocity_along(bare.frame, injection.position_angle)
    cells = [(speed, peak) for speed in speeds for peak in peaks]

    def recover(job):
        (speed, peak), job_rng = job
        path_rng, trial_rng = job_rng.spawn(2)
        paths = draw_paths(
            cube,
            area,
            speed=speed * PM_UNIT,
            position_angle=injection.position_angle,
            n_features=n_features,
            scatter=scatter * injection.fwhm * u.mas,
            rng=path_rng,
        )
        fuller = inject(cube, paths, peak * cube.unit, fwhm=fwhm)
        return injection.offset(
            injection.measure(fuller, trial_rng), own, speed, axis, paths
        )

    outcomes = run_all(
        recover,
        [
            (cell, job_rng)
            for cell, cell_rng in zip(cells, root.spawn(len(cells)), strict=True)
            for job_rng in cell_rng.spawn(n_injections)
        ],
        n_workers=n_workers,
        label="Recovering",
        progress_bar=progress_bar,
    )
    table = _table(cells, outcomes, n_injections, cube.unit, noise)
    away = [np.hypot(*(own - speed * axis).T) for speed, _ in cells]
    table["own"] = [bool(np.any(d <= injection.tolerance)) for d in away]
    for name, text in DESCRIPTIONS.items():
        table[name].info.description = text
    table.meta.update(
        {
            "settings": scc.to_dict(),
            "position_angle": injection.position_angle,
            "tolerance": injection.tolerance * PM_UNIT,
            "level": scc.level,
            "n_features": n_features,
            "n_trials": n_trials,
            "scatter": scatter,
            "own_velocities": own * PM_UNIT,
            "seed": seed,
            "versions": versions(),
        }
    )
    return table


@dataclass(frozen=True, eq=False)
class _Injection:
    """What is the same in all measurements; lengths in mas, speeds in mas/yr."""

    scc: object
    region: np.ndarray | None
    position_angle: u.Quantity | str
    n_trials: int
    fwhm: float
    tolerance: float
    limit: float
    #: Of a speed, along the axis that is searched.
    largest_part: float

    def checked_speeds(self, speeds):
        """Return speeds as numbers in mas/yr, that are searched."""
        values = positive_quantities("speeds", speeds, "2 mas/yr").to_value(PM_UNIT)
        if np.any(values * self.largest_part > self.limit):
            raise ValueError(
                f"speed {values.max():.4g} mas/yr is beyond the largest that is "
                f"searched, {self.limit:.4g} mas/yr: give StackedCrossCorrelation a "
                "larger max_speed"
            )
        return values.tolist()

    def measure(self, cube, rng):
        """Return the result of a cube, also of one that shows nothing."""
        matched = self.scc.match(cube, region=self.region)
        return self.scc.stack(matched, n_trials=self.n_trials, rng=rng)

    def offset(self, result, own, speed, axis, paths):
        """Return measured minus true speed, and its error; None if not found."""
        number = recovered(
            result,
            own,
            speed * axis,
            tolerance=self.tolerance,
            level=self.scc.level,
            paths=paths,
            fwhm=self.fwhm,
        )
        if number is None:
            return None
        velocity = result.velocities[number - 1]
        error = np.inf
        if np.all(np.isfinite(velocity.covariance)):
            error = np.sqrt(axis @ velocity.covariance @ axis)
        return axis @ velocity.value - speed, error


def _injection_of(cube, scc, position_angle, region, n_trials, fwhm, tolerance):
    """Check the arguments of `completeness`, and fill in what is not given."""
    pairs = scc.date_pairs(cube)
    n_epochs, level = len(cube), scc.level
    if smallest_p(n_epochs) > level:
        raise ValueError(
            f"{n_epochs} epochs allow no p_global below {smallest_p(n_epochs):.2g} "
            f"(2/N!), so nothing that moves can be found at level {level:g}: "
            f"{epochs_needed(level)} epochs or more are needed"
        )
    check_trials(n_trials, level)
    axis = _axis(scc.position_angle)
    position_angle = _direction(position_angle, axis)
    if fwhm is not None:
        fwhm = named("fwhm", one_quantity, fwhm, "an angle", "1 mas").to_value(u.mas)
    elif cube.beams is None:
        raise ValueError(
            "the cube has no beams: give fwhm, the full width of features, as an angle"
        )
    else:
        fwhm = mean_fwhm(cube, max(scc.scale_numbers(cube)))
    if tolerance is None:
        tolerance = TOLERANCE * fwhm / np.median(pairs.interval)
    else:
        how = "a proper motion", "2 mas/yr"
        tolerance = named("tolerance", one_quantity, tolerance, *how).to_value(PM_UNIT)
    largest_part = 1.0
    if isinstance(axis, u.Quantity):
        largest_part = float(abs(np.cos(position_angle - axis)))
    return _Injection(
        scc=scc,
        region=None if region is None else cube.region_mask(region),
        position_angle=position_angle,
        n_trials=n_trials,
        fwhm=fwhm,
        tolerance=tolerance,
        limit=scc.speed_limit(cube).to_value(PM_UNIT),
        largest_part=largest_part,
    )


def _axis(position_angle):
    """Return the direction of the velocity axes of a measurement."""
    if isinstance(position_angle, PositionAngleFrame):
        return position_angle.pa
    if position_angle is None or isinstance(position_angle, u.Quantity):
        return position_angle
    if isinstance(position_angle, str) and position_angle == "radial":
        return position_angle
    raise ValueError(
        "features move on straight lines, so the measurement needs velocity axes of "
        f"one direction, or 'radial', not {position_angle}: give "
        "StackedCrossCorrelation an angle as position_angle"
    )


def _direction(position_angle, axis):
    """Return the direction in which features move."""
    if position_angle is None:
        position_angle = axis
    if position_angle is None:
        raise ValueError(
            "position_angle is missing: give the direction in which features move, an "
            "angle or 'radial'"
        )
    radial = isinstance(position_angle, str)
    if radial != isinstance(axis, str) or (radial and position_angle != "radial"):
        raise ValueError(
            f"position_angle {position_angle} does not go with that of the "
            f"measurement, {axis}: either both are 'radial', or none"
        )
    if radial:
        return position_angle
    how = "an angle", "65 deg", False
    return named("position_angle", one_quantity, position_angle, *how).to(u.deg)


def _peaks(fluxes, unit, noise):
    """Return peaks of features as numbers in the unit of a cube."""
    if isinstance(fluxes, u.Quantity):
        # What is as small as the beam has as much in it as at its peak.
        per_beam = fluxes / u.beam
        if per_beam.unit.is_equivalent(unit):
            fluxes = per_beam
        wanted = f"must be in a unit like {unit}"
        values = named("fluxes", to_quantity, fluxes, unit, wanted).to_value(unit)
    else:
        values = np.asarray(fluxes, dtype=float) * noise
        if noise == 0:
            raise ValueError(
                "fluxes in multiples of the noise need epochs with noise, theirs is 0: "
                "give fluxes in the unit of the cube"
            )
    values = np.atleast_1d(values)
    good = values.ndim == 1 and values.size > 0
    if not (good and np.all((values >= 0) & np.isfinite(values))):
        raise ValueError(f"fluxes must be one or more numbers from 0, got {fluxes}")
    return values.tolist()


def _table(cells, outcomes, n_injections, unit, noise):
    """Return a row for each speed and peak of the injected features."""
    found = [
        [outcome for outcome in outcomes[k : k + n_injections] if outcome is not None]
        for k in range(0, len(outcomes), n_injections)
    ]
    n_found = np.array([len(row) for row in found], dtype=int)
    fraction, low, high = share(n_found, n_injections)
    bias, bias_err, scatter, coverage = [], [], [], []
    for row in found:
        off, err = np.array(row).reshape(-1, 2).T
        n = len(row)
        spread = float(off.std(ddof=1)) if n > 1 else None
        bias.append(float(off.mean()) if n else None)
        bias_err.append(None if spread is None else spread / np.sqrt(n))
        scatter.append(spread)
        coverage.append(float(np.mean(np.abs(off) <= err)) if n else None)
    speed, peak = np.array(cells).T
    return QTable(
        {
            "speed": speed * PM_UNIT,
            "flux": peak * unit,
            "snr": partly_known([p / noise if noise > 0 else None for p in peak]),
            "n_injected": np.full(len(cells), n_injections),
            "n_found": n_found,
            "fraction": fraction,
            "fraction_low": low,
            "fraction_high": high,
            "bias": partly_known(bias, PM_UNIT),
            "bias_err": partly_known(bias_err, PM_UNIT),
            "scatter": partly_known(scatter, PM_UNIT),
            "coverage": partly_known(coverage),
        }
    )


def positive_quantities(name, value, example):
    """Return one or more positive quantities of the unit of an example."""
    wanted = f"must be positive and finite, with a unit, such as {example!r}"
    unit = u.Quantity(example).unit
    found = np.atleast_1d(named(name, to_quantity, value, unit, wanted))
    good = found.ndim == 1 and found.size > 0
    if not (good and np.all((found.value > 0) & np.isfinite(found.value))):
        raise ValueError(f"{name} = {shortened(value)} {wanted}")
    return found


def check_trials(n_trials, level):
    """Refuse trials that allow no probability as small as a level."""
    if not n_trials >= 2:
        raise ValueError(f"n_trials must be at least 2, got {n_trials}")
    if 1 / (n_trials + 1) > level:
        raise ValueError(
            f"{n_trials} trials allow no p_global below {1 / (n_trials + 1):.2g}, so "
            f"nothing can be found at level {level:g}: give more n_trials"
        )


def seeded(rng):
    """Return a seed or generator, drawn if there is none, and the seed if it is one."""
    if rng is None:
        rng = int(np.random.SeedSequence().entropy % 2**63)
    return rng, int(rng) if isinstance(rng, (int, np.integer)) else None


def smallest_p(n_epochs):
    """Return the smallest ``p_global`` of what moves, 2 / N! (:ref:`significance`)."""
    # The factorial of 171 is no float any more.
    return min(1.0, 2 / math.factorial(min(n_epochs, 170)))


def epochs_needed(level):
    """Return the fewest epochs with which a moving component can reach a level."""
    n_epochs = 2
    while smallest_p(n_epochs) > level:
        n_epochs += 1
    return n_epochs


def share(number, of):
    """Return shares with the limits of their 95% intervals (Jeffreys)."""
    number = np.asarray(number, dtype=int)
    low, high = binom_conf_interval(number, of, CONFIDENCE, interval="jeffreys")
    return number / of, np.asarray(low), np.asarray(high)


def partly_known(values, unit=None):
    """Return a column, masked where a value is None."""
    missing = np.array([value is None for value in values], dtype=bool)
    numbers = np.array([0.0 if v is None else v for v in values], dtype=float)
    column = numbers if unit is None else u.Quantity(numbers, unit)
    if not missing.any():
        return column
    if unit is None:
        return np.ma.MaskedArray(column, mask=missing)
    return Masked(column, mask=missing)


def run_all(function, jobs, *, n_workers=1, label="", progress_bar=False):
    """
    Return what a function makes of each job, whatever the number of threads.

    Warnings about what the data support are not repeated for each of them.
    """
    from threadpoolctl import threadpool_limits

    if n_workers < 1:
        raise ValueError(f"n_workers must be at least 1, got {n_workers}")
    with (
        # Each measurement limits the threads of products by itself; limits that
        # overlap in time would be restored in the wrong order.
        threadpool_limits(1),
        warnings.catch_warnings(),
        progress(len(jobs), label, show=progress_bar) as done,
    ):
        warnings.simplefilter("ignore", MeasurementWarning)

        def work(job):
            result = function(job)
            done(1)
            return result

        if n_workers == 1:
            return [work(job) for job in jobs]
        with ThreadPoolExecutor(n_workers) as pool:
            return list(pool.map(work, jobs))
