# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Figures of speeds: along the jet, and of the features of a survey."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from textwrap import fill
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np

from astro_scc.features.trust import MOST_FALSE
from astro_scc.units import offset_unit, unit_name
from astro_scc.visualization import images, style
from astro_scc.visualization.tracks import draw_feature_speeds

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure

    from astro_scc.epochs import EpochCube
    from astro_scc.kinematics import RidgeLine

#: Errors beyond so many times the median one are of features that say little.
LARGE_ERROR = 4.0


def plot_feature_speeds(result, *, profile=None, beta_per_pm=None, ax=None, **look):
    """
    Draw the radial speed of each feature against its separation from the core.

    Features have the colours of their streams; those that are not secure are pale.
    Further keywords are those of their symbols.
    """
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 3.4))
    table = result.features
    separation, speeds = table["separation"].to_value(u.mas), table["pm"].unit
    unit = offset_unit(separation.max(initial=1.0))
    speed, error = (table[k].value for k in ("pm_radial", "pm_radial_err"))
    error = np.minimum(error, LARGE_ERROR * np.median(error) if len(error) else 0.0)
    draw_feature_speeds(ax, result, separation * u.mas.to(unit), speed, error, look)
    if profile is not None and len(profile):
        mean = {"fmt": "none", "color": style.BLACK, "elinewidth": 1.6, "zorder": 3}
        style.draw_bins(ax, profile, unit, speeds, {"label": "mean of bin", **mean})
    ax.axhline(0, color=style.GREY, lw=0.6, zorder=0)
    ax.set_xlim(left=0)
    ax.set_xlabel(f"Core separation ({unit_name(unit)})")
    ax.set_ylabel(f"Radial proper motion ({unit_name(speeds)})")
    style.legend_above(ax)
    style.add_speed_axis(ax, speeds, beta_per_pm, "right")
    return figure


def plot_sensitivity(table, *, beta_per_pm=None, ax=None, **look):
    """
    Draw the main speed from parts of the data, beside that of the whole spectrum.

    Parts that differ significantly are red squares.  Further keywords are those of the
    symbols.

    Raises
    ------
    ValueError
        If the table has no rows.
    """
    if len(table) == 0:
        raise ValueError("the table has no rows: nothing moves significantly")
    height = 0.8 + 0.36 * len(table)
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, height))
    unit = table["pm"].unit
    speed, error = (table[name].to_value(unit) for name in ("pm", "pm_err"))
    ends = speed[0] - error[0], speed[0] + error[0]
    ax.axvspan(*ends, color=style.GREY, alpha=0.2, lw=0)
    ax.axvline(speed[0], color=style.GREY, lw=0.8)
    row, large = np.arange(len(table)), np.asarray(table["significant"])
    for use, color, sign in ((~large, style.BLUE, "o"), (large, style.VERMILION, "s")):
        usual = {"marker": sign, "color": color, "ms": 4, "lw": 1, "linestyle": ""}
        usual = style.look_of("line", look, **usual)
        ax.errorbar(speed[use], row[use], xerr=error[use], **usual)
    for k in row[~np.isfinite(speed)]:
        where = {"transform": ax.get_yaxis_transform(), "va": "center"}
        ax.text(0.02, k, "nothing found", fontsize="small", **where)
    ax.set_yticks(row, [fill(str(text), 30) for text in table["choice"]])
    ax.tick_params(axis="y", labelsize="small", length=0)
    ax.set_ylim(len(table) - 0.5, -0.5)
    ax.set_xlabel(f"Proper motion ({unit_name(unit)})")
    style.add_speed_axis(ax, unit, beta_per_pm)
    return figure


# -- of many sources -----------------------------------------------------------------


def population(features, *, significant=3.0, often=10):
    """
    Return which features of many sources show what.

    Parameters
    ----------
    features : `~astropy.table.QTable`
        ``features.ecsv`` of a survey.
    significant : float, optional
        What differs from zero by so many standard errors is not zero.
    often : int, optional
        Fewest epochs of a feature whose acceleration is judged, or that stands still.

    Returns
    -------
    dict of `~numpy.ndarray` of bool, shape (n,)
        ``moving``, secure and significantly fast; of these ``inward`` and, in often
        enough epochs, ``judged``; of the latter ``accelerated``.  ``at rest`` are
        features of as many epochs that are false with a probability of at most 0.3 and
        not significantly fast; secure ones have moved by a beam.
    """

    def ratio(name):
        value, error = (_plain(features[k]) for k in (name, f"{name}_err"))
        return value / error

    speed = ratio("pm")
    change = [np.abs(ratio(f"acc_{k}")) for k in ("parallel", "perpendicular")]
    moving = np.asarray(features["secure"], dtype=bool) & (speed >= significant)
    often = np.asarray(features["n_epochs"]) >= often
    true = np.asarray(features["p_false"]) <= MOST_FALSE
    return {
        "moving": moving,
        "at rest": often & true & (speed < significant),
        "inward": moving & (ratio("pm_radial") <= -significant),
        "judged": moving & often,
        # Only of those whose motion is better described so is it measured.
        "accelerated": moving & often & (np.max(change, axis=0) >= significant),
    }


def fastest_of(features, column):
    """Return the largest value of the moving features of each source."""
    moving, largest = features[population(features)["moving"]], {}
    for source, value in zip(moving["source"], _plain(moving[column]), strict=True):
        if np.isfinite(value):
            largest[source] = max(value, largest.get(source, 0.0))
    return np.array(list(largest.values()))


def plot_population(features):
    """
    Draw the speeds of the features of many sources.

    Parameters
    ----------
    features : `~astropy.table.QTable`
        ``features.ecsv`` of a survey, of which some move.

    Returns
    -------
    `matplotlib.figure.Figure`
        Histograms of the speeds of secure features that move and of the fastest one of
        each jet, in mas/yr and, if sources have redshifts, in units of c.
    """
    found = population(features)
    columns = {"pm": f"Proper motion ({unit_name(features['pm'].unit)})"}
    if "beta_app" in features.colnames:
        columns["beta_app"] = r"Apparent speed, $\beta_\mathrm{app}$ ($c$)"
    figure = style.new_figure((style.WIDTH, 2.6 * len(columns)))
    axes = figure.subplots(len(columns), 2, squeeze=False)
    inward, colors = found["inward"], (style.BLUE, style.VERMILION)
    for (name, label), (left, right) in zip(columns.items(), axes, strict=True):
        speed = np.where(inward, -1.0, 1.0) * _plain(features[name])
        use = found["moving"] & np.isfinite(speed)
        parts = [speed[use & ~inward], speed[use & inward]]
        _histogram(left, parts, colors, ("outward", "inward"))
        left.set(xlabel=label, ylabel="Features")
        _histogram(right, [fastest_of(features, name)], (style.GREEN,), ("fastest",))
        right.set(xlabel=f"Fastest {label[0].lower()}{label[1:]}", ylabel="Jets")
    return figure


def _histogram(ax, parts, colors, names):
    """Draw a stacked histogram, of which parts without values have no name."""
    every = np.concatenate(parts)
    if len(every) == 0:
        ax.text(0.5, 0.5, "none", ha="center", va="center", transform=ax.transAxes)
        return
    edges = np.histogram_bin_edges(np.append(every, 0.0), bins=20)
    ax.hist(parts, edges, color=colors, label=names, stacked=True)
    ax.yaxis.get_major_locator().set_params(integer=True)
    if sum(len(part) > 0 for part in parts) > 1:
        ax.legend(frameon=False)


def _plain(values):
    """Return the numbers of a column, NaN where it is masked."""
    values = getattr(values, "filled", lambda _: values)(np.nan)
    return np.asarray(u.Quantity(values).value, dtype=float)


def plot_profile(
    table: QTable, *, cube: EpochCube | None = None, line: RidgeLine | None = None,
    fits: Sequence[Callable[[u.Quantity], u.Quantity]] = (),
    others: Sequence[tuple[str, u.Quantity, u.Quantity, u.Quantity]] = (),
    beta_per_pm: float | None = None, **look: Any,
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
    fits : sequence of `~astro_scc.flow.ProfileFit`, optional
        Fits that are drawn as curves.
    others : sequence of (str, distance, speed, error), optional
        Names and values of published or other speeds.
    beta_per_pm : float, optional
        Apparent speed, in units of c, of a proper motion of 1 mas/yr, for a
        second axis.
    **look
        Keywords of the symbols, see `matplotlib.lines.Line2D`.

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
    ...                 "main": [True, True], "n_features": [6, 2],
    ...                 "pm_parallel": speed, "pm_parallel_err": 0.1 * speed})
    >>> plot_profile(table).axes[0].get_xlabel()
    'Core separation (mas)'
    """
    above = cube is not None and line is not None
    figure = style.new_figure((style.WIDTH, 4.6 if above else 3.4))
    if above:
        figure.set_layout_engine("constrained")
        strip, ax = figure.subplots(2, 1, sharex=True, height_ratios=(1, 3))
    else:
        ax = figure.add_subplot()
    speeds = table["pm_parallel"].unit
    far = float(table["r_max"].to_value(u.mas).max()) if len(table) else 1.0
    for name, r, *speed in others:
        r = u.Quantity(r).to_value(u.mas)
        grey = {"fmt": "D", "color": style.GREY, "ms": 3, "lw": 0.8, "zorder": 1}
        ax.errorbar(r, *u.Quantity(speed).to_value(speeds), label=name, **grey)
        far = max(far, float(np.max(r, initial=0)))
    _draw_streams(ax, table, look)
    grid = np.linspace(0, far, 200)[1:] * u.mas
    for k, fit in enumerate(fits):
        ax.plot(
            grid.value, u.Quantity(fit(grid)).to_value(speeds), lw=1.2, zorder=2,
            color=style.BLACK, label=str(fit), ls=style.LINES[k % 3],
        )  # fmt: skip
    ax.set_xlim(0, 1.02 * far)
    # Very large errors must not squeeze the rest.
    shown = np.append(table["pm_parallel"].value, 0.0)
    margin = 0.35 * max(np.ptp(shown), 1e-9) if len(table) else np.inf
    bottom, top = ax.get_ylim()
    ax.set_ylim(max(bottom, shown.min() - margin), min(top, shown.max() + margin))
    ax.set_xlabel("Core separation (mas)")
    ax.set_ylabel(f"Proper motion along the jet ({unit_name(speeds)})")
    style.legend_above(ax, columns=2)
    style.add_speed_axis(ax, speeds, beta_per_pm, "right")
    if above:
        _draw_strip(strip, cube, line, far)
    return figure


def _draw_streams(ax, table, given):
    """Draw streams by kind and group of scales, those not main in their bin smaller."""
    table = table[np.isfinite(table["pm_parallel"])]
    kinds, main = np.asarray(table["kind"], dtype=str), np.asarray(table["main"])
    group = np.full(len(table), "")
    if "scale_group" in table.colnames:
        group = np.asarray(table["scale_group"], dtype=str)
    names = list(dict.fromkeys(group.tolist()))
    for name, kind in product(names, style.KIND_MARKERS):
        here, color = (kinds == kind) & (group == name), names.index(name) + 1
        for part, size in ((here & main, 5), (here & ~main, 3)):
            if part.any():
                label = f"{kind}, scales {name}" if name else kind
                look = style.look_of(
                    "line", given, ms=size, marker=style.KIND_MARKERS[kind], lw=1.0,
                    color=style.component_color(color), zorder=3, linestyle="",
                    mfc="white" if kind.startswith("not") else None,
                    label=label if size == 5 or not (here & main).any() else None,
                )  # fmt: skip
                style.draw_bins(ax, table[part], u.mas, table["pm_parallel"].unit, look)


def _draw_strip(ax, cube, line, far):
    """Draw the mean image, straightened along a line, three beams wide."""
    from scipy.ndimage import map_coordinates

    half = 3 * cube.resolution.to_value(u.mas) / 2
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
        cmap="Greys", norm=images.plotting_norm(cube, strip),
    )  # fmt: skip
    ax.set_ylabel("Across\n(mas)")


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
    >>> from astro_scc.visualization.speeds import plot_position_angles
    >>> figure = plot_position_angles({"scales 1, 2": [240, 250, 251] * u.deg})
    >>> figure.axes[0].get_xlabel()
    'Position angle (deg)'
    """
    figure, ax = style.figure_and_axes(None, (style.WIDTH, 3.2))
    degrees = {name: angles.to_value(u.deg) for name, angles in groups.items()}
    low, high = np.percentile(np.concatenate([*degrees.values()]), [0.5, 99.5])
    edges = np.linspace(low, high if high > low else low + 1, 25)
    for k, (name, v) in enumerate(degrees.items()):
        color = style.component_color(k + 1)
        ax.hist(
            v, edges, weights=np.full(len(v), 1 / max(len(v), 1)), histtype="step",
            lw=1.6, ls=style.LINES[k % 3], color=color, label=f"{name}: {len(v)} SSPs",
        )  # fmt: skip
        if len(v):
            ax.axvline(np.median(v), color=color, lw=0.8)
    ax.set(xlabel="Position angle (deg)", ylabel="Fraction of the SSPs")
    ax.legend(fontsize="small")
    return figure
