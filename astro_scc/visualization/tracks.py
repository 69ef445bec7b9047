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
    scales, colors = _scales(tracking)
    if figure is None:
        figure = style.new_figure((style.WIDTH, max(1.0 + 1.9 * len(scales), 2.8)))
    axes = figure.subplots(len(scales), 1, sharex=True, sharey=True, squeeze=False)
    start = tracking.cube.times[0].jyear
    years = tracking.cube.years.to_value(u.yr)
    distance = np.hypot(*tracking.offsets)
    tracked = distance[tracking.track >= 0]
    unit = offset_unit(tracked.max(initial=1.0), unit)
    factor = u.mas.to(unit)
    for ax, scale in zip(axes[:, 0], scales, strict=True):
        own = _shown(tracking, scale, min_epochs)
        for number in own:
            ssps = tracking.members(number)
            time = years[tracking.ssps.epoch[ssps]]
            ax.plot(
                start + time, distance[ssps] * factor, "o", color=colors[scale],
                markersize=3, markeredgewidth=0,
            )  # fmt: skip
            _draw_fits(ax, tracking, number, time, start, factor)
        _name_panel(ax, tracking, scale, unit, len(own))
        # Leave room for the name above the features.
        ax.set_ylim(0, 1.15 * factor * tracked.max(initial=0.0) or 1.0)
    margin = 0.03 * (np.ptp(years) or 1.0)
    axes[-1, 0].set_xlim(start - margin, start + years[-1] + margin)
    axes[-1, 0].set_xlabel("Year")
    axes[-1, 0].ticklabel_format(axis="x", useOffset=False)
    label = f"Distance from the core ({unit_name(unit)})"
    if len(scales) == 1:
        axes[0, 0].set_ylabel(label)
    else:
        figure.supylabel(label, fontsize="medium")
    return figure


def _draw_fits(ax, tracking, number, time, start, factor):
    fit = tracking.fits[number]
    ends = np.linspace(time[0], time[-1], 50)
    line = {"color": BLACK, "linewidth": 0.8}
    ax.plot(start + ends, factor * np.hypot(*fit.at(ends)), "-", **line)
    row = tracking.tracks[number]
    if row["accelerated"]:
        curve = tracking.accelerated_fits[number].at(ends)
        ax.plot(start + ends, factor * np.hypot(*curve), "--", **line)
    if not np.any(row["t_ej"].mask):
        born = row["t_ej"].unmasked.value - start
        if born < time[0]:
            before = np.linspace(born, time[0], 20)
            ax.plot(start + before, factor * np.hypot(*fit.at(before)), ":", **line)


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
    scales, colors = _scales(tracking)
    view, figure, axes = drawing.mean_image_panels(
        tracking.cube, tracking.ssps, len(scales), figure=figure, unit=unit
    )
    for ax, scale in zip(axes, scales, strict=True):
        own = _shown(tracking, scale, min_epochs)
        for number in own:
            offsets = tracking.offsets[:, tracking.members(number)]
            east, north = view.factor * offsets
            ax.plot(
                east, north, "-o", color=colors[scale], linewidth=0.9,
                markersize=2, markeredgewidth=0,
            )  # fmt: skip
            ax.annotate(
                "", (east[-1], north[-1]), (east[-2], north[-2]),
                arrowprops={"arrowstyle": "-|>", "color": colors[scale],
                            "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0,
                            "mutation_scale": 7},
                annotation_clip=True,
            )  # fmt: skip
        _name_panel(ax, tracking, scale, view.unit, len(own))
    return figure


def _shown(tracking, scale, min_epochs):
    """Return the numbers of the tracks of a scale that are long enough."""
    table = tracking.tracks
    long = np.asarray(table["n_epochs"]) >= (min_epochs or 0)
    return np.flatnonzero(long & (np.asarray(table["scale"]) == scale)).tolist()


def _scales(tracking):
    """Return the scales of all SSPs, at least one, and a colour for each."""
    scales = np.unique(tracking.ssps.scale).tolist() or [1.0]
    return scales, style.scale_colors(scales)


def _name_panel(ax, tracking, scale, unit, number):
    size = (scale_size(scale) * tracking.cube.pixel_scale).to_value(unit)
    tracks = "track" if number == 1 else "tracks"
    text = f"scale {scale:g} ({size:.3g} {unit_name(unit)}), {number} {tracks}"
    drawing.panel_text(ax, text, color=BLACK if number else style.VERMILLION)
