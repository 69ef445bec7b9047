# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams that are fitted to a part of a flow."""

from dataclasses import dataclass

import numpy as np

from astro_scc.spectrum.diagram import Diagram, correlate
from astro_scc.spectrum.equations import Equations, set_up
from astro_scc.spectrum.errors import fit_errors
from astro_scc.spectrum.gaussians import StreamFit, fit_streams, one_stream
from astro_scc.spectrum.permutations import EVERY
from astro_scc.spectrum.planes import FlowPlanes


@dataclass(frozen=True, eq=False)
class PartFit:
    """Streams that are fitted to a part of a flow."""

    planes: FlowPlanes
    region: np.ndarray | None
    diagram: Diagram
    equations: Equations
    fit: StreamFit

    def errors(self, travel=None, stream=None):
        """Return the errors, of clusters that move at a speed; those of one stream."""
        return fit_errors(
            self.planes, self.diagram, self.equations, self.fit, region=self.region,
            travel=travel, stream=stream,
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
    return None if fit is None else PartFit(planes, region, diagram, equations, fit)


def has_flow(flow):
    """Return whether a flow is seen in a part."""
    return float(weight_of(flow).sum()) >= 4


def weight_of(flow):
    """Return the weight of each point of the first grid, shape (n_along, n_across)."""
    mask, region = flow.planes[0].mask, flow.regions[0]
    return mask * 1.0 if region is None else mask * region
