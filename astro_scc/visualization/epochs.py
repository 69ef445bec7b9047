# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Figures of the epochs with their SSPs, and a figure of dates."""

import astropy.units as u
import numpy as np

from astro_scc.images.series import epoch_index
from astro_scc.stacking.velocities import consecutive_pairs
from astro_scc.visualization import drawing, style

LEGEND = {"fontsize": "small", "frameon": False, "columnspacing": 1.0}
LEGEND |= {"handletextpad": 0.3, "borderaxespad": 0.2, "ncols": 9}


def plot_epoch(cube, epoch, ssps=None, *, ax=None, colorbar=True, **view):
    """
    Draw one epoch in offsets from the reference pixel, east to the left.

    Solar images have west to the right.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    epoch : int
        Index of the epoch.
    ssps : `~astropy.table.QTable` or `~astro_scc.decomposition.SSPs`, optional
        The SSPs of all epochs: a table (``result.ssps``) is drawn as
        circles, larger for larger scales and pale if the SSP is outside the
        region that was measured; a catalogue (``result.matched.ssps``) is
        drawn as outlines.
    ax : `matplotlib.axes.Axes`, optional
        Axes to draw on instead of a new figure.
    unit : `~astropy.units.Unit`, optional
        Unit of the offsets.
    stretch : {"asinh", "log", "linear"}
        "asinh" is linear up to three times the noise and logarithmic above.
    vmin, vmax : float, optional
        Brightness at the ends of the colours, in the unit of the cube.
    zoom : bool, optional
        Show only the part of the image that holds SSPs, except the outermost,
        which may be noise.
    colorbar : bool, optional

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the stretch is unknown, or the unit is not an angle.
    IndexError
        If there is no such epoch.
    """
    index = epoch_index(epoch, len(cube))
    image = np.ma.masked_array(cube.data[index], cube.mask[index])
    view = drawing.View(cube, ssps, image, epochs=[index], **view)
    width, height = np.ptp(view.limits, axis=1)
    height = float(np.clip(4.6 * height / width + 1.0, 2.4, 8.0))
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, height))
    drawn = drawing.draw_image(ax, view, image, index)
    drawing.draw_ssps(ax, view, ssps, index)
    _label_masked(ax, view, image.mask)
    handles, _ = ax.get_legend_handles_labels()
    ax.set_title(drawing.epoch_names(cube.times)[index], pad=22.0 if handles else None)
    ax.set(xlabel=view.labels[0], ylabel=view.labels[1])
    if handles:
        # The date is above the line with the legend.
        place = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0)}
        ax.legend(markerscale=0.8, **place, **LEGEND)
    if colorbar:
        view.add_colorbar(drawn, cax=style.beside(ax))
    return figure


def plot_epochs(cube, ssps=None, *, figure=None, max_panels=12, **view):
    """
    Draw up to ``max_panels`` epochs, evenly selected, with the same colours.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    ssps : `~astropy.table.QTable` or `~astro_scc.decomposition.SSPs`, optional
        As in `plot_epoch`.
    figure : `matplotlib.figure.Figure`, optional
        Figure to draw on instead of a new one.
    max_panels : int, optional
        If there are more epochs, the first, the last and others evenly between
        them are drawn.
    **view
        ``unit``, ``stretch``, ``vmin``, ``vmax`` and ``zoom``, see `plot_epoch`.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If ``max_panels`` is below 1, the stretch is unknown, or the unit is
        not an angle.
    """
    if max_panels < 1:
        raise ValueError(f"max_panels must be at least 1, got {max_panels}")
    n = len(cube)
    chosen = np.unique(np.rint(np.linspace(0, n - 1, min(n, max_panels))).astype(int))
    images = np.ma.masked_array(cube.data[chosen], cube.mask[chosen])
    view = drawing.View(cube, ssps, images, epochs=chosen, **view)
    figure, axes = drawing.image_panels(view, len(chosen), figure, aside=1.4, above=0.4)
    dates = drawing.epoch_names(cube.times)
    of_beam, of_date, *_ = drawing.empty_corners(view, images.max(axis=0))
    for ax, index, image in zip(axes, chosen, images, strict=True):
        drawn = drawing.draw_image(ax, view, image, index, of_beam)
        drawing.draw_ssps(ax, view, ssps, index, size=0.5)
        drawing.panel_text(ax, dates[index], of_date)
    view.add_colorbar(drawn, ax=figure.axes, pad=0.02, aspect=40)
    _label_masked(ax, view, images.mask.any(axis=0))
    handles, _ = ax.get_legend_handles_labels()
    if handles:
        place = {"loc": "outside upper center", "markerscale": 1.6}
        figure.legend(handles=handles, **place, **LEGEND)
    return figure


def plot_intervals(cube, pairs=None, *, ax=None):
    """
    Draw the dates of the epochs, and the pairs of epochs that are compared.

    Each pair is a bar from its first to its second date, drawn at the height of
    the interval between them, over which motion is measured.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    pairs : ``DatePairs``, optional
        For example ``result.pairs``; by default consecutive epochs.
    ax : `matplotlib.axes.Axes`, optional
        Axes to draw on instead of a new figure.

    Returns
    -------
    `matplotlib.figure.Figure`
    """
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    if pairs is None:
        pairs = consecutive_pairs(cube.years.to_value(u.yr))
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 2.6))
    longest = pairs.interval.max(initial=0.0) or 1.0
    unit = next((v for v in (u.yr, u.d, u.h) if longest >= v.to(u.yr)), u.min)
    height = u.yr.to(unit, pairs.interval)
    dates = cube.times.plot_date
    first, second = dates[pairs.first], dates[pairs.second]
    many = len(pairs) > 60
    width, alpha = (0.8, 0.4) if many else (1.8, 0.9)
    bar = {"colors": style.BLUE, "linewidths": width, "alpha": alpha}
    ax.hlines(height, first, second, gid="pairs", **bar)
    if not many:
        ends = np.stack([first, second])
        ax.plot(ends, [height, height], "o", color=style.BLUE, markersize=3)
    top = 1.15 * height.max(initial=0.0) or 1.0
    ax.vlines(dates, -0.12 * top, -0.02 * top, color=style.BLACK, linewidth=1.2)
    ax.axhline(0, color=style.BLACK, linewidth=0.6)
    ax.set_ylim(-0.14 * top, top)
    margin = 0.03 * np.ptp(dates) or 1.0
    ax.set_xlim(dates[0] - margin, dates[-1] + margin)
    locator = AutoDateLocator(minticks=3, maxticks=8)
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    ax.set(xlabel="Date of observation", ylabel=f"Time between epochs ({unit})")
    return figure


def _label_masked(ax, view, mask):
    """Give masked pixels a label for the legend, if any is seen."""
    row, column = np.nonzero(mask)
    offset = u.Quantity(view.cube.pixel_to_offset(column, row)).to_value(view.unit)
    low, high = view.limits.T[..., None]
    if np.any(np.all((offset > low) & (offset < high), axis=0)):
        ax.fill([], [], color=drawing.MASKED, label="masked")
