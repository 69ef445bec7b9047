# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The features of a measurement: their speeds and their distances."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

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

#: Length of the longest arrow, as a share of the longer side of the figure.
LONGEST = 0.1
#: Errors beyond so many times the median one are of features that say little.
LARGE_ERROR = 4.0
#: Most letters of a label beside a figure in one line.
LABEL = 30


def plot_streams(
    result: SCCResult, *, figure: Figure | None = None,
    unit: u.UnitBase | str | None = None,
) -> Figure:  # fmt: skip
    """
    Draw the velocity of each feature on contours of the mean image.

    One arrow for each feature, at its mean position, as long as its speed.  Features
    of stationary components are squares.

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
    >>> from astro_scc.visualization import plot_streams
    >>> scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    >>> figure = plot_streams(scc(simulate_jet(rng=1).cube, n_trials=50, rng=1))
    """
    view, figure, (ax,) = drawing.mean_image_panels(
        result.cube, result.ssps, 1, figure=figure, unit=unit
    )
    drawing.draw_contours(ax, view)
    table, years = result.feature_positions, result.cube.years.to_value(u.yr)
    rows = []
    for feature in range(len(result.features)):
        own = table[table["feature"] == feature]
        time, here = years[own["epoch"]], view.place[:, own["ssp"]]
        velocity = np.polyfit(time - time.mean(), here.T, 1)[0]
        rows.append((int(own["component"][0]), *here.mean(axis=1), *velocity))
    rows = np.reshape(rows, (-1, 5))
    fastest = np.hypot(rows[:, 3], rows[:, 4]).max(initial=0.0)
    # The longest arrow is a tenth of the jet.
    scale = fastest / (LONGEST * np.ptp(view.limits, axis=1).max()) or 1.0
    for number, stream in enumerate(result.search.streams, 1):
        _, east, north, *motion = rows[rows[:, 0] == number].T
        look = style.component_look(number, stream.kind)
        if stream.kind == "stationary":
            ax.plot(east, north, "s", ms=5, **look | {"mfc": "none"})
            continue
        ax.quiver(
            east, north, *motion, angles="xy", scale_units="xy", scale=scale,
            color=look["color"], width=0.004, headwidth=4, headlength=5, minlength=0.1,
            zorder=3,
        )  # fmt: skip
        ax.plot([], [], **look)
    if fastest:
        _draw_key(ax, view, fastest, scale)
    style.legend_above(ax)
    return figure


def _draw_key(ax, view, fastest, scale):
    """Draw an arrow of a round speed above the axes, on the right, with its value."""
    unit = speed_unit(fastest / view.factor)
    speed = PM_UNIT.to(unit, fastest / view.factor)
    size = 10.0 ** np.floor(np.log10(speed))
    speed = size * max(k for k in (1, 2, 5) if k * size <= speed)
    length = unit.to(PM_UNIT, speed) * view.factor / scale
    ax.annotate(
        f"{speed:g} {unit_name(unit)}  ", (1, 1.04),
        (1 - length / np.ptp(ax.get_xlim()), 1.04), xycoords="axes fraction",
        ha="right", va="center", fontsize="small",
        arrowprops={"arrowstyle": "-|>", "color": BLACK, "lw": 1.2, "shrinkA": 0,
                    "shrinkB": 0, "relpos": (1, 0.5)},
    )  # fmt: skip


def plot_feature_speeds(
    result: SCCResult, *, profile: QTable | None = None,
    beta_per_pm: float | None = None, ax: Axes | None = None,
) -> Figure:  # fmt: skip
    """
    Draw the speed of each feature against its distance.

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
    'Distance (mas)'
    """
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 3.4))
    table = result.features
    distance = np.abs(table["distance"].to_value(u.mas))
    unit = offset_unit(distance.max(initial=1.0))
    speed, error = (table[k].to_value(PM_UNIT) for k in ("pm", "pm_err"))
    # Outward is positive, also along a component that points to the core.
    speed = np.where(table["distance"] < 0, -speed, speed)
    if len(error):
        error = np.minimum(error, LARGE_ERROR * np.median(error))
    for number, stream in enumerate(result.search.streams, 1):
        own = np.asarray(table["component"]) == number
        if own.any():
            ax.errorbar(
                distance[own] * u.mas.to(unit), speed[own], error[own], ms=4, lw=0.8,
                fmt=style.KINDS[stream.kind].on_profile, zorder=2,
                **style.component_look(number, stream.kind),
            )  # fmt: skip
    if profile is not None and len(profile):
        look = {"fmt": "none", "color": BLACK, "elinewidth": 1.6, "zorder": 3}
        style.draw_bins(ax, profile, "pm_parallel", unit, label="mean of bin", **look)
    ax.axhline(0, color=style.GREY, lw=0.6, zorder=0)
    ax.set_xlim(left=0)
    ax.set_xlabel(f"Distance ({unit_name(unit)})")
    ax.set_ylabel(f"Proper motion ({unit_name(PM_UNIT)})")
    style.legend_above(ax)
    style.add_speed_axis(ax, PM_UNIT, beta_per_pm, "right")
    return figure


def plot_feature_distances(
    result: SCCResult, *, unit: u.UnitBase | str | None = None, ax: Axes | None = None
) -> Figure:
    """
    Draw the distances of the features against time, with their straight lines.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    unit : `~astropy.units.Unit`, optional
        Of the distances.
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
    >>> from astro_scc.visualization import plot_feature_distances
    >>> scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    >>> result = scc(simulate_jet(rng=1).cube, n_trials=50, rng=1)
    >>> plot_feature_distances(result).axes[0].get_xlabel()
    'Year'
    """
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 4.2))
    table, cube = result.feature_positions, result.cube
    start, years = cube.times[0].jyear, cube.years.to_value(u.yr)
    kinds = [stream.kind for stream in result.search.streams]
    distance = table["distance"].to_value(u.mas)
    unit = offset_unit(np.abs(distance).max(initial=1.0), unit)
    named = set()
    for feature, slope in enumerate(result.features["pm"].to_value(PM_UNIT)):
        own = np.flatnonzero(table["feature"] == feature)
        number = int(table["component"][own[0]])
        kind = kinds[number - 1]
        look = style.component_look(number, kind)
        time, place = years[table["epoch"][own]], distance[own]
        # Outward is positive, also along a component that points to the core.
        factor = u.mas.to(unit) * (-1.0 if place.mean() < 0 else 1.0)
        ax.plot(
            start + time, factor * place, style.KINDS[kind].on_profile, ms=3, mew=0.6,
            **look | ({"label": None} if number in named else {}),
        )  # fmt: skip
        named.add(number)
        # Positions near a standing feature are not of the line.
        ends = time[[0, -1]]
        line = factor * (np.median(place - slope * time) + slope * ends)
        ax.plot(start + ends, line, color=look["color"], lw=0.8)
    style.show_years(ax, cube)
    ax.set_ylim(bottom=0)
    ax.set_ylabel(f"Distance ({unit_name(unit)})")
    style.legend_above(ax)
    return figure


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
