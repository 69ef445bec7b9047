# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features that were followed from epoch to epoch."""

import astropy.units as u
import numpy as np

from astro_scc.decomposition import scale_size
from astro_scc.visualization.drawing import (
    columns_of,
    draw_beam,
    draw_image,
    image_limits,
    label_panels,
    longest,
    panels_size,
    plotting_norm,
)
from astro_scc.visualization.patterns import ssp_points
from astro_scc.visualization.style import (
    BLACK,
    BLUE,
    ORANGE,
    PM_UNIT,
    VERMILLION,
    WIDTH,
    add_speed_axis,
    figure_and_axes,
    new_figure,
    offset_unit,
    outline,
    scale_colors,
    unit_name,
)

__all__ = ["plot_separation", "plot_track_profile", "plot_tracks"]


def plot_separation(tracking, *, figure=None, unit=None, min_epochs=None):
    """
    Draw the distances of tracked features against time, with their fits.

    A panel a scale.  Solid lines are the straight fits, dashed ones the
    accelerated fits where these count; dotted ones lead back to the ejection
    epoch.

    Parameters
    ----------
    tracking : `~astro_scc.tracking.Tracking`
    figure : `matplotlib.figure.Figure`, optional
        Drawn on this one instead of a new figure.
    unit : `~astropy.units.Unit`, optional
        Of the distances.
    min_epochs : int, optional
        Tracks of fewer epochs are not drawn.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is no angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import FeatureTracker
    >>> from astro_scc.visualization import plot_separation
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> decompositions = [Decomposer(scales=[1, 2])(image) for image in cube.data]
    >>> tracking = FeatureTracker(max_speed=36 * u.mas / u.yr)(cube, decompositions)
    >>> figure = plot_separation(tracking)
    >>> figure.axes[-1].get_xlabel()
    'Year'
    """
    numbers = _shown(tracking, min_epochs)
    scales = _scales(tracking)
    colors = scale_colors(scales)
    if figure is None:
        figure = new_figure((WIDTH, max(1.0 + 1.9 * len(scales), 2.8)))
    axes = figure.subplots(len(scales), 1, sharex=True, sharey=True, squeeze=False)
    start = tracking.cube.times[0].jyear
    years = tracking.cube.years.to_value(u.yr)
    distance = np.hypot(*tracking.offsets)
    tracked = distance[tracking.track >= 0]
    unit = offset_unit(tracked.max(initial=1.0), unit)
    factor = u.mas.to(unit)
    table = tracking.tracks
    for ax, scale in zip(axes[:, 0], scales, strict=True):
        own = [n for n in numbers if table["scale"][n] == scale]
        for number in own:
            ssps = tracking.members(number)
            time = years[tracking.ssps.epoch[ssps]]
            ax.plot(
                start + time, distance[ssps] * factor, "o", color=colors[scale],
                markersize=3, markeredgewidth=0,
            )  # fmt: skip
            _draw_fits(ax, tracking, number, time, start, factor)
        _name_panel(ax, tracking.cube, scale, unit, len(own))
        # Room for the name above the features.
        ax.set_ylim(0, 1.15 * factor * tracked.max(initial=0.0) or 1.0)
        ax.set_ylabel(f"Distance from the core ({unit_name(unit)})")
    margin = 0.03 * (np.ptp(years) or 1.0)
    axes[-1, 0].set_xlim(start - margin, start + years[-1] + margin)
    axes[-1, 0].set_xlabel("Year")
    axes[-1, 0].ticklabel_format(axis="x", useOffset=False)
    if len(scales) > 1:
        for ax in axes[:, 0]:
            ax.set_ylabel("")
        figure.supylabel(
            f"Distance from the core ({unit_name(unit)})", fontsize="medium"
        )
    return figure


def _draw_fits(ax, tracking, number, time, start, factor):
    fit = tracking.fits[number]
    ends = np.linspace(time[0], time[-1], 50)
    line = {"color": BLACK, "linewidth": 0.8}
    ax.plot(start + ends, factor * np.hypot(*fit.at(ends)), "-", **line)
    row = tracking.tracks[number]
    if row["accelerated"]:
        curve = tracking.accelerated_fits[number].at(ends)
        ax.plot(start + ends, factor * np.hypot(*curve), "--", **line)
    if not np.any(row["t_ej"].mask):
        born = row["t_ej"].unmasked.value - start
        if born < time[0]:
            before = np.linspace(born, time[0], 20)
            ax.plot(start + before, factor * np.hypot(*fit.at(before)), ":", **line)


def plot_tracks(tracking, *, figure=None, unit=None, min_epochs=None):
    """
    Draw the tracks over the mean image, a panel a scale.

    Each track is a line through the positions of its feature, with a dot
    an epoch and an arrow head at the last one.

    Parameters
    ----------
    tracking : `~astro_scc.tracking.Tracking`
    figure : `matplotlib.figure.Figure`, optional
        Drawn on this one instead of a new figure.
    unit : `~astropy.units.Unit`, optional
        Of the offsets.
    min_epochs : int, optional
        Tracks of fewer epochs are not drawn.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is no angle.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import FeatureTracker
    >>> from astro_scc.visualization import plot_tracks
    >>> cube = simulate_two_fluid(n_epochs=5, rng=1).cube
    >>> decompositions = [Decomposer(scales=[1, 2])(image) for image in cube.data]
    >>> tracking = FeatureTracker(max_speed=36 * u.mas / u.yr)(cube, decompositions)
    >>> len(plot_tracks(tracking).axes)
    2
    """
    numbers, scales = _shown(tracking, min_epochs), _scales(tracking)
    colors, cube = scale_colors(scales), tracking.cube
    limits = image_limits(cube, ssp_points(cube, tracking.ssps))
    unit = offset_unit(longest(limits), unit)
    factor = u.mas.to(unit)
    mean = cube.mean_image()
    image = np.ma.masked_array(mean.data, mean.mask)
    norm = plotting_norm(cube, image)
    columns = columns_of(len(scales), limits, figure)
    rows = -(-len(scales) // columns)
    if figure is None:
        figure = new_figure(panels_size(rows, columns, limits, aside=0.6))
    axes = figure.subplots(
        rows, columns, sharex=True, sharey=True, squeeze=False
    ).ravel()
    table = tracking.tracks
    for ax, scale in zip(axes, scales, strict=False):
        # Pale, so that the tracks stand out.
        draw_image(ax, cube, image, norm, unit, limits).set_alpha(0.5)
        if cube.beams is not None and all(b == cube.beams[0] for b in cube.beams):
            draw_beam(ax, cube.beams[0], unit, limits)
        own = [n for n in numbers if table["scale"][n] == scale]
        for number in own:
            east, north = factor * tracking.offsets[:, tracking.members(number)]
            ax.plot(
                east, north, "-o", color=colors[scale], linewidth=0.9,
                markersize=2, markeredgewidth=0,
            )  # fmt: skip
            ax.annotate(
                "", (east[-1], north[-1]), (east[-2], north[-2]),
                arrowprops={"arrowstyle": "-|>", "color": colors[scale],
                            "linewidth": 0.9, "shrinkA": 0, "shrinkB": 0,
                            "mutation_scale": 7},
                annotation_clip=True,
            )  # fmt: skip
        _name_panel(ax, cube, scale, unit, len(own))
    for ax in axes[len(scales) :]:
        ax.set_axis_off()
    label_panels(figure, cube, unit)
    return figure


def plot_track_profile(profile, *, stack=None, beta_per_pm=None, ax=None):
    """
    Draw the speed of tracks against distance, and that of the stack over it.

    Parameters
    ----------
    profile : `~astropy.table.QTable`
        As `~astro_scc.tracking.Tracking.profile` gives it.
    stack : `~astropy.table.QTable`, optional
        What stacked cross-correlation gives: columns ``r_mid``,
        ``pm_parallel``, ``pm_parallel_err`` and, for bars, ``r_min`` and
        ``r_max``.
    beta_per_pm : float, optional
        Apparent speed in units of c of 1 mas/yr, for a second axis.
    ax : `matplotlib.axes.Axes`, optional
        Drawn on these instead of a new figure.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If ``stack`` lacks a column, or ``beta_per_pm`` is not positive.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> from astro_scc.visualization import plot_track_profile
    >>> pm = u.mas / u.yr
    >>> profile = QTable({"r": [1, 2] * u.mas, "speed": [1.0, 1.2] * pm,
    ...                   "speed_err": [0.1, 0.1] * pm, "n_tracks": [3, 4]})
    >>> figure = plot_track_profile(profile)
    >>> figure.axes[0].get_xlabel()
    'Distance from the core (mas)'
    """
    figure, ax = figure_and_axes(ax, (WIDTH, 3.4))
    unit = offset_unit(profile["r"].to_value(u.mas).max(initial=1.0))
    r = profile["r"].to_value(unit)
    speed, error = (profile[n].to_value(PM_UNIT) for n in ("speed", "speed_err"))
    ax.fill_between(r, speed - error, speed + error, color=ORANGE, alpha=0.3, lw=0)
    ax.plot(r, speed, "o-", color=ORANGE, markersize=4, label="tracks")
    if stack is not None:
        wanted = ("r_mid", "pm_parallel", "pm_parallel_err")
        missing = [name for name in wanted if name not in stack.colnames]
        if missing:
            raise ValueError(f"the profile of the stack has no {', '.join(missing)}")
        middle = stack["r_mid"].to_value(unit)
        bars = None
        if "r_min" in stack.colnames and "r_max" in stack.colnames:
            ends = [stack[name].to_value(unit) for name in ("r_min", "r_max")]
            bars = np.abs(np.stack(ends) - middle)
        ax.errorbar(
            middle, stack["pm_parallel"].to_value(PM_UNIT),
            stack["pm_parallel_err"].to_value(PM_UNIT), bars,
            fmt="s", color=BLUE, markersize=4, linewidth=1, label="stack",
        )  # fmt: skip
    ax.legend(fontsize="small", frameon=False)
    ax.set_xlabel(f"Distance from the core ({unit_name(unit)})")
    ax.set_ylabel(f"Speed ({unit_name(PM_UNIT)})")
    if beta_per_pm is not None:
        add_speed_axis(ax, PM_UNIT, beta_per_pm, "right")
    return figure


def _shown(tracking, min_epochs):
    counts = np.asarray(tracking.tracks["n_epochs"])
    return np.flatnonzero(counts >= (min_epochs or 0)).tolist()


def _scales(tracking):
    """The scales of all SSPs, those without a track too; one at least."""
    return np.unique(tracking.ssps.scale).tolist() or [1.0]


def _name_panel(ax, cube, scale, unit, number):
    angle = (scale_size(scale) * cube.pixel_scale).to_value(unit)
    tracks = "track" if number == 1 else "tracks"
    ax.text(
        0.02, 0.95,
        f"scale {scale:g} ({angle:.3g} {unit_name(unit)}), {number} {tracks}",
        transform=ax.transAxes, va="top", fontsize="small",
        color=BLACK if number else VERMILLION, path_effects=outline(),
    )  # fmt: skip
