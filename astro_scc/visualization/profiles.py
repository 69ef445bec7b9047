# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Figures of speed against distance, velocity maps by scale, and position angles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from astro_scc.kinematics.ridge_line import mean_width
from astro_scc.units import PM_UNIT, unit_name
from astro_scc.visualization import drawing, style
from astro_scc.visualization.velocity import draw_map

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure

    from astro_scc.epochs import EpochCube
    from astro_scc.kinematics import RidgeLine

#: Half the width of the strip of the jet above the profile, in beams.
STRIP = 3.0
#: Bins of a histogram of position angles.
ANGLE_BINS = 24


def plot_profile(
    table: QTable, *, cube: EpochCube | None = None, line: RidgeLine | None = None,
    column: str = "pm_parallel",
    fits: Sequence[Callable[[u.Quantity], u.Quantity]] = (),
    others: Sequence[tuple[str, u.Quantity, u.Quantity, u.Quantity]] = (),
    beta_per_pm: float | None = None, figure: Figure | None = None,
) -> Figure:  # fmt: skip
    """
    Draw speed against distance, with the jet above it.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        `Profile.components <astro_scc.flow.Profile.components>`.
    cube : `~astro_scc.epochs.EpochCube`, optional
        Cube whose mean image is drawn above, on the same scale of distances.
    line : `~astro_scc.kinematics.RidgeLine`, optional
        Line along which the jet is drawn; it needs the cube.
    column : str, optional
        Column of the speed that is drawn.
    fits : sequence of `~astro_scc.flow.ProfileFit`, optional
        Fits that are drawn as curves.
    others : sequence of (str, distance, speed, error), optional
        Names and values of published or other speeds.
    beta_per_pm : float, optional
        Apparent speed, in units of c, of a proper motion of 1 mas/yr, for a
        second axis.
    figure : `matplotlib.figure.Figure`, optional
        Figure to draw on instead of a new one.

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
    >>> from astropy.table import QTable
    >>> from astro_scc.visualization import plot_profile
    >>> speed = [1.0, 1.2] * u.mas / u.yr
    >>> table = QTable({"r_min": [0, 1] * u.mas, "r_max": [1, 2] * u.mas,
    ...                 "r_mid": [0.5, 1.5] * u.mas,
    ...                 "kind": ["moving", "not significant"],
    ...                 "pm_parallel": speed, "pm_parallel_err": 0.1 * speed})
    >>> plot_profile(table).axes[0].get_xlabel()
    'Core separation (mas)'
    """
    above = cube is not None and line is not None
    if figure is None:
        figure = style.new_figure((style.WIDTH, 4.6 if above else 3.4))
    if above:
        figure.set_layout_engine("constrained")
        strip, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1, 3))
    else:
        ax = figure.add_subplot()
    speeds = table[column].unit
    far = float(table["r_max"].to_value(u.mas).max()) if len(table) else 1.0
    for name, *values in others:
        r, speed, error = (
            u.Quantity(value).to_value(unit)
            for value, unit in zip(values, (u.mas, speeds, speeds), strict=True)
        )
        look = {"fmt": "D", "color": style.GREY, "ms": 3, "lw": 0.8, "zorder": 1}
        ax.errorbar(r, speed, error, label=name, **look)
        far = max(far, float(np.max(r, initial=0)))
    _draw_components(ax, table, column)
    grid = np.linspace(0, far, 200)[1:] * u.mas
    for k, fit in enumerate(fits):
        ax.plot(
            grid.value, u.Quantity(fit(grid)).to_value(speeds), lw=1.2, zorder=2,
            color=style.component_color(k + 2), label=fit.model, ls=style.LINES[k % 3],
        )  # fmt: skip
    ax.set_xlim(0, 1.02 * far)
    if len(table):
        # Very large errors must not squeeze the rest.
        speed = table[column].value
        low, high = speed.min(initial=0.0), speed.max(initial=0.0)
        margin = 0.35 * max(high - low, 1e-9)
        bottom, top = ax.get_ylim()
        ax.set_ylim(max(bottom, low - margin), min(top, high + margin))
    ax.set_xlabel("Core separation (mas)")
    ax.set_ylabel(f"Proper motion along the jet ({unit_name(speeds)})")
    if ax.get_legend_handles_labels()[0]:
        style.legend_above(ax)
    style.add_speed_axis(ax, speeds, beta_per_pm, "right")
    if above:
        _draw_strip(strip, cube, line, far)
    return figure


def _draw_components(ax, table, column):
    """Draw the components by kind, those that do not represent their bin smaller."""
    if "n_features" in table.colnames:
        # What has no feature has no speed.
        table = table[np.asarray(table["n_features"]) > 0]
    kinds = np.asarray(table["kind"], dtype=str)
    main = table["main"] if "main" in table.colnames else np.ones(len(table), bool)
    for kind, sign in style.KINDS.items():
        own = kinds == kind
        for part, size in ((own & main, 5), (own & ~main, 3)):
            if part.any():
                style.draw_bins(
                    ax, table[part], column, u.mas, table[column].unit, ms=size,
                    fmt=sign.on_profile, lw=1.0, zorder=3,
                    color=style.VERMILION if kind == "stationary" else style.BLUE,
                    mfc="white" if kind.startswith("not") else None,
                    label=kind if size == 5 or not (own & main).any() else None,
                )  # fmt: skip


def _draw_strip(ax, cube, line, far):
    """Draw the mean image, straightened along a line."""
    from scipy.ndimage import map_coordinates

    half = STRIP * mean_width(cube) / 2
    s = np.linspace(0, far, 400) * u.mas
    n = np.linspace(-half, half, 80) * u.mas
    east, north = line.at(s)
    angle = line.position_angle(s).to_value(u.rad)
    x, y = cube.offset_to_pixel(
        east + n[:, None] * np.cos(angle), north - n[:, None] * np.sin(angle)
    )
    image = np.asarray(cube.mean_image().data)
    strip = np.ma.masked_invalid(map_coordinates(image, [y, x], order=1, cval=np.nan))
    ax.imshow(
        strip, origin="lower", extent=(0, far, -half, half), aspect="auto",
        cmap="Greys", norm=drawing.plotting_norm(cube, strip),
    )  # fmt: skip
    ax.set_ylabel("Across\n(mas)")


def plot_scale_maps(maps, grid, *, axis_names=("parallel", "transverse"), unit=PM_UNIT):
    """
    Draw the stacks of several groups of scales side by side.

    Parameters
    ----------
    maps : dict of `~numpy.ndarray`, shape ``grid.shape``
        The stacks, by the names of the groups.
    grid : ``VelocityGrid``
        In mas/yr.
    axis_names : (str, str), optional
    unit : `~astropy.units.Unit`, optional
        Unit of the axes.

    Returns
    -------
    `matplotlib.figure.Figure`

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking.velocities import VelocityGrid
    >>> from astro_scc.visualization.profiles import plot_scale_maps
    >>> grid = VelocityGrid.covering(2.0, 0.5)
    >>> figure = plot_scale_maps({"scale 1": np.ones(grid.shape)}, grid)
    >>> figure.axes[0].get_title()
    'scale 1'
    """
    columns = min(len(maps), 2)
    rows = -(-len(maps) // columns)
    figure = style.new_figure((style.WIDTH, 2.9 * rows))
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for ax, (name, values) in zip(axes.flat, maps.items(), strict=False):
        draw_map(ax, values, grid, unit)
        if np.max(values, initial=0.0) > 0:
            row, column = np.unravel_index(values.argmax(), values.shape)
            place = PM_UNIT.to(unit, [grid.v1[column], grid.v2[row]])
            ax.plot(*place, "+", color="white", ms=8)
        ax.set_title(name)
    for ax in axes.flat[len(maps) :]:
        ax.set_axis_off()
    labels = (f"Proper motion, {name} ({unit_name(unit)})" for name in axis_names)
    style.label_all(figure, *labels)
    return figure


def plot_position_angles(groups):
    """
    Draw histograms of the position angles of groups of SSPs.

    Parameters
    ----------
    groups : dict of `~astropy.units.Quantity`
        The angles by the names of the groups, of which some may be empty.

    Returns
    -------
    `matplotlib.figure.Figure`

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.visualization.profiles import plot_position_angles
    >>> figure = plot_position_angles({"scales 1, 2": [240, 250, 251] * u.deg})
    >>> figure.axes[0].get_xlabel()
    'Position angle (deg)'
    """
    figure, ax = style.figure_and_axes(None, (style.WIDTH, 3.2))
    degrees = {name: angles.to_value(u.deg) for name, angles in groups.items()}
    low, high = np.percentile(np.concatenate([*degrees.values()]), [0.5, 99.5])
    edges = np.linspace(low, high if high > low else low + 1, ANGLE_BINS + 1)
    for k, (name, v) in enumerate(degrees.items()):
        color = style.component_color(k + 1)
        ax.hist(
            v, edges, weights=np.full(len(v), 1 / max(len(v), 1)), histtype="step",
            lw=1.6, ls=style.LINES[k % 3], color=color, label=f"{name}: {len(v)} SSPs",
        )  # fmt: skip
        if len(v):
            ax.axvline(np.median(v), color=color, lw=0.8)
    ax.set(xlabel="Position angle (deg)", ylabel="Share of the SSPs")
    ax.legend(fontsize="small")
    return figure
