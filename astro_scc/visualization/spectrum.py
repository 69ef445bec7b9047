# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The velocity spectrum of a result, and speeds against distance from the core."""

import astropy.units as u
import numpy as np

from astro_scc.columns import cell
from astro_scc.spectrum.equations import deconvolve, set_up
from astro_scc.streams.decomposed import distances
from astro_scc.streams.members import frame_velocities
from astro_scc.units import PM_UNIT, offset_unit, unit_name
from astro_scc.visualization import images, style
from astro_scc.visualization.tracks import draw_feature_speeds


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
        self.name = unit_name(self.unit)
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


def _look(stream, number):
    """Return the colour of a stream, grey if it is not significant, and its filling."""
    color = style.component_color(number)
    sure = stream.kind in ("moving", "stationary")
    color = style.GREY if stream.kind == "not significant" else color
    return color, color if sure else "white"


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
    main = {"color": style.BLUE, "label": words[0], "lw": 1.2}
    main = style.look_of("line", look, **main)
    upper.step(speed, there, where="mid", **main)
    fill = {"step": "mid", "color": main["color"], "alpha": 0.2, "lw": 0}
    upper.fill_between(speed, there, **fill)
    back = {"color": style.GREY, "lw": 0.8, "label": words[1]}
    upper.step(speed, share[:half][::-1], where="mid", **back)
    top = max(there.max(), share[:half].max()) or 1.0
    _draw_streams(upper, result, speeds, top, speed[[0, -1]])
    _draw_ticks(upper, result, speeds, top)
    _draw_test(lower, search, speeds)
    for ax in (upper, lower):
        ax.set(xscale="log", xlim=speed[[0, -1]])
    _draw_limits(upper, lower, search, speeds)
    upper.set_ylabel("Share of the variance\nof the moving emission")
    lower.set_xlabel(f"Speed along the flow ({speeds.name})")
    upper.legend(fontsize="small", frameon=False, loc="best")
    style.plain_log(lower)
    if second := style.add_speed_axis(upper, speeds.unit, beta_per_pm):
        style.plain_log(second)
    figure.align_ylabels()
    return figure


def _draw_limits(upper, lower, search, speeds):
    """Shade speeds that were not searched, and mark where they are ambiguous."""
    limits = search.slowest, search.fastest, search.unambiguous
    slowest, fastest, safe = (limit * speeds.factor for limit in limits)
    low, high = lower.get_xlim()
    for ax in (upper, lower):
        for ends in ((low, slowest), (fastest, high)):
            ax.axvspan(*ends, color=style.GREY, alpha=0.15, lw=0, gid="not searched")
        if low < safe < high:
            ax.axvline(safe, color=style.BLACK, lw=0.8, ls=":", gid="unambiguous")
    if low < safe < high:
        left = safe**2 > low * high
        lower.annotate(
            "ambiguous beyond", (safe, 0.97), xycoords=lower.get_xaxis_transform(),
            xytext=(-3 if left else 3, 0), textcoords="offset points",
            fontsize="x-small", ha="right" if left else "left", va="top",
        )  # fmt: skip


def _draw_streams(ax, result, speeds, top, ends):
    """Draw the streams that move above the spectrum, with their speeds inside of it."""
    row, (low, high) = 0, ends
    pairs = zip(result.search.streams, result.streams, strict=True)
    for k, (stream, line) in enumerate(pairs):
        if stream.kind == "stationary":
            continue
        speed, (color, filling) = abs(speeds.stream[k]), _look(stream, k + 1)
        row += 1
        y, spread = top * (1 + 0.18 * row - 0.06), speeds.dispersion[k]
        ax.plot(
            [max(speed - spread, 1e-3 * speed), speed + spread], [y, y], lw=6,
            alpha=0.3, color=color, solid_capstyle="butt", gid="dispersion",
        )  # fmt: skip
        text = f"{k + 1}: {cell(line, 'pm')}"
        text += "" if stream.kind == "moving" else f", {stream.kind}"
        error = min(speeds.stream_err[k], 0.99 * speed)
        ax.errorbar(
            speed, y, xerr=error, fmt=style.KIND_MARKERS[stream.kind], ms=5, capsize=2,
            lw=1, color=color, mfc=filling, zorder=4,
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
    test = search.test
    z = test.z[test.best[0]]
    use = test.speed > 0
    order = np.argsort(test.speed[use])
    speed = test.speed[use][order] * search.beam * speeds.factor
    z = z[use][order]
    ax.plot(speed, z, color=style.BLUE, lw=1.2)
    ax.axhline(0, color=style.GREY, lw=0.6)
    for sign in (1, -1):
        look = {"color": style.VERMILION, "lw": 0.9, "ls": "--", "gid": "level"}
        ax.axhline(sign * test.level, **look)
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
    r = distances(flow.grids[0])[inside]
    low, high = (r.min(), r.max()) if r.size else (0.0, 1.0)
    # Two beams wide or more, and not more than twelve.
    n = int(np.clip((high - low) // 2, 1, 12))
    edges = np.linspace(low, high, n + 1) * flow.beam
    found = []
    for ends in zip(edges[:-1], edges[1:], strict=True):
        part = flow.between(*ends)
        limits = {"fastest": flow.fastest, "intervals": search.intervals}
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
    _draw_lines(ax, result, speeds)
    shown = [*speeds.stream, *speeds.feature[secure], 0.0]
    if not any(stream.kind == "moving" for stream in result.search.streams):
        shown += [-min(shown), -max(shown)]
    low, high = 1.35 * min(shown), 1.35 * max(shown)
    margin = 0.06 * (high - low)
    ax.set(xlim=(0, 1.02 * far * scale), ylim=(low - margin, high or 1.0))
    ax.set_xlabel(f"Core separation ({unit_name(lengths)})")
    ax.set_ylabel(f"Speed along the flow ({speeds.name})")
    style.legend_above(ax, columns=3)
    style.add_speed_axis(ax, speeds.unit, beta_per_pm, "right")
    return figure


def _draw_lines(ax, result, speeds):
    """Draw the streams as lines at their speeds."""
    rows = zip(result.search.streams, result.streams, strict=True)
    for k, (stream, row) in enumerate(rows):
        color, _ = _look(stream, k + 1)
        text = cell(row, "pm")
        text = text if stream.kind == "moving" else f"{text}, {stream.kind}"
        ax.axhline(
            speeds.stream[k], color=color, lw=1.2, zorder=2, gid="stream",
            ls=style.KIND_LINES[stream.kind], label=f"{k + 1}: {text}",
            path_effects=style.outline(2.2),
        )  # fmt: skip
