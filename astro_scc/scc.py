# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Stacked cross-correlation: the call that runs all stages of a measurement.

::

    cube       = EpochCube.read(files)         # EpochCube, epochs/cube.py
    decomposed = scc.decompose(cube)           # DecomposedEpochs, patterns.py
    features   = decomposed.follow()           # Features, features/finder.py
    flow       = scc.flow(decomposed)          # DecomposedFlow, streams/decomposed.py
    search     = find_streams(flow, features)  # StreamSearch, streams/finder.py
      flow, test = find_motion(flow)             # MotionTest, spectrum/permutations.py
      part       = fit_along_lines(flow)         # PartFit, streams/decomposed.py
        diagram    = correlate(flow.planes[0])     # Diagram, spectrum/diagram.py
      spectrum   = deconvolve(part.equations)    # shares; spectrum/equations.py
    result     = SCCResult(decomposed, search) # SCCResult, measurement/result.py
"""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from typing import Any

from astropy.table import QTable
from threadpoolctl import threadpool_limits

from astro_scc import patterns, plan
from astro_scc.decomposition import Decomposer
from astro_scc.decomposition.segmentation import require_ssps
from astro_scc.epochs import EpochCube
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.grid import has_core
from astro_scc.kinematics import PositionAngleFrame
from astro_scc.measurement import SCCResult
from astro_scc.measurement.cautions import parts_of
from astro_scc.paper.method import match, measure_as_in_paper, plan_matches
from astro_scc.parallel import Workers, progress
from astro_scc.quantities import Seed, seeded
from astro_scc.settings import (
    MeasurementSettings,
    Settings,
    refuse_other_method,
    require,
)
from astro_scc.streams.decomposed import DecomposedFlow, decompose_flow
from astro_scc.streams.finder import find_streams
from astro_scc.streams.members import passing_features
from astro_scc.writing import versions

__all__ = ["StackedCrossCorrelation", "measure_velocities"]


class StackedCrossCorrelation(MeasurementSettings):
    """
    Measure the streams of a flow by stacked cross-correlation.

    The object holds the settings; calling it with a cube measures the cube.
    Settings with a unit may be text, as on the command line.

    Parameters
    ----------
    method : {"spectrum", "paper"}, optional
        Find streams in the velocity spectrum, or as Mertens & Lobanov
        (2016): then a call returns an `~astro_scc.paper.method.PaperMeasurement`.
    scales : sequence of float or str, optional
        Wavelet scales, by number (j means 2^j pixels, j + 1/2 means
        1.5 x 2^j) or by size, as angles; by default the three up to 0.55 beams for
        the velocity spectrum and, for SSPs, from a quarter of the beam to two beams
        or, without a beam, up to half of the size of structures.
    max_speed : `~astropy.units.Quantity`, optional
        Largest proper motion, by default two beams in the shorter quarter of the
        intervals between consecutive epochs.
    position_angle : `~astropy.units.Quantity`, str or frame, optional
        Direction of the jet, north through east, for velocity axes along
        and across it, or "fit" for the direction of the jet in the mean
        image; "radial" for axes away from the reference pixel; "ridge" for
        axes along and across the ridge line of the mean image; or a frame of
        `astro_scc.kinematics`.  By default the axes are east and north, and what flows
        along a one-sided jet is measured, or else along any of twelve directions;
        "any" is always the latter.
    baseline : `~astropy.units.Quantity`, shape (2,), optional
        Shortest and longest time between two epochs that are compared, by
        default all.
    min_error_beams : float, optional
        Smallest standard error of a displacement, in beams.
    kappa, target, min_overlap
        See `~astro_scc.paper.Correlator`.
    wavelet, detection, segmentation, noise
        ``kernel`` and the rest of `~astro_scc.decomposition.Decomposer`.
    alpha : float, optional
        Largest ``p_global`` of a significant stream.
    outward : bool, optional
        Search only speeds away from the core, or without one along the position
        angle, if the jet has a direction.
    alignment_error : `~astropy.units.Quantity`, optional
        Standard error of the alignment on either axis, one for all epochs or
        one per epoch.  By default the error that `~astro_scc.EpochCube.align` found.
    small_displacement_correction : bool, optional
        Shift the permuted images by a fifth of the beam (paper, Sect. 2.3).
    common_beam : bool, optional
        By default epochs whose beams differ are refused;
        ``cube.to_common_beam()`` convolves them to one beam.  False measures
        them as they are.

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

    def __post_init__(self):
        super().__post_init__()
        self._decomposer(self.scales if isinstance(self.scales, tuple) else (1,))

    @classmethod
    def from_settings(cls, settings: Settings) -> StackedCrossCorrelation:
        """
        Return the measurement that settings describe.

        Parameters
        ----------
        settings : `~astro_scc.settings.Settings`

        Returns
        -------
        `StackedCrossCorrelation`
        """
        names = (one.name for one in fields(MeasurementSettings))
        return cls(**{name: getattr(settings, name) for name in names})

    def _decomposer(self, scales):
        return Decomposer(
            scales, self.wavelet, self.detection, self.segmentation, self.noise
        )

    def decomposer(self, cube: EpochCube) -> Decomposer:
        """
        Return the decomposer for the epochs of a cube.

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`

        Returns
        -------
        `~astro_scc.decomposition.Decomposer`
        """
        scales = plan.scale_numbers(cube, self.scales)
        return patterns.allow_for_structure(cube, self._decomposer(scales))

    def decompose(
        self, cube: EpochCube, *, region: Any = None,
        n_workers: Workers = 1, progress_bar: bool = False,
    ) -> patterns.DecomposedEpochs:  # fmt: skip
        """
        Decompose the epochs into wavelets and significant structural patterns (SSPs).

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`
        region : optional
            Anything that ``cube.region_mask`` takes.
        n_workers : int, str or `dask.distributed.Client`, optional
            Number of processes, or a Dask scheduler, given by its address or a
            client.  The results do not depend on it.
        progress_bar : bool, optional
            Show the progress on standard error.

        Returns
        -------
        `~astro_scc.patterns.DecomposedEpochs`

        Raises
        ------
        TypeError
            If ``cube`` is no cube.
        ValueError
            If the beams of the epochs differ, unless ``common_beam`` is False.

        Warns
        -----
        `~astro_scc.exceptions.MeasurementWarning`
            If no SSP lies in the region, structure fills the images, or the alignment
            of the epochs scatters by 0.2 beams or more.
        """
        patterns.check_cube(cube, self.common_beam)
        found, _ = patterns.decompose_epochs(
            cube, self.decomposer(cube), region=region, n_workers=n_workers,
            progress_bar=progress_bar,
        )  # fmt: skip
        if empty := patterns.empty_region(found, region):
            warn(empty, MeasurementWarning)
        return found

    plan, match = plan_matches, match

    def flow(self, decomposed: patterns.DecomposedEpochs) -> DecomposedFlow:
        """
        Return what changes in the images, along the flow.

        Parameters
        ----------
        decomposed : `~astro_scc.patterns.DecomposedEpochs`

        Returns
        -------
        ``DecomposedFlow``
            On the scales of the settings, or the three up to 0.55 beams.

        Raises
        ------
        ValueError
            If no flow is seen, there are two epochs or fewer, or none are as far apart
            as ``baseline``.
        """
        cube = decomposed.cube
        intervals = plan.used_intervals(cube, self.baseline)
        scales = None if self.scales is None else plan.scale_numbers(cube, self.scales)
        plan.require_speed(cube, self.max_speed)
        frame = plan.velocity_frame(cube, self.position_angle)
        # A one-sided jet has a direction, also where the axes are east and north.
        given = self.position_angle is not None
        along = None if given else plan.choose_direction(cube)[0]
        beam = plan.flow_beam(cube)
        passes = has_core(cube, beam) and passing_features(decomposed.features, beam)
        flow = decompose_flow(
            cube, frame if along is None else PositionAngleFrame(along), scales=scales,
            beam=beam, region=decomposed.region, max_speed=self.max_speed,
            kernel=self.wavelet, passes=bool(passes),
        )  # fmt: skip
        found = self.position_angle is None or isinstance(self.position_angle, str)
        return replace(flow, frame=frame, given=not found, intervals=intervals)

    def measure(
        self, decomposed: patterns.DecomposedEpochs, *, n_trials: int = 1000,
        rng: Seed | None = None, n_workers: Workers = 1, progress_bar: bool = False,
    ) -> SCCResult:  # fmt: skip
        """
        Measure the streams of decomposed epochs.

        Parameters
        ----------
        decomposed : `~astro_scc.patterns.DecomposedEpochs`
        n_trials : int, optional
            Number of permutations of the innovations of the epochs.
        rng : None, int or `~numpy.random.Generator`, optional
            Seed of the trials.
        n_workers : int, str or `dask.distributed.Client`, optional
            See `decompose`; they find the features.
        progress_bar : bool, optional

        Returns
        -------
        `~astro_scc.measurement.SCCResult`

        Raises
        ------
        ValueError
            If ``n_trials`` is below 2, there are two epochs or fewer, no flow is
            seen, or ``method`` is ``'paper'``, which starts from the images.

        Warns
        -----
        `~astro_scc.exceptions.MeasurementWarning`
            If there are so few trials or epochs that no ``p_global`` can be as
            small as ``alpha``.
        """
        n_trials = require("n_trials", n_trials)
        if self.method == "paper":
            raise ValueError(
                "method = 'paper' measures images, not decomposed epochs: call the "
                "settings with a cube, or use method='spectrum'"
            )
        (generator, seed), cube = seeded(rng), decomposed.cube
        features = decomposed.follow(n_workers=n_workers, progress_bar=progress_bar)
        refuse_other_method("spectrum", self.to_dict())
        # The matrix products are small: threads would wait for one another.
        with threadpool_limits(1), progress(None, "Searching", show=progress_bar):
            flow = self.flow(decomposed)
            search = find_streams(
                flow, features, self, n_trials=n_trials, rng=generator
            )
            choices = parts_of(search)
        smallest = search.test.p_smallest
        if said := plan.out_of_reach(smallest, len(cube), n_trials, self.alpha):
            warn(said, MeasurementWarning)
        angle = plan.flow_direction(decomposed, flow.frame)
        meta = meta_of(self, n_trials, seed) | {
            "jet_position_angle": angle, "misalignment_beams": cube.misalignment,
        }  # fmt: skip
        return SCCResult(decomposed, search, angle, choices, meta)

    def __call__(
        self, cube: EpochCube, *, region: Any = None, n_trials: int = 1000,
        rng: Seed | None = None, n_workers: Workers = 1, progress_bar: bool = False,
    ) -> SCCResult:  # fmt: skip
        """
        Measure the streams of a cube.

        Parameters
        ----------
        cube : `~astro_scc.epochs.EpochCube`
        region : optional
            A region of `regions`, the path of a region file or a boolean
            image.  Only what moves inside is measured.
        n_trials, rng
            See `measure`.
        n_workers : int, str or `dask.distributed.Client`, optional
            See `decompose`.
        progress_bar : bool, optional

        Returns
        -------
        `~astro_scc.measurement.SCCResult` or PaperMeasurement
            See `~astro_scc.paper.method.PaperMeasurement` and ``method``.

        Raises
        ------
        ValueError
            If no two epochs make a pair, the beams differ, no epoch has an SSP,
            or a setting does not fit the images or the method.
        """
        # Refused before the decomposition.
        n_trials = require("n_trials", n_trials)
        refuse_other_method(self.method, self.to_dict())
        if self.method == "paper":
            found: Any = measure_as_in_paper(
                cube, self, region=region, n_trials=n_trials, rng=rng,
                n_workers=n_workers, progress_bar=progress_bar,
            )  # fmt: skip
            return found
        shown = {"n_workers": n_workers, "progress_bar": progress_bar}
        decomposed = self.decompose(cube, region=region, **shown)
        require_ssps(decomposed.ssps, decomposed.scales)
        return self.measure(decomposed, n_trials=n_trials, rng=rng, **shown)

    def to_dict(self) -> dict[str, Any]:
        """
        Return the settings as a dictionary that the meta of a table can hold.

        Returns
        -------
        dict
        """
        values = asdict(self).items()
        return {k: list(v) if isinstance(v, tuple) else v for k, v in values}


def measure_velocities(
    cube: EpochCube, *, region: Any = None, n_trials: int = 1000,
    rng: Seed | None = None, n_workers: Workers = 1, **settings: Any,
) -> QTable:  # fmt: skip
    """
    Measure the streams of a cube in one call.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    region, n_trials, rng, n_workers
        See `StackedCrossCorrelation`.
    **settings
        The parameters of `StackedCrossCorrelation`.

    Returns
    -------
    `~astropy.table.QTable`
        The streams, see `~astro_scc.measurement.SCCResult.streams`.

    Examples
    --------
    >>> from astro_scc import measure_velocities
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(rng=1).cube
    >>> table = measure_velocities(cube, scales=[1, 2, 3], n_trials=100, rng=1)
    >>> table["pm"].unit
    Unit("mas / yr")
    """
    scc = StackedCrossCorrelation(**settings)
    return scc(
        cube, region=region, n_trials=n_trials, rng=rng, n_workers=n_workers
    ).components


def meta_of(scc, n_trials, seed):
    """Return what the meta of a table says on how it was made."""
    made = {"settings": scc.to_dict(), "n_trials": int(n_trials), "seed": seed}
    return made | {"versions": versions()}
