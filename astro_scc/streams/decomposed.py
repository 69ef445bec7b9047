# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The flow of a cube: its wavelet planes along its directions, and parts of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import astropy.units as u
import numpy as np

from astro_scc.epochs import EpochCube
from astro_scc.exceptions import NoFlowError
from astro_scc.grid import (
    FlowGrid,
    SampledPlanes,
    default_scales,
    flow_grids,
    flow_lines,
    has_core,
    sample_mask,
    sample_planes,
    seen_flow,
)
from astro_scc.intervals import without_short
from astro_scc.kinematics import PositionAngleFrame
from astro_scc.spectrum.diagram import Diagram, correlate
from astro_scc.spectrum.planes import REACH, FlowPlanes
from astro_scc.units import PM_UNIT

#: Beams by which diagrams go beyond the largest speed in the shorter intervals.
MARGIN = 1.5


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
            See ``flow_planes``; scales are compared on planes that are normalised along
            the flow only.

        Returns
        -------
        `DecomposedFlow`
            With the same axes of velocities.
        """
        scales = tuple(scales or self.planes[0].scales)
        if angle is None and self.sampled and scales == self.sampled.scales:
            planes = self.sampled.changes(normalise)
            return replace(self, planes=(planes,))
        angle = self.grids[0].angle if angle is None else angle
        known = np.isfinite(angle)
        made = decompose_flow(
            self.cube, PositionAngleFrame(angle * u.rad) if known else self.frame,
            scales=scales, beam=self.beam, region=self.inside,
            max_speed=self.max_speed, kernel=self.kernel, normalise=normalise,
            passes=self.passes,
        )  # fmt: skip
        if self.grids[0].lines is not None:
            made = made.along_lines(self.grids[0].lines, normalise)
        return replace(made, frame=self.frame, given=self.given)

    def along_lines(
        self, lines: np.ndarray, normalise: str = "local"
    ) -> DecomposedFlow:
        """Return the flow of a straight grid along lines, see ``SampledPlanes``."""
        sampled, regions = self.sampled.along_lines(lines), self.regions
        if self.inside is not None:
            regions = (sample_mask(self.inside, sampled.grid).astype(np.float32),)
        planes = (sampled.changes(normalise),)
        return replace(
            self, grids=(sampled.grid,), planes=planes, regions=regions, sampled=sampled
        )

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
        places = []
        for grid in self.grids:
            r = distances(grid)
            places.append(((r >= low / self.beam) & (r < high / self.beam)) * 1.0)
        return self.part(places=places)


def _reach(cube, max_speed, beam):
    """Return the largest displacement of the diagrams in beams."""
    if max_speed is None:
        return REACH
    gaps = np.diff(cube.years.to_value(u.yr))
    way = max_speed.to_value(PM_UNIT) / beam * np.quantile(without_short(gaps), 0.25)
    return max(REACH, float(way) + MARGIN)


def distances(grid):
    """Return the distance of each point from the origin along the flow, in beams."""
    return grid.distance[:, None] * np.ones(len(grid.across))


def decompose_flow(
    cube, frame, *, scales=None, beam, region=None, max_speed=None, kernel="b1",
    normalise="local", passes=False,
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
    normalise : {"local", "along"}
        See ``flow_planes``.
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
    sampling = {
        "kernel": kernel, "order": 3 if len(grids) == 1 else 1,
        "reach": _reach(cube, max_speed, beam),
    }  # fmt: skip
    scales = tuple(scales)
    sampled = [sample_planes(cube, g, scales, seen, **sampling) for g in grids]
    planes = tuple(one.changes(normalise) for one in sampled)
    if region is None and not any(one.mask.any() for one in planes):
        raise NoFlowError(
            "all that is seen is so near to the edge of the images, or to missing "
            "pixels, that wavelets reach beyond: leave out the largest scales, or give "
            "larger images"
        )
    regions = (None,) * len(grids)
    if region is not None:
        regions = tuple(sample_mask(region, g).astype(np.float32) for g in grids)
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
