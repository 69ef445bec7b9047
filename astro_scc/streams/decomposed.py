# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The flow of a cube, its direction, and streams that are fitted to parts of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import astropy.units as u
import numpy as np

from astro_scc.epochs import EpochCube
from astro_scc.exceptions import NoFlowError
from astro_scc.grid import (
    FlowGrid,
    default_scales,
    flow_grids,
    flow_lines,
    has_core,
    region_weight,
    sample_lines,
    sample_planes,
    seen_flow,
)
from astro_scc.intervals import without_short
from astro_scc.kinematics import PositionAngleFrame
from astro_scc.spectrum.diagram import (
    REACH,
    Diagram,
    FlowPlanes,
    SampledPlanes,
    correlate,
    correlate_aside,
    weight_of_pairs,
)
from astro_scc.spectrum.equations import Equations, set_up
from astro_scc.spectrum.gaussians import StreamFit, fit_errors, fit_streams, one_stream
from astro_scc.spectrum.permutations import EVERY, INWARD, permutation_test
from astro_scc.spectrum.rays import (
    correlation_kept,
    deletion_error,
    transverse_speed,
)
from astro_scc.units import PM_UNIT

#: Beams by which diagrams go beyond the largest speed in the shorter intervals.
MARGIN = 1.5
#: Other lines are those of a flow if patterns keep more of their correlation along
#: them, by so many errors.
ERRORS = 2.0


@dataclass(frozen=True, eq=False, repr=False)
class DecomposedFlow:
    """
    What changes in the images of a cube, along one direction or several.

    Attributes
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    frame : frame of `astro_scc.kinematics`
        Axes of the velocities.
    grids : tuple of ``FlowGrid``
        One, or one for each direction if none is known.
    planes : tuple of ``FlowPlanes``
    regions : tuple of `~numpy.ndarray` or None
        Weights of the points of each grid.
    beam : float
        The unit of length, in mas: the mean beam or, without beams, the size of the
        structures.
    fastest : float or None
        The largest speed, if one was given, in beams/yr.
    inside : `~numpy.ndarray` of bool, shape (ny, nx), or None
        Pixels of the region.
    kernel : {"b1", "b3"}
        Of the wavelet.
    sampled : ``SampledPlanes`` or None
        What the planes of the whole are made of, along one direction.
    passes : bool
        Whether features move past the reference position, so that it is no core from
        which both sides flow.
    given : bool
        Whether the position angle was given, not found in the images.
    intervals : (float, float)
        Shortest and longest interval between epochs that are compared, in years.
    """

    cube: EpochCube
    frame: Any
    grids: tuple[FlowGrid, ...]
    planes: tuple[FlowPlanes, ...]
    regions: tuple[np.ndarray | None, ...]
    beam: float
    fastest: float | None = None
    inside: np.ndarray | None = None
    kernel: str = "b1"
    sampled: SampledPlanes | None = None
    passes: bool = False
    given: bool = False
    intervals: tuple[float, float] = EVERY

    @property
    def years(self) -> np.ndarray:
        """Dates of the epochs, in years from the first one of the cube."""
        return self.planes[0].years

    @property
    def max_speed(self) -> u.Quantity | None:
        """The largest speed that was given, in mas/yr, or None."""
        return None if self.fastest is None else self.fastest * self.beam * PM_UNIT

    @property
    def directed(self) -> bool:
        """Whether the direction of the flow is known."""
        return len(self.grids) == 1

    @property
    def outward(self) -> bool:
        """Whether positive speeds lead away from a core."""
        return self.grids[0].outward

    @property
    def angle(self) -> float:
        """Direction of the first grid from the first axis of the frame, in radians."""
        if not self.frame.uniform or not np.isfinite(self.grids[0].angle):
            return 0.0
        first, second = np.asarray(self.frame.matrix(0.0, 0.0)) @ self.grids[0].axes[0]
        return float(np.arctan2(second, first))

    def along(
        self, angle: float | None = None, *, scales: Any = None,
        normalise: str = "local",
    ) -> DecomposedFlow:  # fmt: skip
        """
        Return the same flow along one direction.

        Parameters
        ----------
        angle : float, optional
            Position angle in radians, by default that of the first grid.
        scales : sequence of float, optional
            By default those of the flow.
        normalise : {"local", "along"}
            See ``SampledPlanes.changes``; scales are compared on planes that are
            normalised along the flow only.

        Returns
        -------
        `DecomposedFlow`
            With the same axes of velocities.
        """
        scales = tuple(scales or self.planes[0].scales)
        if angle is None and self.sampled and scales == self.sampled.scales:
            return replace(self, planes=(self.sampled.changes(normalise),))
        angle = self.grids[0].angle if angle is None else angle
        known = np.isfinite(angle)
        made = decompose_flow(
            self.cube, PositionAngleFrame(angle * u.rad) if known else self.frame,
            scales=scales, beam=self.beam, region=self.inside,
            max_speed=self.max_speed, kernel=self.kernel, passes=self.passes,
        )  # fmt: skip
        if self.grids[0].lines is not None:
            made = made.along_lines(self.grids[0].lines)
        return replace(
            made, planes=(made.sampled.changes(normalise),), frame=self.frame,
            given=self.given, intervals=self.intervals,
        )  # fmt: skip

    def along_lines(self, lines: np.ndarray) -> DecomposedFlow:
        """Return the flow of a straight grid along lines, see ``sample_lines``."""
        grid, sampled = sample_lines(self.grids[0], self.sampled, lines)
        return replace(
            self, grids=(grid,), planes=(sampled.changes(),), sampled=sampled,
            regions=(region_weight(self.inside, grid),),
        )  # fmt: skip

    def lines(self) -> list[np.ndarray]:
        """Return other lines than straight ones along which a jet may flow."""
        grid = self.grids[0]
        straight = self.sampled is not None and np.isfinite(grid.angle)
        if not straight or not grid.outward or grid.lines is not None:
            return []
        return flow_lines(grid, self.planes[0].values)

    def diagram(self, k: int) -> Diagram:
        """Return the displacement-interval diagram along direction k."""
        return correlate(self.planes[k], region=self.regions[k])

    def part(self, *, epochs=None, scales=None, places=None):
        """
        Return a part of the flow.

        Parameters
        ----------
        epochs : slice, optional
        scales : sequence of float, optional
        places : sequence of `~numpy.ndarray`, optional
            Weights of the points of each grid, by which those of the regions are
            multiplied.

        Returns
        -------
        `DecomposedFlow`
        """
        planes, regions = self.planes, self.regions
        if scales is not None:
            planes = tuple(p.of_scales(scales) for p in planes)
        if epochs is not None:
            planes = tuple(p.of_epochs(epochs) for p in planes)
        if places is not None:
            pairs = zip(regions, places, strict=True)
            regions = tuple(p if region is None else region * p for region, p in pairs)
        return replace(self, planes=planes, regions=regions, sampled=None)

    def between(self, low, high):
        """Return the part between two distances along the flow, in mas."""
        low, high = low / self.beam, high / self.beam
        far = [grid.distances for grid in self.grids]
        return self.part(places=[((r >= low) & (r < high)) * 1.0 for r in far])


def _reach(cube, max_speed, beam):
    """Return the largest displacement of the diagrams in beams."""
    if max_speed is None:
        return REACH
    gaps = np.diff(cube.years.to_value(u.yr))
    way = max_speed.to_value(PM_UNIT) / beam * np.quantile(without_short(gaps), 0.25)
    return max(REACH, float(way) + MARGIN)


def decompose_flow(
    cube, frame, *, scales=None, beam, region=None, max_speed=None, kernel="b1",
    passes=False,
):  # fmt: skip
    """
    Return the flow of a cube: wavelet planes along its direction.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    frame : frame of `astro_scc.kinematics`
    scales : sequence of float, optional
        Numbers of the wavelet scales, by default the three up to 0.55 beams.
    beam : float
        In mas.
    region : `~numpy.ndarray` of bool, shape (ny, nx), optional
    max_speed : `~astropy.units.Quantity`, optional
    kernel : {"b1", "b3"}
    passes : bool, optional
        Whether the flow passes the reference position, which is no core then.

    Returns
    -------
    `DecomposedFlow`

    Raises
    ------
    `~astro_scc.exceptions.NoFlowError`
        If no flow is seen, or only beside the edge of the images.
    """
    core = has_core(cube, beam)
    seen = _seen(cube, beam, region, core)
    if scales is None:
        scales = default_scales(beam / cube.pixel_scale.to_value(u.mas))
    grids = tuple(flow_grids(cube, frame, seen, beam, core=core and not passes))
    reach, order = _reach(cube, max_speed, beam), 3 if len(grids) == 1 else 1
    sampled = [
        sample_planes(cube, g, scales, seen, kernel=kernel, order=order, reach=reach)
        for g in grids
    ]
    planes = tuple(one.changes() for one in sampled)
    if region is None and not any(one.mask.any() for one in planes):
        raise NoFlowError(
            "all that is seen is so near to the edge of the images, or to missing "
            "pixels, that wavelets reach beyond: leave out the largest scales, or give "
            "larger images"
        )
    regions = tuple(region_weight(region, g) for g in grids)
    fastest = None if max_speed is None else max_speed.to_value(PM_UNIT) / beam
    return DecomposedFlow(
        cube, frame, grids, planes, regions, beam, fastest, inside=region,
        kernel=kernel, sampled=sampled[0] if len(grids) == 1 else None, passes=passes,
    )  # fmt: skip


def _seen(cube, beam, region, core):
    """Return the pixels where a flow is seen, or refuse that there are none."""
    seen = seen_flow(cube, beam, core=core)
    if region is not None and not (seen & region).any():
        seen = region
    if not seen.any() and cube.beams is None:
        # Texture everywhere, of which the noise is not known.
        seen = ~cube.mask.all(axis=0)
    if not seen.any():
        away = " a beam or more from the core" if core else ""
        raise NoFlowError(
            f"nothing in the images is brighter than five times their noise{away}: "
            "there is no flow to be measured"
        )
    return seen


# -- its direction ------------------------------------------------------------------

#: Displacement across the flow at which diagrams are compared, in beams.
ASIDE = 0.4
#: Without a known direction, that of the flow is found in so many turns, of at most
#: and at least so many radians.
MOST_TURNS, MOST_TURN, LEAST_TURN = 3, 0.3, 0.03


def find_motion(flow, n_trials, rng, *, outward=False):
    """
    Return a flow along its direction, and the test for motion along all directions.

    Parameters
    ----------
    flow : ``DecomposedFlow``
    n_trials : int
        Permutations of the innovations of the epochs.
    rng : `~numpy.random.Generator`
    outward : bool, optional
        Test only speeds along a known direction, away from the core.

    Returns
    -------
    flow : ``DecomposedFlow``
    test : ``MotionTest``
    """
    shared = {"fastest": flow.fastest, "intervals": flow.intervals}
    shared |= {"n_trials": n_trials, "rng": rng}
    inward = INWARD if flow.directed and flow.outward else 1.0
    inward = 0.0 if flow.directed and outward else inward
    diagrams = [flow.diagram(k) for k in range(len(flow.planes))]
    test = permutation_test(diagrams, inward=inward, **shared)
    if flow.directed:
        return flow, test
    # Along the direction of the largest z, outward.
    flow = _turned(flow, test.best[0], test.clearest)
    along = permutation_test([flow.diagram(0)], inward=0.0, **shared)
    return flow, replace(
        along, p_global=test.p_global, p_smallest=test.p_smallest, level=test.level
    )


def _turned(flow, direction, speed):
    """Return the flow along its own direction, from the best of those tested."""
    angle = flow.grids[direction].angle + (0.0 if speed > 0 else np.pi)
    for _ in range(MOST_TURNS):
        found = flow.along(angle)
        sheet, aside = sheet_of(found, 1)
        across, error = transverse_speed(sheet, aside, abs(speed))
        if not np.isfinite(error):
            break
        # Positive to larger position angles.
        turn = np.arctan2(across, abs(speed))
        turn = float(np.clip(turn, -MOST_TURN, MOST_TURN))
        angle += turn
        if abs(turn) < LEAST_TURN:
            break
    return flow.along(angle)


def sheet_of(flow, number):
    """Return diagrams at displacements across the flow, and their distance in beams."""
    planes = flow.planes[0].fitted
    lag, n_across = max(1, round(ASIDE / planes.step)), len(planes.across)
    lags = [k * lag for k in range(1, number + 1) if 2 * k * lag < n_across]
    return correlate_aside(planes, lags, region=flow.regions[0]), lag * planes.step


# -- parts of a flow -----------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PartFit:
    """Streams that are fitted to a part of a flow; their fit is None if none are."""

    flow: DecomposedFlow
    diagram: Diagram
    equations: Equations
    fit: StreamFit | None

    def errors(self, travel=None, stream=None):
        """Return what `fit_errors` does, of clusters that move at one speed."""
        return fit_errors(
            self.flow.planes[0].fitted, self.diagram, self.equations, self.fit,
            region=self.flow.regions[0], travel=travel, stream=stream,
        )  # fmt: skip

    def knows(self, stream: int) -> bool:
        """Return whether a stream is seen, and not at the limit of the search."""
        if self.fit is None or not self.fit.amplitude[stream] > 0:
            return False
        return bool(abs(self.fit.mean[stream]) < 0.99 * self.equations.speed[-1])


def fit_part(flow, *, sign=1.0, start=None, diagram=None, fit=None):
    """
    Fit one stream, or those of the whole flow, to a part of it.

    Parameters
    ----------
    flow : ``DecomposedFlow``
        Along one direction.
    sign : float, optional
        Of the speed of one stream.
    start : sequence of (mean, sd), optional
        Streams of the whole.
    diagram : ``Diagram``, optional
        That of these planes, if it is known.
    fit : ``StreamFit``, optional
        If it is known.

    Returns
    -------
    `PartFit`
    """
    if diagram is None:
        diagram = correlate(flow.planes[0].fitted, region=flow.regions[0])
    equations = set_up(diagram, fastest=flow.fastest, intervals=flow.intervals)
    if not has_flow(flow):
        fit = None
    elif fit is None and start is None:
        fit = one_stream(equations, 1 / np.ptp(flow.years), sign)
    elif fit is None:
        fit = fit_streams(equations, start)
    return PartFit(flow, diagram, equations, fit)


def fit_along_lines(flow, *, straight=False, sign=1.0, diagram=None):
    """
    Fit one stream along the lines of its flow.

    Images that are longer than wide mistake motion off the axis for faster motion along
    it, so that lines should follow the flow.  They are straight if the position angle
    is given, and else diverge from the core, unless patterns keep more of their
    correlation along other lines, by two standard errors: straight, diverging or bent.

    Parameters
    ----------
    flow : ``DecomposedFlow``
        Along one direction.
    straight : bool, optional
        Whether lines must be straight.
    sign, diagram
        See `fit_part`.

    Returns
    -------
    `PartFit`
    """
    part = fit_part(flow, sign=sign, diagram=diagram)
    if part.fit is None or straight:
        return part
    flows = [flow.along_lines(one) for one in flow.lines()]
    others = [fit_part(other, sign=sign) for other in flows]
    parts = [part, *others] if flow.given else [*others, part]
    parts = [one for one in parts if one.fit is not None]
    kept = [correlation_kept(one.diagram, one.fit.mean[0]) for one in parts]
    best = 0
    for k in range(1, len(parts)):
        more = kept[k] - kept[0]
        if kept[k][0] > kept[best][0] and more[0] > ERRORS * deletion_error(more):
            best = k
    return parts[best]


def is_behind(flow, speed):
    """Return whether most of what moves at a speed is on the side of a counter-jet."""
    counter, moves = flow.grids[0].counter, []
    if not counter.any():
        return False
    for side in (counter, ~counter):
        weight = weight_of(flow) * side
        diagram = correlate(flow.planes[0].fitted, region=weight)
        kept = correlation_kept(diagram, speed)[0]
        moves.append(kept * diagram.power * weight.sum())
    return bool(moves[0] > moves[1])


def has_flow(flow, least=0.3):
    """
    Return whether a flow is seen in a part, and can be followed for half a beam.

    Both ends must be seen around an area of ``least`` square beams: in a smaller one,
    as beside an edge, slow patterns alone are known.
    """
    planes, weight = flow.planes[0], weight_of(flow)
    lag = min(round(0.5 / planes.step), len(planes.mask) - 1)
    followed = float(weight_of_pairs(planes.mask, weight, lag, 0).sum())
    return followed * planes.step**2 >= least


def weight_of(flow):
    """Return the weight of each point of the first grid, shape (n_along, n_across)."""
    mask, region = flow.planes[0].mask, flow.regions[0]
    return mask * 1.0 if region is None else mask * region
