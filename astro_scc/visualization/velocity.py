# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Velocity maps, and significance along the jet."""

from __future__ import annotations

from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from astro_scc.epochs.positions import axis_words, sky_columns
from astro_scc.units import PM_UNIT, speed_unit, unit_name
from astro_scc.visualization import style
from astro_scc.visualization.style import BLACK, GREY, KINDS

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from astro_scc.measurement import SCCResult

AXIS_LABELS = {
    "east": "Proper motion to the east",
    "north": "Proper motion to the north",
    "parallel": "Proper motion parallel to the jet",
    "transverse": "Transverse proper motion",
    "radial": "Radial proper motion",
}
MAP_LABELS = {
    "coefficient": "Stacked correlation coefficient",
    "z_score": "Significance z",
}
#: Corners for the legend (the first preferred) and for the arrow (the last preferred).
CORNERS = {"upper right": (1, 1), "upper left": (0, 1)}
CORNERS |= {"lower right": (1, 0), "lower left": (0, 0)}
#: Sizes of legend and arrow as fractions of the axes.
LEGEND_SIZE = (0.34, 0.16)
ARROW_SIZE = (0.22, 0.22)


def plot_velocity_map(
    result: SCCResult, *, ax: Axes | None = None, components: QTable | None = None,
    which: str = "coefficient", unit: u.UnitBase | str | None = None,
    beta_per_pm: float | None = None, colorbar: bool = True,
) -> Figure:  # fmt: skip
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
        Unit of the axes, by default mas/yr, or arcsec/yr or arcsec/h for large
        speeds.
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

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.visualization import plot_velocity_map
    >>> scc = StackedCrossCorrelation(scales=[1, 2], max_speed=36 * u.mas / u.yr)
    >>> result = scc(simulate_two_fluid(n_epochs=5, rng=1).cube, n_trials=50, rng=1)
    >>> figure = plot_velocity_map(result)
    >>> figure.axes[0].get_xlabel()
    'Proper motion to the east (mas/yr)'
    """
    if which not in MAP_LABELS:
        raise ValueError(f"unknown map {which!r}: use 'coefficient' or 'z_score'")
    unit = speed_unit(max(result.grid.v_max), unit)
    components = result.components if components is None else components
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 5.2))
    drawn = draw_map(ax, getattr(result, which), result.grid, unit)
    if on_sky(result) and axis_words(result.cube)[2]:
        ax.invert_xaxis()
    ax.set_xlabel(_axis_label(result, 0, unit))
    ax.set_ylabel(_axis_label(result, 1, unit))
    place = _draw_components(ax, result, components, unit)
    free = list(CORNERS)
    if len(components):
        corner = min(free, key=lambda name: _crowd(place, name, LEGEND_SIZE))
        free.remove(corner)
        ax.legend(loc=corner, fontsize="small", framealpha=0.85)
    _draw_jet(ax, result, min(free[::-1], key=lambda n: _crowd(place, n, ARROW_SIZE)))
    style.add_speed_axis(ax, unit, beta_per_pm)
    if colorbar:
        style.add_colorbar(ax, drawn, MAP_LABELS[which])
    return figure


def draw_map(ax, values, grid, unit):
    """Draw a map of velocities."""
    factor = PM_UNIT.to(unit)
    (left, right), (bottom, top) = (
        np.array([axis[0] - step / 2, axis[-1] + step / 2]) * factor
        for axis, step in zip((grid.v1, grid.v2), grid.step, strict=True)
    )
    values = np.ma.masked_invalid(values)
    highest = values.max() if values.count() else 0.0
    drawn = ax.imshow(
        values, origin="lower", extent=(left, right, bottom, top), cmap="cividis",
        vmin=0.0, vmax=highest if highest > 0 else 1.0, interpolation="bilinear",
    )  # fmt: skip
    ax.axhline(0, color="white", linewidth=0.6, alpha=0.6)
    ax.axvline(0, color="white", linewidth=0.6, alpha=0.6)
    ax.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    return drawn


def on_sky(result):
    """Return whether the axes of a result are east and north."""
    return tuple(result.frame.axis_names) == ("east", "north")


def _axis_label(result, axis, unit):
    name = result.frame.axis_names[axis]
    label = AXIS_LABELS.get(name, f"Proper motion, {name}")
    if on_sky(result) and (word := axis_words(result.cube)[axis]) != name:
        label = f"Proper motion to {word}"
    return f"{label} ({unit_name(unit)})"


def _draw_components(ax, result, components, unit):
    """Draw the components; return their positions as fractions of the axes, (n, 2)."""
    from matplotlib.patches import Ellipse

    first, second = ("pm_parallel", "pm_transverse")
    if on_sky(result):
        first, second = sky_columns(components)
    v1, v2 = (_plain(components, name, unit) for name in (first, second))
    e1, e2 = (_plain(components, f"{name}_err", unit) for name in (first, second))
    # Positions of the components as fractions of the axes place the text beside them.
    place = ax.transLimits.transform(np.stack([v1, v2], axis=-1))
    kinds = style.component_kinds(components)
    for kind in dict.fromkeys(kinds):
        ax.plot(
            [], [], KINDS[kind].on_map, markersize=5, markerfacecolor="none",
            markeredgecolor=BLACK, linestyle="", label=KINDS[kind].name,
        )  # fmt: skip
    effects = style.outline(2.5, BLACK)
    for k, kind in enumerate(kinds):
        strong = kind != "not significant"
        if np.isfinite([e1[k], e2[k]]).all():
            ax.add_patch(
                Ellipse(
                    (v1[k], v2[k]), 2 * e1[k], 2 * e2[k], facecolor="none",
                    edgecolor="white", linewidth=1.2, path_effects=effects,
                    linestyle="-" if strong else ":", gid="error",
                )
            )  # fmt: skip
        ax.plot(
            v1[k], v2[k], KINDS[kind].on_map, markersize=4, markerfacecolor="none",
            markeredgecolor="white", path_effects=effects,
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


def _crowd(place, corner, size):
    """Return the number of components in an area of some size in a corner."""
    return int(np.sum(np.all(np.abs(place - CORNERS[corner]) < size, axis=1)))


def _draw_jet(ax, result, corner):
    """Draw an arrow with the jet's direction in a corner of the axes."""
    direction = np.array([1.0, 0.0])
    if on_sky(result):
        angle = u.Quantity(result.position_angle).to_value(u.rad)
        side = -1 if axis_words(result.cube)[2] else 1
        direction = np.array([side * np.sin(angle), np.cos(angle)])
    name = "outward" if result.frame.axis_names[0] == "radial" else "jet"
    centre = 0.11 + 0.78 * np.array(CORNERS[corner])
    ax.annotate(
        "", centre + 0.07 * direction, centre - 0.07 * direction,
        xycoords="axes fraction", textcoords="axes fraction",
        arrowprops={"arrowstyle": "-|>", "color": "white", "linewidth": 1.5},
    )  # fmt: skip
    beside = centre + 0.05 * np.array([-direction[1], direction[0]])
    ax.text(
        *beside, name, transform=ax.transAxes, color="white", fontsize="small",
        ha="center", va="center", gid="jet",
    )  # fmt: skip


def _plain(components, name, unit=None):
    """Return a column as plain numbers, in a unit if it has one."""
    values = components[name]
    if unit is not None:
        return np.atleast_1d(u.Quantity(values).to_value(unit))
    return np.atleast_1d(np.asarray(values, dtype=float))


# -- significance ------------------------------------------------------------------


def plot_significance(
    result: SCCResult, *, ax: Axes | None = None, components: QTable | None = None,
    unit: u.UnitBase | str | None = None, beta_per_pm: float | None = None,
) -> Figure:  # fmt: skip
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

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.visualization import plot_significance
    >>> scc = StackedCrossCorrelation(scales=[1, 2], max_speed=36 * u.mas / u.yr)
    >>> result = scc(simulate_two_fluid(n_epochs=5, rng=1).cube, n_trials=50, rng=1)
    >>> figure = plot_significance(result)
    """
    unit = speed_unit(max(result.grid.v_max), unit)
    components = result.components if components is None else components
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 3.4))
    speed, axis, highest = _along_jet(result)
    speed = (speed * PM_UNIT).to_value(unit)
    ax.axhline(0, color=GREY, linewidth=0.6)
    ax.plot(
        speed, highest, color=GREY, linewidth=0.8, label="highest, any transverse speed"
    )
    at_zero = {"color": style.BLUE, "label": "at zero transverse speed"}
    ax.plot(speed, axis, linewidth=1.6, **at_zero)
    _mark_significance(ax, result, components, unit)
    ax.set_xlim(speed[0], speed[-1])
    top = max(np.nanmax(highest, initial=1.0), *_plain(components, "z_score"), 1.0)
    ax.set_ylim(min(np.nanmin(axis, initial=0.0), 0.0) - 0.05 * top, 1.4 * top)
    label = _axis_label(result, 0, unit)
    if on_sky(result):
        angle = u.Quantity(result.position_angle).to_value(u.deg) % 360
        label = f"Proper motion along position angle {angle:.0f} deg"
        label = f"{label} ({unit_name(unit)})"
    ax.set_xlabel(label)
    ax.set_ylabel(MAP_LABELS["z_score"])
    ax.legend(loc="upper left", fontsize="small", ncols=2, frameon=False)
    style.add_speed_axis(ax, unit, beta_per_pm)
    return figure


def plot_map_and_significance(
    result: SCCResult, *, figure: Figure | None = None,
    components: QTable | None = None, unit: u.UnitBase | str | None = None,
    beta_per_pm: float | None = None,
) -> Figure:  # fmt: skip
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

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.visualization import plot_map_and_significance
    >>> scc = StackedCrossCorrelation(scales=[1, 2], max_speed=36 * u.mas / u.yr)
    >>> result = scc(simulate_two_fluid(n_epochs=5, rng=1).cube, n_trials=50, rng=1)
    >>> figure = plot_map_and_significance(result)
    """
    figure = style.new_figure((style.WIDTH, 8.0)) if figure is None else figure
    upper, lower = figure.subplots(2, 1, height_ratios=(2.0, 1.0))
    shared = {"components": components, "unit": unit}
    plot_velocity_map(result, ax=upper, beta_per_pm=beta_per_pm, **shared)
    plot_significance(result, ax=lower, **shared)
    return figure


def _along_jet(result):
    """Return speeds along the jet, z at zero speed across, and z's maximum across."""
    from scipy.ndimage import map_coordinates

    grid, z_score = result.grid, np.asarray(result.z_score, dtype=float)
    if not on_sky(result):
        middle = int(np.argmin(np.abs(grid.v2)))
        return grid.v1, z_score[middle], _highest(z_score)
    angle = u.Quantity(result.position_angle).to_value(u.rad)
    sin, cos = np.sin(angle), np.cos(angle)
    # The map is square, so its reach depends on the direction.
    reach = min(np.divide(grid.v_max, np.maximum(np.abs([sin, cos]), 1e-9)))
    half = int(np.ceil(reach / min(grid.step)))
    speed = np.linspace(-reach, reach, 2 * half + 1)
    along, across = np.meshgrid(speed, speed)
    east, north = sin * along + cos * across, cos * along - sin * across
    steps = grid.step
    at = [(north - grid.v2[0]) / steps[1], (east - grid.v1[0]) / steps[0]]
    turned = map_coordinates(z_score, at, order=1, cval=np.nan)
    return speed, turned[half], _highest(turned)


def _highest(rows):
    seen = np.isfinite(rows)
    highest = np.max(rows, axis=0, where=seen, initial=-np.inf)
    return np.where(seen.any(axis=0), highest, np.nan)


def _mark_significance(ax, result, components, unit):
    names = ("pm_parallel", "pm_parallel_err", "pm_transverse", "pm_transverse_err")
    along, error, across, across_error = (_plain(components, n, unit) for n in names)
    z_score = _plain(components, "z_score")
    least = max(result.grid.step) * PM_UNIT.to(unit)
    for k, kind in enumerate(style.component_kinds(components)):
        strong = kind != "not significant"
        on_axis = abs(across[k]) <= 3 * max(across_error[k], least)
        color = style.VERMILLION if strong else GREY
        ax.errorbar(
            along[k], z_score[k], xerr=error[k] if np.isfinite(error[k]) else 0.0,
            fmt=KINDS[kind].on_slice, color=color, markersize=5,
            markerfacecolor=color if on_axis else "white", capsize=2, zorder=3,
        )  # fmt: skip
        ax.annotate(
            f"{components['component'][k]:.0f}", (along[k], z_score[k]), xytext=(0, 6),
            textcoords="offset points", ha="center", color=color,
            fontweight="bold" if strong else "normal", path_effects=style.outline(),
            clip_on=True,
        )  # fmt: skip
