# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The speeds of the features of a measurement, and of other choices of the data."""

from textwrap import fill

import astropy.units as u
import numpy as np

from astro_scc.units import offset_unit, unit_name
from astro_scc.visualization import style
from astro_scc.visualization.style import BLACK
from astro_scc.visualization.tracks import feature_look

#: Errors beyond so many times the median one are of features that say little.
LARGE_ERROR = 4.0
#: Most letters of a label beside a figure in one line.
LABEL = 30


def plot_feature_speeds(
    result, *, profile=None, beta_per_pm=None, component=None, ax=None
):
    """
    Draw the radial speed of each feature against its separation from the core.

    Features have the colours of their streams; those that are not secure are pale.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    profile : `~astropy.table.QTable`, optional
        Of `astro_scc.flow.feature_profile`: mean speeds in bins of core separation.
    beta_per_pm : float, optional
        Apparent speed in units of c of 1 mas/yr, for a second axis.
    component : array_like of int, shape (n,), optional
        Stream of each feature, 0 for none, by default that of ``result.features``.
    ax : `matplotlib.axes.Axes`, optional
        Drawn on these instead of a new figure.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If ``beta_per_pm`` is not positive.
    """
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 3.4))
    table = result.features
    component = table["component"] if component is None else component
    separation = table["separation"].to_value(u.mas)
    unit = offset_unit(separation.max(initial=1.0))
    speed, error = (table[k].value for k in ("pm_radial", "pm_radial_err"))
    speeds = table["pm"].unit
    if len(error):
        error = np.minimum(error, LARGE_ERROR * np.median(error))
    for k, place in enumerate(separation * u.mas.to(unit)):
        look = feature_look(result.tracked_features, k, component)
        look |= {"ms": 4, "lw": 0.8, "linestyle": "", "marker": "o"}
        ax.errorbar(place, speed[k], error[k], **look)
    if profile is not None and len(profile):
        look = {"fmt": "none", "color": BLACK, "elinewidth": 1.6, "zorder": 3}
        look["label"] = "mean of bin"
        style.draw_bins(ax, profile, "pm_parallel", unit, speeds, **look)
    ax.axhline(0, color=style.GREY, lw=0.6, zorder=0)
    ax.set_xlim(left=0)
    ax.set_xlabel(f"Core separation ({unit_name(unit)})")
    ax.set_ylabel(f"Radial proper motion ({unit_name(speeds)})")
    style.legend_above(ax)
    style.add_speed_axis(ax, speeds, beta_per_pm, "right")
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
    unit = table["pm"].unit
    speed, error = (table[name].to_value(unit) for name in ("pm", "pm_err"))
    low, high = speed[0] - error[0], speed[0] + error[0]
    ax.axvspan(low, high, color=style.GREY, alpha=0.2, lw=0)
    ax.axvline(speed[0], color=style.GREY, lw=0.8)
    row, large = np.arange(len(table)), np.asarray(table["significant"])
    for own, color, marker in (
        (~large, style.BLUE, "o"),
        (large, style.VERMILION, "s"),
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
