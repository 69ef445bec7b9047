# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Figures of speeds along the flow: their spectrum, against distance, and in bins of it.

That of parts of the data is here, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from textwrap import fill
from typing import TYPE_CHECKING, Any

import astropy.units as u
import numpy as np

from astro_scc.columns import cell
from astro_scc.spectrum.equations import deconvolve, set_up
from astro_scc.streams.members import frame_velocities
from astro_scc.units import PM_UNIT, offset_unit, unit_name
from astro_scc.visualization import images, style
from astro_scc.visualization.tracks import draw_feature_speeds

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure

    from astro_scc.epochs import EpochCube
    from astro_scc.kinematics import RidgeLine


class Speeds:
    """
    Speeds along the flow of a result, positive outward, in the unit of a figure.

    Attributes
    ----------
    unit : `~astropy.units.Unit`
    factor : float
        The unit in mas/yr.
    distance, feature, feature_err : `~numpy.ndarray`, shape (n_features,)
        Distance of each feature from the core in mas, and its speed.
    stream, stream_err, dispersion : `~numpy.ndarray`, shape (n_streams,)
        The speed of what stands still is zero.
    """

    def __init__(self, result, unit=None):
        self.unit = style.speed_unit_of(result, unit)
        self.factor, search = PM_UNIT.to(self.unit), result.search
        along = np.array([np.cos(search.angle), np.sin(search.angle)])
        features = result.tracked_features
        velocity, covariance = frame_velocities(result.frame, features)
        self.distance = np.hypot(*features.places.T)
        self.feature = self.factor * velocity @ along
        self.feature_err = self.factor * np.sqrt(along @ covariance @ along)
        rows = [
            (s.velocity @ along, np.sqrt(along @ s.covariance @ along), s.dispersion)
            for s in search.streams
        ]
        self.stream, self.stream_err, self.dispersion = np.nan_to_num(
            self.factor * np.reshape(rows, (-1, 3)).T
        )


def _streams(result):
    """Yield each stream's index, kind, colour, and number with speed or kind."""
    pairs = zip(result.search.streams, result.streams, strict=True)
    for k, (stream, row) in enumerate(pairs):
        color = style.component_color(k + 1)
        color = style.GREY if stream.kind == "not significant" else color
        # The length of a velocity is no speed along the flow of what stands still.
        text = "" if stream.kind == "stationary" else cell(row, "pm")
        said = [text, "" if stream.kind == "moving" else stream.kind]
        text = f"{k + 1}: {', '.join(filter(None, said))}"
        yield k, stream.kind, color, text


def plot_spectrum(result, *, figure=None, unit=None, beta_per_pm=None, **look):
    """
    Draw the velocity spectrum over its significance.

    Above is the share of the variance of the moving emission at each speed along the
    flow, of both directions one in all; the opposite one is noise where nothing moves
    that way.
    Symbols are the streams with their errors, pale bars their dispersions, ticks the
    secure features.  Below is the excess over permuted innovations; a dashed line is
    the level that the largest of one in a hundred permutations exceeds.  Speeds that
    were not searched are grey; beyond the dotted line patterns can be mistaken for one
    another.  Further keywords are those of the line of the spectrum.
    """
    figure = style.new_figure((style.WIDTH, 4.8)) if figure is None else figure
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    search, speeds = result.search, Speeds(result, unit)
    words = ("outward", "inward") if result.flow.outward else ("along", "against")
    share = search.spectrum / (search.spectrum.sum() or 1.0)
    half = len(share) // 2
    speed, there = search.speed[half + 1 :] * speeds.factor, share[half + 1 :]
    main = style.look_of("line", look, color=style.BLUE, label=words[0], lw=1.2)
    upper.step(speed, there, where="mid", **main)
    upper.fill_between(speed, there, step="mid", color=main["color"], alpha=0.2, lw=0)
    back = share[:half][::-1]
    upper.step(speed, back, where="mid", color=style.GREY, lw=0.8, label=words[1])
    top = max(there.max(), back.max()) or 1.0
    _draw_streams(upper, result, speeds, top, speed[[0, -1]])
    _draw_ticks(upper, result, speeds, top)
    _draw_test(lower, search, speeds)
    for ax in (upper, lower):
        ax.set(xscale="log", xlim=speed[[0, -1]])
    _draw_limits(upper, lower, search, speeds, top)
    upper.set_ylabel("Share of the variance\nof the moving emission")
    lower.set_xlabel(f"Speed along the flow ({unit_name(speeds.unit)})")
    upper.legend(fontsize="small", frameon=False, loc="best")
    style.plain_log(lower)
    if second := style.add_speed_axis(upper, speeds.unit, beta_per_pm):
        style.plain_log(second)
    figure.align_ylabels()
    return figure


def _draw_limits(upper, lower, search, speeds, top):
    """Shade speeds that were not searched, and mark where they are ambiguous."""
    limits = search.slowest, search.fastest, search.unambiguous
    slowest, fastest, safe = (limit * speeds.factor for limit in limits)
    low, high = lower.get_xlim()
    for ax in (upper, lower):
        for ends in ((low, slowest), (fastest, high)):
            ax.axvspan(*ends, color=style.GREY, alpha=0.15, lw=0, gid="not searched")
    if low < safe < high:
        line = {"color": style.BLACK, "lw": 0.8, "ls": ":", "gid": "unambiguous"}
        lower.axvline(safe, **line)
        # Above the spectrum are the streams with their labels.
        upper.plot([safe, safe], [upper.get_ylim()[0], 1.02 * top], **line)
        left = safe**2 > low * high
        lower.annotate(
            "ambiguous beyond", (safe, 0.97), xycoords=lower.get_xaxis_transform(),
            xytext=(-3 if left else 3, 0), textcoords="offset points",
            fontsize="x-small", ha="right" if left else "left", va="top",
        )  # fmt: skip


def _draw_streams(ax, result, speeds, top, ends):
    """Draw the streams that move above the spectrum, with their speeds inside of it."""
    row, (low, high) = 0, ends
    for k, kind, color, text in _streams(result):
        if kind == "stationary":
            continue
        row += 1
        speed, spread = abs(speeds.stream[k]), speeds.dispersion[k]
        y = top * (1 + 0.18 * row - 0.06)
        ax.plot(
            [max(speed - spread, 1e-3 * speed), speed + spread], [y, y], lw=6,
            alpha=0.3, color=color, solid_capstyle="butt", gid="dispersion",
        )  # fmt: skip
        error = min(speeds.stream_err[k], 0.99 * speed)
        ax.errorbar(
            speed, y, xerr=error, fmt=style.KIND_MARKERS[kind], ms=5, capsize=2, lw=1,
            color=color, mfc=color if kind == "moving" else "white", zorder=4,
        )  # fmt: skip
        # Above the bar, towards the middle of the axes, where there is room.
        ax.annotate(
            text, (speed, y), (0, 5), textcoords="offset points", va="bottom",
            ha="right" if speed**2 > low * high else "left", fontsize="small",
            color=color, path_effects=style.outline(),
        )  # fmt: skip
    ax.set_ylim(-0.06 * top, top * (1.14 + 0.18 * row))


def _draw_ticks(ax, result, speeds, top):
    """Draw the secure features as ticks below the spectrum, in colours of streams."""
    stream, secure = result.features["stream"], result.tracked_features.secure
    for number in np.unique(stream[secure]):
        members = np.abs(speeds.feature[secure & (stream == number)])
        color = style.component_color(number) if number else style.BLACK
        ax.vlines(members, -0.05 * top, -0.005 * top, color=color, lw=1, gid="features")


def _draw_test(ax, search, speeds):
    """Draw the excess over permutations at the speeds that were tested."""
    test, order = search.test, np.argsort(search.test.speed)
    order = order[test.speed[order] > 0]
    z = test.z[test.best[0]][order]
    speed = test.speed[order] * search.beam * speeds.factor
    ax.plot(speed, z, color=style.BLUE, lw=1.2)
    ax.axhline(0, color=style.GREY, lw=0.6)
    for level in (test.level, -test.level):
        ax.axhline(level, color=style.VERMILION, lw=0.9, ls="--", gid="level")
    ax.annotate(
        "99% of permutations", (0.0, test.level), xycoords=ax.get_yaxis_transform(),
        xytext=(4, 2), textcoords="offset points", va="bottom", fontsize="x-small",
        color=style.VERMILION,
    )  # fmt: skip
    top = max(z.max(), 1.25 * test.level)
    ax.set(ylim=(min(z.min(), -1.0) * 1.1, 1.25 * top), ylabel="z")


# -- against distance ----------------------------------------------------------------


def spectra_of_bins(search):
    """
    Return the velocity spectra of bins of distance.

    Parameters
    ----------
    search : ``StreamSearch``

    Returns
    -------
    edges : `~numpy.ndarray`, shape (n_bins + 1,)
        In mas.
    speed : `~numpy.ndarray`, shape (n_v,)
        In mas/yr.
    share : `~numpy.ndarray`, shape (n_v, n_bins)
        The sum of each bin is one; zero where nothing moves, and at speeds that were
        not searched.
    """
    flow = search.flow
    inside = flow.planes[0].mask
    if flow.regions[0] is not None:
        inside = inside & (flow.regions[0] > 0)
    r = flow.grids[0].distances[inside]
    low, high = (r.min(), r.max()) if r.size else (0.0, 1.0)
    # Two beams wide or more, and not more than twelve.
    n = int(np.clip((high - low) // 2, 1, 12))
    edges = np.linspace(low, high, n + 1) * flow.beam
    found = []
    for ends in zip(edges[:-1], edges[1:], strict=True):
        part = flow.between(*ends)
        limits = {"fastest": flow.fastest, "intervals": flow.intervals}
        equations = set_up(part.diagram(0), **limits)
        share, size = deconvolve(equations), np.abs(equations.speed) * flow.beam
        share[(size < search.slowest) | (size > search.fastest)] = 0.0
        found.append(share / (share.sum() or 1.0))
    return edges, equations.speed * flow.beam, np.array(found).T


def plot_distance(result, *, ax=None, unit=None, beta_per_pm=None, **look):
    """
    Draw speeds along the flow against distance from the core.

    Grey is the velocity spectrum of each bin of distance, dark where most of what moves
    there has this speed.  Points are features at the dates of their speeds, in the
    colours of their streams; those that are not secure are pale.  Lines are the
    streams.  Further keywords are those of the grey cells, such as ``cmap``.
    """
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 4.2))
    speeds, secure = Speeds(result, unit), result.tracked_features.secure
    edges, speed, share = spectra_of_bins(result.search)
    far = max(edges[-1], speeds.distance[secure].max(initial=0.0))
    lengths = offset_unit(far)
    scale = u.mas.to(lengths)
    cells = {"cmap": "Greys", "vmin": 0, "vmax": 1.4 * share.max() or 1.0}
    cells = style.look_of("mesh", look, rasterized=True, **cells)
    speed = images.edges(speed * speeds.factor)
    drawn = ax.pcolormesh(edges * scale, speed, share, **cells)
    ax.fill([], [], color=drawn.cmap(0.6), label="velocity spectrum")
    place = speeds.distance * scale
    draw_feature_speeds(ax, result, place, speeds.feature, speeds.feature_err)
    for k, kind, color, text in _streams(result):
        ax.axhline(
            speeds.stream[k], color=color, lw=1.2, zorder=2, gid="stream",
            ls=style.KIND_LINES[kind], label=text, path_effects=style.outline(2.2),
        )  # fmt: skip
    shown = [*speeds.stream, *speeds.feature[secure], 0.0]
    if not any(stream.kind == "moving" for stream in result.search.streams):
        shown += [-min(shown), -max(shown)]
    low, high = 1.35 * min(shown), 1.35 * max(shown)
    margin = 0.06 * (high - low)
    ax.set(xlim=(0, 1.02 * far * scale), ylim=(low - margin, high or 1.0))
    what = "Speed along the flow"
    style.label_distances(ax, lengths, what, speeds.unit, beta_per_pm, columns=3)
    return figure


def plot_profile(
    table: QTable, *, cube: EpochCube | None = None, line: RidgeLine | None = None,
    fits: Sequence[Any] | dict[str, Sequence[Any]] = (),
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
    fits : sequence of `~astro_scc.flow.ProfileFit`, or dict of them, optional
        Fits that are drawn as curves; of groups of scales, by their names.
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
    groups = _draw_bins(ax, table, look)
    grid = np.linspace(0, far, 200)[1:] * u.mas
    for name, each in (fits if isinstance(fits, dict) else {"": fits}).items():
        color = style.component_color(groups.index(name) + 1) if name else style.BLACK
        for k, fit in enumerate(each):
            ax.plot(
                grid.value, u.Quantity(fit(grid)).to_value(speeds), lw=1.2, zorder=2,
                color=color, label=f"scales {name}, {fit}" if name else str(fit),
                ls=style.LINES[k % 3],
            )  # fmt: skip
    ax.set_xlim(0, 1.02 * far)
    # Very large errors must not squeeze the rest.
    shown = np.append(table["pm_parallel"].value, 0.0)
    margin = 0.35 * max(np.ptp(shown), 1e-9) if len(table) else np.inf
    bottom, top = ax.get_ylim()
    ax.set_ylim(max(bottom, shown.min() - margin), min(top, shown.max() + margin))
    what = "Proper motion along the jet"
    style.label_distances(ax, u.mas, what, speeds, beta_per_pm, columns=2)
    if above:
        _draw_strip(strip, cube, line, far)
    return figure


def _draw_bins(ax, table, given):
    """
    Draw streams by kind and group of scales, and return the names of the groups.

    Those that are not main in their bin are smaller.
    """
    group = np.full(len(table), "")
    if "scale_group" in table.colnames:
        group = np.asarray(table["scale_group"], dtype=str)
    names = list(dict.fromkeys(group.tolist()))
    known = np.isfinite(table["pm_parallel"])
    table, group = table[known], group[known]
    kinds, main = np.asarray(table["kind"], dtype=str), np.asarray(table["main"])
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
    return names


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
            ax.axvline(np.median(v), color=color, lw=0.8, label="their median")
    ax.set(xlabel="Position angle (deg)", ylabel="Fraction of the SSPs")
    # A jet to the north has both 359 and 1.
    ax.xaxis.set_major_formatter(lambda angle, _: f"{angle % 360:g}")
    ax.legend(fontsize="small")
    return figure


# -- of parts of the data --------------------------------------------------------------


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
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 0.8 + 0.36 * len(table)))
    unit = table["pm"].unit
    speed, error = (table[name].to_value(unit) for name in ("pm", "pm_err"))
    ends = speed[0] - error[0], speed[0] + error[0]
    ax.axvspan(*ends, color=style.GREY, alpha=0.2, lw=0)
    ax.axvline(speed[0], color=style.GREY, lw=0.8)
    row, large = np.arange(len(table)), np.asarray(table["significant"])
    for use, color, sign in ((~large, style.BLUE, "o"), (large, style.VERMILION, "s")):
        usual = style.look_of("line", look, marker=sign, color=color, ms=4, lw=1, ls="")
        ax.errorbar(speed[use], row[use], xerr=error[use], **usual)
    for k in row[~np.isfinite(speed)]:
        where = {"transform": ax.get_yaxis_transform(), "va": "center"}
        ax.text(0.02, k, "nothing found", fontsize="small", **where)
    ax.set_yticks(row, [fill(str(text), 30) for text in table["choice"]])
    ax.tick_params(axis="y", labelsize="small", length=0)
    ax.set_ylim(len(table) - 0.5, -0.5)
    # Where it is not well known, the table of streams has another mean.
    ax.set_xlabel(f"Proper motion of a fitted Gaussian ({unit_name(unit)})")
    style.add_speed_axis(ax, unit, beta_per_pm)
    return figure
