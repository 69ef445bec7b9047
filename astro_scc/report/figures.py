# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The figures of a report, what they show and how they are read."""

import base64
import io
from dataclasses import dataclass, field

import astropy.units as u
import numpy as np

from astro_scc.report.words import plural

__all__ = ["CAPTIONS", "Picture", "draw_pictures"]

#: Dots per inch of the figures, which are up to six inches wide.
DPI = 150
#: Title of each figure, and how it is read.
CAPTIONS = {
    "diagram": (
        "Displacement against interval",
        "Red is where more patterns match than in permuted epochs, at each "
        "displacement and time between two epochs.  A line from the origin is a "
        "speed, numbered as in the table: solid if it is significant and dotted if "
        "not, between thin lines for its dispersion, and dashed where structure "
        "stands still.",
    ),
    "velocity_map": (
        "Velocity map",
        "How well the patterns of the images agree when they are moved at each "
        "velocity.  Components have their number of the table and an ellipse of one "
        "standard error.  A square is structure that stands still; an oblique cross "
        "with a dotted ellipse is not significant.",
    ),
    "significance": (
        "Significance along the jet",
        "The map against those of shuffled epochs, in standard deviations, along the "
        "jet, as in the paper.  It is no probability: that is p_global.  Open signs "
        "are components off the axis.",
    ),
    "members": (
        "Which patterns make which component",
        "Each arrow leads from a pattern (SSP) to its match in the next epoch in which "
        "its feature is seen, drawn on the mean image.",
    ),
    "epochs": (
        "Epochs and their patterns",
        "All images on one colour scale with the significant structural patterns "
        "(SSPs), larger circles for larger scales.  The ellipse is the beam.",
    ),
    "intervals": (
        "Dates and pairs of epochs",
        "Ticks are epochs.  Each bar joins two epochs that the velocity map compares, "
        "as high as the time between them.",
    ),
}


@dataclass(frozen=True)
class Picture:
    """
    One figure of a report.

    Attributes
    ----------
    name : str
        Of its file, without ``.png``.
    png : bytes
    alt : str
        What it shows, for who cannot see it.
    """

    name: str
    png: bytes = field(repr=False)
    alt: str

    @property
    def title(self):
        """What the figure is of."""
        return CAPTIONS[self.name][0]

    @property
    def caption(self):
        """How it is read."""
        return CAPTIONS[self.name][1]

    @property
    def source(self):
        """The picture as an address that holds it."""
        return f"data:image/png;base64,{base64.b64encode(self.png).decode('ascii')}"


def draw_pictures(result, components):
    """
    Draw the figures.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    components : `~astropy.table.QTable`

    Returns
    -------
    list of `Picture`
        Without that of the members where there is no component.
    """
    from astro_scc import visualization as show

    shared = {"components": components, "beta_per_pm": _beta_per_pm(components)}
    figures = {
        "diagram": show.plot_diagram(result, components=components),
        "velocity_map": show.plot_velocity_map(result, **shared),
        "significance": show.plot_significance(result, **shared),
        "members": show.plot_members(result, components=components),
        "epochs": show.plot_epochs(result.cube, result.ssps),
        "intervals": show.plot_intervals(result.cube, result.pairs),
    }
    if len(components) == 0:
        del figures["members"]
    alts = _alts(result, components)
    return [Picture(name, _png(figure), alts[name]) for name, figure in figures.items()]


def _png(figure):
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()


def _alts(result, components):
    n, n_epochs, n_pairs = len(components), len(result.cube), len(result.pairs)
    marked = f"{n} {plural(n, 'component')} marked" if n else "no component marked"
    one, other = result.frame.axis_names
    return {
        "diagram": "Diagram of the displacements of matched patterns against the "
        f"interval between their epochs, {marked} by lines",
        "velocity_map": f"Map of the stacked correlation over the velocities {one} "
        f"and {other}, {marked}",
        "significance": "Curve of the z score against the velocity along the jet, "
        f"{marked}",
        "members": "Mean image with an arrow from each pattern to its match, a panel "
        "for each component",
        "epochs": f"Images of {n_epochs} epochs with circles about their patterns",
        "intervals": f"{n_epochs} dates on a line, and a bar for each of {n_pairs} "
        f"{plural(n_pairs, 'pair')} of epochs",
    }


def _beta_per_pm(components):
    """Apparent speed in units of c of 1 mas/yr, if the table tells."""
    if "beta_app" not in components.colnames:
        return None
    speed = u.Quantity(components["pm"]).to_value(u.mas / u.yr)
    beta = np.asarray(components["beta_app"], dtype=float)
    usable = (speed > 0) & (beta > 0)
    return float(beta[usable][0] / speed[usable][0]) if usable.any() else None
