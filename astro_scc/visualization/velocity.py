# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Draw velocity maps and the significance along the jet."""

import astropy.units as u
import numpy as np

from astro_scc.columns import cell
from astro_scc.images.positions import axis_words, sky_columns
from astro_scc.units import PM_UNIT, unit_like, unit_name
from astro_scc.visualization import drawing, style
from astro_scc.visualization.style import BLACK, GREY, KINDS

AXIS_LABELS = {
    "parallel": "Proper motion parallel to the jet",
    "transverse": "Transverse proper motion",
    "radial": "Radial proper motion",
}
MAP_LABELS = {
    "coefficient": "Stacked correlation coefficient",
    "z_score": "z-score",
}
#: Corners for the legend (the first preferred) and for the arrow (the second).
CORNERS = {"upper right": (1, 1), "lower left": (0, 0)}
CORNERS |= {"upper left": (0, 1), "lower right": (1, 0)}
#: Size of what is in a corner as fractions of the axes.
CORNER_SIZE = (0.34, 0.22)


def plot_velocity_map(
    result, *, ax=None, components=None, which="coefficient", unit=None,
    beta_per_pm=None, colorbar=True,
):  # fmt: skip
    """
    Draw the stacked cross-correlation as a map of velocities.

    Components are marked with their numbers in the table, a symbol for their
    kind (moving, stationary, not significant), and an ellipse of one standard
    error along each axis.  The arrow shows the direction of the jet.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    ax : `matplotlib.axes.Axes`, optional
        Axes to draw on instead of a new figure.
    components : `~astropy.table.QTable`, optional
        The components to mark, by default ``result.components``.
    which : {"coefficient", "z_score"}
        The map that is drawn.
    unit : `~astropy.units.Unit`, optional
        Unit of the axes, by default that of the tables.
    beta_per_pm : float, optional
        Apparent speed, in units of c, of a proper motion of 1 mas/yr, for a
        second axis.
    colorbar : bool, optional

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the map is unknown, the unit is not that of a proper motion, or
        ``beta_per_pm`` is not positive.
    """
    image, unit = result.velocity_map(which), _unit(result, unit)
    components, kinds = style.marked(result, components)
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 5.2))
    drawn = draw_map(ax, image.data, result.grid, unit)
    words = axis_words(result.cube)
    if on_sky(result) and words[2]:
        ax.invert_xaxis()
    across, up = velocity_labels(result.frame.axis_names, words, unit)
    ax.set(xlabel=across, ylabel=up)
    place = _draw_components(ax, result, components, kinds, unit)
    crowd = {
        name: np.sum(np.all(np.abs(place - corner) < CORNER_SIZE, axis=1))
        for name, corner in CORNERS.items()
    }
    first, second, *_ = sorted(CORNERS, key=crowd.get)
    if len(components):
        ax.legend(loc=first, fontsize="small", facecolor="0.3", labelcolor="white")
    _draw_jet(ax, result, CORNERS[second])
    style.add_speed_axis(ax, unit, beta_per_pm)
    if colorbar:
        figure.colorbar(drawn, cax=style.beside(ax), label=MAP_LABELS[which])
    return figure


def _unit(result, unit):
    """Return the unit of the axes, by default that of the tables."""
    if unit is None:
        return result.cube.speed_unit
    return unit_like(PM_UNIT, unit, "an angle over a time, such as 'mas/yr'")


def draw_map(ax, values, grid, unit):
    """Draw a map of velocities."""
    sides = [PM_UNIT.to(unit, drawing.edges(v)[[0, -1]]) for v in (grid.v1, grid.v2)]
    values = np.ma.masked_invalid(values)
    drawn = ax.imshow(
        values, origin="lower", extent=np.ravel(sides), cmap="cividis", vmin=0.0,
        vmax=values.compressed().max(initial=0.0) or 1.0, interpolation="bilinear",
    )  # fmt: skip
    ax.axhline(0, color="white", linewidth=0.6, alpha=0.6)
    ax.axvline(0, color="white", linewidth=0.6, alpha=0.6)
    ax.set(xlim=sides[0], ylim=sides[1], aspect="equal")
    return drawn


def on_sky(result):
    """Return whether the axes of a result are east and north."""
    return tuple(result.frame.axis_names) == ("east", "north")


def velocity_labels(names, words, unit):
    """Return the labels of the axes of velocities, of the sky by where they point."""
    if names[0] in ("east", "lon"):
        return drawing.axis_labels("Proper motion", words, unit)
    names = (AXIS_LABELS.get(name, f"Proper motion, {name}") for name in names)
    return [f"{name} ({unit_name(unit)})" for name in names]


def _draw_components(ax, result, components, kinds, unit):
    """Draw the components; return their positions as fractions of the axes, (n, 2)."""
    from matplotlib.patches import Ellipse

    names = ("pm_parallel", "pm_transverse")
    if on_sky(result):
        names = sky_columns(components)
    speed, error = (
        np.stack([components[f"{name}{end}"].to_value(unit) for name in names], axis=-1)
        for end in ("", "_err")
    )
    # Positions of the components as fractions of the axes place the text beside them.
    place = ax.transLimits.transform(speed)
    effects = style.outline(2.5, BLACK)
    for k, kind in enumerate(kinds):
        strong = not kind.startswith("not")
        if np.isfinite(error[k]).all():
            ellipse = Ellipse(
                speed[k], *(2 * error[k]), facecolor="none", edgecolor="white",
                linewidth=1.2, linestyle="-" if strong else ":", path_effects=effects,
                gid="error",
            )  # fmt: skip
            ax.add_patch(ellipse)
        ax.plot(
            *speed[k], KINDS[kind].on_map, markersize=4, markerfacecolor="none",
            markeredgecolor="white", path_effects=effects,
            label=None if kind in kinds[:k] else KINDS[kind].name,
        )  # fmt: skip
        inward = np.where(place[k] > 0.93, -1, 1)
        ax.annotate(
            f"{components['component'][k]:.0f}", np.clip(place[k], 0, 1),
            xycoords="axes fraction", xytext=7 * inward, textcoords="offset points",
            ha="left" if inward[0] > 0 else "right",
            va="bottom" if inward[1] > 0 else "top", color="white",
            fontweight="bold" if strong else "normal",
            fontsize="large" if strong else "small", path_effects=effects,
        )  # fmt: skip
    return place


def _draw_jet(ax, result, corner):
    """Draw an arrow with the jet's direction in a corner of the axes."""
    direction = np.array([1.0, 0.0])
    if on_sky(result):
        angle = result.position_angle.to_value(u.rad)
        side = -1 if axis_words(result.cube)[2] else 1
        direction = np.array([side * np.sin(angle), np.cos(angle)])
    centre = 0.17 + 0.66 * np.array(corner)
    ax.annotate(
        "outward" if result.frame.axis_names[0] == "radial" else "jet",
        centre + 0.09 * direction, centre - 0.09 * direction,
        xycoords="axes fraction", textcoords="axes fraction", color="white",
        fontsize="small", ha="center", va="center", gid="jet",
        arrowprops={"arrowstyle": "-|>", "color": "white", "linewidth": 1.5},
    )  # fmt: skip


def plot_significance(result, *, ax=None, components=None, unit=None, beta_per_pm=None):
    """
    Draw the significance along the jet, at zero speed across it.

    The figure is like the lower panels of Fig. 2 of Mertens & Lobanov (2016).
    A thin line is the largest significance at any speed across the jet;
    components off the axis have open symbols.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
        On axes east and north, the map is interpolated along
        ``result.position_angle``.
    ax, components, unit, beta_per_pm
        As in `plot_velocity_map`.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is not that of a proper motion, or ``beta_per_pm`` is not
        positive.
    """
    unit = _unit(result, unit)
    components, kinds = style.marked(result, components)
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 3.4))
    speed, axis, highest = _along_jet(result)
    speed = PM_UNIT.to(unit, speed)
    ax.axhline(0, color=GREY, linewidth=0.6)
    for line, color, width, label in (
        (highest, GREY, 0.8, "highest, any transverse speed"),
        (axis, style.BLUE, 1.6, "at zero transverse speed"),
    ):
        ax.plot(speed, line, color=color, linewidth=width, label=label)
    _mark_significance(ax, result, components, kinds, unit)
    ax.set_xlim(speed[0], speed[-1])
    top = max(np.nanmax(highest, initial=1.0), *components["z_score"], 1.0)
    ax.set_ylim(min(np.nanmin(axis, initial=0.0), 0.0) - 0.05 * top, 1.4 * top)
    label, _ = velocity_labels(result.frame.axis_names, axis_words(result.cube), unit)
    if on_sky(result):
        angle = result.position_angle.to_value(u.deg) % 360
        label = f"Proper motion along position angle {angle:.0f} deg"
        label = f"{label} ({unit_name(unit)})"
    ax.set(xlabel=label, ylabel=MAP_LABELS["z_score"])
    columns = style.legend_columns(2)
    ax.legend(loc="upper left", fontsize="small", ncols=columns, frameon=False)
    style.add_speed_axis(ax, unit, beta_per_pm)
    return figure


def plot_map_and_significance(result, *, figure=None, beta_per_pm=None, **shared):
    """
    Draw the velocity map over its significance along the jet.

    The figure is like Fig. 2 of Mertens & Lobanov (2016): `plot_velocity_map`
    over `plot_significance`.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    figure : `matplotlib.figure.Figure`, optional
        Figure to draw on instead of a new one.
    components, unit, beta_per_pm
        As in `plot_velocity_map`.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is not that of a proper motion, or ``beta_per_pm`` is not
        positive.
    """
    figure = style.new_figure((style.WIDTH, 8.0)) if figure is None else figure
    upper, lower = figure.subplots(2, 1, height_ratios=(2.0, 1.0))
    plot_velocity_map(result, ax=upper, beta_per_pm=beta_per_pm, **shared)
    plot_significance(result, ax=lower, **shared)
    return figure


def _along_jet(result):
    """Return speeds along the jet, z at zero speed across, and z's maximum across."""
    from scipy.ndimage import map_coordinates

    grid, rows = result.grid, np.asarray(result.z_score, dtype=float)
    speed, middle = grid.v1, int(np.argmin(np.abs(grid.v2)))
    if on_sky(result):
        angle = result.position_angle.to_value(u.rad)
        sin, cos = np.sin(angle), np.cos(angle)
        # The map is square, so its reach depends on the direction.
        reach = min(np.divide(grid.v_max, np.maximum(np.abs([sin, cos]), 1e-9)))
        middle = int(np.ceil(reach / min(grid.step)))
        speed = np.linspace(-reach, reach, 2 * middle + 1)
        along, across = np.meshgrid(speed, speed)
        east, north = sin * along + cos * across, cos * along - sin * across
        at = [(north - grid.v2[0]) / grid.step[1], (east - grid.v1[0]) / grid.step[0]]
        rows = map_coordinates(rows, at, order=1, cval=np.nan)
    return speed, rows[middle], np.fmax.reduce(rows)


def _mark_significance(ax, result, components, kinds, unit):
    names = ("pm_parallel", "pm_parallel_err", "pm_transverse", "pm_transverse_err")
    speeds = np.stack([components[name].to_value(unit) for name in names], axis=-1)
    least = PM_UNIT.to(unit, max(result.grid.step))
    for row, kind, (along, error, across, across_error) in zip(
        components, kinds, speeds, strict=True
    ):
        strong = not kind.startswith("not")
        on_axis = abs(across) <= 3 * max(across_error, least)
        color = style.VERMILION if strong else GREY
        ax.errorbar(
            along, row["z_score"], xerr=error if np.isfinite(error) else 0.0,
            fmt=KINDS[kind].on_slice, color=color, markersize=5,
            markerfacecolor=color if on_axis else "white", capsize=2, zorder=3,
        )  # fmt: skip
        ax.annotate(
            f"{row['component']:.0f}", (along, row["z_score"]), xytext=(0, 6),
            textcoords="offset points", ha="center", color=color,
            fontweight="bold" if strong else "normal", path_effects=style.outline(),
            clip_on=True,
        )  # fmt: skip


def speed_text(row, kind):
    """Return the speed of a stream, its kind, or both as text."""
    if not row["n_features"]:
        return kind
    form = None if np.isfinite(row["pm_err"]) else ".3g"
    text = f"{cell(row, 'pm', form=form)} {unit_name(row['pm'].unit)}"
    return {"moving": text, "stationary": kind}.get(kind, f"{text},\n{kind}")
