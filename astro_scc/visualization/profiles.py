# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speed against distance, maps of velocity by scale, histograms of position angles."""

import astropy.units as u
import numpy as np

from astro_scc.visualization.style import (
    BLACK,
    BLUE,
    GREY,
    PM_UNIT,
    SCALE_COLORS,
    VERMILLION,
    WIDTH,
    add_speed_axis,
    figure_and_axes,
    new_figure,
    unit_name,
)

__all__ = ["plot_position_angles", "plot_profile", "plot_scale_maps"]

#: Half the height of the strip of jet above the profile, in beams.
STRIP = 3.0
#: Sign of each kind of component: marker, filled, name.
SIGNS = {
    "moving": ("o", True, "component"),
    "stationary": ("s", True, "stationary"),
    "not significant": ("o", False, "not significant"),
}


def plot_profile(
    table,
    *,
    cube=None,
    line=None,
    column="pm_parallel",
    fits=(),
    others=(),
    beta_per_pm=None,
    figure=None,
):
    """
    Draw speed against distance, with the jet above it.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        `Profile.components <astro_scc.flow.Profile.components>`.
    cube : `~astro_scc.epochs.EpochCube`, optional
        Its mean image is drawn above, on the scale of distances.
    line : `~astro_scc.kinematics.RidgeLine`, optional
        Along which the jet is drawn; it needs the cube.
    column : str, optional
        The speed that is drawn.
    fits : sequence of `~astro_scc.flow.ProfileFit`, optional
        Curves.
    others : sequence of (str, distance, speed, error), optional
        Speeds that others found, with their name.
    beta_per_pm : float, optional
        Apparent speed, in units of c, of a proper motion of 1 mas/yr; draws
        a second axis.
    figure : `matplotlib.figure.Figure`, optional
        Drawn on this one instead of a new figure.

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
    'Distance from the core (mas)'
    """
    above = cube is not None and line is not None
    figure = new_figure((WIDTH, 4.6 if above else 3.4)) if figure is None else figure
    if above:
        figure.set_layout_engine("constrained")
        top, ax = figure.subplots(
            2, 1, sharex=True, gridspec_kw={"height_ratios": [1, 3]}
        )
    else:
        ax = figure.add_subplot()
    far = float(table["r_max"].to_value(u.mas).max()) if len(table) else 1.0
    for name, r, v, e in others:
        ax.errorbar(
            u.Quantity(r).to_value(u.mas), u.Quantity(v).to_value(PM_UNIT),
            u.Quantity(e).to_value(PM_UNIT), fmt="D", color=GREY, ms=3, lw=0.8,
            label=name, zorder=1,
        )  # fmt: skip
        far = max(far, float(np.max(u.Quantity(r).to_value(u.mas), initial=0)))
    _draw_components(ax, table, column)
    grid = np.linspace(0, far, 200)[1:] * u.mas
    for k, fit in enumerate(fits):
        ax.plot(
            grid.value, u.Quantity(fit(grid)).to_value(PM_UNIT), lw=1.2, zorder=2,
            color=SCALE_COLORS[(k + 1) % len(SCALE_COLORS)], label=fit.model,
            ls=("-", "--", ":")[k % 3],
        )  # fmt: skip
    ax.set_xlim(0, 1.02 * far)
    _limit_speeds(ax, table, column)
    ax.set_xlabel("Distance from the core (mas)")
    ax.set_ylabel(f"Proper motion along the jet ({unit_name(PM_UNIT)})")
    handles, labels = ax.get_legend_handles_labels()
    if handles:
        ax.legend(handles, labels, fontsize="small", framealpha=0.85)
    if beta_per_pm is not None:
        add_speed_axis(ax, PM_UNIT, beta_per_pm, "right")
    if above:
        _draw_strip(top, cube, line, far)
    return figure


def _draw_components(ax, table, column):
    kinds = np.asarray(table["kind"], dtype=str)
    main = table["main"] if "main" in table.colnames else np.ones(len(table), bool)
    for kind, (marker, full, name) in SIGNS.items():
        own = kinds == kind
        if not own.any():
            continue
        for part, alpha in ((own & main, 1.0), (own & ~main, 0.45)):
            if not part.any():
                continue
            rows = table[part]
            middle = rows["r_mid"].to_value(u.mas)
            error = rows[f"{column}_err"].to_value(PM_UNIT)
            ax.errorbar(
                middle, rows[column].to_value(PM_UNIT),
                np.where(np.isfinite(error), error, 0.0),
                [middle - rows["r_min"].to_value(u.mas),
                 rows["r_max"].to_value(u.mas) - middle],
                fmt=marker, ms=5, color=BLUE if kind != "stationary" else VERMILLION,
                mfc=None if full else "white", alpha=alpha, lw=1.0, zorder=3,
                label=name if alpha == 1.0 or not (own & main).any() else None,
            )  # fmt: skip


def _limit_speeds(ax, table, column):
    """Errors that say nothing must not squeeze the rest."""
    if len(table) == 0:
        return
    v = table[column].to_value(PM_UNIT)
    low, high = min(v.min(), 0.0), max(v.max(), 0.0)
    margin = 0.35 * max(high - low, 1e-9)
    bottom, top = ax.get_ylim()
    ax.set_ylim(max(bottom, low - margin), min(top, high + margin))


def _draw_strip(ax, cube, line, far):
    """The mean image, straightened along a line."""
    import matplotlib
    from scipy.ndimage import map_coordinates

    from astro_scc.visualization.drawing import plotting_norm

    beam = 4 * cube.pixel_scale.value
    if cube.beams is not None:
        beam = max(b.major.to_value(u.mas) for b in cube.beams)
    half = STRIP * beam / 2
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
        cmap=matplotlib.colormaps["Greys"], norm=plotting_norm(cube, strip),
    )  # fmt: skip
    ax.set_ylabel("Across\n(mas)")


def plot_scale_maps(maps, grid, *, axis_names=("parallel", "transverse"), figure=None):
    """
    Draw the stacks of several groups of scales beside one another.

    Parameters
    ----------
    maps : dict of `~numpy.ndarray`, shape ``grid.shape``
        By the name of the group.
    grid : `~astro_scc.stacking.VelocityGrid`
        In mas/yr.
    axis_names : (str, str), optional
    figure : `matplotlib.figure.Figure`, optional

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If there is no map.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import VelocityGrid
    >>> from astro_scc.visualization import plot_scale_maps
    >>> grid = VelocityGrid.covering(2.0, 0.5)
    >>> figure = plot_scale_maps({"scale 1": np.ones(grid.shape)}, grid)
    >>> figure.axes[0].get_title()
    'scale 1'
    """
    if not maps:
        raise ValueError("maps must hold one map or more, got none")
    columns = min(len(maps), 2)
    rows = -(-len(maps) // columns)
    figure = new_figure((WIDTH, 2.9 * rows)) if figure is None else figure
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    (left, right), (bottom, top) = (
        (axis[0] - step / 2, axis[-1] + step / 2)
        for axis, step in zip((grid.v1, grid.v2), grid.step, strict=True)
    )
    for ax, (name, values) in zip(axes.flat, maps.items(), strict=False):
        high = float(np.max(values, initial=0.0))
        ax.imshow(
            values, origin="lower", extent=(left, right, bottom, top), cmap="cividis",
            vmin=0, vmax=high if high > 0 else 1.0, interpolation="bilinear",
        )  # fmt: skip
        if high > 0:
            row, column = np.unravel_index(values.argmax(), values.shape)
            ax.plot(grid.v1[column], grid.v2[row], "+", color="white", ms=8)
        ax.axhline(0, color="white", lw=0.6, alpha=0.6)
        ax.axvline(0, color="white", lw=0.6, alpha=0.6)
        ax.set_title(name)
    for ax in axes.flat[len(maps) :]:
        ax.set_axis_off()
    unit = unit_name(PM_UNIT)
    figure.supxlabel(f"Proper motion, {axis_names[0]} ({unit})", fontsize="medium")
    figure.supylabel(f"Proper motion, {axis_names[1]} ({unit})", fontsize="medium")
    return figure


def plot_position_angles(groups, *, ax=None, label=None, n_bins=24):
    """
    Draw histograms of position angles, or of offsets, of groups of SSPs.

    Parameters
    ----------
    groups : dict of `~astropy.units.Quantity`
        By the name of the group.
    ax : `matplotlib.axes.Axes`, optional
        Drawn on these instead of a new figure.
    label : str, optional
        Of the axis; by default for position angles.
    n_bins : int, optional

    Returns
    -------
    `matplotlib.figure.Figure`

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.visualization import plot_position_angles
    >>> figure = plot_position_angles({"scales 1, 2": [240, 250, 251] * u.deg})
    >>> figure.axes[0].get_xlabel()
    'Position angle (deg)'
    """
    figure, ax = figure_and_axes(ax, (WIDTH, 3.2))
    values = [np.atleast_1d(u.Quantity(v)) for v in groups.values()]
    unit = next((v.unit for v in values if len(v)), u.deg)
    values = [v.to_value(unit) if len(v) else v.value for v in values]
    everything = np.concatenate(values) if values else np.zeros(0)
    low, high = (
        np.percentile(everything, [0.5, 99.5]) if len(everything) else (0.0, 1.0)
    )
    edges = np.linspace(low, high if high > low else low + 1, n_bins + 1)
    for k, (name, v) in enumerate(zip(groups, values, strict=True)):
        weight = np.full(len(v), 1 / max(len(v), 1))
        ax.hist(
            v, edges, weights=weight, histtype="step", lw=1.6,
            ls=("-", "--", ":")[k % 3],
            color=SCALE_COLORS[k % len(SCALE_COLORS)], label=f"{name}: {len(v)} SSPs",
        )  # fmt: skip
        if len(v):
            ax.axvline(np.median(v), color=SCALE_COLORS[k % len(SCALE_COLORS)], lw=0.8)
    ax.set_xlabel(label or f"Position angle ({unit_name(unit)})")
    ax.set_ylabel("Share of the SSPs")
    if groups:
        ax.legend(fontsize="small")
    ax.tick_params(colors=BLACK)
    return figure
