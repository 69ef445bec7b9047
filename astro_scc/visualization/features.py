# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The features of a measurement: their paths, speeds and separations from the core."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, NamedTuple

import astropy.units as u
import numpy as np

from astro_scc.units import PM_UNIT, offset_unit, speed_unit, unit_name
from astro_scc.visualization import drawing, style
from astro_scc.visualization.style import BLACK

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from astro_scc.measurement import SCCResult

#: Errors beyond so many times the median one are of features that say little.
LARGE_ERROR = 4.0
#: Most letters of a label beside a figure in one line.
LABEL = 30
#: Colour of features that are not vouched for, and how many features there may be for
#: these to have their numbers too.
PALE, CROWDED = "#B8B8B8", 40


def plot_feature_paths(
    result: SCCResult, *, figure: Figure | None = None,
    unit: u.UnitBase | str | None = None,
) -> Figure:  # fmt: skip
    """
    Draw the paths of the features on contours of the mean image.

    Each has its number at its last position; a line is the motion that was fitted.
    Secure features have the colours of their components, others are pale.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    figure : `matplotlib.figure.Figure`, optional
        Drawn on this one instead of a new figure.
    unit : `~astropy.units.Unit`, optional
        Of the offsets.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is no angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_jet
    >>> from astro_scc.visualization import plot_feature_paths
    >>> scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    >>> figure = plot_feature_paths(scc(simulate_jet(rng=1).cube, n_trials=50, rng=1))
    """
    view, figure, (ax,) = drawing.mean_image_panels(
        result.cube, result.ssps, 1, figure=figure, unit=unit
    )
    drawing.draw_contours(ax, view)
    for feature in _Drawn.of(result):
        place, fit = view.factor * feature.place, view.factor * feature.fit
        ax.plot(*place, "o", ms=2, **feature.look | {"label": None})
        ax.plot(*fit, lw=1.5, **feature.look)
        feature.number_at(ax, *place[:, -1])
    style.legend_above(ax)
    return figure


def plot_feature_speeds(
    result: SCCResult, *, profile: QTable | None = None,
    beta_per_pm: float | None = None, ax: Axes | None = None,
) -> Figure:  # fmt: skip
    """
    Draw the radial speed of each feature against its separation from the core.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    profile : `~astropy.table.QTable`, optional
        Of `astro_scc.flow.feature_profile`: mean speeds in bins of distance.
    beta_per_pm : float, optional
        Apparent speed in units of c of 1 mas/yr, for a second axis.
    ax : `matplotlib.axes.Axes`, optional
        Drawn on these instead of a new figure.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If ``beta_per_pm`` is not positive.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_jet
    >>> from astro_scc.visualization import plot_feature_speeds
    >>> scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    >>> result = scc(simulate_jet(rng=1).cube, n_trials=50, rng=1)
    >>> plot_feature_speeds(result).axes[0].get_xlabel()
    'Core separation (mas)'
    """
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 3.4))
    table = result.features
    separation = table["separation"].to_value(u.mas)
    unit = offset_unit(separation.max(initial=1.0))
    speed, error = (table[k].to_value(PM_UNIT) for k in ("pm_radial", "pm_radial_err"))
    if len(error):
        error = np.minimum(error, LARGE_ERROR * np.median(error))
    rows = zip(separation * u.mas.to(unit), speed, error, strict=True)
    for feature, row in zip(_Drawn.of(result), rows, strict=True):
        ax.errorbar(*row, fmt="o", ms=4, lw=0.8, **feature.look)
    if profile is not None and len(profile):
        look = {"fmt": "none", "color": BLACK, "elinewidth": 1.6, "zorder": 3}
        style.draw_bins(ax, profile, "pm_parallel", unit, label="mean of bin", **look)
    ax.axhline(0, color=style.GREY, lw=0.6, zorder=0)
    ax.set_xlim(left=0)
    ax.set_xlabel(f"Core separation ({unit_name(unit)})")
    ax.set_ylabel(f"Radial proper motion ({unit_name(PM_UNIT)})")
    style.legend_above(ax)
    style.add_speed_axis(ax, PM_UNIT, beta_per_pm, "right")
    return figure


def plot_feature_separations(
    result: SCCResult, *, unit: u.UnitBase | str | None = None, ax: Axes | None = None
) -> Figure:
    """
    Draw the separations of the features from the core against time, with their fits.

    Each has its number at its last date.  Secure features have the colours of their
    components, others are pale; positions that the fit does not use are open.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    unit : `~astropy.units.Unit`, optional
        Of the separations.
    ax : `matplotlib.axes.Axes`, optional
        Drawn on these instead of a new figure.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is no angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_jet
    >>> from astro_scc.visualization import plot_feature_separations
    >>> scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    >>> result = scc(simulate_jet(rng=1).cube, n_trials=50, rng=1)
    >>> plot_feature_separations(result).axes[0].get_ylabel()
    'Core separation (mas)'
    """
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 4.2))
    drawn = _Drawn.of(result)
    farthest = max((np.hypot(*d.place).max() for d in drawn), default=1.0)
    unit = offset_unit(farthest, unit)
    factor, start = u.mas.to(unit), result.cube.times[0].jyear
    for feature in drawn:
        separation = factor * np.hypot(*feature.place)
        outward = feature.place / np.hypot(*feature.place)
        error = factor * np.hypot(*(outward * feature.error))
        date = start + feature.years
        for own, face in ((feature.used, {}), (~feature.used, {"mfc": "white"})):
            look = {"fmt": "o", "ms": 3, "mew": 0.6, "elinewidth": 0.8, **face}
            look |= feature.look | {"label": None}
            ax.errorbar(date[own], separation[own], error[own], **look)
        ax.plot(date, factor * np.hypot(*feature.fit), lw=1.0, **feature.look)
        feature.number_at(ax, date[-1], separation[-1])
    style.show_years(ax, result.cube)
    ax.set_ylim(bottom=0)
    ax.set_ylabel(f"Core separation ({unit_name(unit)})")
    style.legend_above(ax)
    return figure


class _Drawn(NamedTuple):
    """What is drawn of a feature: positions (2, n) in mas, dates, and its look."""

    number: str
    years: np.ndarray
    place: np.ndarray
    error: np.ndarray
    fit: np.ndarray
    used: np.ndarray
    look: dict

    @classmethod
    def of(cls, result):
        """Return all features of a result, in the order of its table."""
        tracked, drawn = result.tracked_features, []
        kinds = [stream.kind for stream in result.search.streams]
        d, years = tracked.detections, result.cube.years.to_value(u.yr)
        rows = zip(result.features, tracked.tracks, tracked.motions, strict=True)
        for row, track, motion in rows:
            own, component = track.detection, int(row["component"])
            look = {"color": PALE, "label": "not secure", "zorder": 2}
            if row["secure"]:
                look = {"color": BLACK, "label": "of no component", "zorder": 3}
                if component:
                    kind = kinds[component - 1]
                    look |= style.component_look(component, kind)
            place = d.place[own].T
            fit = place - motion.residual.T
            when = years[d.epoch[own]]
            parts = place, d.place_error[own].T, fit, motion.used, look
            numbered = row["secure"] or len(tracked) <= CROWDED
            number = str(row["feature"]) if numbered else ""
            drawn.append(cls(number, when, *parts))
        return drawn

    def number_at(self, ax, x, y):
        """Write the number of the feature beside a point."""
        ax.annotate(
            self.number, (x, y), (3, 2), textcoords="offset points",
            color=self.look["color"], fontsize="small", zorder=4, annotation_clip=True,
            path_effects=style.outline(),
        )  # fmt: skip


def plot_sensitivity(table, *, beta_per_pm=None, ax=None):
    """
    Draw the main speed with other choices of the data, beside that as measured.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        See `~astro_scc.measurement.SCCResult.sensitivity`.
    beta_per_pm : float, optional
        Apparent speed in units of c of 1 mas/yr, for a second axis.
    ax : `matplotlib.axes.Axes`, optional
        Drawn on these instead of a new figure.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the table has no rows, or ``beta_per_pm`` is not positive.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.simulation import simulate_jet
    >>> from astro_scc.visualization.features import plot_sensitivity
    >>> scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    >>> result = scc(simulate_jet(rng=1).cube, n_trials=50, rng=1)
    >>> figure = plot_sensitivity(result.sensitivity)
    """
    if len(table) == 0:
        raise ValueError("the table has no rows: nothing moves significantly")
    height = 0.8 + 0.36 * len(table)
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, height))
    unit = speed_unit(np.abs(table["pm"].to_value(PM_UNIT)).max())
    speed, error = (table[name].to_value(unit) for name in ("pm", "pm_err"))
    low, high = speed[0] - error[0], speed[0] + error[0]
    ax.axvspan(low, high, color=style.GREY, alpha=0.2, lw=0)
    ax.axvline(speed[0], color=style.GREY, lw=0.8)
    row, large = np.arange(len(table)), np.asarray(table["significant"])
    for own, color, marker in (
        (~large, style.BLUE, "o"),
        (large, style.VERMILLION, "s"),
    ):
        if own.any():
            look = {"fmt": marker, "color": color, "ms": 4, "lw": 1}
            ax.errorbar(speed[own], row[own], xerr=error[own], **look)
    ax.set_yticks(row, [fill(str(text), LABEL) for text in table["choice"]])
    ax.tick_params(axis="y", labelsize="small", length=0)
    ax.set_ylim(len(table) - 0.5, -0.5)
    ax.set_xlabel(f"Proper motion ({unit_name(unit)})")
    style.add_speed_axis(ax, unit, beta_per_pm)
    return figure
