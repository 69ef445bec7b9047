# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Style that the figures share: colours, markers, units of axes, and colour bars."""

from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from io import BytesIO
from itertools import product

import astropy.units as u
import numpy as np

from astro_scc.units import PM_UNIT, unit_like, unit_name

# Colours of Okabe & Ito, which colour-blind readers can distinguish.
BLACK = "#000000"
ORANGE = "#E69F00"
SKY_BLUE = "#56B4E9"
GREEN = "#009E73"
BLUE = "#0072B2"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
GREY = "#767676"
COLORS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY_BLUE)
LINES = ("-", "--", ":")

#: Width and largest height of a figure in inches, for a page.
WIDTH = 6.0
HEIGHT = 9.5
#: Figures of many panels, which need two columns.
WIDE = ("epochs",)
#: Settings of figures for journals, which take letters of 8 pt and no fonts of Type 3.
JOURNAL = {
    "font.size": 8.0,
    "axes.linewidth": 0.6,
    "lines.linewidth": 0.8,
    "lines.markersize": 3.0,
    "pdf.fonttype": 42,
}
_SCALE = ContextVar("scale", default=1.0)
#: Label of features of no stream.
NONE = "no stream"
#: Keywords of matplotlib's functions that are not of their artists.
OF_PLOTS = "vmin", "vmax", "shading", "capsize", "elinewidth"
#: Dots per inch of a page.
DPI = 150


#: Markers and lines of the kinds of streams in all figures.
KIND_MARKERS = {
    "moving": "o", "stationary": "s", "not confirmed": "D", "not significant": "X",
}  # fmt: skip
KIND_LINES = {
    "moving": "-", "stationary": "--", "not confirmed": "-.", "not significant": ":",
}  # fmt: skip


def look_of(kind, given, **usual):
    """
    Return the usual keywords of an artist, with those that are given in their place.

    Parameters
    ----------
    kind : {"line", "image", "mesh"}
        Keywords may be short, as those of the artist of matplotlib are.
    given : dict

    Raises
    ------
    TypeError
        If a keyword is none of the artist.
    """
    from matplotlib import cbook, collections, image, lines
    from matplotlib.artist import ArtistInspector

    kinds = {"line": lines.Line2D, "image": image.AxesImage}
    artist = kinds.get(kind, collections.QuadMesh)
    usual, given = (cbook.normalize_kwargs(look, artist) for look in (usual, given))
    known = {*ArtistInspector(artist).get_setters(), *usual, *OF_PLOTS}
    for name in given.keys() - known:
        if name == "ax":
            what = "this figure has several axes: give figure=, not ax="
            raise TypeError(what)
        raise TypeError(
            f"unknown option {name!r} of this figure: it takes its own and those of "
            f"matplotlib's {artist.__name__}"
        )
    if given.get("norm") is not None:
        # A norm has limits of its own.
        usual = {k: v for k, v in usual.items() if k not in ("vmin", "vmax")}
    return usual | given


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

    scale = min(_SCALE.get(), HEIGHT / figsize[1])
    return Figure(figsize=[scale * side for side in figsize], layout="compressed")


@contextmanager
def for_journal(columns=1, width=3.46):
    """Make figures as wide as columns, in inches, with the fonts of a journal."""
    from matplotlib import rc_context

    token = _SCALE.set(columns * width / WIDTH)
    try:
        with rc_context(JOURNAL):
            yield
    finally:
        _SCALE.reset(token)


def figure_files(names, draw, *, pdf=False):
    """
    Return figures as the contents of files by their names.

    Parameters
    ----------
    names : sequence of str
    draw : callable
        Returns the figure of a name.
    pdf : bool, optional
        Draw them for a column of a journal as well, as PDF; wide ones for two.
    """
    files, kinds = {}, {"png": None} | ({"pdf": {"CreationDate": None}} if pdf else {})
    for name, (kind, metadata) in product(names, kinds.items()):
        width = for_journal(2 if name in WIDE else 1)
        with width if kind == "pdf" else nullcontext(), BytesIO() as buffer:
            figure = draw(name)
            thin(figure)
            figure.savefig(buffer, format=kind, dpi=DPI, metadata=metadata)
            files[f"{name}.{kind}"] = buffer.getvalue()
    return files


def thin(figure):
    """Draw lines and symbols of a narrow figure smaller."""
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    scale = min(_SCALE.get(), 1.0)
    for ax in figure.axes if scale < 1 else ():
        drawn = [*ax.lines, *ax.collections]
        drawn += ax.get_legend().findobj() if ax.get_legend() else []
        for artist in drawn:
            if isinstance(artist, Line2D):
                artist.set_markersize(scale * artist.get_markersize())
            if isinstance(artist, Line2D | LineCollection):
                artist.set_linewidth(scale * np.asarray(artist.get_linewidth()))
        for text in ax.texts:
            if arrow := getattr(text, "arrow_patch", None):
                arrow.set_mutation_scale(scale * arrow.get_mutation_scale())


def legend_columns(n):
    """Return the number of columns of a legend: half of n in a narrow figure."""
    return n if _SCALE.get() >= 1 else max(n // 2, 1)


def component_color(number):
    """Return the colour of a stream, or a scale, with a number from 1."""
    return COLORS[(number - 1) % len(COLORS)]


def speed_unit_of(result, unit=None):
    """Return a unit of speeds for figures of a result, that of its tables if None."""
    unit = result.cube.speed_unit if unit is None else unit
    return unit_like(PM_UNIT, unit, "an angle over a time, such as 'mas/yr'")


def draw_bins(ax, table, unit, speeds, look):
    """Draw speeds in bins of distance in units of both, with bars for their errors."""
    low, middle, high = (table[f"r_{k}"].to_value(unit) for k in ("min", "mid", "max"))
    names = "pm_parallel", "pm_parallel_err"
    speed, error = (table[name].to_value(speeds) for name in names)
    error = np.where(np.isfinite(error), error, 0.0)
    ax.errorbar(middle, speed, error, [middle - low, high - middle], **look)


def date_axis(ax, cube, earliest=None, room=0.03):
    """
    Limit the horizontal axis of axes to the dates of a cube, and label it.

    A series that is measured in years has decimal years, others the Modified Julian
    Date or hours.  On the right there is ``room`` for labels, a share of the span.  The
    function that converts Julian years to the axis is returned.
    """
    unit = cube.speed_unit.bases[1]
    first, last = cube.times[[0, -1]]
    factor, zero, label = 1.0, 0.0, "Year"
    if unit != u.yr:
        factor, zero, label = 365.25, 2000.0 - 51544.5 / 365.25, "MJD"
    if unit == u.h:
        midnight = first.strftime("%Y-%m-%d")
        factor *= 24
        zero += np.floor(first.mjd) / 365.25
        label = f"Hours since {midnight} 00:00 UTC"

    def convert(years):
        return (np.asarray(years) - zero) * factor

    low, high = convert([first.jyear, last.jyear])
    low = low if earliest is None else min(low, convert(earliest))
    span = (high - low) or 1.0
    ax.set(xlabel=label, xlim=(low - 0.03 * span, high + room * span))
    ax.ticklabel_format(axis="x", useOffset=False, style="plain")
    # Labels such as 2000.5 need room.
    ax.locator_params(axis="x", nbins=7)
    return convert


def legend_above(ax, columns=4):
    """Add a legend above axes, on the left, with each label once, as it is darkest."""
    pairs = zip(*ax.get_legend_handles_labels()[::-1], strict=True)
    # The lines of an errorbar are in a container.
    lines = ((text, [*k.get_children(), k][0], k) for text, k in pairs)
    each = [(text, line.get_alpha() or 1.0, k) for text, line, k in lines]
    each.sort(key=lambda k: (k[0] == NONE, *k[:2]))
    if each := {text: handle for text, _, handle in each}:
        ax.legend(
            each.values(), each.keys(), fontsize="small", frameon=False,
            ncols=legend_columns(columns), loc="lower left", bbox_to_anchor=(0, 1),
            borderaxespad=0,
        )  # fmt: skip


def plain_log(ax):
    """Write the speeds at a logarithmic axis as plain numbers: 1, 2, 5, 10."""
    from matplotlib.ticker import LogLocator

    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter("")


def beside(ax):
    """Return axes for a colour bar beside others, exactly as high as they are."""
    return ax.inset_axes((1.02, 0.0, 0.03, 1.0))


def add_speed_axis(ax, unit, beta_per_pm, side="top"):
    """Return an axis in units of c beside one of proper motion, if known, or None."""
    if beta_per_pm is None:
        return None
    factor = float(beta_per_pm) * (1 * unit).to_value(PM_UNIT)
    if not 0 < factor < np.inf:
        raise ValueError(f"beta_per_pm must be positive, got {beta_per_pm}")
    axis = "x" if side == "top" else "y"
    both = (lambda v: v * factor, lambda beta: beta / factor)
    second = getattr(ax, f"secondary_{axis}axis")(side, functions=both)
    second.set(**{f"{axis}label": "Apparent speed (c)"})
    return second


def label_distances(ax, lengths, what, speeds, beta_per_pm, columns=4):
    """Label speeds against distance in units of both; add a legend and an axis in c."""
    ax.set_xlabel(f"Core separation ({unit_name(lengths)})")
    ax.set_ylabel(f"{what} ({unit_name(speeds)})")
    legend_above(ax, columns)
    add_speed_axis(ax, speeds, beta_per_pm, "right")


def outline(width=2.5, color="white"):
    """Return path effects that keep lines and letters readable on any background."""
    from matplotlib.patheffects import Normal, Stroke

    return [Stroke(linewidth=width, foreground=color), Normal()]
