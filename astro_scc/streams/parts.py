# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams that are fitted to a part of a flow."""

from dataclasses import dataclass

import numpy as np

from astro_scc.spectrum.diagram import Diagram, correlate
from astro_scc.spectrum.equations import Equations, set_up
from astro_scc.spectrum.errors import fit_errors
from astro_scc.spectrum.gaussians import StreamFit, fit_streams, one_stream
from astro_scc.spectrum.permutations import EVERY, LENGTH
from astro_scc.spectrum.planes import FlowPlanes
from astro_scc.streams.decomposed import DecomposedFlow

#: Lines are those of the flow if patterns keep so much more of their correlation along
#: them than along straight ones, between such displacements in beams.
KEPT, FROM, TO = 0.03, 0.3, 4.0


@dataclass(frozen=True, eq=False)
class PartFit:
    """Streams that are fitted to a part of a flow."""

    flow: DecomposedFlow
    planes: FlowPlanes
    diagram: Diagram
    equations: Equations
    fit: StreamFit

    @property
    def kept(self) -> float:
        """The largest mean correlation of patterns that move, over that at rest."""
        equations, x = self.equations, self.diagram.displacement
        mean = equations.data / np.sqrt(equations.number)[:, None]
        odd = mean - mean[:, ::-1]
        moved = np.abs(equations.speed[:, None]) * equations.interval
        weight = equations.share * np.exp(-moved / LENGTH)
        weight *= (moved > FROM) & (moved < TO)
        at = moved * np.sign(equations.speed)[:, None]
        pairs = zip(at.T, odd, strict=True)
        found = np.array([np.interp(v, x, values) for v, values in pairs]).T
        total = weight.sum(axis=1)
        found = (weight * found).sum(axis=1) / np.where(total > 0, total, np.inf)
        return float(found.max() / max(self.diagram.power, np.finfo(float).tiny))

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


def fit_along_lines(flow, *, straight=False, **settings):
    """
    Fit one stream along the lines of its flow.

    Images that are longer than wide mistake motion off the axis for faster motion along
    it, so that lines should follow the flow: they are straight, or diverge from the
    core or bend with it if patterns keep more of their correlation along these.

    Parameters
    ----------
    flow : ``DecomposedFlow``
        Along one direction.
    straight : bool, optional
        Whether lines must be straight.
    settings
        See `fit_part`.

    Returns
    -------
    `PartFit` or None
    """
    part = fit_part(flow, **settings)
    if part is None or straight:
        return part
    settings["diagram"], most = None, part.kept * (1 + KEPT)
    for lines in flow.lines():
        other = fit_part(flow.along_lines(lines), **settings)
        if other is not None and other.kept > most:
            part, most = other, other.kept
    return part


def has_flow(flow):
    """Return whether a flow is seen in a part."""
    return float(weight_of(flow).sum()) >= 4


def weight_of(flow):
    """Return the weight of each point of the first grid, shape (n_along, n_across)."""
    mask, region = flow.planes[0].mask, flow.regions[0]
    return mask * 1.0 if region is None else mask * region
