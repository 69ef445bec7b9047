# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The epochs one after the other, with their moving SSPs."""

from pathlib import Path

import astropy.units as u
import numpy as np

from astro_scc.visualization.drawing import (
    brightness_label,
    date_of,
    draw_beam,
    draw_image,
    image_limits,
    label_offsets,
    longest,
    plotting_norm,
    ticks_of,
)
from astro_scc.visualization.images import LEGEND, epoch_figsize
from astro_scc.visualization.patterns import draw_ssps, ssp_points
from astro_scc.visualization.style import (
    ORANGE,
    add_colorbar,
    figure_and_axes,
    offset_unit,
)

__all__ = ["animate_epochs", "write_animation"]

#: What writes which files, by their ending.
WRITERS = {".gif": "pillow", ".mp4": "ffmpeg"}


def animate_epochs(
    cube,
    ssps=None,
    *,
    n_frames=None,
    trail=3,
    interval=400 * u.ms,
    ax=None,
    unit=None,
    stretch="asinh",
    zoom=True,
):
    """
    Show the epochs one after the other, with their SSPs.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    ssps : `~astropy.table.QTable` or `~astro_scc.decomposition.SSPs`, optional
        As in `plot_epoch`.
    n_frames : int, optional
        By default a frame an epoch.  With a number, so many frames at equal
        steps of time, each of the last epoch before it: motion then looks as
        fast as it is, and gaps between the epochs as long.
    trail : int, optional
        Dots show where SSPs were in so many epochs before.
    interval : `~astropy.units.Quantity`, optional
        Time between frames.
    ax : `matplotlib.axes.Axes`, optional
        Drawn on these instead of a new figure.
    unit, stretch, zoom
        As in `plot_epoch`.

    Returns
    -------
    `matplotlib.animation.FuncAnimation`
        To be kept in a variable.  In a notebook,
        ``IPython.display.HTML(animation.to_jshtml())`` plays it;
        `write_animation` saves it.

    Raises
    ------
    ValueError
        If ``n_frames`` is below 1, ``trail`` negative, the interval not
        positive, the stretch unknown, or the unit no angle.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_static
    >>> from astro_scc.visualization import animate_epochs, write_animation
    >>> cube = simulate_static(n_epochs=2, rng=1).cube
    >>> animation = animate_epochs(cube)
    >>> write_animation(animation, "jet.gif").name
    'jet.gif'
    """
    from matplotlib.animation import FuncAnimation
    from matplotlib.lines import Line2D

    if trail < 0:
        raise ValueError(f"trail must be at least 0, got {trail}")
    wait = u.Quantity(interval).to_value(u.ms)
    if not wait > 0:
        raise ValueError(f"interval must be positive, got {interval}")
    shown = _epochs_shown(cube, n_frames)
    points = ssp_points(cube, ssps)
    limits = image_limits(cube, points if zoom else None)
    unit = offset_unit(longest(limits), unit)
    images = np.ma.masked_array(cube.data, cube.mask)
    norm = plotting_norm(cube, images, stretch=stretch)
    figure, ax = figure_and_axes(ax, epoch_figsize(limits))
    picture = draw_image(ax, cube, images[shown[0]], norm, unit, limits)
    label_offsets(ax, cube, unit)
    add_colorbar(ax, picture, brightness_label(cube.unit), ticks_of(norm))
    # Laid out with a title and a legend, the same in all frames.
    handles = [] if points is None else draw_ssps(ax, cube, ssps, points, -1, unit)
    if handles and trail:
        dot = {"linestyle": "", "marker": "o", "markersize": 2.5, "color": ORANGE}
        handles.append(Line2D([], [], label="before", **dot))
    if handles:
        ax.legend(
            handles=handles, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=9,
            **LEGEND,
        )  # fmt: skip
    title = ax.set_title(date_of(cube, shown[0]), pad=22.0 if handles else None)
    drawn = []

    def draw(index):
        while drawn:
            drawn.pop().remove()
        picture.set_data(images[index])
        title.set_text(date_of(cube, index))
        before = {id(artist) for artist in ax.get_children()}
        if cube.beams is not None:
            draw_beam(ax, cube.beams[index], unit, limits)
        if points is not None:
            _draw_trail(ax, points, index, trail, unit)
            draw_ssps(ax, cube, ssps, points, index, unit)
        drawn.extend(a for a in ax.get_children() if id(a) not in before)
        return [picture, title, *drawn]

    return FuncAnimation(
        figure,
        draw,
        frames=shown,
        init_func=lambda: draw(shown[0]),
        interval=wait,
        cache_frame_data=False,
    )


def write_animation(animation, path, *, fps=None, dpi=100, overwrite=False):
    """
    Save an animation as GIF or MP4.

    Parameters
    ----------
    animation : `matplotlib.animation.FuncAnimation`
        Of `animate_epochs`.
    path : path
        Its ending says what is written: ``.gif``, or ``.mp4`` where the
        program ``ffmpeg`` is found.
    fps : float, optional
        Frames a second, by default those of the animation.
    dpi : float, optional
        Pixels an inch; a figure is six inches wide.
    overwrite : bool, optional
        Replace a file that exists.

    Returns
    -------
    `~pathlib.Path`

    Raises
    ------
    ValueError
        If the ending is neither ``.gif`` nor ``.mp4``.
    OSError
        If the file exists and ``overwrite`` is False, cannot be written, or
        there is no ``ffmpeg``.

    Examples
    --------
    >>> from astro_scc.simulation import simulate_static
    >>> from astro_scc.visualization import animate_epochs, write_animation
    >>> animation = animate_epochs(simulate_static(n_epochs=2, rng=1).cube)
    >>> write_animation(animation, "jet.gif", dpi=40).name
    'jet.gif'
    """
    from matplotlib.animation import writers

    from astro_scc.partial import replace_when_complete

    path = Path(path)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise ValueError(f"{path}: animations are written as .gif or .mp4")
    if not writers.is_available(writer):
        raise OSError(
            f"{path}: the program {writer} is not found; install it, or write a .gif"
        )
    with replace_when_complete(path, overwrite=overwrite) as part:
        animation.save(part, writer=writer, fps=fps, dpi=dpi)
    return path


def _epochs_shown(cube, n_frames):
    """Index of the epoch in each frame."""
    if n_frames is None:
        return list(range(len(cube)))
    if n_frames < 1:
        raise ValueError(f"n_frames must be at least 1, got {n_frames}")
    years = cube.years.value
    # Rounding must not put the last frame before the last epoch.
    dates = np.linspace(0.0, years[-1], n_frames) + 1e-9
    return (np.searchsorted(years, dates, side="right") - 1).tolist()


def _draw_trail(ax, points, index, trail, unit):
    past = points["used"] & (points["epoch"] < index)
    past &= points["epoch"] >= index - trail
    if not past.any():
        return
    ax.scatter(
        points["east"][past] * u.mas.to(unit),
        points["north"][past] * u.mas.to(unit),
        s=4.0,
        color=ORANGE,
        # The older, the paler.
        alpha=1 - (index - points["epoch"][past]) / (trail + 1),
        linewidths=0,
        gid="trail",
    )
