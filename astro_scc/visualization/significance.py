# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The significance of velocities along the jet."""

import astropy.units as u
import numpy as np

from astro_scc.visualization.style import (
    BLUE,
    GREY,
    PM_UNIT,
    VERMILLION,
    WIDTH,
    add_speed_axis,
    component_kinds,
    figure_and_axes,
    new_figure,
    outline,
    speed_unit,
    unit_name,
)
from astro_scc.visualization.velocity import (
    KINDS,
    MAP_LABELS,
    axis_label,
    on_sky,
    plain,
    plot_velocity_map,
)

__all__ = ["plot_map_and_significance", "plot_significance"]


def plot_significance(
    result,
    *,
    ax=None,
    components=None,
    unit=None,
    beta_per_pm=None,
):
    """
    Draw the significance along the jet, at zero speed across it.

    The lower panels of Fig. 2 of Mertens & Lobanov (2016).  A thin line is
    the largest significance at any speed across the jet; components off the
    axis have open signs.

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
        If the unit is no proper motion, or ``beta_per_pm`` is not positive.

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
    figure, ax = figure_and_axes(ax, (WIDTH, 3.4))
    speed, axis, highest = _along_jet(result)
    speed = (speed * PM_UNIT).to_value(unit)
    ax.axhline(0, color=GREY, linewidth=0.6)
    ax.plot(
        speed, highest, color=GREY, linewidth=0.8, label="highest, any transverse speed"
    )
    ax.plot(speed, axis, color=BLUE, linewidth=1.6, label="at zero transverse speed")
    _mark_significance(ax, result, components, component_kinds(components), unit)
    ax.set_xlim(speed[0], speed[-1])
    top = max(np.nanmax(highest, initial=1.0), *plain(components, "z_score"), 1.0)
    ax.set_ylim(min(np.nanmin(axis, initial=0.0), 0.0) - 0.05 * top, 1.4 * top)
    ax.set_xlabel(_slice_label(result, unit))
    ax.set_ylabel(MAP_LABELS["z_score"])
    ax.legend(loc="upper left", fontsize="small", ncols=2, frameon=False)
    if beta_per_pm is not None:
        add_speed_axis(ax, unit, beta_per_pm)
    return figure


def plot_map_and_significance(
    result,
    *,
    figure=None,
    components=None,
    unit=None,
    beta_per_pm=None,
):
    """
    Draw the velocity map over its significance along the jet.

    Fig. 2 of Mertens & Lobanov (2016): `plot_velocity_map` over
    `plot_significance`.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    figure : `matplotlib.figure.Figure`, optional
        Drawn on this one instead of a new figure.
    components, unit, beta_per_pm
        As in `plot_velocity_map`.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is no proper motion, or ``beta_per_pm`` is not positive.

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
    figure = new_figure((WIDTH, 8.0)) if figure is None else figure
    upper, lower = figure.subplots(2, 1, height_ratios=(2.0, 1.0))
    shared = {"components": components, "unit": unit}
    plot_velocity_map(result, ax=upper, beta_per_pm=beta_per_pm, **shared)
    plot_significance(result, ax=lower, **shared)
    return figure


def _along_jet(result):
    """Speeds along the jet, z-score at no speed across, and its highest across."""
    grid, z_score = result.grid, np.asarray(result.z_score, dtype=float)
    if not on_sky(result):
        middle = int(np.argmin(np.abs(grid.v2)))
        return grid.v1, z_score[middle], _highest(z_score)
    from scipy.ndimage import map_coordinates

    angle = u.Quantity(result.position_angle).to_value(u.rad)
    sin, cos = np.sin(angle), np.cos(angle)
    # As far as the square map reaches in this direction.
    reach = min(
        grid.v_max[0] / max(abs(sin), 1e-9), grid.v_max[1] / max(abs(cos), 1e-9)
    )
    half = int(np.ceil(reach / min(grid.step)))
    speed = np.linspace(-reach, reach, 2 * half + 1)
    along, across = np.meshgrid(speed, speed)
    east, north = sin * along + cos * across, cos * along - sin * across
    steps = grid.step
    turned = map_coordinates(
        z_score,
        [(north - grid.v2[0]) / steps[1], (east - grid.v1[0]) / steps[0]],
        order=1,
        cval=np.nan,
        # Rounding must not push the ends of the slice off the map.
        mode="constant",
    )
    return speed, turned[half], _highest(turned)


def _highest(rows):
    seen = np.isfinite(rows)
    highest = np.max(rows, axis=0, where=seen, initial=-np.inf)
    return np.where(seen.any(axis=0), highest, np.nan)


def _mark_significance(ax, result, components, kinds, unit):
    along = plain(components, "pm_parallel", unit)
    across = plain(components, "pm_transverse", unit)
    error = plain(components, "pm_parallel_err", unit)
    across_error = plain(components, "pm_transverse_err", unit)
    z_score = plain(components, "z_score")
    least = max(result.grid.step) * PM_UNIT.to(unit)
    for k, (number, kind) in enumerate(
        zip(plain(components, "component"), kinds, strict=True)
    ):
        on_axis = abs(across[k]) <= 3 * max(across_error[k], least)
        color = VERMILLION if kind != "not significant" else GREY
        bar = error[k] if np.isfinite(error[k]) else 0.0
        ax.errorbar(
            along[k],
            z_score[k],
            xerr=bar,
            fmt=KINDS[kind][1],
            color=color,
            markersize=5,
            markerfacecolor=color if on_axis else "white",
            capsize=2,
            zorder=3,
        )
        ax.annotate(
            f"{number:.0f}",
            (along[k], z_score[k]),
            xytext=(0, 6),
            textcoords="offset points",
            ha="center",
            color=color,
            fontweight="bold" if kind != "not significant" else "normal",
            path_effects=outline(),
            clip_on=True,
        )


def _slice_label(result, unit):
    if on_sky(result):
        angle = u.Quantity(result.position_angle).to_value(u.deg) % 360
        return f"Proper motion along position angle {angle:.0f} deg ({unit_name(unit)})"
    return axis_label(result, 0, unit)
