# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Figures of features: matches of components, paths on the mean image, separations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.table import QTable
from numpy.typing import ArrayLike

from astro_scc.units import PM_UNIT, offset_unit, speed_unit, unit_name
from astro_scc.visualization import drawing, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from astro_scc.features import Features
    from astro_scc.measurement import SCCResult

#: How features are drawn that are secure, and that are not.
STRONG = {"alpha": 1.0, "zorder": 3, "linestyle": "-"}
PALE = {"alpha": 0.5, "zorder": 2, "linestyle": ":"}
#: Of more features than these only the secure ones have numbers.
CROWDED = 40


def plot_members(
    result: SCCResult, *, figure: Figure | None = None,
    components: QTable | None = None, max_panels: int = 4,
    unit: u.UnitBase | str | None = None,
) -> Figure:  # fmt: skip
    """
    Draw the displacements that belong to each component on the mean image.

    There is one panel per component.  Each arrow leads from an SSP to its match
    in the next epoch in which its feature is seen.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    figure : `matplotlib.figure.Figure`, optional
        Figure to draw on instead of a new one.
    components : `~astropy.table.QTable`, optional
        By default ``result.components``.
    max_panels : int, optional
        Largest number of panels.  Components are drawn in the order of the
        table, but those that are not significant come last.
    unit : `~astropy.units.Unit`, optional
        Unit of the offsets.

    Returns
    -------
    `matplotlib.figure.Figure`
        It shows only the mean image if there is no component.

    Raises
    ------
    ValueError
        If ``max_panels`` is below 1, or the unit is not an angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.visualization import plot_members
    >>> scc = StackedCrossCorrelation(scales=[1, 2], max_speed=36 * u.mas / u.yr)
    >>> result = scc(simulate_two_fluid(n_epochs=5, rng=1).cube, n_trials=50, rng=1)
    >>> figure = plot_members(result)
    """
    if max_panels < 1:
        raise ValueError(f"max_panels must be at least 1, got {max_panels}")
    components = result.components if components is None else components
    kinds = style.component_kinds(components)
    order = sorted(range(len(kinds)), key=lambda k: kinds[k] == "not significant")
    panels = [(int(components["component"][k]), kinds[k]) for k in order[:max_panels]]
    view, figure, axes = drawing.mean_image_panels(
        result.cube, result.ssps, max(len(panels), 1), figure=figure, unit=unit
    )
    for ax, (number, kind) in zip(axes, panels, strict=False):
        _draw_members(ax, view, result, number, kind)
    if not panels:
        axes[0].set_title("no component")
    return figure


def _draw_members(ax, view, result, number, kind):
    member, d = result.members(number)["match"], result.displacements
    n_ssp = len(np.unique(d.ssp[member]))
    member = member[d.target[member] > d.reference[member]]
    member = member[np.argsort(d.target[member], kind="stable")]
    owner, first = np.unique(d.ssp[member], return_index=True)
    member = member[first]
    axes = result.frame.matrix(*view.points["place"][:, owner])
    # The matrix is orthogonal, so its transpose leads back to the sky.
    motion = np.stack([d.d1[member], d.d2[member]], axis=-1)
    motion = np.einsum("nai,na->in", axes, motion) * view.factor
    strong = kind != "not significant"
    ax.quiver(
        *view.place[:, owner], *motion, angles="xy",
        scale_units="xy", scale=1, color=style.component_color(number),
        width=0.0035, headwidth=4, headlength=5, minlength=0.5, alpha=0.75,
    )  # fmt: skip
    speed = result.components["pm"][number - 1]
    speed = speed.to(speed_unit(speed.to_value(PM_UNIT)))
    text = f"{number}: {speed.value:.3g} {unit_name(speed.unit)}, {n_ssp} SSPs"
    drawing.panel_text(ax, text + ("" if strong else ", not significant"))


def plot_separation(
    features: Features, *, component: ArrayLike | None = None, ax: Axes | None = None,
    unit: u.UnitBase | str | None = None,
) -> Figure:  # fmt: skip
    """
    Draw the separations of features from the core against time, with their fits.

    A line is the motion that is fitted to a feature, with its number at the end; those
    of features that are not secure are pale and dotted.

    Parameters
    ----------
    features : `~astro_scc.features.Features`
    component : array_like of int, shape (n,), optional
        Velocity component of each, 0 for none, which gives its colour.
    ax : `matplotlib.axes.Axes`, optional
        Axes to draw on instead of a new figure.
    unit : `~astropy.units.Unit`, optional
        Unit of the separations.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is not an angle.

    Examples
    --------
    >>> from astro_scc.features import find_features
    >>> from astro_scc.simulation import simulate_jet
    >>> from astro_scc.visualization import plot_separation
    >>> features = find_features(simulate_jet(n_epochs=8, rng=3).cube)
    >>> plot_separation(features).axes[0].get_xlabel()
    'Year'
    """
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 4.5))
    d = features.detections
    distance = np.hypot(*d.place.T)
    unit = offset_unit(distance.max(initial=1.0), unit)
    factor = u.mas.to(unit)
    outward = d.place / np.maximum(distance, 1e-30)[:, None]
    error, ends = np.hypot(*(outward * d.place_error).T), []
    for number, motion in enumerate(features.motions):
        k = features.tracks[number].detection
        look = feature_look(features, number, component)
        time = d.time[k]
        ax.errorbar(
            time, factor * distance[k], factor * error[k], fmt="o", markersize=3,
            markeredgewidth=0, linewidth=0.8, **look | {"linestyle": ""},
        )  # fmt: skip
        t = np.linspace(*time[[0, -1]], 50)
        fitted = factor * np.hypot(*_fitted(motion, t).T)
        ax.plot(t, fitted, linewidth=1.2, **look)
        ends.append(((time[-1], fitted[-1]), look["color"]))
    style.legend_above(ax)
    ax.set_ylim(bottom=0)
    style.show_years(ax, features.cube)
    ax.set_ylabel(f"Separation from the core ({unit_name(unit)})")
    _write_numbers(ax, features, ends)
    return figure


def _fitted(motion, time):
    """Return the places of a fitted motion, shape (n, 2) in mas."""
    dt = (time - motion.date)[:, None]
    bend = np.nan_to_num(motion.acceleration)
    return motion.place + motion.velocity * dt + bend * dt**2 / 2


def feature_look(features, number, component=None):
    """Return the look of a feature, pale unless it is secure."""
    look = STRONG if features.secure[number] else PALE
    if component is None:
        return {"color": style.component_color(number + 1), **look}
    own = int(component[number])
    color = style.component_color(own) if own else style.BLACK
    return {"color": color, "label": f"component {own}" if own else "none", **look}


def _write_numbers(ax, features, ends):
    """
    Write the numbers of features beside places, given with colours.

    Secure features and those seen in most epochs come first; a number that would cover
    another one is left out.
    """
    ax.get_figure().draw_without_rendering()
    frame, taken = ax.get_window_extent(), []
    shown = [k for k in range(len(ends)) if features.secure[k] or len(ends) <= CROWDED]
    for k in sorted(
        shown, key=lambda k: (~features.secure[k], -len(features.tracks[k]))
    ):
        place, color = ends[k]
        text = ax.annotate(
            f"{features.number[k]}", place, (4, 0), textcoords="offset points",
            va="center", fontsize="small", color=color, annotation_clip=True, zorder=4,
            path_effects=style.outline(1.5),
        )  # fmt: skip
        if text.get_window_extent().x1 > frame.x1:
            text.set(ha="right", position=(-4, 0))
        box = text.get_window_extent()
        if any(box.overlaps(other) for other in taken):
            text.remove()
        else:
            taken.append(box)


def plot_tracks(
    features: Features, *, component: ArrayLike | None = None,
    figure: Figure | None = None, unit: u.UnitBase | str | None = None,
) -> Figure:  # fmt: skip
    """
    Draw the paths of features over the mean image.

    Each path is a line through the positions of a feature, with one dot per epoch, an
    arrow head at the last one and the number of the feature.  Those of features that
    are not secure are pale and dotted.

    Parameters
    ----------
    features : `~astro_scc.features.Features`
    component : array_like of int, shape (n,), optional
        Velocity component of each, 0 for none, which gives its colour.
    figure : `matplotlib.figure.Figure`, optional
        Figure to draw on instead of a new one.
    unit : `~astropy.units.Unit`, optional
        Unit of the offsets.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is not an angle.

    Examples
    --------
    >>> from astro_scc.features import find_features
    >>> from astro_scc.simulation import simulate_jet
    >>> from astro_scc.visualization import plot_tracks
    >>> features = find_features(simulate_jet(n_epochs=8, rng=3).cube)
    >>> len(plot_tracks(features).axes)
    1
    """
    d = features.detections
    east, north = np.concatenate([d.place, features.core.place]).T * u.mas
    n = len(east)
    points = QTable({"east": east, "north": north, "epoch": np.zeros(n, dtype=int),
                     "scale": np.ones(n), "snr": np.ones(n)})  # fmt: skip
    view, figure, (ax,) = drawing.mean_image_panels(
        features.cube, points, 1, figure=figure, unit=unit
    )
    head = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, "mutation_scale": 7}
    last = []
    for number, track in enumerate(features.tracks):
        look = feature_look(features, number, component)
        place = view.factor * d.place[track.detection].T
        dots = {"marker": "o", "markersize": 2, "markeredgewidth": 0}
        ax.plot(*place, linewidth=0.9, **dots, **look)
        arrow = head | {k: v for k, v in look.items() if k != "label"}
        arrow["linewidth"] = 0.9
        ends = {"xy": place[:, -1], "xytext": place[:, -2]}
        ax.annotate("", arrowprops=arrow, annotation_clip=True, **ends)
        last.append((place[:, -1], look["color"]))
    style.legend_above(ax)
    _write_numbers(ax, features, last)
    return figure
