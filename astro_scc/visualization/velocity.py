# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The map of velocities."""

import astropy.units as u
import numpy as np

from astro_scc.epochs.positions import axis_words, sky_columns
from astro_scc.visualization.style import (
    BLACK,
    PM_UNIT,
    WIDTH,
    add_colorbar,
    add_speed_axis,
    component_kinds,
    figure_and_axes,
    outline,
    speed_unit,
    unit_name,
)

__all__ = ["plot_velocity_map"]

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
#: Of each kind of component: marker in the map and in the slice, name.
KINDS = {
    "moving": ("+", "o", "component"),
    "stationary": ("s", "s", "stationary"),
    "not significant": ("x", "x", "not significant"),
}
#: Corners for the legend, the first ones preferred, and the last ones for the arrow.
CORNERS = {
    "upper right": (1, 1),
    "upper left": (0, 1),
    "lower right": (1, 0),
    "lower left": (0, 0),
}
#: Size of legend and arrow as parts of the axes.
LEGEND_SIZE = (0.34, 0.16)
ARROW_SIZE = (0.22, 0.22)


def plot_velocity_map(
    result,
    *,
    ax=None,
    components=None,
    which="coefficient",
    unit=None,
    beta_per_pm=None,
    colorbar=True,
):
    """
    Draw the stacked cross-correlation as a map of velocities.

    Components have their numbers of the table, a sign for their kind (moving,
    stationary, not significant), and an ellipse of one standard error along
    each axis.  The arrow is the direction of the jet.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    ax : `matplotlib.axes.Axes`, optional
        Drawn on these instead of a new figure.
    components : `~astropy.table.QTable`, optional
        The components to mark, by default ``result.components``.
    which : {"coefficient", "z_score"}
        The map that is drawn.
    unit : `~astropy.units.Unit`, optional
        Of the axes, by default mas/yr, or arcsec/yr or arcsec/h for large
        speeds.
    beta_per_pm : float, optional
        Apparent speed, in units of c, of a proper motion of 1 mas/yr; draws
        a second axis.
    colorbar : bool, optional

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the map is unknown, the unit no proper motion, or ``beta_per_pm``
        not positive.

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
    figure, ax = figure_and_axes(ax, (WIDTH, 5.2))
    drawn = _draw_map(ax, result, which, unit)
    kinds = component_kinds(components)
    place = _draw_components(ax, result, components, kinds, unit)
    free = list(CORNERS)
    if kinds:
        corner = min(free, key=lambda name: _crowd(place, name, LEGEND_SIZE))
        free.remove(corner)
        ax.legend(loc=corner, fontsize="small", framealpha=0.85)
    _draw_jet(ax, result, min(free[::-1], key=lambda n: _crowd(place, n, ARROW_SIZE)))
    if beta_per_pm is not None:
        add_speed_axis(ax, unit, beta_per_pm)
    if colorbar:
        add_colorbar(ax, drawn, MAP_LABELS[which])
    return figure


def axis_label(result, axis, unit):
    """Label of an axis of velocities."""
    name = result.frame.axis_names[axis]
    label = AXIS_LABELS.get(name, f"Proper motion, {name}")
    if on_sky(result) and (word := axis_words(result.cube)[axis]) != name:
        label = f"Proper motion to {word}"
    return f"{label} ({unit_name(unit)})"


def on_sky(result):
    """Whether the axes of a result are east and north."""
    return tuple(result.frame.axis_names) == ("east", "north")


def _draw_map(ax, result, which, unit):
    import matplotlib

    grid = result.grid
    factor = PM_UNIT.to(unit)
    (left, right), (bottom, top) = (
        np.array([axis[0] - step / 2, axis[-1] + step / 2]) * factor
        for axis, step in zip((grid.v1, grid.v2), grid.step, strict=True)
    )
    values = np.ma.masked_invalid(getattr(result, which))
    highest = values.max() if values.count() else 0.0
    drawn = ax.imshow(
        values,
        origin="lower",
        extent=(left, right, bottom, top),
        vmin=0.0,
        vmax=highest if highest > 0 else 1.0,
        cmap=matplotlib.colormaps["cividis"],
        interpolation="bilinear",
    )
    ax.axhline(0, color="white", linewidth=0.6, alpha=0.6)
    ax.axvline(0, color="white", linewidth=0.6, alpha=0.6)
    ax.set_aspect("equal")
    to_the_left = on_sky(result) and axis_words(result.cube)[2]
    ax.set_xlim((right, left) if to_the_left else (left, right))
    ax.set_ylim(bottom, top)
    ax.set_xlabel(axis_label(result, 0, unit))
    ax.set_ylabel(axis_label(result, 1, unit))
    return drawn


def _draw_components(ax, result, components, kinds, unit):
    """Draw the components; their positions as parts of the axes, shape (n, 2)."""
    from matplotlib.patches import Ellipse

    first, second = ("pm_parallel", "pm_transverse")
    if on_sky(result):
        first, second = sky_columns(components)
    v1, v2 = (plain(components, name, unit) for name in (first, second))
    e1, e2 = (plain(components, f"{name}_err", unit) for name in (first, second))
    # Where the components are as parts of the axes, for what is written beside them.
    place = ax.transLimits.transform(np.stack([v1, v2], axis=-1))
    for kind in dict.fromkeys(kinds):
        marker, _, name = KINDS[kind]
        ax.plot(
            [], [], marker, markersize=5, markerfacecolor="none",
            markeredgecolor=BLACK, linestyle="", label=name,
        )  # fmt: skip
    effects = outline(2.5, BLACK)
    for k, (number, kind) in enumerate(
        zip(plain(components, "component"), kinds, strict=True)
    ):
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
            v1[k], v2[k], KINDS[kind][0], markersize=4, markerfacecolor="none",
            markeredgecolor="white", path_effects=effects,
        )  # fmt: skip
        inward = np.where(place[k] > 0.93, -1, 1)
        ax.annotate(
            f"{number:.0f}",
            np.clip(place[k], 0, 1),
            xycoords="axes fraction",
            xytext=7 * inward,
            textcoords="offset points",
            ha="left" if inward[0] > 0 else "right",
            va="bottom" if inward[1] > 0 else "top",
            color="white",
            fontweight="bold" if strong else "normal",
            fontsize="large" if strong else "small",
            path_effects=effects,
        )
    return place


def _crowd(place, corner, size):
    """How many components are in so much of a corner."""
    return int(np.sum(np.all(np.abs(place - CORNERS[corner]) < size, axis=1)))


def _draw_jet(ax, result, corner):
    """An arrow in a corner of the axes in the jet's direction."""
    if on_sky(result):
        angle = u.Quantity(result.position_angle).to_value(u.rad)
        side = -1 if axis_words(result.cube)[2] else 1
        direction = np.array([side * np.sin(angle), np.cos(angle)])
    else:
        direction = np.array([1.0, 0.0])
    name = "outward" if result.frame.axis_names[0] == "radial" else "jet"
    centre = 0.11 + 0.78 * np.array(CORNERS[corner])
    ax.annotate(
        "",
        centre + 0.07 * direction,
        centre - 0.07 * direction,
        xycoords="axes fraction",
        textcoords="axes fraction",
        arrowprops={"arrowstyle": "-|>", "color": "white", "linewidth": 1.5},
    )
    beside = centre + 0.05 * np.array([-direction[1], direction[0]])
    ax.text(
        *beside, name, transform=ax.transAxes, color="white", fontsize="small",
        ha="center", va="center", gid="jet",
    )  # fmt: skip


def plain(components, name, unit=None):
    """A column as plain numbers, in a unit if it has one."""
    values = components[name]
    if unit is not None:
        return np.atleast_1d(u.Quantity(values).to_value(unit))
    return np.atleast_1d(np.asarray(values, dtype=float))
