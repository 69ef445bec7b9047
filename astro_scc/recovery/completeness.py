# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What would have been found in your own epochs, had it been there."""

import warnings

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc.exceptions import MeasurementWarning
from astro_scc.measurement import versions
from astro_scc.recovery.area import area_for_features
from astro_scc.recovery.checks import PM_UNIT
from astro_scc.recovery.features import draw_paths, inject
from astro_scc.recovery.rates import partly_known, share
from astro_scc.recovery.rule import moving_components, recovered, velocity_along
from astro_scc.recovery.setup import InjectionSetup, peaks_of
from astro_scc.recovery.work import run_all

__all__ = ["completeness"]

#: Beginning of the warning of a region without SSPs.
NOTHING_THERE = ".*: no significant pattern has its centroid inside"

DESCRIPTIONS = {
    "speed": "speed of the features that were put in",
    "flux": "their peak",
    "snr": "their peak over the median noise of the epochs",
    "n_injected": "measurements with features put in",
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
    Put moving features into epochs and see how often they are found.

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
    4. has most of its SSPs within half a beam of features that were put in.

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
    setup = InjectionSetup.of(
        cube, scc, position_angle, region, n_trials, fwhm, tolerance
    )
    speeds = setup.speeds(speeds)
    noise = float(np.median(cube.noise_rms().value))
    fluxes = peaks_of(fluxes, cube.unit, noise)
    for name, value, least in (("n_injections", n_injections, 1),
                               ("n_features", n_features, 1)):  # fmt: skip
        if not least <= value < np.inf:
            raise ValueError(f"{name} must be at least {least}, got {value}")
    if not 0 <= scatter < np.inf:
        raise ValueError(f"scatter must be zero or positive, got {scatter}")
    if rng is None:
        rng = int(np.random.SeedSequence().entropy % 2**63)
    seed = int(rng) if isinstance(rng, (int, np.integer)) else None
    own_rng, root = np.random.default_rng(rng).spawn(2)

    def stacked(images, rng):
        # Not in one call, which refuses epochs that show nothing.
        matched = scc.match(images, region=setup.region)
        return scc.stack(matched, n_trials=n_trials, rng=rng)

    with warnings.catch_warnings():
        # Features are put in where there were none as well.
        warnings.filterwarnings("ignore", NOTHING_THERE, MeasurementWarning)
        bare = stacked(cube, own_rng)
    area = area_for_features(bare.matched, setup.region)
    numbers = moving_components(bare, scc.level)
    own = np.reshape([bare.velocities[k - 1].value for k in numbers], (-1, 2))
    axis = velocity_along(bare.frame, setup.position_angle)
    cells = [(speed, flux) for speed in speeds for flux in fluxes]
    jobs = [
        (cell, job_rng)
        for cell, cell_rng in zip(cells, root.spawn(len(cells)), strict=True)
        for job_rng in cell_rng.spawn(n_injections)
    ]

    def measure(job):
        (speed, flux), own_rng = job
        path_rng, trial_rng = own_rng.spawn(2)
        paths = draw_paths(
            cube,
            area,
            speed=speed * PM_UNIT,
            position_angle=setup.position_angle,
            n_features=n_features,
            scatter=scatter * setup.fwhm * u.mas,
            rng=path_rng,
        )
        result = stacked(inject(cube, paths, flux * cube.unit, fwhm=fwhm), trial_rng)
        number = recovered(
            result,
            own,
            speed * axis,
            tolerance=setup.tolerance,
            level=scc.level,
            paths=paths,
            fwhm=setup.fwhm,
        )
        if number is None:
            return None
        velocity = result.velocities[number - 1]
        error = _error_along(velocity.covariance, axis)
        return axis @ velocity.value - speed, error

    outcomes = run_all(
        measure,
        jobs,
        n_workers=n_workers,
        label="Recovering",
        progress_bar=progress_bar,
    )
    rows = [
        outcomes[k : k + n_injections] for k in range(0, len(outcomes), n_injections)
    ]
    table = _table(cells, rows, n_injections, cube.unit, noise)
    near = [
        bool(np.any(np.hypot(*(own - speed * axis).T) <= setup.tolerance))
        for speed, _ in cells
    ]
    table["own"] = near
    for name, text in DESCRIPTIONS.items():
        table[name].info.description = text
    table.meta.update(
        {
            "settings": scc.to_dict(),
            "position_angle": setup.position_angle,
            "tolerance": setup.tolerance * PM_UNIT,
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


def _error_along(covariance, axis):
    """Standard error in a direction; infinite where there is no bound."""
    if not np.all(np.isfinite(covariance)):
        return np.inf
    return np.sqrt(axis @ covariance @ axis)


def _table(cells, rows, n_injections, unit, noise):
    found = [[outcome for outcome in row if outcome is not None] for row in rows]
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
    speed, flux = np.array(cells).T
    return QTable(
        {
            "speed": speed * PM_UNIT,
            "flux": flux * unit,
            "snr": partly_known([f / noise if noise > 0 else None for f in flux]),
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
