# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Recovery: injection of moving features, and how often they are found."""

from __future__ import annotations

import warnings
from concurrent.futures import ThreadPoolExecutor
from itertools import islice, product
from typing import Any

import astropy.units as u
import numpy as np
from astropy.stats import binom_conf_interval
from astropy.table import QTable
from numpy.typing import ArrayLike
from threadpoolctl import threadpool_limits

from astro_scc import quantities as q
from astro_scc.columns import build_table
from astro_scc.epochs import EpochCube
from astro_scc.epochs.restoring import add_gaussians
from astro_scc.exceptions import MeasurementWarning, NoFlowError
from astro_scc.images.beam import FWHM_TO_SIGMA
from astro_scc.intervals import median_interval
from astro_scc.kinematics import PositionAngleFrame
from astro_scc.parallel import progress
from astro_scc.plan import (
    choose_direction,
    flow_beam,
    out_of_reach,
    used_intervals,
    velocity_frame,
)
from astro_scc.quantities import Seed, random_generator, seeded
from astro_scc.scc import StackedCrossCorrelation
from astro_scc.settings import require
from astro_scc.spectrum.permutations import fastest_speed, number_of_orders
from astro_scc.units import PM_UNIT
from astro_scc.writing import versions

__all__ = ["completeness", "draw_paths", "inject"]

#: Beginning of the warning of a region without SSPs.
NOTHING_THERE = ".*: no significant pattern has its centroid inside"
NO_BEAMS = "the cube has no beams: give fwhm, the full width of features, as an angle"


def draw_paths(
    cube: EpochCube, area: ArrayLike, *, speed: u.Quantity,
    position_angle: u.Quantity | str, n_features: float = 10,
    scatter: u.Quantity | None = None, rng: Seed | None = None,
) -> np.ndarray:  # fmt: skip
    """
    Draw features that flow through an area at one speed.

    All lines that meet the area are equally likely, so features populate it
    evenly at all times: a line is drawn through a point of the area at one of
    the epochs and kept with probability 1/m, where m is the number of epochs at
    which it meets the area.  Lines are added until the mean number of features
    in the area reaches ``n_features``.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    area : array_like of bool, shape (ny, nx)
    speed : `~astropy.units.Quantity`
        An angle per time.
    position_angle : `~astropy.units.Quantity` or "radial"
        Direction of motion, north through east, or away from the reference
        pixel.
    n_features : float, optional
        Mean number in the area at a time.
    scatter : `~astropy.units.Quantity`, optional
        Standard deviation of positions around the lines, an angle; it is drawn
        on each axis and at each epoch independently.
    rng : `numpy.random.Generator`, seed or None, optional

    Returns
    -------
    `~numpy.ndarray`, shape (2, n_features, n_epochs)
        x and y in pixels counted from 0, NaN at epochs before a feature has left the
        origin of a radial flow.

    Raises
    ------
    ValueError
        If the area holds no pixel.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc import EpochCube
    >>> from astro_scc.recovery import draw_paths
    >>> cube = EpochCube.from_arrays(np.zeros((3, 32, 64)), ["2000-01-01", "2001-01-01",
    ...                              "2003-01-01"], pixel_scale=0.1 * u.mas)
    >>> area = np.zeros((32, 64), dtype=bool)
    >>> area[10:20, 10:50] = True
    >>> paths = draw_paths(cube, area, speed=1 * u.mas / u.yr,
    ...                    position_angle=270 * u.deg, n_features=4, rng=1)
    >>> np.diff(paths[0])[0].round(1)  # west is to the right
    array([10., 20.])
    """
    rng = random_generator(rng)
    rows, columns = np.nonzero(area)
    if len(rows) == 0:
        raise ValueError("the area for features holds no pixel")
    (ny, nx), years = area.shape, cube.years.to_value(u.yr)
    speed = u.Quantity(speed).to_value(PM_UNIT)
    to_sky = cube.pixel_matrix.value
    to_pixels = np.linalg.inv(to_sky)
    origin = np.array(cube.reference_pixel)
    lines, number = [], 0.0
    while number < n_features * (1 - 1e-9):
        epoch, pixel = rng.integers(len(years)), rng.integers(len(rows))
        start = [columns[pixel], rows[pixel]] + rng.uniform(-0.5, 0.5, 2)
        keep = rng.random()
        direction, distance = _motion(start, origin, to_sky, position_angle)
        travelled = speed * (years - years[epoch])
        line = start[:, None] + (to_pixels @ direction)[:, None] * travelled
        line[:, distance + travelled < 0] = np.nan
        # At which epochs it is in the area.
        x, y = np.rint(np.nan_to_num(line, nan=-1)).astype(int)
        inside = (x >= 0) & (x < nx) & (y >= 0) & (y < ny)
        inside &= area[np.clip(y, 0, ny - 1), np.clip(x, 0, nx - 1)]
        if keep * max(inside.sum(), 1) < 1:
            lines.append(line)
            number += inside.mean()
    lines = np.array(lines)
    if scatter is not None:
        sigma = u.Quantity(scatter).to_value(u.mas)
        shift = rng.normal(0, sigma, (len(lines), len(years), 2))
        lines = lines + np.einsum("ij,nej->nie", to_pixels, shift)
    return lines.swapaxes(0, 1)


def _motion(start, origin, to_sky, position_angle):
    """Return the direction of motion (east, north) and the distance from its origin."""
    if isinstance(position_angle, str):
        offset = to_sky @ (start - origin)
        # Avoid a division by zero at the origin.
        distance = max(np.hypot(*offset), 1e-12)
        return offset / distance, distance
    angle = u.Quantity(position_angle).to_value(u.rad)
    return np.array([np.sin(angle), np.cos(angle)]), np.inf


def inject(
    cube: EpochCube, paths: ArrayLike, peak: u.Quantity, *,
    fwhm: u.Quantity | None = None,
) -> EpochCube:  # fmt: skip
    """
    Add features with the shape of each epoch's beam to a cube.

    Everything but the images stays the same.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    paths : array_like, shape (2, n_features, n_epochs)
        See `draw_paths`.
    peak : `~astropy.units.Quantity`
        Peak of a feature in the unit of the cube.
    fwhm : `~astropy.units.Quantity`, optional
        Full width of round features, instead of the beams.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`

    Raises
    ------
    ValueError
        If the cube has no beams and ``fwhm`` is not given.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astro_scc import EpochCube
    >>> from astro_scc.recovery import draw_paths, inject
    >>> dates = ["2000-01-01", "2001-01-01"]
    >>> cube = EpochCube.from_arrays(np.zeros((2, 16, 32)), dates,
    ...                              pixel_scale=0.1 * u.mas)
    >>> paths = draw_paths(cube, np.eye(16, 32) > 0, speed=1 * u.mas / u.yr,
    ...                    position_angle=270 * u.deg, n_features=1, rng=1)
    >>> fuller = inject(cube, paths, 2.0, fwhm=0.5 * u.mas)
    >>> bool(fuller.data.max() > 1)
    True
    """
    if fwhm is not None:
        to_pixels = np.linalg.inv(cube.pixel_matrix.value)
        sigma = FWHM_TO_SIGMA * u.Quantity(fwhm).to_value(u.mas)
        shapes = [to_pixels @ (sigma**2 * np.eye(2)) @ to_pixels.T] * len(cube)
    elif cube.beams is not None:
        shapes = cube.beam_shapes
    else:
        raise ValueError(NO_BEAMS)
    value = u.Quantity(peak, cube.unit).to_value(cube.unit)
    data, paths = cube.data.copy(), np.asarray(paths)
    for epoch, shape in enumerate(shapes):
        x, y = paths[:, np.isfinite(paths[0, :, epoch]), epoch]
        add_gaussians(data[epoch], x, y, [value] * len(x), [shape] * len(x))
    return cube.with_step(f"{paths.shape[1]} simulated features added", data=data)


def completeness(
    cube: EpochCube, scc: StackedCrossCorrelation, *, speeds: u.Quantity,
    fluxes: u.Quantity | float, position_angle: u.Quantity | str | None = None,
    region: Any = None, n_features: float = 10, n_injections: int = 30,
    n_trials: int = 200, scatter: float = 0.1, tolerance: u.Quantity | None = None,
    fwhm: u.Quantity | None = None, rng: Seed | None = None,
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
        Anything that ``cube.region_mask`` takes.  What moves inside is measured,
        and features are injected there.  Without it, everything is measured
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
        Largest distance of a stream's velocity from the true one, by
        default 0.2 beams over the median interval between epochs.
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
        own streams, the seed and the versions.

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
    The features are found if there is a stream that

    1. is "moving",
    2. lies within the tolerance of the features' velocity, and
    3. is not one of the epochs' own: the epochs are first measured without
       features, and each moving stream found there claims the nearest one within
       the tolerance.  At a speed that the epochs already show (``own``), a second
       stream is therefore needed.

    The epochs are measured ``1 + len(speeds) len(fluxes) n_injections``
    times.  Features change the planes of every epoch and the noise that is
    measured on them, so every measurement decomposes everything again.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.recovery import completeness
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=7, shape=(64, 128), extent=(10, 120), axis=32,
    ...                        rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=20 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> table = completeness(cube, scc, speeds=12 * u.mas / u.yr, fluxes=2 * u.Jy,
    ...                      n_injections=3, n_trials=100, rng=1)
    >>> table["speed", "flux", "n_injected"].pprint()
     speed     flux   n_injected
    mas / yr Jy / beam
    -------- --------- ----------
        12.0       2.0          3
    """
    n_trials = require("n_trials", n_trials)
    _require_sense(cube, scc, n_trials, n_injections, n_features, scatter)
    position_angle, axis = _direction(position_angle, scc.position_angle, cube)
    width, tolerance = _lengths(cube, fwhm, tolerance)
    region = None if region is None else cube.region_mask(region)
    speeds = _searched(speeds, axis, cube, scc)
    peaks, noise = _peaks(fluxes, cube)
    generator, seed = seeded(rng)
    bare_rng, root = generator.spawn(2)
    area, bare = _bare(cube, scc, region, n_trials, bare_rng)

    def recover(cell, rng):
        (speed, peak), (path_rng, trial_rng) = cell, rng.spawn(2)
        paths = draw_paths(
            cube, area, speed=speed * PM_UNIT, position_angle=position_angle,
            n_features=n_features, scatter=scatter * width * u.mas, rng=path_rng,
        )  # fmt: skip
        fuller = inject(cube, paths, peak * cube.unit, fwhm=fwhm)
        found = _streams(scc, scc.decompose(fuller, region=region), n_trials, trial_rng)
        return recovered(found, bare, speed, axis, tolerance=tolerance)

    cells = list(product(speeds.tolist(), peaks.tolist()))
    outcomes = run_all(recover, cells, n_injections, root, n_workers, progress_bar)
    rows = [_row(*pair, noise) for pair in zip(cells, outcomes, strict=True)]
    shown = [any(np.hypot(*(bare - v * axis).T) <= tolerance) for v, _ in cells]
    peaks = [peak for _, peak in cells] * cube.unit
    table = build_table("completeness", rows, flux=peaks, own=shown)
    table.meta = {
        "settings": scc.to_dict(), "position_angle": position_angle,
        "tolerance": tolerance * PM_UNIT, "alpha": scc.alpha, "n_features": n_features,
        "n_trials": n_trials, "scatter": scatter, "own_velocities": bare * PM_UNIT,
        "seed": seed, "versions": versions(),
    }  # fmt: skip
    return table


def _require_sense(cube, scc, n_trials, n_injections, n_features, scatter):
    """Refuse numbers out of their range, and those with which nothing can be found."""
    number = number_of_orders(np.diff(cube.years.to_value(u.yr)))
    smallest = 1 / min(number, n_trials + 1)
    if said := out_of_reach(smallest, len(cube), n_trials, scc.alpha):
        raise ValueError(said)
    q.named("n_injections", q.check_integer, n_injections, 1)
    q.named("n_features", q.check_number, n_features, 0, np.inf, "must be above 0")
    if not 0 <= scatter < np.inf:
        raise ValueError(f"scatter must be zero or positive, got {scatter}")


def _lengths(cube, fwhm, tolerance):
    """Return the width of features in mas, and the tolerance in mas/yr."""
    if fwhm is not None:
        width = q.named("fwhm", q.one_quantity, fwhm, "an angle", "1 mas")
        width = width.to_value(u.mas)
    elif cube.beams is None:
        raise ValueError(NO_BEAMS)
    else:
        width = flow_beam(cube)
    if tolerance is None:
        return width, 0.2 * width / median_interval(cube.years.to_value(u.yr))
    wanted = "a proper motion", "2 mas/yr"
    tolerance = q.named("tolerance", q.one_quantity, tolerance, *wanted)
    return width, tolerance.to_value(PM_UNIT)


def _searched(speeds, axis, cube, scc):
    """Return speeds in mas/yr, whose part along the axis must be searched."""
    along = 1.0 if scc.position_angle is None else abs(axis[0])
    if scc.max_speed is None:
        years, intervals = cube.years.to_value(u.yr), used_intervals(cube, scc.baseline)
        limit = flow_beam(cube) * fastest_speed(years, intervals)
    else:
        limit = scc.max_speed.to_value(PM_UNIT)
    speeds = _positive("speeds", speeds, PM_UNIT)
    if np.any(speeds * along > limit):
        raise ValueError(
            f"speed {speeds.max():.4g} mas/yr is beyond the largest that is searched, "
            f"{limit:.4g} mas/yr: give StackedCrossCorrelation a larger max_speed"
        )
    return speeds


def _bare(cube, scc, region, n_trials, rng):
    """
    Return where features are injected, and the velocities that are there already.

    They are injected into the pixels of the region that are valid in any epoch.
    Without a region, these are the pixels of SSPs of any epoch and scale, or all if
    there are none.
    """
    exists = ~cube.mask.all(axis=0)
    with warnings.catch_warnings():
        # Features are injected even if the region has no SSP.
        warnings.filterwarnings("ignore", NOTHING_THERE, MeasurementWarning)
        decomposed = scc.decompose(cube, region=region)
        if region is None:
            area = np.zeros(exists.shape, dtype=bool)
            area.flat[decomposed.ssps.pixels] = True
            area = area if area.any() else exists
        elif not (area := region & exists).any():
            what = "region holds masked pixels only: no feature can be injected"
            raise ValueError(what)
        found = _streams(scc, decomposed, n_trials, rng)
    return area, np.reshape([stream.velocity for stream in found], (-1, 2))


def _streams(scc, decomposed, n_trials, rng):
    """Return the streams that move in decomposed epochs."""
    try:
        found = scc.measure(decomposed, n_trials=n_trials, rng=rng).search.streams
    except NoFlowError:
        return []
    return [stream for stream in found if stream.kind == "moving"]


def _direction(position_angle, axis, cube):
    """Return the direction of motion, and its unit vector on the axes of velocities."""
    axis = axis.pa if isinstance(axis, PositionAngleFrame) else axis
    given = axis if position_angle is None else position_angle
    radial = [isinstance(k, str) and k == "radial" for k in (axis, given)]
    if all(radial):
        return given, np.array([1.0, 0.0])
    straight = axis is None or isinstance(axis, u.Quantity)
    if given is None or any(radial) or not straight:
        found, _ = choose_direction(cube)
        such = "" if found is None else f", such as the {found:g} of the mean image"
        raise ValueError(
            f"position_angle {given} does not go with {axis} of "
            "StackedCrossCorrelation: features move on straight lines, so give both an "
            f"angle{such}, or both 'radial'"
        )
    wanted = "an angle", "65 deg", False
    given = q.named("position_angle", q.one_quantity, given, *wanted).to(u.deg)
    angle = given.to_value(u.rad)
    matrix = velocity_frame(cube, axis).matrix(0.0, 0.0)
    return given, matrix @ [np.sin(angle), np.cos(angle)]


def _peaks(fluxes, cube):
    """Return peaks of features in the unit of a cube, and the median noise."""
    unit, noise = cube.unit, float(np.median(cube.noise_rms().value))
    if not isinstance(fluxes, u.Quantity):
        if noise == 0:
            what = "fluxes in multiples of the noise need epochs with noise"
            raise ValueError(f"{what}: give fluxes in the unit of the cube")
        fluxes = np.asarray(fluxes, dtype=float) * noise * unit
    elif (fluxes / u.beam).unit.is_equivalent(unit):
        # The flux density of a feature of the size of the beam equals its peak.
        fluxes = fluxes / u.beam
    return _positive("fluxes", fluxes, unit), noise


def _positive(name, value, unit):
    """Return one or more positive quantities as numbers in a unit."""
    wanted = f"must be one or more positive numbers in a unit like {unit}"
    found = q.named(name, q.finite_quantities, value, unit, wanted).to_value(unit)
    if not np.all(found > 0):
        raise ValueError(f"{name} = {value} {wanted}")
    return np.atleast_1d(found)


def _row(cell, outcomes, noise):
    """Return how many injections were found, and how well (None if unknown)."""
    speed, peak = cell
    found = [outcome for outcome in outcomes if outcome is not None]
    n, of = len(found), len(outcomes)
    low, high = binom_conf_interval(n, of, 0.95, interval="jeffreys").tolist()
    off, error = np.array(found).reshape(-1, 2).T
    spread = float(off.std(ddof=1)) if n > 1 else None
    return {
        "speed": speed, "snr": peak / noise if noise > 0 else None,
        "n_injected": of, "n_found": n, "fraction": n / of, "fraction_low": low,
        "fraction_high": high, "bias": float(off.mean()) if n else None,
        "bias_err": spread / np.sqrt(n) if n > 1 else None, "scatter": spread,
        "coverage": float(np.mean(np.abs(off) <= error)) if n else None,
    }  # fmt: skip


def run_all(function, cells, number, rng, n_workers=1, progress_bar=False):
    """
    Call a function with each cell and each of its generators; return lists by cell.

    Each cell has ``number`` generators of its own, so the outcome is the same for any
    number of threads.  Warnings about what the data support are not repeated.
    """
    q.named("n_workers", q.check_integer, n_workers, 1)
    jobs = [
        (cell, generator)
        for cell, root in zip(cells, rng.spawn(len(cells)), strict=True)
        for generator in root.spawn(number)
    ]
    with (
        # Each measurement limits the threads of matrix products by itself; limits
        # that overlap in time would be restored in the wrong order.
        threadpool_limits(1),
        warnings.catch_warnings(action="ignore", category=MeasurementWarning),
        progress(len(jobs), "Recovering", show=progress_bar) as done,
        ThreadPoolExecutor(n_workers) as pool,
    ):

        def work(job):
            result = function(*job)
            done(1)
            return result

        found = map(work, jobs) if n_workers == 1 else pool.map(work, jobs)
        return [list(islice(found, number)) for _ in cells]


def recovered(streams, claims, speed, axis, *, tolerance):
    """
    Return by how much a stream is faster than injected features, and its error.

    Parameters
    ----------
    streams : sequence of ``Stream``
        Those that move.
    claims : `~numpy.ndarray`, shape (n, 2)
        Velocities that the epochs have without features; each claims the stream
        nearest to it within the tolerance.
    speed : float
        Of the features.
    axis : `~numpy.ndarray`, shape (2,)
        Their direction on the axes of the frame.
    tolerance : float
        In mas/yr.

    Returns
    -------
    (float, float) or None
        Of the nearest one that is left; None if none is within the tolerance.
    """
    left = streams
    for claim in claims:
        taken = _nearest(left, claim, tolerance)
        left = [stream for stream in left if stream is not taken]
    stream = _nearest(left, speed * axis, tolerance)
    if stream is None:
        return None
    variance = axis @ stream.covariance @ axis
    error = np.inf if np.isnan(variance) else np.sqrt(variance)
    return axis @ stream.velocity - speed, error


def _nearest(streams, velocity, tolerance):
    """Return the stream of the nearest velocity within a tolerance, or None."""

    def distance(stream):
        return np.hypot(*(stream.velocity - velocity))

    near = min(streams, key=distance, default=None)
    return None if near is None or distance(near) > tolerance else near
