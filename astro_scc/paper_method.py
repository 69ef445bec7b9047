# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The paper's own method: from a cube of images to its velocity components."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np
from astropy.table import QTable
from threadpoolctl import threadpool_limits

from astro_scc.alignment.registration import warn_of_misalignment
from astro_scc.columns import build_table, round_to_errors
from astro_scc.correlation import Correlator
from astro_scc.decomposition import Decomposer, SSPs
from astro_scc.decomposition.segmentation import require_ssps
from astro_scc.epochs import EpochCube
from astro_scc.images.beam import require_common_beam
from astro_scc.images.positions import beam_fwhm, name_by_frame
from astro_scc.matching.matched import (
    MatchedEpochs,
    allow_for_structure,
    centroids_inside,
    decompose_epochs,
)
from astro_scc.matching.plan import flow_direction, pairs_of_dates, scale_numbers
from astro_scc.measurement.axes import matched_displacements
from astro_scc.measurement.tables import VelocityMaps, ssp_table, velocity_columns
from astro_scc.paper import (
    draw_orders,
    image_pairs,
    stack_patterns,
)
from astro_scc.paper.components import PaperStack
from astro_scc.paper.stack import VelocityGrid
from astro_scc.parallel import workers_of
from astro_scc.progress import progress
from astro_scc.quantities import random_generator, seeded
from astro_scc.settings import MeasurementSettings, require
from astro_scc.units import PM_UNIT, in_speed_unit
from astro_scc.writing import versions

if TYPE_CHECKING:
    from distributed import Client
    from matplotlib.figure import Figure

__all__ = ["PaperMeasurement", "measure_as_in_paper"]

#: Shift of the paper's correction for small displacements, in beams.
SMALL_SHIFT = 0.2
#: Without a largest speed, motion of this many beams in the longest interval of a pair
#: of epochs is searched, as in the simulated jets of the paper.
FAR_BEAMS = 4.0
#: A component stands still if its velocity is within this many standard errors of zero.
STILL_SIGMA = 3.0


@dataclass(frozen=True, eq=False, repr=False)
class PaperMeasurement(VelocityMaps):
    """
    The velocity components that the paper's method finds in a cube.

    Attributes
    ----------
    matched : `~astro_scc.matching.MatchedEpochs`
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
    >>> from astro_scc.paper_method import measure_as_in_paper
    >>> from astro_scc.simulation import simulate_static
    >>> cube = simulate_static(n_epochs=4, rng=1).cube
    >>> found = measure_as_in_paper(cube, StackedCrossCorrelation(), n_trials=9, rng=1)
    >>> found.velocity_map("z_score").data.shape == found.grid.shape
    True
    """

    matched: MatchedEpochs
    frame: Any
    position_angle: u.Quantity
    stack: PaperStack
    meta: dict[str, Any]

    def __repr__(self):
        n = len(self.stack.components)
        return f"<PaperMeasurement: {len(self.cube)} epochs, {n} components>"

    @property
    def cube(self) -> EpochCube:
        """The epochs that were measured."""
        return self.matched.cube

    @property
    def ssps(self) -> QTable:
        """The SSPs of all epochs as a `~astropy.table.QTable`."""
        return ssp_table(self.matched)

    @property
    def grid(self) -> VelocityGrid:
        """Velocities of the maps, in mas/yr."""
        return self.stack.grid

    @property
    def coefficient(self) -> np.ndarray:
        """Coefficient of correlation at the velocities of ``grid``."""
        return self.stack.coefficient

    @property
    def z_score(self) -> np.ndarray:
        """Z-score at the velocities of ``grid``."""
        return self.stack.z_score

    @property
    def level(self) -> float:
        """The z-score that significant components exceed."""
        return float(np.quantile(self.stack.trial_z, 1 - self.meta["alpha"]))

    @property
    def components(self) -> QTable:
        """
        The components as a table, the largest z-score first.

        Its columns are those of ``PaperComponent``, with velocities on
        the sky and along the jet.
        """
        rows = [
            component_row(component, number, self.frame, self.position_angle)
            for number, component in enumerate(self.stack.components, start=1)
        ]
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


def component_row(component, number, frame, angle):
    """
    Return a component as a row of the table, in mas/yr and degrees.

    Parameters
    ----------
    component : ``PaperComponent``
    number : int
    frame : frame of `astro_scc.kinematics`
    angle : `~astropy.units.Quantity`
        Position angle of the jet.

    Returns
    -------
    dict
    """
    errors = np.array([component.v1_err, component.v2_err])
    correlations = np.full((2, 2), component.correlation)
    np.fill_diagonal(correlations, 1.0)
    covariance = correlations * np.outer(errors, errors)
    velocity = np.array([component.v1, component.v2])
    still = np.hypot(*(velocity / errors)) <= STILL_SIGMA
    kind = "stationary" if still else "moving"
    columns = velocity_columns(velocity, covariance, frame, angle)
    return {
        "stream": number,
        "kind": kind if component.significant else "not significant",
        **columns,
        "pm_err_jitter": columns["pm_err"],
        **asdict(component),
    }


def measure_as_in_paper(
    cube: EpochCube, settings: MeasurementSettings, *, region: Any = None,
    n_trials: int = 1000, rng: np.random.Generator | int | None = None,
    n_workers: int | str | Client = 1, progress_bar: bool = False,
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
    >>> from astro_scc.paper_method import measure_as_in_paper
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(rng=1).cube
    >>> settings = StackedCrossCorrelation(scales=[1, 2, 3], position_angle=270 * u.deg)
    >>> found = measure_as_in_paper(cube, settings, n_trials=30, rng=1)
    >>> found.components["pm_parallel"][0].round(0)
    <Quantity 6. mas / yr>
    """
    n_trials = require("n_trials", n_trials)
    if settings.outward or settings.alignment_error is not None:
        name = "outward" if settings.outward else "alignment_error"
        raise ValueError(
            f"{name} is not used by the paper's method: leave it out, or use "
            "method='spectrum'"
        )
    rng, seed = seeded(rng)
    generator = random_generator(rng)
    if settings.common_beam is not False:
        require_common_beam(cube)
    warn_of_misalignment(cube)
    pairs = pairs_of_dates(cube, settings.baseline)
    orders = draw_orders(pairs, n_trials, generator)
    scales = scale_numbers(cube, settings.scales)
    epochs, level = np.indices((len(cube), len(scales))).reshape(2, -1)
    resolved = partial(beam_fwhm, cube, epochs, np.array(scales)[level])
    fwhm = float(np.mean(resolved(np.eye(2))))
    longest, speed = pairs.interval.max(), settings.max_speed
    speed = FAR_BEAMS * fwhm / longest if speed is None else speed.to_value(PM_UNIT)
    reach = _reach(cube, speed, pairs, fwhm)
    decomposer = Decomposer(
        scales, settings.wavelet, settings.detection, settings.segmentation,
        settings.noise,
    )  # fmt: skip
    decomposer = allow_for_structure(cube, decomposer)
    correlator = Correlator(settings.kappa, settings.target, settings.min_overlap)
    with workers_of(n_workers) as workers:
        decompositions = decompose_epochs(
            cube, decomposer, n_workers=workers, progress_bar=progress_bar
        )
        ssps = SSPs.of_epochs(decompositions)
        require_ssps(ssps, scales)
        inside = None if region is None else cube.region_mask(region)
        select = centroids_inside(ssps, cube, inside)
        if not select.any():
            raise ValueError(
                f"region: no significant pattern has its centroid inside, {len(ssps)} "
                "in the rest of the images: check where it lies, or make it larger"
            )
        with progress(len(cube), "Correlating", show=progress_bar) as done:
            matches = correlator(
                decompositions, image_pairs(pairs, orders), reach, select=select,
                n_workers=workers, progress=done,
            )  # fmt: skip
    matched = MatchedEpochs(
        cube=cube, decomposer=decomposer, ssps=ssps, select=select, matches=matches,
        correlator=correlator, reach=reach, region=inside,
    )  # fmt: skip
    samples, frame = matched_displacements(matched, settings)
    axes = np.asarray(frame.matrix(0.0, 0.0)) if frame.uniform else np.eye(2)
    with progress(n_trials, "Permuting", show=progress_bar) as done:
        # The matrix products are small: threads would wait for one another.
        with threadpool_limits(1, "blas"):
            stack = stack_patterns(
                samples.displacements, pairs, orders,
                fwhm=resolved(axes).mean(axis=0), max_speed=speed, rng=generator,
                alpha=settings.alpha, correlated=matches.pairs, progress=done,
                shift_beams=SMALL_SHIFT * settings.small_displacement_correction,
            )  # fmt: skip
    meta = {
        "method": "paper", "n_trials": n_trials, "seed": seed, "versions": versions(),
        "n_ssp": stack.n_ssp, "n_pairs": len(pairs),
        "alpha": settings.alpha,
    }  # fmt: skip
    return PaperMeasurement(matched, frame, flow_direction(matched, frame), stack, meta)


def _reach(cube, speed, pairs, fwhm):
    """
    Return the largest displacement to correlate, along (y, x) in pixels.

    A trial can put two images at the dates that are farthest apart.  Matches beyond
    the largest speed still reach into the map, by a beam at most.
    """
    side, shape = np.hypot(*cube.pixel_matrix.value), np.array(cube.shape[1:])
    least, most = speed * pairs.interval.min(), speed * pairs.interval.max()
    image = np.hypot(*(side * shape[::-1]))
    if least > image or most < 0.01 * side.min():
        other = "smaller" if least > image else "larger"
        raise ValueError(
            f"max_speed moves {least:.3g} to {most:.3g} mas between two dates, in "
            f"images of {image:.3g} mas with pixels of {side.min():.3g} mas: give a "
            f"{other} one"
        )
    reach = np.ceil((most + fwhm) / side).astype(int)[::-1]
    return tuple(np.minimum(reach, shape - 1).tolist())
