# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Figure of the features of many sources."""

from __future__ import annotations

from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np

from astro_scc.features.trust import MOST_FALSE
from astro_scc.units import unit_name
from astro_scc.visualization import style

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure

#: What differs from zero by so many standard errors is not zero.
SIGNIFICANT = 3.0
#: Fewest epochs of a feature whose acceleration is judged, or that stands still.
EPOCHS = 10
BINS = 20


def population(features: QTable) -> dict[str, np.ndarray]:
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
    >>> from astro_scc.visualization.population import population
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
    some = features[population(features)["moving"]]
    values, largest = _plain(some[column]) if len(some) else [], {}
    for source, value in zip(some["source"] if len(some) else (), values, strict=True):
        if np.isfinite(value):
            largest[source] = max(value, largest.get(source, 0.0))
    return np.array(list(largest.values()))


def plot_population(features: QTable, *, figure: Figure | None = None) -> Figure:
    """
    Draw the speeds of the features of many sources.

    Parameters
    ----------
    features : `~astropy.table.QTable`
        ``features.ecsv`` of a survey.
    figure : `matplotlib.figure.Figure`, optional
        Figure to draw on instead of a new one.

    Returns
    -------
    `matplotlib.figure.Figure`
        Histograms of the speeds of secure features that move and of the fastest one of
        each jet, in mas/yr and, if sources have redshifts, in units of c.

    Raises
    ------
    ValueError
        If no feature is secure and moves.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> from astro_scc.visualization.population import plot_population
    >>> speed = {k: [0.5, 0.2] * u.mas / u.yr for k in ("pm", "pm_radial")}
    >>> error = {f"{k}_err": 0.1 * v for k, v in speed.items()}
    >>> none = [float("nan")] * 2
    >>> acc = {f"acc_{k}{e}": none for k in ("parallel", "perpendicular")
    ...        for e in ("", "_err")}
    >>> table = QTable({"source": ["a", "b"], "secure": [True, True],
    ...                 "n_epochs": [9, 9], "p_false": [0.1, 0.1],
    ...                 **speed, **error, **acc})
    >>> len(plot_population(table).axes)
    2
    """
    found = population(features)
    if not found["moving"].any():
        raise ValueError("no secure feature moves")
    columns = {"pm": f"Proper motion ({unit_name(features['pm'].unit)})"}
    if "beta_app" in features.colnames:
        columns["beta_app"] = r"Apparent speed, $\beta_\mathrm{app}$ ($c$)"
    size = style.WIDTH, 2.6 * len(columns)
    figure = style.new_figure(size) if figure is None else figure
    axes = figure.subplots(len(columns), 2, squeeze=False)
    for (name, label), (left, right) in zip(columns.items(), axes, strict=True):
        sign = np.where(found["inward"], -1.0, 1.0)
        speed = sign * _plain(features[name])
        use = found["moving"] & np.isfinite(speed)
        parts = [speed[use & ~found["inward"]], speed[use & found["inward"]]]
        colors, names = (style.BLUE, style.VERMILION), ("outward", "inward")
        _histogram(left, parts, colors, names)
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
