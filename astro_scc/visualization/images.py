# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Pictures of the epochs and of their SSPs."""

import operator

import numpy as np

from astro_scc.visualization.drawing import (
    MASKED,
    brightness_label,
    columns_of,
    date_of,
    draw_beam,
    draw_image,
    image_limits,
    label_offsets,
    label_panels,
    lengths,
    longest,
    panels_size,
    plotting_norm,
    ticks_of,
)
from astro_scc.visualization.patterns import draw_ssps, ssp_points
from astro_scc.visualization.style import (
    WIDTH,
    add_colorbar,
    figure_and_axes,
    new_figure,
    offset_unit,
    outline,
    set_ticks,
)

__all__ = ["plot_epoch", "plot_epochs"]

LEGEND = {
    "fontsize": "small",
    "frameon": False,
    "columnspacing": 1.0,
    "handletextpad": 0.3,
    "borderaxespad": 0.2,
}


def plot_epoch(
    cube,
    epoch,
    ssps=None,
    *,
    ax=None,
    unit=None,
    stretch="asinh",
    vmin=None,
    vmax=None,
    zoom=True,
    colorbar=True,
):
    """
    Draw one epoch in offsets from the reference pixel, east to the left.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    epoch : int
        Index of the epoch.
    ssps : `~astropy.table.QTable` or `~astro_scc.decomposition.SSPs`, optional
        The SSPs of all epochs: a table (``result.ssps``) is drawn as
        circles, larger for larger scales and pale where the SSP is outside
        the region that was measured; a catalogue
        (``result.matched.ssps``) as the outlines of the SSPs.
    ax : `matplotlib.axes.Axes`, optional
        Drawn on these instead of a new figure.
    unit : `~astropy.units.Unit`, optional
        Of the offsets.
    stretch : {"asinh", "log", "linear"}
        Asinh is linear up to three times the noise and logarithmic above.
    vmin, vmax : float, optional
        Brightness at the ends of the colours, in the unit of the cube.
    zoom : bool, optional
        Show the part of the image that holds SSPs (but for the
        outermost, which may be noise), not all of it.
    colorbar : bool, optional

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the stretch is unknown, or the unit no angle.
    IndexError
        If there is no such epoch.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_static
    >>> from astro_scc.visualization import plot_epoch
    >>> cube = simulate_static(n_epochs=2, rng=1).cube
    >>> figure = plot_epoch(cube, 0)
    >>> figure.axes[0].get_xlabel()
    'Offset to the east (mas)'
    """
    index = _epoch_index(cube, epoch)
    points = ssp_points(cube, ssps)
    limits = image_limits(cube, points if zoom else None)
    unit = offset_unit(longest(limits), unit)
    figure, ax = figure_and_axes(ax, epoch_figsize(limits))
    image = np.ma.masked_array(cube.data[index], cube.mask[index])
    norm = plotting_norm(cube, image, [index], stretch, vmin, vmax)
    drawn = draw_image(ax, cube, image, norm, unit, limits)
    if cube.beams is not None:
        draw_beam(ax, cube.beams[index], unit, limits)
    handles = _masked_handle(cube, image.mask, limits)
    if points is not None:
        handles = draw_ssps(ax, cube, ssps, points, index, unit) + handles
    label_offsets(ax, cube, unit)
    # The legend is a line between the axes and the title.
    ax.set_title(date_of(cube, index), pad=22.0 if handles else None)
    if handles:
        ax.legend(
            handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=9,
            **LEGEND,
        )  # fmt: skip
    if colorbar:
        add_colorbar(ax, drawn, brightness_label(cube.unit), ticks_of(norm))
    return figure


def plot_epochs(
    cube,
    ssps=None,
    *,
    figure=None,
    max_panels=12,
    unit=None,
    stretch="asinh",
    vmin=None,
    vmax=None,
    zoom=True,
):
    """
    Draw all epochs with the same colours, or some of them evenly chosen.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    ssps : `~astropy.table.QTable` or `~astro_scc.decomposition.SSPs`, optional
        As in `plot_epoch`.
    figure : `matplotlib.figure.Figure`, optional
        Drawn on this one instead of a new figure.
    max_panels : int, optional
        Of more epochs than these, the first, the last and others evenly
        between them are drawn.
    unit, stretch, vmin, vmax, zoom
        As in `plot_epoch`.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If ``max_panels`` is below 1, the stretch is unknown, or the unit no
        angle.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_static
    >>> from astro_scc.visualization import plot_epochs
    >>> cube = simulate_static(n_epochs=5, rng=1).cube
    >>> figure = plot_epochs(cube, max_panels=4)
    """
    if max_panels < 1:
        raise ValueError(f"max_panels must be at least 1, got {max_panels}")
    n = len(cube)
    chosen = np.unique(np.rint(np.linspace(0, n - 1, min(n, max_panels))).astype(int))
    points = ssp_points(cube, ssps)
    limits = image_limits(cube, points if zoom else None)
    unit = offset_unit(longest(limits), unit)
    images = np.ma.masked_array(cube.data[chosen], cube.mask[chosen])
    norm = plotting_norm(cube, images, chosen, stretch, vmin, vmax)
    columns = columns_of(len(chosen), limits, figure)
    rows = -(-len(chosen) // columns)
    if figure is None:
        figure = new_figure(panels_size(rows, columns, limits, aside=1.4, above=0.4))
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    handles, masked = [], _masked_handle(cube, images.mask.any(axis=0), limits)
    for ax, index, image in zip(grid.flat, chosen, images, strict=False):
        drawn = draw_image(ax, cube, image, norm, unit, limits)
        if cube.beams is not None:
            draw_beam(ax, cube.beams[index], unit, limits)
        if points is not None:
            handles = draw_ssps(ax, cube, ssps, points, index, unit, size=0.5)
        ax.text(
            0.03, 0.96, date_of(cube, index), transform=ax.transAxes, va="top",
            fontsize="small", path_effects=outline(),
        )  # fmt: skip
    for ax in grid.flat[len(chosen) :]:
        ax.set_axis_off()
    for k in range(len(chosen) - columns, len(chosen)):
        # Shared axes hide their ticks all but in the last row.
        grid.flat[max(k, 0)].tick_params(labelbottom=True)
    label_panels(figure, cube, unit)
    label = brightness_label(cube.unit)
    bar = figure.colorbar(drawn, ax=list(grid.flat), label=label, pad=0.02, aspect=40)
    set_ticks(bar, ticks_of(norm))
    if handles + masked:
        figure.legend(
            handles=handles + masked, loc="outside upper center", ncols=9, **LEGEND
        )
    return figure


def _masked_handle(cube, mask, limits):
    """What the colour of masked pixels means, if some are seen."""
    from matplotlib.patches import Patch

    row, column = np.nonzero(mask)
    offset = np.stack(cube.pixel_to_offset(column, row), axis=-1).value
    seen = np.all((offset > limits[:, 0]) & (offset < limits[:, 1]), axis=1)
    return [Patch(color=MASKED, label="masked")] if seen.any() else []


def epoch_figsize(limits):
    """Size of a figure of one image, for a range of offsets."""
    width, height = lengths(limits)
    return WIDTH, float(np.clip(4.6 * height / width + 1.0, 2.4, 8.0))


def _epoch_index(cube, epoch):
    index = operator.index(epoch)
    if not -len(cube) <= index < len(cube):
        raise IndexError(f"epoch {index} of a cube with {len(cube)} epochs")
    return index % len(cube)
