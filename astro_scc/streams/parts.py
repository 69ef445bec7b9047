# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams that are fitted to a part of a flow."""

from dataclasses import dataclass

import numpy as np

from astro_scc.spectrum.diagram import Diagram, correlate, weight_of_pairs
from astro_scc.spectrum.equations import Equations, set_up
from astro_scc.spectrum.errors import fit_errors
from astro_scc.spectrum.gaussians import StreamFit, fit_streams, one_stream
from astro_scc.spectrum.permutations import EVERY
from astro_scc.spectrum.planes import FlowPlanes
from astro_scc.streams.decomposed import DecomposedFlow
from astro_scc.streams.rays import correlation_kept, deletion_error

#: Other lines are those of a flow if patterns keep more of their correlation along
#: them, by so many errors.
ERRORS = 2.0


@dataclass(frozen=True, eq=False)
class PartFit:
    """Streams that are fitted to a part of a flow."""

    flow: DecomposedFlow
    planes: FlowPlanes
    diagram: Diagram
    equations: Equations
    fit: StreamFit

    def errors(self, travel=None, stream=None):
        """Return the errors, of clusters that move at a speed; those of one stream."""
        return fit_errors(
            self.planes, self.diagram, self.equations, self.fit,
            region=self.flow.regions[0], travel=travel, stream=stream,
        )  # fmt: skip

    def knows(self, stream: int) -> bool:
        """Return whether a stream is seen, and not at the limit of the search."""
        inside = abs(self.fit.mean[stream]) < 0.99 * self.equations.speed[-1]
        return bool(self.fit.amplitude[stream] > 0 and inside)


def fit_part(
    flow, *, sign=1.0, root=True, start=None, intervals=EVERY, diagram=None, fit=None
):
    """
    Fit one stream, or those of the whole flow, to a part of it.

    Parameters
    ----------
    flow : ``DecomposedFlow``
        Along one direction.
    sign : float, optional
        Of the speed of one stream.
    root : bool, optional
        Of the square root of the planes, see `FlowPlanes.square_root`.
    start : sequence of (mean, sd), optional
        Streams of the whole.
    intervals : (float, float), optional
        Shortest and longest interval that is used, in years.
    diagram : ``Diagram``, optional
        That of these planes, if it is known.
    fit : ``StreamFit``, optional
        If it is known.

    Returns
    -------
    `PartFit` or None
    """
    planes = flow.planes[0].square_root if root else flow.planes[0]
    if not has_flow(flow):
        return None
    region = flow.regions[0]
    diagram = correlate(planes, region=region) if diagram is None else diagram
    equations = set_up(diagram, fastest=flow.fastest, intervals=intervals)
    if fit is None and start is None:
        fit = one_stream(equations, 1 / np.ptp(flow.years), sign)
    elif fit is None:
        fit = fit_streams(equations, start)
    return None if fit is None else PartFit(flow, planes, diagram, equations, fit)


def fit_along_lines(
    flow, *, straight=False, sign=1.0, root=True, intervals=EVERY, diagram=None
):
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
    sign, root, intervals, diagram
        See `fit_part`.

    Returns
    -------
    `PartFit` or None
    """
    shared = {"sign": sign, "root": root, "intervals": intervals}
    part = fit_part(flow, diagram=diagram, **shared)
    if part is None or straight:
        return part
    others = [fit_part(flow.along_lines(one), **shared) for one in flow.lines()]
    parts = [part, *others] if flow.given else [*others, part]
    parts = [one for one in parts if one is not None]
    kept = [correlation_kept(one.diagram, one.fit.mean[0]) for one in parts]
    best = 0
    for k in range(1, len(parts)):
        more = kept[k] - kept[0]
        if kept[k][0] > kept[best][0] and more[0] > ERRORS * deletion_error(more):
            best = k
    return parts[best]


def is_behind(flow, planes, speed):
    """Return whether most of what moves at a speed is on the side of a counter-jet."""
    counter, moves = flow.grids[0].counter, []
    if not counter.any():
        return False
    for side in (counter, ~counter):
        weight = weight_of(flow) * side
        diagram = correlate(planes, region=weight)
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
