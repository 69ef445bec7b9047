# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speeds of features: of a measurement, of other choices of the data, of a survey."""

from textwrap import fill

import astropy.units as u
import numpy as np

from astro_scc.features.trust import MOST_FALSE
from astro_scc.units import offset_unit, unit_name
from astro_scc.visualization import style
from astro_scc.visualization.tracks import feature_look

#: Errors beyond so many times the median one are of features that say little.
LARGE_ERROR = 4.0
#: Most letters of a label beside a figure in one line.
LABEL = 30
#: What differs from zero by so many standard errors is not zero.
SIGNIFICANT = 3.0
#: Fewest epochs of a feature whose acceleration is judged, or that stands still.
EPOCHS = 10
BINS = 20


def plot_feature_speeds(
    result, *, profile=None, beta_per_pm=None, component=None, ax=None
):
    """
    Draw the radial speed of each feature against its separation from the core.

    Features have the colours of their streams; those that are not secure are pale.
    """
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 3.4))
    table = result.features
    component = table["component"] if component is None else component
    separation = table["separation"].to_value(u.mas)
    unit = offset_unit(separation.max(initial=1.0))
    speed, error = (table[k].value for k in ("pm_radial", "pm_radial_err"))
    speeds = table["pm"].unit
    if len(error):
        error = np.minimum(error, LARGE_ERROR * np.median(error))
    for k, place in enumerate(separation * u.mas.to(unit)):
        look = feature_look(result.tracked_features, k, component)
        look |= {"ms": 4, "lw": 0.8, "linestyle": "", "marker": "o"}
        ax.errorbar(place, speed[k], error[k], **look)
    if profile is not None and len(profile):
        look = {"fmt": "none", "color": style.BLACK, "elinewidth": 1.6, "zorder": 3}
        look["label"] = "mean of bin"
        style.draw_bins(ax, profile, "pm_parallel", unit, speeds, **look)
    ax.axhline(0, color=style.GREY, lw=0.6, zorder=0)
    ax.set_xlim(left=0)
    ax.set_xlabel(f"Core separation ({unit_name(unit)})")
    ax.set_ylabel(f"Radial proper motion ({unit_name(speeds)})")
    style.legend_above(ax)
    style.add_speed_axis(ax, speeds, beta_per_pm, "right")
    return figure


def plot_sensitivity(table, *, beta_per_pm=None, ax=None):
    """
    Draw the main speed with other choices of the data, beside that as measured.

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
    ax.axvspan(
        speed[0] - error[0], speed[0] + error[0], color=style.GREY, alpha=0.2, lw=0
    )
    ax.axvline(speed[0], color=style.GREY, lw=0.8)
    row, large = np.arange(len(table)), np.asarray(table["significant"])
    looks = (~large, style.BLUE, "o"), (large, style.VERMILION, "s")
    for own, color, marker in looks:
        if own.any():
            look = {"fmt": marker, "color": color, "ms": 4, "lw": 1}
            ax.errorbar(speed[own], row[own], xerr=error[own], **look)
    ax.set_yticks(row, [fill(str(text), LABEL) for text in table["choice"]])
    ax.tick_params(axis="y", labelsize="small", length=0)
    ax.set_ylim(len(table) - 0.5, -0.5)
    ax.set_xlabel(f"Proper motion ({unit_name(unit)})")
    style.add_speed_axis(ax, unit, beta_per_pm)
    return figure


# -- of many sources -----------------------------------------------------------------


def population(features):
    """
    Return which features of many sources show what.

    Parameters
    ----------
    features : `~astropy.table.QTable`
        ``features.ecsv`` of a survey.

    Returns
    -------
    dict of `~numpy.ndarray` of bool, shape (n,)
        ``moving``, secure and faster than three standard errors; of these ``inward``
        and, in at least ten epochs, ``judged``; of the latter ``accelerated``, by
        three standard errors.  ``at rest`` are features of
        at least ten epochs that are false with a probability of at most 0.3 and slower
        than three standard errors; secure ones have moved by a beam.

    Examples
    --------
    >>> from astropy.table import QTable
    >>> from astro_scc.visualization.speeds import population
    >>> population(QTable())["moving"].sum()
    np.int64(0)
    """
    if len(features) == 0:
        names = ("moving", "at rest", "inward", "judged", "accelerated")
        return dict.fromkeys(names, np.zeros(0, dtype=bool))

    def ratio(name):
        value, error = (_plain(features[k]) for k in (name, f"{name}_err"))
        return value / error

    speed, radial = ratio("pm"), ratio("pm_radial")
    change = [np.abs(ratio(f"acc_{k}")) for k in ("parallel", "perpendicular")]
    moving = np.asarray(features["secure"], dtype=bool) & (speed >= SIGNIFICANT)
    often = np.asarray(features["n_epochs"]) >= EPOCHS
    true = np.asarray(features["p_false"]) <= MOST_FALSE
    judged = moving & often
    return {
        "moving": moving,
        "at rest": often & true & (speed < SIGNIFICANT),
        "inward": moving & (radial <= -SIGNIFICANT),
        "judged": judged,
        # Only of those whose motion is better described so is it measured.
        "accelerated": judged & (np.max(change, axis=0) >= SIGNIFICANT),
    }


def fastest_of(features, column="pm"):
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
    edges = np.histogram_bin_edges(np.append(every, 0.0), bins=BINS)
    ax.hist(parts, edges, color=colors, label=names, stacked=True)
    ax.yaxis.get_major_locator().set_params(integer=True)
    if sum(len(part) > 0 for part in parts) > 1:
        ax.legend(frameon=False)


def _plain(values):
    """Return the numbers of a column, NaN where it is masked."""
    values = getattr(values, "filled", lambda _: values)(np.nan)
    return np.asarray(u.Quantity(values).value, dtype=float)
