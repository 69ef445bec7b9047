# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Figures of the features of components and tracks, on the mean image and in time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from astro_scc.decomposition import scale_size
from astro_scc.units import PM_UNIT, offset_unit, speed_unit, unit_name
from astro_scc.visualization import drawing, style
from astro_scc.visualization.style import BLACK

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure

    from astro_scc.measurement import SCCResult
    from astro_scc.tracking import Tracking


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
    tracking: Tracking, *, figure: Figure | None = None,
    unit: u.UnitBase | str | None = None, min_epochs: int | None = None,
) -> Figure:  # fmt: skip
    """
    Draw the distances of tracked features against time, with their fits.

    There is one panel per scale.  Solid lines are straight fits, dashed lines
    accelerated fits if the acceleration is significant; dotted lines lead back
    to the ejection epoch.

    Parameters
    ----------
    tracking : `~astro_scc.tracking.Tracking`
    figure : `matplotlib.figure.Figure`, optional
        Figure to draw on instead of a new one.
    unit : `~astropy.units.Unit`, optional
        Unit of the distances.
    min_epochs : int, optional
        Tracks with fewer epochs are not drawn.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is not an angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import FeatureTracker
    >>> from astro_scc.visualization import plot_separation
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> decompositions = [Decomposer(scales=[1, 2])(image) for image in cube.data]
    >>> tracking = FeatureTracker(max_speed=36 * u.mas / u.yr)(cube, decompositions)
    >>> figure = plot_separation(tracking)
    >>> figure.axes[-1].get_xlabel()
    'Year'
    """
    n = len(_scales(tracking))
    if figure is None:
        figure = style.new_figure((style.WIDTH, max(1.0 + 1.9 * n, 2.8)))
    axes = figure.subplots(n, 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    start = tracking.cube.times[0].jyear
    years = tracking.cube.years.to_value(u.yr)
    distance = np.hypot(*tracking.offsets)
    tracked = distance[tracking.track >= 0]
    unit = offset_unit(tracked.max(initial=1.0), unit)
    factor = u.mas.to(unit)
    for ax, color, numbers in _panels(tracking, axes, unit, min_epochs):
        for number in numbers:
            ssps = tracking.members(number)
            time = years[tracking.ssps.epoch[ssps]]
            dots = {"color": color, "markersize": 3, "markeredgewidth": 0}
            ax.plot(start + time, distance[ssps] * factor, "o", **dots)
            _draw_fits(ax, tracking, number, time, start, factor)
    # Leave room for the name above the features.
    axes[0].set_ylim(0, 1.15 * factor * tracked.max(initial=0.0) or 1.0)
    style.show_years(axes[-1], tracking.cube)
    figure.supylabel(f"Distance from the core ({unit_name(unit)})", fontsize="medium")
    return figure


def _draw_fits(ax, tracking, number, time, start, factor):
    row, fit = tracking.tracks[number], tracking.fits[number]
    first, last = time[[0, -1]]
    curves = [(first, last, fit, "-")]
    if row["accelerated"]:
        curves.append((first, last, tracking.accelerated_fits[number], "--"))
    if not np.any(row["t_ej"].mask):
        born = row["t_ej"].unmasked.value - start
        curves.append((min(born, first), first, fit, ":"))
    for begin, end, curve, line in curves:
        t = np.linspace(begin, end, 50)
        distance = factor * np.hypot(*curve.at(t))
        ax.plot(start + t, distance, line, color=BLACK, linewidth=0.8)


def plot_tracks(
    tracking: Tracking, *, figure: Figure | None = None,
    unit: u.UnitBase | str | None = None, min_epochs: int | None = None,
) -> Figure:  # fmt: skip
    """
    Draw the tracks over the mean image, one panel per scale.

    Each track is a line through the positions of its feature, with one dot
    per epoch and an arrow head at the last one.

    Parameters
    ----------
    tracking : `~astro_scc.tracking.Tracking`
    figure : `matplotlib.figure.Figure`, optional
        Figure to draw on instead of a new one.
    unit : `~astropy.units.Unit`, optional
        Unit of the offsets.
    min_epochs : int, optional
        Tracks with fewer epochs are not drawn.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is not an angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import FeatureTracker
    >>> from astro_scc.visualization import plot_tracks
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> decompositions = [Decomposer(scales=[1, 2])(image) for image in cube.data]
    >>> tracking = FeatureTracker(max_speed=36 * u.mas / u.yr)(cube, decompositions)
    >>> len(plot_tracks(tracking).axes)
    2
    """
    view, figure, axes = drawing.mean_image_panels(
        tracking.cube, tracking.ssps, len(_scales(tracking)), figure=figure, unit=unit
    )
    for ax, color, numbers in _panels(tracking, axes, view.unit, min_epochs):
        line = {"color": color, "linewidth": 0.9}
        head = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, "mutation_scale": 7}
        for number in numbers:
            place = view.factor * tracking.offsets[:, tracking.members(number)]
            ax.plot(*place, "-o", markersize=2, markeredgewidth=0, **line)
            ends = {"xy": place[:, -1], "xytext": place[:, -2]}
            ax.annotate("", arrowprops=head | line, annotation_clip=True, **ends)
    return figure


def _scales(tracking):
    """Return the colour of each scale that SSPs have, at least one."""
    return style.scale_colors(tracking.ssps.scale) or {1.0: style.BLUE}


def _panels(tracking, axes, unit, min_epochs):
    """Yield the axes, colour and long enough tracks of each scale; name the axes."""
    table = tracking.tracks
    long = np.asarray(table["n_epochs"]) >= (min_epochs or 0)
    for ax, (scale, color) in zip(axes, _scales(tracking).items(), strict=True):
        numbers = np.flatnonzero(long & (np.asarray(table["scale"]) == scale)).tolist()
        yield ax, color, numbers
        size = (scale_size(scale) * tracking.cube.pixel_scale).to_value(unit)
        tracks = "track" if len(numbers) == 1 else "tracks"
        text = f"scale {scale:g} ({size:.3g} {unit_name(unit)}), {len(numbers)} "
        color = BLACK if numbers else style.VERMILLION
        drawing.panel_text(ax, text + tracks, color=color)
