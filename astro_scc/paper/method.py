# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The paper's own method: from a cube of images to its streams."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np
from astropy.table import QTable
from threadpoolctl import threadpool_limits

from astro_scc.columns import build_table, round_to_errors
from astro_scc.decomposition.segmentation import require_ssps
from astro_scc.epochs import EpochCube
from astro_scc.images.positions import beam_fwhm, name_by_frame
from astro_scc.measurement.tables import VelocityMaps, ssp_table, velocity_columns
from astro_scc.paper import matching
from astro_scc.paper.peaks import PaperStack, stack_patterns
from astro_scc.paper.stack import draw_orders, image_pairs
from astro_scc.parallel import Workers
from astro_scc.patterns import check_cube, empty_region
from astro_scc.plan import flow_direction, velocity_frame
from astro_scc.progress import progress
from astro_scc.quantities import Seed, seeded
from astro_scc.settings import MeasurementSettings, refuse_other_method, require
from astro_scc.spectrum.maps import VelocityMap
from astro_scc.units import in_speed_unit
from astro_scc.writing import versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["PaperMeasurement", "measure_as_in_paper"]

#: Kinds of rows in their order.
KINDS = "moving", "stationary", "not significant"


@dataclass(frozen=True, eq=False, repr=False)
class PaperMeasurement(VelocityMaps):
    """
    The streams that the paper's method finds in a cube.

    Attributes
    ----------
    matched : `~astro_scc.paper.matching.MatchedEpochs`
    frame : frame of `astro_scc.kinematics`
        The two axes of velocities.
    position_angle : `~astropy.units.Quantity`
        Direction of the jet, north through east.
    stack : ``PaperStack``
        In mas/yr.
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

    matched: matching.MatchedEpochs
    frame: Any
    position_angle: u.Quantity
    stack: PaperStack
    meta: dict[str, Any]

    def __repr__(self):
        n = len(self.stack.components)
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
    def grid(self) -> VelocityMap:
        """The velocities of the maps, in mas/yr."""
        return self.stack.velocities

    @property
    def level(self) -> float:
        """The z-score that significant streams exceed."""
        return float(np.quantile(self.stack.trial_z, 1 - self.meta["alpha"]))

    @property
    def components(self) -> QTable:
        """
        The streams as a table.

        Those that move come first, then what stands still and what is not significant,
        the slowest of each first.
        """
        given = self.frame, self.position_angle, self.meta["alpha"]
        rows = [component_row(one, *given) for one in self.stack.components]
        rows.sort(key=lambda row: (KINDS.index(row["kind"]), row["pm"]))
        for number, row in enumerate(rows, start=1):
            row["stream"] = number
        table = in_speed_unit(build_table("paper", rows), self.cube.speed_unit)
        table.meta.update(self.meta | self.cube.facts)
        return name_by_frame(round_to_errors(table), self.cube)

    @property
    def streams(self) -> QTable:
        """Another name of `components`."""
        return self.components

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


def component_row(component, frame, angle, alpha):
    """
    Return a component as a row of the table, in mas/yr and degrees.

    Parameters
    ----------
    component : dict
        Of ``PaperStack.components``.
    frame : frame of `astro_scc.kinematics`
    angle : `~astropy.units.Quantity`
        Position angle of the jet.
    alpha : float
        Largest ``p_global`` of what is significant.

    Returns
    -------
    dict
        What is within three standard errors of zero is ``stationary``.
    """
    velocity, covariance = component["velocity"], component["covariance"]
    still = np.hypot(*(velocity / np.sqrt(np.diag(covariance)))) <= 3
    kind = "stationary" if still else "moving"
    kind = kind if component["p_global"] <= alpha else "not significant"
    row = component | velocity_columns(velocity, covariance, frame, angle)
    return row | {"kind": kind, "pm_err_jitter": row["pm_err"]}


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
    _check(cube, settings)
    generator, seed = seeded(rng)
    plan = matching.SearchPlan.of(cube, settings)
    orders = draw_orders(plan.pairs, n_trials, generator)
    matched = matching.match_epochs(
        cube, settings, plan, pairs=image_pairs(plan.pairs, orders), region=region,
        n_workers=n_workers, progress_bar=progress_bar,
    )  # fmt: skip
    require_ssps(matched.ssps, plan.scales)
    if empty := empty_region(matched, region):
        raise ValueError(empty)
    frame = velocity_frame(cube, settings.position_angle)
    displacements = matching.matched_displacements(
        matched, frame, min_error_beams=settings.min_error_beams
    )
    axes = np.asarray(frame.matrix(0.0, 0.0)) if frame.uniform else np.eye(2)
    epoch, level = np.indices((len(cube), len(plan.scales))).reshape(2, -1)
    fwhm = beam_fwhm(cube, epoch, np.array(plan.scales)[level], axes).mean(axis=0)
    with (
        progress(n_trials, "Permuting", show=progress_bar) as done,
        # The matrix products are small: threads would wait for one another.
        threadpool_limits(1, "blas"),
    ):
        stack = stack_patterns(
            displacements, plan.pairs, orders, fwhm=fwhm, max_speed=plan.max_speed,
            rng=generator, shift_beams=0.2 * settings.small_displacement_correction,
            progress=done,
        )  # fmt: skip
    meta = {
        "method": "paper", "n_trials": n_trials, "seed": seed, "versions": versions(),
        "n_ssp": stack.n_ssp, "n_pairs": len(plan.pairs), "alpha": settings.alpha,
    }  # fmt: skip
    return PaperMeasurement(matched, frame, flow_direction(matched, frame), stack, meta)


def _check(cube, settings):
    """Refuse settings that are not the paper's and beams that differ."""
    refuse_other_method("paper", settings.to_dict())
    check_cube(cube, settings.common_beam)
