# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the figures share: colours, units of axes, and where they are drawn."""

import astropy.units as u
import numpy as np

__all__ = []

# Okabe & Ito's colours, which people of all colour visions tell apart.
BLACK = "#000000"
ORANGE = "#E69F00"
SKY_BLUE = "#56B4E9"
GREEN = "#009E73"
BLUE = "#0072B2"
VERMILLION = "#D55E00"
PURPLE = "#CC79A7"
GREY = "#767676"

PM_UNIT = u.mas / u.yr

SCALE_COLORS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY_BLUE)

#: Width and largest height of a figure in inches, for a page.
WIDTH = 6.0
HEIGHT = 9.5


def figure_and_axes(ax, figsize):
    """
    The axes to draw on and their figure, new ones where none are given.

    Those of a WCS are refused.

    Figures are made without pyplot: nothing is registered, shown or set.
    """
    if hasattr(ax, "wcs"):
        raise TypeError(
            "ax is a WCSAxes, which counts pixels, and the figures are in offsets and "
            "speeds; give plain axes, without projection="
        )
    if ax is not None:
        return ax.get_figure(), ax
    figure = new_figure(figsize)
    return figure, figure.add_subplot()


def new_figure(figsize):
    """An empty figure that makes room for its labels."""
    from matplotlib.figure import Figure

    return Figure(figsize=figsize, layout="compressed")


def offset_unit(span, unit=None):
    """The unit in which offsets over a span of so many mas are easily read."""
    if unit is not None:
        unit = u.Unit(unit)
        if not unit.is_equivalent(u.mas):
            raise ValueError(f"unit must be an angle, such as 'mas', got {unit}")
        return unit
    for unit, least in ((u.deg, 3.0), (u.arcmin, 5.0), (u.arcsec, 3.0), (u.mas, 0.3)):
        if (span * u.mas).to_value(unit) >= least:
            return unit
    return u.uas


def speed_unit(fastest, unit=None):
    """The unit in which proper motions up to so many mas/yr are easily read."""
    if unit is None:
        if (fastest * PM_UNIT).to_value(u.arcsec / u.h) >= 0.3:
            return u.arcsec / u.h
        return u.arcsec / u.yr if fastest >= 3000 else PM_UNIT
    unit = u.Unit(unit)
    if not unit.is_equivalent(PM_UNIT):
        raise ValueError(
            f"unit must be an angle over a time, such as 'mas/yr', got {unit}"
        )
    return unit


def unit_name(unit):
    """A unit as it stands in a label."""
    return u.Unit(unit).to_string().replace(" / ", "/")


def scale_colors(scales):
    """A colour for each scale number, the finest first."""
    numbers = np.unique(np.asarray(scales, dtype=float))
    return {
        float(number): SCALE_COLORS[k % len(SCALE_COLORS)]
        for k, number in enumerate(numbers)
    }


def component_kinds(components):
    """
    What the figures and the report may say of each component.

    Parameters
    ----------
    components : `~astropy.table.QTable`
        As `~astro_scc.measurement.SCCResult.components`.

    Returns
    -------
    list of str
        The column ``kind``; "moving" without one.
    """
    if "kind" not in components.colnames:
        return ["moving"] * len(components)
    return [str(kind) for kind in components["kind"]]


def add_colorbar(ax, drawn, label, ticks=None):
    """A colour bar beside axes, exactly as high as they are."""
    beside = ax.inset_axes((1.02, 0.0, 0.03, 1.0))
    bar = ax.get_figure().colorbar(drawn, cax=beside, label=label)
    set_ticks(bar, ticks)
    return bar


def add_speed_axis(ax, unit, beta_per_pm, side="top"):
    """An axis in units of c, on top or on the right, of one in proper motions."""
    factor = float(beta_per_pm) * (1 * unit).to_value(PM_UNIT)
    if not 0 < factor < np.inf:
        raise ValueError(f"beta_per_pm must be positive, got {beta_per_pm}")
    make = ax.secondary_xaxis if side == "top" else ax.secondary_yaxis
    second = make(side, functions=(lambda v: v * factor, lambda beta: beta / factor))
    if side == "top":
        second.set_xlabel("Apparent speed (c)")
    else:
        second.set_ylabel("Apparent speed (c)")


def set_ticks(bar, ticks):
    """Set the ticks of a colour bar as plain numbers; none for matplotlib's."""
    if ticks is not None:
        bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
        bar.minorticks_off()


def outline(width=2.5, color="white"):
    """Path effects that keep a line or a letter readable on any ground."""
    from matplotlib.patheffects import Normal, Stroke

    return [Stroke(linewidth=width, foreground=color), Normal()]
