# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Style that the figures share: colours, markers, units of axes, and colour bars."""

from typing import NamedTuple

import numpy as np

from astro_scc.units import PM_UNIT

# Colours of Okabe & Ito, which colour-blind readers can distinguish.
BLACK = "#000000"
ORANGE = "#E69F00"
SKY_BLUE = "#56B4E9"
GREEN = "#009E73"
BLUE = "#0072B2"
VERMILLION = "#D55E00"
PURPLE = "#CC79A7"
GREY = "#767676"
SCALE_COLORS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY_BLUE)
LINES = ("-", "--", ":")

#: Width and largest height of a figure in inches, for a page.
WIDTH = 6.0
HEIGHT = 9.5


class Kind(NamedTuple):
    """Markers of a kind of component in maps, slices and profiles, line and name."""

    on_map: str
    on_slice: str
    on_profile: str
    line: str
    name: str


KINDS = {
    "moving": Kind("+", "o", "o", "-", "component"),
    "stationary": Kind("s", "s", "s", "--", "stationary"),
    "not significant": Kind("x", "x", "o", ":", "not significant"),
}


def figure_and_axes(ax, figsize):
    """
    Return a figure and the axes to draw on, new ones if no axes are given.

    WCSAxes are refused.  Figures are made without pyplot, so nothing is
    registered, shown or set globally.
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
    """Return an empty figure that makes room for its labels."""
    from matplotlib.figure import Figure

    return Figure(figsize=figsize, layout="compressed")


def scale_colors(scales):
    """Return a colour for each scale number, the finest first."""
    numbers = np.unique(np.asarray(scales, dtype=float)).tolist()
    return {n: SCALE_COLORS[k % len(SCALE_COLORS)] for k, n in enumerate(numbers)}


def component_color(number):
    """Return the colour of the component with a number, from 1."""
    return SCALE_COLORS[(number - 1) % len(SCALE_COLORS)]


def component_look(number, kind):
    """Return the colour, the face and the label of the features of a component."""
    face = {"mfc": "white"} if kind == "not significant" else {}
    return {"color": component_color(number), "label": f"{number}: {kind}", **face}


def draw_bins(ax, table, column, unit, **look):
    """Draw the speeds in bins of distance, with bars for errors and widths of bins."""
    low, middle, high = (
        table[name if name in table.colnames else "r_mid"].to_value(unit)
        for name in ("r_min", "r_mid", "r_max")
    )
    speed, error = (table[k].to_value(PM_UNIT) for k in (column, f"{column}_err"))
    error = np.where(np.isfinite(error), error, 0.0)
    ax.errorbar(middle, speed, error, [middle - low, high - middle], **look)


def show_years(ax, cube):
    """Limit the horizontal axis of axes to the dates of a cube, in years."""
    first, last = cube.times.jyear[[0, -1]]
    margin = 0.03 * ((last - first) or 1.0)
    ax.set(xlabel="Year", xlim=(first - margin, last + margin))
    ax.ticklabel_format(axis="x", useOffset=False)


def legend_above(ax):
    """Add a legend above axes, on the left, with each label that they have once."""
    handles, labels = ax.get_legend_handles_labels()
    if each := dict(zip(labels, handles, strict=True)):
        ax.legend(
            each.values(), each.keys(), fontsize="small", frameon=False, ncols=3,
            loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0,
        )  # fmt: skip


def component_kinds(components):
    """Return the column ``kind`` of a table as text, or "moving" if it has none."""
    known = "kind" in components.colnames
    return list(map(str, components["kind"] if known else ["moving"] * len(components)))


def add_colorbar(ax, drawn, label, ticks=None):
    """Add a colour bar beside axes, exactly as high as they are."""
    beside = ax.inset_axes((1.02, 0.0, 0.03, 1.0))
    set_ticks(ax.get_figure().colorbar(drawn, cax=beside, label=label), ticks)


def set_ticks(bar, ticks):
    """Set the ticks of a colour bar as plain numbers; None keeps matplotlib's."""
    if ticks is not None:
        bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
        bar.minorticks_off()


def add_speed_axis(ax, unit, beta_per_pm, side="top"):
    """Add an axis in units of c to one of proper motion, if their ratio is known."""
    if beta_per_pm is None:
        return
    factor = float(beta_per_pm) * (1 * unit).to_value(PM_UNIT)
    if not 0 < factor < np.inf:
        raise ValueError(f"beta_per_pm must be positive, got {beta_per_pm}")
    axis = "x" if side == "top" else "y"
    both = (lambda v: v * factor, lambda beta: beta / factor)
    second = getattr(ax, f"secondary_{axis}axis")(side, functions=both)
    second.set(**{f"{axis}label": "Apparent speed (c)"})


def outline(width=2.5, color="white"):
    """Return path effects that keep lines and letters readable on any background."""
    from matplotlib.patheffects import Normal, Stroke

    return [Stroke(linewidth=width, foreground=color), Normal()]
