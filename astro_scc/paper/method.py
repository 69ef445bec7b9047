# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The paper's own method: from a cube of images to matches and streams."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np
from astropy.table import QTable
from threadpoolctl import threadpool_limits

from astro_scc import patterns
from astro_scc.columns import build_table, round_to_errors
from astro_scc.decomposition.segmentation import require_ssps
from astro_scc.epochs import EpochCube
from astro_scc.exceptions import MeasurementWarning, warn
from astro_scc.images.beam import beam_fwhm, position_errors
from astro_scc.images.positions import name_by_frame, ssp_offsets
from astro_scc.measurement.tables import VelocityMaps, ssp_table, velocity_columns
from astro_scc.paper import stack
from astro_scc.paper.correlate import Correlator, all_pairs, target_ssps
from astro_scc.parallel import Workers, progress, workers_of
from astro_scc.plan import (
    flow_beam,
    flow_direction,
    motion_of,
    require_pairs,
    scale_numbers,
    velocity_frame,
)
from astro_scc.quantities import Seed, seeded
from astro_scc.settings import MeasurementSettings, refuse_other_method, require
from astro_scc.spectrum.rays import VelocityMap
from astro_scc.units import PM_UNIT, in_speed_unit
from astro_scc.writing import versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["PaperMeasurement", "measure_as_in_paper"]

#: Kinds of rows in their order.
KINDS = "moving", "stationary", "not significant"


def plan_matches(
    settings: Any, cube: EpochCube
) -> tuple[tuple[float, ...], stack.DatePairs, float, tuple[int, int]]:
    """
    Return what settings mean for matches of SSPs in a cube.

    Parameters
    ----------
    settings : `~astro_scc.StackedCrossCorrelation`
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    scales : tuple of float
        Numbers of the scales.
    pairs : ``DatePairs``
        Pairs of dates that are compared, consecutive ones without a ``baseline``.
    max_speed : float
        The largest speed of a match, in mas/yr.
    reach : tuple of int
        The largest displacement to match between any two epochs, along (y, x) in
        pixels.

    Raises
    ------
    ValueError
        If no two epochs make a pair, a scale does not fit the pixels, or the
        largest speed leads far out of the image even in the shortest interval, or
        hardly moves anything even in the longest.

    Examples
    --------
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(rng=1).cube
    >>> scales, pairs, _, reach = StackedCrossCorrelation().plan(cube)
    >>> scales, len(pairs), reach
    ((1, 2, 3, 4), 9, (50, 50))
    """
    years, baseline = cube.years.to_value(u.yr), settings.baseline
    if baseline is None:
        pairs = stack.consecutive_pairs(years)
    else:
        pairs = stack.baseline_pairs(years, *baseline.to_value(u.yr))
    require_pairs(cube, baseline, len(pairs))
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
    return scales, pairs, speed, reach


def match(
    settings: Any, cube: EpochCube, *, region: Any = None, n_workers: Workers = 1,
    progress_bar: bool = False,
) -> patterns.DecomposedEpochs:  # fmt: skip
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
    `~astro_scc.patterns.DecomposedEpochs`
        With ``matches``.

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
    *_, reach = settings.plan(cube)
    found = match_epochs(
        cube, settings, reach, region=region, n_workers=n_workers,
        progress_bar=progress_bar,
    )  # fmt: skip
    if empty := patterns.empty_region(found, region):
        warn(empty, MeasurementWarning)
    return found


def match_epochs(
    cube, settings, reach, *, pairs=None, region=None, n_workers=1, progress_bar=False
):
    """
    Decompose epochs and correlate their SSPs.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    settings : `~astro_scc.StackedCrossCorrelation`
    reach : tuple of int
        See `plan_matches`.
    pairs : `~numpy.ndarray` of int, shape (n, 2), optional
        Ordered pairs of epochs that are correlated, by default all.
    region, n_workers, progress_bar
        See `~astro_scc.StackedCrossCorrelation.match`.

    Returns
    -------
    `~astro_scc.patterns.DecomposedEpochs`
        With ``matches``.
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
                decompositions, pairs, reach, select=found.select,
                n_workers=workers, progress=done,
            )  # fmt: skip
    return replace(found, matches=matches)


def matched_displacements(matched, frame, min_error_beams):
    """
    Return matches as displacements along the axes of a frame, in mas.

    Parameters
    ----------
    matched : `~astro_scc.patterns.DecomposedEpochs`
        With ``matches``.
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


# -- the measurement ----------------------------------------------------------------


@dataclass(frozen=True, eq=False, repr=False)
class PaperMeasurement(VelocityMaps):
    """
    The streams that the paper's method finds in a cube.

    Attributes
    ----------
    matched : `~astro_scc.patterns.DecomposedEpochs`
        With ``matches``.
    frame : frame of `astro_scc.kinematics`
        The two axes of velocities.
    position_angle : `~astropy.units.Quantity`
        Direction of the jet, north through east.
    grid : ``VelocityMap``
        The stack, and its velocities in mas/yr.
    trial_z : `~numpy.ndarray`, shape (n_trials,)
        The largest z-score of each trial.
    found : list of dict
        The components, see `astro_scc.paper.stack_patterns`.
    meta : dict
        Level of significance, seed, numbers of trials, SSPs and pairs, and versions.

    Examples
    --------
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.paper.method import measure_as_in_paper
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=4, rng=1).cube
    >>> found = measure_as_in_paper(cube, StackedCrossCorrelation(), n_trials=9, rng=1)
    >>> found.velocity_map("z_score").data.shape == found.grid.shape
    True
    """

    matched: patterns.DecomposedEpochs
    frame: Any
    position_angle: u.Quantity
    grid: VelocityMap
    trial_z: np.ndarray
    found: list[dict[str, Any]]
    meta: dict[str, Any]

    def __repr__(self):
        n = len(self.found)
        return f"<PaperMeasurement: {len(self.cube)} epochs, {n} streams>"

    @property
    def cube(self) -> EpochCube:
        """The epochs that were measured."""
        return self.matched.cube

    @property
    def ssps(self) -> QTable:
        """The SSPs of all epochs as a `~astropy.table.QTable`."""
        return ssp_table(self.matched)

    @property
    def level(self) -> float:
        """The z-score that significant streams exceed."""
        return float(np.quantile(self.trial_z, 1 - self.meta["alpha"]))

    @property
    def streams(self) -> QTable:
        """
        The streams as a table.

        Those that move come first, then what stands still and what is not significant,
        the slowest of each first.  Velocities are on the sky and along the jet.
        """
        rows = []
        for one in self.found:
            velocity, covariance = one["velocity"], one["covariance"]
            # What is within three standard errors of zero is stationary.
            still = np.hypot(*(velocity / np.sqrt(np.diag(covariance)))) <= 3
            kind = "stationary" if still else "moving"
            kind = kind if one["p_global"] <= self.meta["alpha"] else "not significant"
            axes = self.frame, self.position_angle
            row = one | velocity_columns(velocity, covariance, *axes)
            rows.append(row | {"kind": kind, "pm_err_jitter": row["pm_err"]})
        rows.sort(key=lambda row: (KINDS.index(row["kind"]), row["pm"]))
        for number, row in enumerate(rows, start=1):
            row["stream"] = number
        table = in_speed_unit(build_table("paper", rows), self.cube.speed_unit)
        table.meta.update(self.meta | self.cube.facts)
        return name_by_frame(round_to_errors(table), self.cube)

    def plot(self, **options: Any) -> Figure:
        """
        Draw the velocity map over the z-score along the jet, as the paper's Fig. 2.

        Parameters
        ----------
        **options
            ``figure`` to draw on; ``unit`` of the axes; ``beta_per_pm``, the apparent
            speed in units of c of 1 mas/yr, for a second axis.

        Returns
        -------
        `matplotlib.figure.Figure`
        """
        from astro_scc.visualization import plot_result

        return plot_result(self, "paper", level=self.level, **options)


def measure_as_in_paper(
    cube: EpochCube, settings: MeasurementSettings, *, region: Any = None,
    n_trials: int = 1000, rng: Seed | None = None,
    n_workers: Workers = 1, progress_bar: bool = False,
) -> PaperMeasurement:  # fmt: skip
    """
    Measure velocities by the method of Mertens & Lobanov (2016), as it stands there.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    settings : `~astro_scc.StackedCrossCorrelation`
        By default consecutive epochs are compared, or with ``baseline`` all that are
        so far apart, to a largest speed that moves four beams in the longest interval.
    region : optional
        Anything that ``cube.region_mask`` takes.  Only SSPs whose centroid lies inside
        are correlated.
    n_trials : int, optional
        Number of permutations, and of trials of the errors.
    rng : None, int or `~numpy.random.Generator`, optional
        Seed of the trials.
    n_workers : int, str or `dask.distributed.Client`, optional
        Number of processes, or a Dask scheduler.
    progress_bar : bool, optional

    Returns
    -------
    `PaperMeasurement`

    Raises
    ------
    ValueError
        If no two epochs make a pair, the beams differ, no epoch has an SSP in the
        region, or a setting does not fit the images.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.paper.method import measure_as_in_paper
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(rng=1).cube
    >>> settings = StackedCrossCorrelation(scales=[1, 2, 3], position_angle=270 * u.deg)
    >>> found = measure_as_in_paper(cube, settings, n_trials=30, rng=1)
    >>> found.components["pm_parallel"][0].round(0)
    <Quantity 6. mas / yr>
    """
    n_trials = require("n_trials", n_trials)
    refuse_other_method("paper", settings.to_dict())
    patterns.check_cube(cube, settings.common_beam)
    generator, seed = seeded(rng)
    scales, pairs, max_speed, reach = plan_matches(settings, cube)
    orders = stack.draw_orders(pairs, n_trials, generator)
    matched = match_epochs(
        cube, settings, reach, pairs=stack.image_pairs(pairs, orders), region=region,
        n_workers=n_workers, progress_bar=progress_bar,
    )  # fmt: skip
    require_ssps(matched.ssps, scales)
    if empty := patterns.empty_region(matched, region):
        raise ValueError(empty)
    frame = velocity_frame(cube, settings.position_angle)
    displacements = matched_displacements(matched, frame, settings.min_error_beams)
    axes = np.asarray(frame.matrix(0.0, 0.0)) if frame.uniform else np.eye(2)
    epoch, level = np.indices((len(cube), len(scales))).reshape(2, -1)
    fwhm = beam_fwhm(cube, epoch, np.array(scales)[level], axes).mean(axis=0)
    with (
        progress(n_trials, "Permuting", show=progress_bar) as done,
        # The matrix products are small: threads would wait for one another.
        threadpool_limits(1, "blas"),
    ):
        found = stack.stack_patterns(
            displacements, pairs, orders, fwhm=fwhm, max_speed=max_speed,
            rng=generator, shift_beams=0.2 * settings.small_displacement_correction,
            progress=done,
        )  # fmt: skip
    meta = {
        "method": "paper", "n_trials": n_trials, "seed": seed, "versions": versions(),
        "n_ssp": int(displacements.n_ssps[np.unique(pairs.first)].sum()),
        "n_pairs": len(pairs), "alpha": settings.alpha,
    }  # fmt: skip
    angle = flow_direction(matched, frame)
    return PaperMeasurement(matched, frame, angle, *found, meta)
