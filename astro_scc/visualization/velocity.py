# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
The streams of a result: velocity map, z-score along the jet, and diagram.

What the options of these figures mean, `SCCResult.plot
<astro_scc.measurement.SCCResult.plot>` says.
"""

import astropy.units as u
import numpy as np

from astro_scc.columns import cell
from astro_scc.images.positions import axis_words, sky_columns
from astro_scc.units import PM_UNIT, offset_unit, unit_name
from astro_scc.visualization import images, style
from astro_scc.visualization.style import BLACK, GREY

AXIS_LABELS = {
    "parallel": "Proper motion parallel to the jet",
    "transverse": "Transverse proper motion",
    "radial": "Radial proper motion",
    "expansion": "Expansion speed at the radius",
    "rotation": "Rotation speed at the radius",
}
#: First axes of velocities on the sky, and of those that point away from a centre.
SKY, OUTWARD = ("east", "lon"), ("radial", "expansion")
MAP_LABELS = {"coefficient": "Correlation", "z_score": "z-score"}
#: What the correlation of a map of the velocity spectrum is.
EXCESS = "Mean correlation, less that of permuted epochs"
#: Corners for the legend (the first preferred) and for the arrow (the second).
CORNERS = {"upper right": (1, 1), "lower left": (0, 0)}
CORNERS |= {"upper left": (0, 1), "lower right": (1, 0)}


class Scene:
    """
    What figures of a result share: its streams, units, words and axes.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    figsize : (float, float)
        Size of a new figure, in inches.
    ax : `matplotlib.axes.Axes`, optional
        Axes to draw on instead.
    components : `~astropy.table.QTable`, optional
        The streams that are drawn, by default ``result.components``.
    unit : `~astropy.units.Unit`, optional
        Unit of speeds, by default that of the tables.

    Attributes
    ----------
    kinds : list of str
        The kind of each stream.
    on_sky : bool
        Whether the axes of the result are east and north.
    words : (str, str, bool)
        See `~astro_scc.images.positions.axis_words`.
    labels : list of str
        Labels of the axes of velocities.
    """

    def __init__(self, result, figsize, ax=None, components=None, unit=None):
        self.result, self.unit = result, style.speed_unit_of(result, unit)
        self.components = result.components if components is None else components
        self.kinds = self.components["kind"].tolist()
        self.on_sky = result.frame.axis_names[0] in SKY
        self.words = axis_words(result.cube)
        self.labels = velocity_labels(result.frame.axis_names, self.words, self.unit)
        self.figure, self.ax = style.figure_and_axes(ax, figsize)

    def streams(self, *columns):
        """Yield row, kind, whether it was found, and numbers in columns of each."""
        values = np.transpose([self.components[k].to_value(self.unit) for k in columns])
        for row, kind, numbers in zip(self.components, self.kinds, values, strict=True):
            yield row, kind, not kind.startswith("not"), numbers


# -- the paper's stack ---------------------------------------------------------------


def plot_velocity_map(
    result, *, ax=None, components=None, which="coefficient", unit=None,
    beta_per_pm=None, colorbar=True, **look,
):  # fmt: skip
    """
    Draw the velocity map.

    Streams are marked with their numbers in the table, a symbol for their kind
    (moving, stationary, not confirmed, not significant), and an ellipse of one standard
    error along each axis.  The arrow shows the direction of the flow.  Further keywords
    are those of the image, such as ``cmap``.
    """
    image = result.velocity_map(which)
    scene = Scene(result, (style.WIDTH, 5.2), ax, components, unit)
    ax = scene.ax
    drawn = draw_map(ax, image.data, result.grid, scene.unit, look)
    if scene.on_sky and scene.words[2]:
        ax.invert_xaxis()
    ax.set(xlabel=scene.labels[0], ylabel=scene.labels[1])
    place = _draw_components(scene)

    def crowd(corner):
        # What is in a corner takes so much of the axes.
        return np.sum(np.all(np.abs(place - CORNERS[corner]) < (0.34, 0.22), axis=1))

    first, second, *_ = sorted(CORNERS, key=crowd)
    if scene.kinds:
        ax.legend(loc=first, fontsize="small", facecolor="0.3", labelcolor="white")
    _draw_jet(scene, CORNERS[second])
    style.add_speed_axis(ax, scene.unit, beta_per_pm)
    if colorbar:
        excess = which == "coefficient" and hasattr(result, "search")
        label = EXCESS if excess else MAP_LABELS[which]
        scene.figure.colorbar(drawn, cax=style.beside(ax), label=label)
    return scene.figure


def draw_map(ax, values, grid, unit, look):
    """Draw a map of velocities."""
    sides = [PM_UNIT.to(unit, images.edges(v)[[0, -1]]) for v in (grid.v1, grid.v2)]
    values = np.ma.masked_invalid(values)
    usual = {"cmap": "cividis", "vmin": 0.0, "interpolation": "bilinear"}
    usual["vmax"] = values.compressed().max(initial=0.0) or 1.0
    look = style.look_of("image", look, **usual)
    drawn = ax.imshow(values, origin="lower", extent=np.ravel(sides), **look)
    rest = {"color": "white", "linewidth": 0.6, "alpha": 0.6}
    ax.axhline(0, **rest)
    ax.axvline(0, **rest)
    ax.set(xlim=sides[0], ylim=sides[1], aspect="equal")
    return drawn


def velocity_labels(names, words, unit):
    """Return the labels of the axes of velocities, of the sky by where they point."""
    if names[0] in SKY:
        return images.axis_labels("Proper motion", words, unit)
    return [f"{AXIS_LABELS[name]} ({unit_name(unit)})" for name in names]


def axis_columns(components, *, on_sky):
    """Return the columns of the velocities on the axes of a result."""
    return sky_columns(components) if on_sky else ("pm_parallel", "pm_transverse")


def _draw_components(scene):
    """Draw the streams; return their positions as fractions of the axes, (n, 2)."""
    from matplotlib.patches import Ellipse

    names = axis_columns(scene.components, on_sky=scene.on_sky)
    columns = *names, *(f"{name}_err" for name in names)
    ax, effects, places = scene.ax, style.outline(2.5, BLACK), np.zeros((0, 2))
    for row, kind, strong, (x, y, *error) in scene.streams(*columns):
        # Positions as fractions of the axes place the text beside them.
        place = ax.transLimits.transform((x, y))
        if np.isfinite(error).all():
            ellipse = Ellipse(
                (x, y), *(2 * half for half in error), facecolor="none",
                edgecolor="white", linewidth=1.2, linestyle="-" if strong else ":",
                path_effects=effects, gid="error",
            )  # fmt: skip
            ax.add_patch(ellipse)
        ax.plot(
            x, y, style.KIND_MARKERS[kind], markersize=4, markerfacecolor="none",
            markeredgecolor="white", path_effects=effects,
            label=None if kind in scene.kinds[: len(places)] else kind,
        )  # fmt: skip
        inward = np.where(place > 0.93, -1, 1)
        ax.annotate(
            f"{row['stream']}", np.clip(place, 0, 1),
            xycoords="axes fraction", xytext=7 * inward, textcoords="offset points",
            ha="left" if inward[0] > 0 else "right",
            va="bottom" if inward[1] > 0 else "top", color="white",
            fontweight="bold" if strong else "normal",
            fontsize="large" if strong else "small", path_effects=effects,
        )  # fmt: skip
        places = np.vstack([places, place])
    if parts := [patch for patch in ax.patches if patch.get_gid() == "error"]:
        parts[0].set_label("one standard error")
    return places


def _sky_direction(result):
    """Return the position angle of the flow in radians, as it was found or else set."""
    if hasattr(result, "search"):
        # The axes are east and north, which no direction was given for.
        return np.pi / 2 - result.search.angle
    return result.position_angle.to_value(u.rad)


def _draw_jet(scene, corner):
    """Draw an arrow with the direction of the jet or the flow in a corner."""
    direction, word = np.array([1.0, 0.0]), "jet"
    if scene.on_sky:
        angle, word = _sky_direction(scene.result), "flow"
        side = -1 if scene.words[2] else 1
        direction = np.array([side * np.sin(angle), np.cos(angle)])
    centre = 0.17 + 0.66 * np.array(corner)
    scene.ax.annotate(
        "outward" if scene.result.frame.axis_names[0] in OUTWARD else word,
        centre + 0.09 * direction, centre - 0.09 * direction,
        xycoords="axes fraction", textcoords="axes fraction", color="white",
        fontsize="small", ha="center", va="center", gid="jet",
        arrowprops={"arrowstyle": "-|>", "color": "white", "linewidth": 1.5},
    )  # fmt: skip


def plot_significance(
    result, *, ax=None, components=None, unit=None, beta_per_pm=None, level=None,
    **look,
):  # fmt: skip
    """
    Draw the z-score along the jet, at zero speed across it.

    The figure is like the lower panels of Fig. 2 of Mertens & Lobanov (2016).  A thin
    line is the largest z-score at any speed across the jet; streams off the axis
    have open symbols; a dashed line is at ``level``, the z-score of significant
    streams.  On axes east and north, the map is interpolated along the
    direction in which the flow moves.  Further keywords are those of the line.
    """
    scene = Scene(result, (style.WIDTH, 3.4), ax, components, unit)
    ax, unit = scene.ax, scene.unit
    speed, axis, highest = _along_jet(scene)
    speed = PM_UNIT.to(unit, speed)
    ax.axhline(0, color=GREY, linewidth=0.6)
    ax.plot(speed, highest, color=GREY, lw=0.8, label="highest, any transverse speed")
    usual = {"color": style.BLUE, "lw": 1.6, "label": "at zero transverse speed"}
    ax.plot(speed, axis, **style.look_of("line", look, **usual))
    if level is not None:
        ax.axhline(level, color=GREY, lw=0.8, ls="--", gid="level")
        ax.annotate(
            "significant", (1.0, level), xycoords=ax.get_yaxis_transform(),
            xytext=(-3, 2), textcoords="offset points", ha="right", va="bottom",
            fontsize="small", color=GREY,
        )  # fmt: skip
    ax.set_xlim(speed[0], speed[-1])
    top = max(np.nanmax(highest, initial=1.0), level or 0.0)
    ax.set_ylim(min(np.nanmin(axis, initial=0.0), 0.0) - 0.05 * top, 1.55 * top)
    x = np.linspace(speed[0], speed[-1], 2000)
    curves = [np.interp(x, speed, line) for line in (axis, highest)]
    curves += [] if level is None else [np.full(len(x), level)]
    _draw_z_scores(scene, np.concatenate([np.transpose([x, y]) for y in curves]))
    label = scene.labels[0]
    if scene.on_sky:
        angle = f"{np.degrees(_sky_direction(result)) % 360:.0f} deg"
        label = f"Proper motion along position angle {angle} ({unit_name(unit)})"
    ax.set(xlabel=label, ylabel=MAP_LABELS["z_score"])
    columns = style.legend_columns(2)
    ax.legend(loc="upper left", fontsize="small", ncols=columns, frameon=False)
    style.add_speed_axis(ax, unit, beta_per_pm)
    return scene.figure


def _draw_z_scores(scene, drawn):
    """
    Draw the streams at their z-scores, open if they are off the axis.

    Their numbers are above or below, where fewer points of what is ``drawn``, in the
    units of the axes, are in the way.
    """
    to_points = 72 / scene.figure.dpi
    drawn = to_points * scene.ax.transData.transform(drawn)
    names = ("pm_parallel", "pm_parallel_err", "pm_transverse", "pm_transverse_err")
    least = PM_UNIT.to(scene.unit, max(scene.result.grid.step))
    # The highest z-score may be beside the maximum.
    maxima = "z_score" in scene.components.colnames
    label = "maxima of the correlation,\nat fitted speeds" if maxima else "streams"
    for row, kind, strong, numbers in scene.streams(*names):
        along, error, across, across_error = numbers
        z, color = _z_of(scene, row), style.VERMILION if strong else GREY
        on_axis = abs(across) <= 3 * max(across_error, least)
        scene.ax.errorbar(
            along, z, xerr=error if np.isfinite(error) else 0.0,
            fmt=style.KIND_MARKERS[kind], color=color, markersize=5,
            markerfacecolor=color if on_axis else "white", capsize=2, zorder=3,
            label=label if row["stream"] == 1 else None,
        )  # fmt: skip
        off = drawn - to_points * scene.ax.transData.transform((along, z))

        def hidden(y, off=off):
            return np.sum(np.all(np.abs(off - (0, y)) < 5, axis=1))

        y = min((12, -12), key=hidden)
        scene.ax.annotate(
            f"{row['stream']}", (along, z), xytext=(0, y), textcoords="offset points",
            ha="center", va="center", color=color, path_effects=style.outline(),
            fontweight="bold" if strong else "normal", clip_on=True,
        )  # fmt: skip


def _z_of(scene, row):
    """Return the z-score of a row, or else that of the map at its velocity."""
    if "z_score" in row.colnames:
        return float(row["z_score"])
    grid = scene.result.grid
    names = axis_columns(scene.components, on_sky=scene.on_sky)
    v1, v2 = (row[name].to_value(PM_UNIT) for name in names)
    k, n = np.abs(grid.v1 - v1).argmin(), np.abs(grid.v2 - v2).argmin()
    return float(scene.result.z_score[n, k])


def plot_paper(
    result, *, figure=None, components=None, unit=None, beta_per_pm=None, level=None,
    **look,
):  # fmt: skip
    """Draw the velocity map over the z-score along the jet, as the paper's Fig. 2."""
    figure = style.new_figure((style.WIDTH, 8.0)) if figure is None else figure
    upper, lower = figure.subplots(2, 1, height_ratios=(2.0, 1.0))
    shared = {"components": components, "unit": unit}
    plot_velocity_map(result, ax=upper, beta_per_pm=beta_per_pm, **shared, **look)
    plot_significance(result, ax=lower, level=level, **shared)
    return figure


def _along_jet(scene):
    """Return speeds along the jet, z at zero speed across, and z's maximum across."""
    from scipy.ndimage import map_coordinates

    grid = scene.result.grid
    rows = np.asarray(scene.result.z_score, dtype=float)
    speed, middle = grid.v1, int(np.argmin(np.abs(grid.v2)))
    if scene.on_sky:
        angle = _sky_direction(scene.result)
        sin, cos = np.sin(angle), np.cos(angle)
        # The map is square, so its reach depends on the direction.
        reach = min(np.divide(abs(grid.v1[-1]), np.maximum(np.abs([sin, cos]), 1e-9)))
        middle = int(np.ceil(reach / min(grid.step)))
        speed = np.linspace(-reach, reach, 2 * middle + 1)
        along, across = np.meshgrid(speed, speed)
        east, north = sin * along + cos * across, cos * along - sin * across
        at = [(north - grid.v2[0]) / grid.step[1], (east - grid.v1[0]) / grid.step[0]]
        rows = map_coordinates(rows, at, order=1, cval=np.nan)
    return speed, rows[middle], np.fmax.reduce(rows)


def speed_text(row, kind):
    """Return the speed of a stream, its kind, or both as text."""
    form = None if np.isfinite(row["pm_err"]) else ".3g"
    text = f"{cell(row, 'pm', form=form)} {unit_name(row['pm'].unit)}"
    return {"moving": text, "stationary": kind}.get(kind, f"{text},\n{kind}")


# -- the diagram ---------------------------------------------------------------------


def plot_diagram(result, *, ax=None, components=None, unit=None, colorbar=True, **look):
    """
    Draw the displacement-interval diagram with the rays of the streams.

    In red areas, the changes of the images are more alike than the mean of all pairs
    of epochs.  What moves at a constant speed lies on a ray from the origin; what
    stands still lies at zero displacement.  Thin lines on both sides of a ray are one
    dispersion of the speeds away.  Intervals are shown until the slowest moving stream
    leaves the diagram.  A second axis shows the displacement in beams.  Further
    keywords are those of the cells, such as ``cmap``.
    """
    image = result.diagram()
    _, displacement = image.wcs.pixel_to_world_values(0, np.arange(len(image.data)))
    unit = offset_unit(displacement[-1], unit)
    scene = Scene(result, (style.WIDTH, 4.2), ax, components)
    ax, time = scene.ax, scene.unit.bases[1]
    slopes = ray_slopes(scene.components, scene.kinds, image.meta["position_angle"])
    seen = image.meta["n_pairs"] > 0
    years, excess = image.meta["interval"].to_value(u.yr)[seen], image.data[:, seen]
    longest = longest_interval(years, slopes, scene.kinds, displacement[-1])
    highest = highest_excess(years, excess, longest)
    cells = {"cmap": "RdBu_r", "vmin": -highest, "vmax": highest, "gid": "excess"}
    drawn = ax.pcolormesh(
        u.yr.to(time, images.edges(years)), u.mas.to(unit, images.edges(displacement)),
        excess, **style.look_of("mesh", look, rasterized=True, **cells),
    )  # fmt: skip
    ax.axhline(0, color=GREY, linewidth=0.6)
    top = u.mas.to(unit, displacement[-1])
    ax.set(xlim=(0, u.yr.to(time, longest)), ylim=(-top, top))
    _draw_rays(scene, slopes, PM_UNIT.to(unit / time))
    ax.set_xlabel(f"Interval between epochs ({unit_name(time)})")
    ax.set_ylabel(f"{_direction(scene, image)} ({unit_name(unit)})")
    beam = image.meta["beam"].to_value(unit)
    in_beams = (lambda v: v / beam, lambda v: v * beam)
    ax.secondary_yaxis("right", functions=in_beams).set_ylabel("Displacement (beams)")
    if colorbar:
        above = ax.inset_axes((0.0, 1.03, 1.0, 0.035))
        scene.figure.colorbar(
            drawn, cax=above, orientation="horizontal", ticklocation="top",
            extend="both", label="Correlation, less its mean over all pairs of epochs",
        )  # fmt: skip
    return scene.figure


def _draw_rays(scene, slopes, factor):
    """Draw the rays of the streams, with their legend."""
    ax, right, top = scene.ax, scene.ax.get_xlim()[1], scene.ax.get_ylim()[1]
    for row, kind, slope in zip(scene.components, scene.kinds, slopes, strict=True):
        if not np.isfinite(slope):
            continue
        number, slope = f"{row['stream']}", slope * factor
        ax.axline(
            (0, 0), slope=slope, color=BLACK, lw=1.4, ls=style.KIND_LINES[kind],
            gid="ray", label=f"{number}: {speed_text(row, kind)}",
            path_effects=style.outline(2.6),
        )  # fmt: skip
        spread = np.nan_to_num(row["dispersion"].to_value(PM_UNIT)) * factor
        sides = (slope - spread, slope + spread)
        for other in sides if spread > 0 and kind != "stationary" else ():
            thin = {"lw": 0.6, "alpha": 0.7, "gid": "dispersion"}
            ax.axline((0, 0), slope=other, color=BLACK, **thin)
        # The number lies on the ray, before it leaves the axes.
        x = 0.88 * min(right, top / abs(slope) if slope else right)
        ax.text(
            x, slope * x, number, ha="center", va="center", fontsize="small",
            bbox={"boxstyle": "circle,pad=0.2", "facecolor": "white", "linewidth": 0.6},
        )  # fmt: skip
    if np.isfinite(slopes).any():
        corner = "upper right" if slopes[0] < 0 else "lower right"
        ax.legend(loc=corner, fontsize="small", framealpha=0.85)


def _direction(scene, image):
    """Return the label of the displacement, with its direction."""
    if not scene.on_sky:
        jet = scene.result.frame.axis_names[0] == "parallel"
        return f"Displacement {'along the jet' if jet else 'outward'}"
    angle = f"{image.meta['position_angle'].to_value(u.deg):.0f}°"
    axis, _, to_the_left = scene.words
    where = f"towards PA {angle}" if to_the_left else f"{angle} from north to {axis}"
    return f"Displacement {where}"


def ray_slopes(components, kinds, angle):
    """
    Return the slopes of the streams' rays in the diagram.

    Parameters
    ----------
    components : `~astropy.table.QTable`
    kinds : sequence of str
    angle : `~astropy.units.Quantity`, float or None
        Position angle of the displacement, in degrees; None if it is along the jet.

    Returns
    -------
    `~numpy.ndarray`
        In mas/yr.  That of a stationary stream is zero, as is its speed within its
        errors.
    """
    slopes = components["pm_parallel"].to_value(PM_UNIT)
    if angle is not None:
        sky = (components[name].to_value(PM_UNIT) for name in sky_columns(components))
        angle = u.Quantity(angle, u.deg).to_value(u.rad)
        slopes = np.array([np.sin(angle), np.cos(angle)]) @ [*sky]
    return np.where(np.array(kinds) == "stationary", 0.0, slopes)


def longest_interval(years, slopes, kinds, reach, *, beyond=1.3, fewest=4):
    """
    Return the longest interval that is shown, in years.

    It is ``beyond`` times the one after which the slowest moving stream leaves the
    diagram, and there are the ``fewest`` intervals or more.
    """
    ends = images.edges(years)
    for shown in ("moving", "not confirmed", "not significant"):
        speeds = np.abs(slopes[np.array(kinds) == shown])
        if (speeds > 0).any():
            longest = beyond * reach / speeds[speeds > 0].min()
            # A fast stream alone would leave a single column.
            return min(max(longest, ends[: fewest + 1][-1]), ends[-1])
    return ends[-1]


def highest_excess(years, excess, longest):
    """Return the end of the range of the colours, which little of a diagram exceeds."""
    # No pair of epochs overlaps at some displacements.
    return np.nanquantile(np.abs(excess[:, years <= longest]), 0.995) or 1.0


def diagram_levels(years, excess, longest, n):
    """
    Return a diagram as levels from -127 to 127 at n equal intervals up to the longest.

    The shortest intervals, which no two epochs have, are zero, and what is unknown.
    """
    ends = images.edges(years)
    column = np.searchsorted(ends, (np.arange(n) + 0.5) / n * longest) - 1
    level = np.clip(excess / highest_excess(years, excess, longest), -1, 1)[:, column]
    known = (column >= 0) & np.isfinite(level)
    return np.where(known, np.round(127 * level), 0).astype(np.int8)
