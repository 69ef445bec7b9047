# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""When the epochs are, and which of them are compared."""

import astropy.units as u
import numpy as np

from astro_scc.visualization.style import BLACK, BLUE, WIDTH, figure_and_axes

__all__ = ["plot_intervals"]


def plot_intervals(cube, pairs=None, *, ax=None):
    """
    Draw the dates of the epochs, and the pairs of them that are compared.

    Each pair is a bar from its first date to its second, as high as the time
    between them: speeds come from motion over these times.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    pairs : `~astro_scc.stacking.DatePairs`, optional
        By default consecutive epochs; ``result.pairs`` of a measurement.
    ax : `matplotlib.axes.Axes`, optional
        Drawn on these instead of a new figure.

    Returns
    -------
    `matplotlib.figure.Figure`

    Examples
    --------
    >>> from astro_scc.simulation import simulate_static
    >>> from astro_scc.visualization import plot_intervals
    >>> figure = plot_intervals(simulate_static(n_epochs=5, rng=1).cube)
    >>> figure.axes[0].get_ylabel()
    'Time between epochs (d)'
    """
    from matplotlib.collections import LineCollection
    from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

    if pairs is None:
        from astro_scc.stacking import consecutive_pairs

        pairs = consecutive_pairs(cube.years.to_value(u.yr))
    figure, ax = figure_and_axes(ax, (WIDTH, 2.6))
    interval = pairs.interval * u.yr
    unit = u.yr
    if len(pairs):
        longest = interval.max()
        unit = next((v for v in (u.yr, u.day, u.hour) if longest >= 1 * v), u.min)
    height = interval.to_value(unit)
    dates = cube.times.plot_date
    ends = np.stack(
        [
            np.stack([dates[pairs.first], height], axis=-1),
            np.stack([dates[pairs.second], height], axis=-1),
        ],
        axis=1,
    )
    many = len(pairs) > 60
    ax.add_collection(
        LineCollection(
            ends, colors=BLUE, linewidths=0.8 if many else 1.8,
            alpha=0.4 if many else 0.9, gid="pairs",
        ),
        autolim=False,
    )  # fmt: skip
    if not many:
        ax.plot(ends[..., 0], ends[..., 1], "o", color=BLUE, markersize=3)
    top = 1.15 * height.max(initial=0.0) or 1.0
    ax.vlines(dates, -0.12 * top, -0.02 * top, color=BLACK, linewidth=1.2)
    ax.axhline(0, color=BLACK, linewidth=0.6)
    ax.set_ylim(-0.14 * top, top)
    margin = 0.03 * np.ptp(dates) or 1.0
    ax.set_xlim(dates[0] - margin, dates[-1] + margin)
    locator = AutoDateLocator(minticks=3, maxticks=8)
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    ax.set_xlabel("Date of observation")
    ax.set_ylabel(f"Time between epochs ({unit})")
    return figure
