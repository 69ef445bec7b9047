# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""How SSPs are drawn on an image."""

import astropy.units as u
import numpy as np

from astro_scc.visualization.style import GREY, scale_colors, unit_name

__all__ = []


def ssp_points(cube, ssps):
    """
    What is drawn of SSPs: a dictionary of arrays, or None for None.

    Positions in mas, ``epoch``, ``scale``, whether they are ``used``, and a
    ``weight`` that is small where an SSP is hardly more than noise.
    """
    if ssps is None:
        return None
    used = np.ones(len(ssps), bool)
    if is_catalogue(ssps):
        east, north = cube.pixel_to_offset(ssps.x, ssps.y)
        epoch, scale, snr = ssps.epoch, ssps.scale, ssps.snr
    else:
        names = "east", "north"
        if "lon_offset" in ssps.colnames:
            names = "lon_offset", "lat_offset"
        east, north = (u.Quantity(ssps[name]) for name in names)
        epoch, scale, snr = (np.asarray(ssps[n]) for n in ("epoch", "scale", "snr"))
        if "in_region" in ssps.colnames:
            used = np.asarray(ssps["in_region"], bool)
    snr = np.asarray(snr, dtype=float)
    return {
        "east": east.to_value(u.mas),
        "north": north.to_value(u.mas),
        "epoch": epoch,
        "scale": np.asarray(scale, dtype=float),
        "used": used,
        "weight": 0.05 + np.log(snr / snr.min(initial=np.inf)),
    }


def is_catalogue(ssps):
    """Whether SSPs know their pixels, as those of a decomposition do."""
    return hasattr(ssps, "pixels_of")


def draw_ssps(ax, cube, ssps, points, epoch, unit, size=1.0):
    """Draw the SSPs of an epoch; legend handles for all scales of the cube."""
    from matplotlib.lines import Line2D

    hollow = {"linestyle": "", "marker": "o", "markerfacecolor": "none"}
    handles = []
    colors = scale_colors(points["scale"])
    for rank, (scale, color) in enumerate(colors.items()):
        here = (points["epoch"] == epoch) & (points["scale"] == scale)
        diameter = (4.0 + 3.0 * rank) * size
        label = _label(cube, scale, unit, rank, len(colors))
        if is_catalogue(ssps):
            line = {"color": color, "linewidth": 0.7 + 0.4 * rank}
            _draw_outlines(ax, cube, ssps, np.flatnonzero(here), unit, **line)
            handles.append(Line2D([], [], label=label, **line))
            continue
        for used, alpha in ((True, 1.0), (False, 0.3)):
            some = here & (points["used"] == used)
            ax.plot(
                points["east"][some] * u.mas.to(unit),
                points["north"][some] * u.mas.to(unit),
                markersize=diameter,
                markeredgecolor=color,
                markeredgewidth=1.1,
                alpha=alpha,
                gid=f"ssps {scale:g}",
                **hollow,
            )
        handles.append(
            Line2D([], [], markersize=diameter / size * 0.8, markeredgecolor=color,
                   label=label, **hollow)
        )  # fmt: skip
    if not np.all(points["used"]):
        handles.append(
            Line2D([], [], markersize=5, alpha=0.4, markeredgecolor=GREY,
                   label="not used", **hollow)
        )  # fmt: skip
    return handles


def _label(cube, scale, unit, rank, n_scales):
    """Size of a scale; the first says what it is, the last has the unit."""
    from astro_scc.decomposition import scale_size

    size = (scale_size(scale) * cube.pixel_scale).to_value(unit)
    words = ["SSPs of scale"] * (rank == 0) + [f"{size:.2g}"]
    return " ".join(words + [unit_name(unit)] * (rank == n_scales - 1))


def _draw_outlines(ax, cube, ssps, indices, unit, **line):
    """Draw the edges of the pixels of SSPs, none over another."""
    from matplotlib.collections import LineCollection

    _, ny, nx = cube.shape
    label = np.zeros(ny * nx, dtype=int)
    for index in indices:
        label[ssps.pixels_of(index)] = index + 1
    label = np.pad(label.reshape(ny, nx), 1)
    row, column = np.nonzero(label[:, 1:] != label[:, :-1])
    upright = np.stack([[column - 0.5, row - 1.5], [column - 0.5, row - 0.5]])
    row, column = np.nonzero(label[1:] != label[:-1])
    level = np.stack([[column - 1.5, row - 0.5], [column - 0.5, row - 0.5]])
    ends = np.concatenate([upright, level], axis=2)
    east, north = cube.pixel_to_offset(ends[:, 0], ends[:, 1])
    lines = np.stack([east.to_value(unit), north.to_value(unit)], axis=-1)
    ax.add_collection(
        LineCollection(lines.swapaxes(0, 1), gid="outlines", **line), autolim=False
    )
