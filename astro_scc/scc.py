# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Stacked cross-correlation: the one call that ties the stages together."""

import warnings
from dataclasses import asdict, dataclass
from itertools import starmap

import astropy.units as u
import numpy as np

from astro_scc.correlation import Correlator, all_pairs
from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.exceptions import MeasurementWarning
from astro_scc.kinematics import PositionAngleFrame, RadialFrame, SkyFrame
from astro_scc.measurement import (
    MatchedEpochs,
    SCCResult,
    angular_displacements,
    beam_fwhm,
    ssp_offsets,
    versions,
)
from astro_scc.measurement.tables import PM_UNIT
from astro_scc.progress import progress
from astro_scc.stacking import (
    PairMaps,
    VelocityGrid,
    baseline_pairs,
    consecutive_pairs,
    find_components,
    jitter_positions,
    shuffle_epochs,
    stack,
)

__all__ = ["StackedCrossCorrelation", "measure_velocities"]

#: Without a largest speed, displacements up to this many beams are tried.
BEAMS_PER_INTERVAL = 4.0
#: Spacing of the velocity grid in units of the narrowest kernel.
GRID_STEP = 0.5
#: Shift of the paper's correction for small displacements, in beams.
SMALL_SHIFT = 0.2


@dataclass(frozen=True, kw_only=True)
class StackedCrossCorrelation:
    """
    Measure velocity components by stacked cross-correlation.

    The settings are kept; calling the object on a cube measures it.

    Parameters
    ----------
    scales : sequence of float, optional
        Wavelet scales by number (j means 2^j pixels, j + 1/2 means
        1.5 x 2^j) or as an angle `~astropy.units.Quantity`.
    max_speed : `~astropy.units.Quantity`, optional
        Largest proper motion along either axis.  By default four beams
        over the median interval of the pairs of epochs.
    position_angle : `~astropy.units.Quantity` or "radial", optional
        Direction of the jet, north through east, for velocity axes along
        and across it; "radial" for axes away from the reference pixel.  The
        axes are east and north without it.
    baseline : `~astropy.units.Quantity`, shape (2,), optional
        Shortest and longest time between two epochs that are paired.
        Consecutive epochs are paired without it.
    kernel : float, optional
        Smallest standard error of a displacement, in beams.
    kappa, target, min_overlap
        See `~astro_scc.correlation.Correlator`.
    wavelet, detection, segmentation, noise
        ``kernel`` and the rest of `~astro_scc.decomposition.Decomposer`.
    min_z_score : float, optional
        Components below this significance are not listed.
    small_displacement_correction : bool, optional
        Shift the shuffled images by a fifth of the beam (paper, Sect. 2.3).

    Raises
    ------
    ValueError
        If a setting is out of its range.
    `~astropy.units.UnitConversionError`
        If a unit does not fit.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[1, 2, 3], max_speed=36 * u.mas / u.yr,
    ...                               position_angle=270 * u.deg)
    >>> result = scc(cube, n_trials=100, rng=1)
    >>> bool(len(result.components) >= 2)
    True
    """

    scales: tuple = (1, 2, 3, 4)
    max_speed: u.Quantity | None = None
    position_angle: u.Quantity | str | None = None
    baseline: u.Quantity | None = None
    kernel: float = 0.2
    kappa: float = 0.6
    target: str = "segments"
    min_overlap: float = 0.8
    wavelet: str = "b1"
    detection: float = 4.0
    segmentation: float = 3.0
    noise: str = "plane"
    min_z_score: float = 3.0
    small_displacement_correction: bool = False

    def __post_init__(self):
        if self.max_speed is not None:
            speed = _in_unit("max_speed", self.max_speed, PM_UNIT)
            if not (speed.isscalar and 0 < speed.value < np.inf):
                raise ValueError(f"max_speed must be one positive speed, got {speed}")
            object.__setattr__(self, "max_speed", speed)
        if self.baseline is not None:
            baseline = _in_unit("baseline", self.baseline, u.yr)
            if baseline.shape != (2,) or not 0 <= baseline[0] <= baseline[1]:
                raise ValueError(
                    f"baseline must be a shortest and a longest time, got {baseline}"
                )
            object.__setattr__(self, "baseline", baseline)
        if isinstance(self.position_angle, str):
            if self.position_angle != "radial":
                raise ValueError(
                    "position_angle must be an angle or 'radial', "
                    f"got {self.position_angle!r}"
                )
        elif self.position_angle is not None:
            angle = _in_unit("position_angle", self.position_angle, u.deg)
            if not (angle.isscalar and np.isfinite(angle)):
                raise ValueError(
                    f"position_angle must be one finite angle, got {angle}"
                )
            object.__setattr__(self, "position_angle", angle)
        if not 0 < self.kernel < 5:
            raise ValueError(f"kernel must be a part of the beam, got {self.kernel}")
        if isinstance(self.scales, u.Quantity):
            sizes = _in_unit("scales", self.scales, u.mas).value
            if np.size(sizes) == 0 or not np.all((sizes > 0) & np.isfinite(sizes)):
                raise ValueError(f"scales must be positive angles, got {self.scales}")
            self._decomposer((1,))
        else:
            scales = tuple(float(s) for s in np.atleast_1d(self.scales))
            object.__setattr__(self, "scales", scales)
            self._decomposer(scales)
        self._correlator()

    def _decomposer(self, scales):
        return Decomposer(
            scales=scales,
            kernel=self.wavelet,
            detection=self.detection,
            segmentation=self.segmentation,
            noise=self.noise,
        )

    def _correlator(self):
        return Correlator(
            kappa=self.kappa, target=self.target, min_overlap=self.min_overlap
        )

    def scale_numbers(self, cube):
        """
        The scales as numbers, for the pixels of a cube.

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`

        Returns
        -------
        tuple of float

        Raises
        ------
        ValueError
            If an angle is not within 20% of a scale's size.
        """
        if not isinstance(self.scales, u.Quantity):
            return self.scales
        numbers = np.arange(0, 12, 0.5)
        sizes = np.array([2.0 ** int(j) * (1.5 if j % 1 else 1.0) for j in numbers])
        wanted = (np.atleast_1d(self.scales) / cube.pixel_scale).to_value(u.one)
        nearest = np.abs(np.log(wanted[:, None] / sizes)).argmin(axis=1)
        for angle, size, k in zip(
            np.atleast_1d(self.scales), wanted, nearest, strict=True
        ):
            if abs(size / sizes[k] - 1) > 0.2:
                raise ValueError(
                    f"scale {angle} is {size:.2g} px, not near 2^j or 1.5 x 2^j px"
                )
        return tuple(numbers[nearest])

    def date_pairs(self, cube):
        """
        The pairs of dates that are compared.

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`

        Returns
        -------
        `~astro_scc.stacking.DatePairs`

        Raises
        ------
        ValueError
            If no two epochs make a pair.
        """
        years = cube.years.to_value(u.yr)
        if len(years) < 2:
            raise ValueError("velocities need at least two epochs, the cube has one")
        if self.baseline is None:
            pairs = consecutive_pairs(years)
            if len(pairs) == 0:
                raise ValueError(
                    f"all {len(years)} epochs are of one date ({cube.times[0].isot}): "
                    "velocities need different dates"
                )
            return pairs
        shortest, longest = self.baseline.to_value(u.yr)
        pairs = baseline_pairs(years, shortest, longest)
        if len(pairs) == 0:
            raise ValueError(
                f"no two epochs are {shortest:g} to {longest:g} yr apart: their "
                f"separations go from {np.diff(years).min():.3g} to "
                f"{np.ptp(years):.3g} yr; choose another baseline"
            )
        return pairs

    def speed_limit(self, cube):
        """
        The largest speed that is searched.

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`

        Returns
        -------
        `~astropy.units.Quantity`
            In mas/yr.
        """
        if self.max_speed is not None:
            return self.max_speed
        interval = np.median(self.date_pairs(cube).interval)
        every = np.arange(len(cube))
        scale = np.full(len(cube), max(self.scale_numbers(cube)))
        width = np.median(beam_fwhm(cube, every, scale, np.eye(2)))
        return BEAMS_PER_INTERVAL * width / interval * PM_UNIT

    def match(self, cube, *, region=None, n_workers=1, progress_bar=False):
        """
        Decompose the epochs and correlate their SSPs.

        This is the long part; everything after it is a stack of the same
        matches.

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`
        region : optional
            Anything that ``cube.region_mask`` takes.  SSPs whose centroid
            lies inside are correlated.
        n_workers : int, optional
        progress_bar : bool, optional
            Show the progress on standard error.

        Returns
        -------
        `~astro_scc.measurement.MatchedEpochs`
        """
        pairs = self.date_pairs(cube)
        decompose = self._decomposer(self.scale_numbers(cube))
        decompositions = tuple(
            starmap(
                lambda k, image: self._decompose(decompose, cube, k, image),
                enumerate(cube.data),
            )
        )
        ssps = SSPs.of_epochs(decompositions)
        select = np.ones(len(ssps), bool)
        if region is not None:
            inside = cube.region_mask(region)
            row = np.clip(np.rint(ssps.y_centroid).astype(int), 0, inside.shape[0] - 1)
            column = np.clip(
                np.rint(ssps.x_centroid).astype(int), 0, inside.shape[1] - 1
            )
            select = inside[row, column]
        reach = self._reach(cube, pairs)
        with progress(len(cube), "Correlating", show=progress_bar) as done:
            matches = self._correlator()(
                decompositions,
                all_pairs(len(cube)),
                reach,
                select=select,
                n_workers=n_workers,
                progress=done,
            )
        return MatchedEpochs(cube, decompositions, ssps, select, matches)

    def _decompose(self, decompose, cube, k, image):
        mask = None if cube.mask is None else cube.mask[k]
        if self.noise != "propagated":
            return decompose(image, mask=mask)
        rms = cube.noise_rms()[k].value
        covariance = None
        if cube.beams is not None:
            inverse = np.linalg.inv(cube.pixel_matrix.value)
            covariance = inverse @ cube.beams[k].covariance.value @ inverse.T
        return decompose(image, mask=mask, rms=rms, beam_covariance=covariance)

    def _reach(self, cube, pairs):
        """Largest displacement (y, x) in pixels that any order of the epochs needs."""
        longest = pairs.interval.max()
        farthest = self.speed_limit(cube).value * longest
        every = np.arange(len(cube))
        scale = np.full(len(cube), max(self.scale_numbers(cube)))
        margin = self.kernel * beam_fwhm(cube, every, scale, np.eye(2)).max()
        # Pixels may not be square: (x, y) sides.
        side = np.hypot(*cube.pixel_matrix.value)
        reach = np.ceil((farthest + margin) / side).astype(int)[::-1]
        limit = np.array(cube.shape[1:]) - 1
        if np.any(reach > limit.max() // 2):
            warnings.warn(
                f"the largest speed moves {farthest:.3g} mas in the longest interval "
                f"({longest:.3g} yr), more than half the image: give a smaller "
                "max_speed, or a baseline that leaves out long intervals",
                MeasurementWarning,
                stacklevel=4,
            )
        return tuple(np.minimum(reach, limit))

    def _frame(self, matched):
        """The velocity frame, and the direction of the jet."""
        if isinstance(self.position_angle, u.Quantity):
            return PositionAngleFrame(self.position_angle), self.position_angle
        angle = _flow_direction(matched)
        if self.position_angle == "radial":
            return RadialFrame(), angle
        return SkyFrame(), angle

    def stack(self, matched, *, n_trials=1000, rng=None, progress_bar=False):
        """
        Stack matches and measure the components.

        Parameters
        ----------
        matched : `~astro_scc.measurement.MatchedEpochs`
        n_trials : int, optional
            Number of shuffled orders and of position trials.
        rng : None, int or `~numpy.random.Generator`, optional
            Seed of the trials.
        progress_bar : bool, optional

        Returns
        -------
        `~astro_scc.measurement.SCCResult`

        Raises
        ------
        ValueError
            If ``n_trials`` is below 2.
        """
        if n_trials < 2:
            raise ValueError(f"n_trials must be at least 2, got {n_trials}")
        if rng is None:
            rng = int(np.random.SeedSequence().entropy % 2**63)
        seed = int(rng) if isinstance(rng, (int, np.integer)) else None
        shuffle_rng, jitter_rng = np.random.default_rng(rng).spawn(2)
        cube = matched.cube
        pairs = self.date_pairs(cube)
        frame, angle = self._frame(matched)
        displacements = angular_displacements(
            matched.matches,
            matched.ssps,
            cube,
            frame,
            self.kernel,
            select=matched.select,
        )
        limit = self.speed_limit(cube).value
        grid = _velocity_grid(displacements, pairs, limit)
        scc = stack(displacements, pairs, grid)
        fwhm = beam_fwhm(
            cube, np.arange(len(cube)), np.full(len(cube), 1.0), np.eye(2)
        ).mean()
        shift = (
            (SMALL_SHIFT * fwhm,) * 2 if self.small_displacement_correction else None
        )
        maps = PairMaps.of(displacements, grid.v_max, pairs.interval.max())
        with progress(n_trials, "Shuffling", show=progress_bar) as done:
            shuffled = shuffle_epochs(
                maps, pairs, grid, scc, n_trials, rng=shuffle_rng, shift=shift,
                progress=done,
            )  # fmt: skip
        z_score = shuffled.z_score(scc)
        box = (fwhm / np.average(pairs.interval, weights=pairs.weight),) * 2
        maxima = tuple(
            c
            for c in find_components(scc, grid, box)
            if z_score[c.row, c.column] >= self.min_z_score
        )
        errors = []
        with progress(len(maxima), "Jittering", show=progress_bar) as done:
            for component, own in zip(
                maxima, jitter_rng.spawn(len(maxima)), strict=True
            ):
                errors.append(
                    jitter_positions(
                        displacements, pairs, component, box, n_trials, rng=own
                    )
                )
                done(1)
        return SCCResult(
            matched=matched,
            frame=frame,
            position_angle=angle,
            pairs=pairs,
            displacements=displacements,
            grid=grid,
            coefficient=scc,
            z_score=z_score,
            shuffled=shuffled,
            maxima=maxima,
            errors=tuple(errors),
            meta={
                "settings": self.to_dict(),
                "n_trials": int(n_trials),
                "seed": seed,
                "versions": versions(),
                "jet_position_angle": angle,
            },
        )

    def __call__(
        self,
        cube,
        *,
        region=None,
        n_trials=1000,
        rng=None,
        n_workers=1,
        progress_bar=False,
    ):
        """
        Measure the velocity components of a cube.

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`
        region : optional
            A region of `regions`, the path of a region file or a boolean
            image; only SSPs with their centroid inside are correlated.
        n_trials : int, optional
            Number of shuffled orders and of position trials.
        rng : None, int or `~numpy.random.Generator`, optional
            Seed of the trials.
        n_workers : int, optional
        progress_bar : bool, optional

        Returns
        -------
        `~astro_scc.measurement.SCCResult`

        Raises
        ------
        ValueError
            If no two epochs make a pair, or a setting does not fit the
            images.
        """
        matched = self.match(
            cube, region=region, n_workers=n_workers, progress_bar=progress_bar
        )
        return self.stack(
            matched, n_trials=n_trials, rng=rng, progress_bar=progress_bar
        )

    def to_dict(self):
        """
        The settings, as a dictionary that a table's meta can hold.

        Returns
        -------
        dict
        """
        return {
            k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()
        }


def measure_velocities(
    cube, *, region=None, n_trials=1000, rng=None, n_workers=1, **settings
):
    """
    Measure the velocity components of a cube in one call.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    region, n_trials, rng, n_workers
        See `StackedCrossCorrelation`.
    **settings
        Of `StackedCrossCorrelation`.

    Returns
    -------
    `~astropy.table.QTable`
        The components, see `~astro_scc.measurement.SCCResult.components`.

    Examples
    --------
    >>> from astro_scc import measure_velocities
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(rng=1).cube
    >>> table = measure_velocities(cube, scales=[1, 2, 3], n_trials=50, rng=1)
    >>> table["pm"].unit
    Unit("mas / yr")
    """
    scc = StackedCrossCorrelation(**settings)
    return scc(
        cube, region=region, n_trials=n_trials, rng=rng, n_workers=n_workers
    ).components


def _in_unit(name, value, unit):
    try:
        return u.Quantity(value).to(unit)
    except u.UnitConversionError:
        raise u.UnitConversionError(
            f"{name} must be in a unit like {unit}, got {value}"
        ) from None


def _velocity_grid(displacements, pairs, limit):
    rate = 1 / pairs.interval.max()
    steps = [
        GRID_STEP * rate * (s.min() if len(s) else np.inf)
        for s in (displacements.s1, displacements.s2)
    ]
    steps = [step if np.isfinite(step) else limit / 20 for step in steps]
    return VelocityGrid.covering(limit, steps)


def _flow_direction(matched):
    """Position angle of the mean offset of the SSPs, weighted by flux."""
    use = matched.select
    east, north = ssp_offsets(matched.ssps, matched.cube)
    weight = matched.ssps.flux[use]
    if weight.sum() <= 0:
        return 0.0 * u.deg
    mean = [np.average(offset[use], weights=weight) for offset in (east, north)]
    return np.degrees(np.arctan2(*mean)) % 360 * u.deg
