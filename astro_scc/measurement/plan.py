# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Plan of a measurement: scales, pairs of dates, search radius, speeds and SSPs."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from numpy.typing import ArrayLike

from astro_scc.decomposition.wavelet import scale_size
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.images.positions import ssp_offsets
from astro_scc.kinematics import PositionAngleFrame, RidgeLine
from astro_scc.measurement.choices import choose_scales, mean_fwhm
from astro_scc.measurement.decomposing import centroids_inside
from astro_scc.measurement.match_files import MatchedEpochs
from astro_scc.settings import MeasurementSettings, require
from astro_scc.stacking.diagram import Rays
from astro_scc.stacking.search_settings import DEFAULT
from astro_scc.stacking.velocities import (
    DatePairs,
    VelocityGrid,
    baseline_pairs,
    consecutive_pairs,
)
from astro_scc.units import PM_UNIT

if TYPE_CHECKING:
    from astro_scc.epochs import EpochCube

#: Largest relative difference between an angle and the size of the scale it names.
SCALE_TOLERANCE = 0.2
#: Largest scale number that an angle can name.
LARGEST_SCALE = 12
#: Smallest displacement in the longest interval, in pixels.
LEAST_MOTION = 0.01
#: Largest displacement in the shortest interval, in diagonals of the image.
MOST_MOTION = 10
#: Spacing of the velocity grid in units of the narrowest kernel.
GRID_STEP = 0.5
#: Smoothing lengths by which the search goes beyond the largest displacement.
MARGIN = 3.0
#: Beams by which matches go beyond the largest speed: stacks in speed and
#: acceleration have kernels of 0.8 beam.
BEYOND = 1.0
#: Without a largest speed, series of up to this many epochs are searched to
#: ``FAR_BEAMS`` beams in the median interval.
FEW_EPOCHS = 20
FAR_BEAMS = 4.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchPlan:
    """
    What settings mean for the pixels, beams and dates of a cube.

    Attributes
    ----------
    scales : tuple of float
        Numbers of the scales.
    pairs : ``DatePairs``
        Pairs of dates of the paper's stack.
    intervals : (float, float)
        Shortest and longest interval that is searched, in years.
    radius : float
        Largest displacement at which streams are searched for, in beams.
    fwhm : float
        The beam, or the size of the largest scale without one, in mas.
    max_speed : float or None
        The largest speed of the settings in mas/yr.

    Examples
    --------
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> plan = StackedCrossCorrelation().plan(simulate_two_fluid(rng=1).cube)
    >>> plan.scales, len(plan.pairs), float(plan.radius)
    ((1, 2, 3, 4), 9, 4.36)
    """

    scales: tuple[float, ...]
    pairs: DatePairs
    intervals: tuple[float, float]
    radius: float
    fwhm: float
    max_speed: float | None

    @classmethod
    def of(cls, cube: EpochCube, settings: MeasurementSettings) -> SearchPlan:
        """
        Return the plan of a measurement.

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
            If no two epochs make a pair, or a scale does not fit the pixels.
        """
        pairs = pairs_of_dates(cube, settings.baseline)
        scales = scale_numbers(cube, settings.scales)
        fwhm = mean_fwhm(cube, max(scales))
        max_speed, intervals = settings.max_speed, (0.0, np.inf)
        if max_speed is not None:
            max_speed = max_speed.to_value(PM_UNIT)
        if settings.baseline is not None:
            intervals = settings.baseline.to_value(u.yr)
        return cls(
            scales=scales,
            pairs=pairs,
            intervals=tuple(intervals),
            radius=search_radius(cube, max_speed, fwhm),
            fwhm=fwhm,
            max_speed=max_speed,
        )

    def speed_limit(self, cube: EpochCube) -> u.Quantity:
        """
        Return the largest speed that is searched.

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`

        Returns
        -------
        `~astropy.units.Quantity`
            In mas/yr.
        """
        if self.max_speed is not None:
            return self.max_speed * PM_UNIT
        years = cube.years.to_value(u.yr)
        rays = Rays.of(years, self.radius, DEFAULT, intervals=self.intervals)
        return float(rays.speed.max()) * self.fwhm * PM_UNIT


def scale_numbers(cube, scales):
    """
    Return the numbers of the scales, for the pixels of a cube.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    scales : sequence of float, `~astropy.units.Quantity` or None
        If None, they follow from the beam, or the size of the structures.

    Returns
    -------
    tuple of float

    Raises
    ------
    ValueError
        If an angle is not within 20% of a scale's size, or two angles mean the same
        scale.
    """
    if scales is None:
        return choose_scales(cube)[0]
    return require("scales", scales_of_pixels(scales, cube.pixel_scale))


def scales_of_pixels(scales, pixel_scale):
    """
    Return the numbers of scales that are given as angles.

    Parameters
    ----------
    scales : sequence of float or `~astropy.units.Quantity`
        Numbers, or angles.
    pixel_scale : `~astropy.units.Quantity`

    Returns
    -------
    tuple of float

    Raises
    ------
    ValueError
        If an angle is not within 20% of the size of a scale.
    """
    if not isinstance(scales, u.Quantity):
        return scales
    numbers, scales = np.arange(0, LARGEST_SCALE, 0.5), np.atleast_1d(scales)
    sizes = np.array([scale_size(j) for j in numbers])
    wanted = (scales / pixel_scale).to_value(u.one)
    nearest = np.abs(np.log(wanted[:, None] / sizes)).argmin(axis=1)
    for angle, size, k in zip(scales, wanted, nearest, strict=True):
        if abs(size / sizes[k] - 1) > SCALE_TOLERANCE:
            raise ValueError(
                f"scale {angle} is {size:.2g} px, not near 2^j or 1.5 x 2^j px"
            )
    return tuple(numbers[nearest].tolist())


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
    if len(years) < 2:
        raise ValueError("velocities need at least two epochs, the cube has one")
    if baseline is None:
        pairs = consecutive_pairs(years)
        why = (
            f"all {len(years)} epochs are of one date ({cube.times[0].isot}): "
            "velocities need different dates"
        )
    else:
        shortest, longest = baseline.to_value(u.yr)
        pairs = baseline_pairs(years, shortest, longest)
        why = (
            f"no two epochs are {shortest:g} to {longest:g} yr apart: their "
            f"separations go from {np.diff(years).min():.3g} to "
            f"{np.ptp(years):.3g} yr; choose another baseline"
        )
    if len(pairs) == 0:
        raise ValueError(why)
    return pairs


def search_radius(cube, max_speed, fwhm):
    """
    Return the search radius, the largest displacement between epochs, in beams.

    It is one and a half beams, or more if even the shortest intervals are too
    long for that: as far as the largest speed moves in the lower quartile of
    the intervals between epochs, plus a margin.  Without a largest speed, series
    of up to 20 epochs are searched to four beams in the median interval.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    max_speed : float or None
        In mas/yr.
    fwhm : float
        Resolution in mas.

    Returns
    -------
    float
    """
    gaps = np.diff(cube.years.to_value(u.yr))
    gaps = gaps[gaps > 0]
    if len(gaps) == 0:
        return DEFAULT.radius
    short, far = np.quantile(gaps, 0.25), 0.0
    if max_speed is not None:
        far = max_speed * short / fwhm
    elif len(cube) <= FEW_EPOCHS:
        far = FAR_BEAMS * short / np.median(gaps)
    return max(DEFAULT.radius, far + MARGIN * DEFAULT.smoothing)


def search_reach(cube, plan):
    """
    Return the largest displacement to match between any two epochs, in pixels.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    plan : `SearchPlan`

    Returns
    -------
    tuple of int
        Along (y, x).

    Raises
    ------
    ValueError
        If the largest speed leads far out of the image even in the shortest
        interval, or hardly moves anything even in the longest.
    """
    farthest, max_speed = plan.radius * plan.fwhm, plan.max_speed
    # Pixels may not be square: (x, y) sides.
    side, shape = np.hypot(*cube.pixel_matrix.value), np.array(cube.shape[1:])
    if max_speed is not None:
        shortest, longest = plan.pairs.interval.min(), plan.pairs.interval.max()
        unit = cube.speed_unit.bases[1]

        def easy(interval):
            return f"{(interval * u.yr).to(unit):.3g}"

        least, most = max_speed * shortest, max_speed * longest
        if least > MOST_MOTION * np.hypot(*(side * shape[::-1])):
            raise ValueError(
                f"max_speed moves {least:.3g} mas in the shortest interval "
                f"({easy(shortest)}), more than {MOST_MOTION} times the image: give "
                "a smaller one"
            )
        in_longest = f"{most:.3g} mas in the longest interval ({easy(longest)})"
        if most < LEAST_MOTION * side.min():
            raise ValueError(
                f"max_speed moves {in_longest}, less than {LEAST_MOTION:g} of a pixel: "
                "give a larger one, or a baseline with longer intervals"
            )
        if np.any(most / side > (shape.max() - 1) // 2):
            warn(
                f"the largest speed moves {in_longest}, more than half the image: give "
                "a smaller max_speed, or a baseline that leaves out long intervals",
                MeasurementWarning,
            )
        farthest = max(farthest, most + BEYOND * plan.fwhm)
    reach = np.ceil(farthest / side).astype(int)[::-1]
    return tuple(np.minimum(reach, shape - 1).tolist())


def map_grid(displacements, pairs, limit):
    """
    Return the grid of velocities of the stack.

    Parameters
    ----------
    displacements : ``VelocitySamples``
    pairs : ``DatePairs``
    limit : float
        Largest velocity along either axis.

    Returns
    -------
    ``VelocityGrid``
        Spaced by half the narrowest kernel.
    """
    rate = 1 / pairs.interval.max()
    errors = displacements.s1, displacements.s2
    steps = [GRID_STEP * rate * s.min() if len(s) else limit / 20 for s in errors]
    return VelocityGrid.covering(limit, steps)


def flow_direction(matched, frame=None):
    """
    Return the direction of the jet.

    It is that of the velocity axes, if they have one position angle, or that of the
    mean offset of the SSPs, weighted by flux.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
    frame : frame of `astro_scc.kinematics`, optional

    Returns
    -------
    `~astropy.units.Quantity`
        North through east, 0 to 360 deg.
    """
    if isinstance(frame, PositionAngleFrame):
        return frame.pa
    use = matched.select
    east, north = ssp_offsets(matched.ssps, matched.cube)
    weight = matched.ssps.flux[use]
    if weight.sum() <= 0:
        return 0.0 * u.deg
    mean = [np.average(offset[use], weights=weight) for offset in (east, north)]
    return np.degrees(np.arctan2(*mean)) % 360 * u.deg


def ssp_distances(matched, *, origin=None, ridge=None):
    """
    Return the distances of the centroids of SSPs from a point or along a line.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
    origin : `~astropy.units.Quantity`, shape (2,), optional
        (east, north) of the core, by default the reference pixel.
    ridge : `~astro_scc.kinematics.RidgeLine`, optional
        Measure along this line instead of from ``origin``.

    Returns
    -------
    `~astropy.units.Quantity`, shape (n_ssps,)
        In mas.
    """
    east, north = ssp_offsets(matched.ssps, matched.cube, centroid=True) * u.mas
    if ridge is not None:
        return ridge.coordinates(east, north)[0]
    origin = u.Quantity([0, 0] * u.mas if origin is None else origin)
    return np.hypot(east - origin[0], north - origin[1]).to(u.mas)


def select_ssps(
    matched: MatchedEpochs, *, region: Any = None, r_min: u.Quantity | None = None,
    r_max: u.Quantity | None = None, scales: ArrayLike | None = None,
    origin: u.Quantity | SkyCoord | None = None, ridge: RidgeLine | None = None,
) -> MatchedEpochs:  # fmt: skip
    """
    Return the matches of the SSPs in a part of the jet and on some scales.

    Nothing is correlated again; only the matches of the selected SSPs are
    stacked.  An SSP is selected by its centroid; its matches may lie outside.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
    region : optional
        Anything that ``cube.region_mask`` takes.
    r_min, r_max : `~astropy.units.Quantity`, optional
        ``r_min <= r < r_max``.
    scales : sequence of float or `~astropy.units.Quantity`, optional
        Numbers, or angles.
    origin, ridge : optional
        Point from which, or line along which, r is measured, see
        ``ssp_distances``.

    Returns
    -------
    `~astro_scc.measurement.MatchedEpochs`

    Raises
    ------
    ValueError
        If ``r_min`` is not below ``r_max``, or a scale was not decomposed.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.measurement import select_ssps
    >>> from astro_scc.simulation import simulate_static
    >>> matched = StackedCrossCorrelation(scales=[1, 2]).match(
    ...     simulate_static(n_epochs=3, rng=1).cube)
    >>> inner = select_ssps(matched, r_max=8 * u.mas, scales=[1])
    >>> bool(0 < inner.select.sum() < matched.select.sum())
    True
    """
    select = matched.select & centroids_inside(matched.ssps, matched.cube, region)
    if r_min is not None or r_max is not None:
        low = 0 * u.mas if r_min is None else u.Quantity(r_min)
        high = np.inf * u.mas if r_max is None else u.Quantity(r_max)
        if not low < high:
            raise ValueError(f"r_min={r_min} must be below r_max={r_max}")
        r = ssp_distances(matched, origin=origin, ridge=ridge)
        select &= (r >= low) & (r < high)
    if scales is not None:
        scales = require("scales", scales)
        numbers = scales_of_pixels(scales, matched.cube.pixel_scale)
        have = matched.scales
        missing = [s for s in numbers if s not in have]
        if missing:
            what, there = (", ".join(f"{s:g}" for s in v) for v in (missing, have))
            raise ValueError(f"scale {what} was not decomposed; there are {there}")
        select &= np.isin(matched.ssps.scale, numbers)
    return matched.part(select)


def warn_of_none_inside(ssps, select, region):
    """
    Warn if a region holds none of the SSPs.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
    select : `~numpy.ndarray` of bool, shape (n_ssps,)
        Those with their centroid in the region.
    region : optional
        The region, or None for everything, which gives no warning.

    Warns
    -----
    `~astro_scc.exceptions.MeasurementWarning`
        If there are SSPs, but none in the region.
    """
    if region is None or np.any(select) or len(ssps) == 0:
        return
    name = region if isinstance(region, str | os.PathLike) else "the region"
    warn(
        f"{name}: no significant pattern has its centroid inside, {len(ssps)} in the "
        "rest of the images: check where it lies, or make it larger",
        MeasurementWarning,
    )
