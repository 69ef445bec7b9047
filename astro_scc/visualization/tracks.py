# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Figures of features: paths on the mean image, separations, and speeds."""

from itertools import combinations

import astropy.units as u
import numpy as np

from astro_scc.features.motion import MOST_FALSE
from astro_scc.units import offset_unit, unit_name
from astro_scc.visualization import images, style

#: Errors beyond so many times the median one are of features that say little.
LARGE_ERROR = 4.0
#: How features are drawn that are secure, and that are not.
STRONG = {"alpha": 1.0, "zorder": 3, "linestyle": "-"}
PALE = {"alpha": 0.35, "zorder": 2, "linestyle": ":"}
#: Of more features than these only so many have numbers and ejections, those of most
#: epochs, and none its speed.
CROWDED, NAMED = 40, 20
#: Where a number may stand: its alignment, and its shift in points.
BESIDE = (
    ("left", 4, 0), ("right", -4, 0), ("left", 4, 7), ("left", 4, -7),
    ("center", 0, 9), ("center", 0, -9), ("right", -4, 7), ("right", -4, -7),
)  # fmt: skip


def plot_separation(
    features, *, stream=None, beta_per_pm=None, published=None, ax=None, unit=None,
    **look,
):  # fmt: skip
    """
    Draw the core separations of features against time, with their fits.

    A line is the motion that is fitted to a feature, with its number at the end; those
    of features that are not secure are pale and dotted.  Dashes lead back to the
    ejection of a feature, a triangle with its error.  Below are the residuals.

    Parameters
    ----------
    features : `~astro_scc.features.Features`
    stream : array_like of int, shape (n,), optional
        Stream of each, 0 for none, which gives its colour.
    beta_per_pm : float, optional
        Apparent speed in units of c of 1 mas/yr; with it, secure features have their
        speeds beside their numbers.
    published : `~astropy.table.QTable`, optional
        Features to compare with, in grey, see
        ``astro_scc.products.publication.published_positions``.
    ax : `matplotlib.axes.Axes`, optional
        Axes to draw on instead of a new figure, without residuals.
    unit : `~astropy.units.Unit`, optional
        Unit of the separations.
    **look
        Keywords of the fitted lines, see `matplotlib.lines.Line2D`.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is not an angle.
    """
    lower, far = None, np.hypot(*features.detections.place.T).max(initial=1.0)
    unit = offset_unit(far, unit)
    if ax is None:
        figure = style.new_figure((style.WIDTH, 5.4))
        ax, lower = figure.subplots(2, 1, sharex=True, height_ratios=(7, 3))
    figure, ax = style.figure_and_axes(ax, None)
    ejected = ejections(features)
    earliest = min((date for date, _ in ejected.values()), default=None)
    room = 0.16 if beta_per_pm and len(features) <= CROWDED else 0.08
    on_axis = style.date_axis(lower or ax, features.cube, earliest, room)
    if published is not None:
        x, y = on_axis(published["date"].jyear), published["separation"].to_value(unit)
        _draw_published(ax, published, features.cube, x, y)
    ends = _draw_separations(ax, lower, features, on_axis, unit, stream, look)
    _draw_ejections(ax, ejected, ends, on_axis)
    style.legend_above(ax)
    ax.set_ylim(bottom=0)
    ax.set_ylabel(f"Core separation ({unit_name(unit)})")
    if lower is not None:
        ax.set_xlabel("")
        lower.axhline(0, color=style.GREY, lw=0.6, zorder=0)
        lower.set_ylabel(f"Residual ({unit_name(unit)})")
        figure.align_ylabels()
    _lay_out(figure, fixed=lower is not None)
    _write_numbers(ax, features, [(k[1], k[2]) for k in ends], beta_per_pm)
    return figure


def _draw_separations(ax, lower, features, on_axis, unit, stream, given):
    """Draw separations, fits and residuals; return ends of fits, and colours."""
    d, factor, ends = features.detections, u.mas.to(unit), []
    distance = np.hypot(*d.place.T)
    outward = d.place / np.maximum(distance, 1e-30)[:, None]
    error = np.hypot(*(outward * d.place_error).T)
    for number, motion in enumerate(features.motions):
        k = features.tracks[number]
        look = style.look_of("line", given, **feature_look(features, number, stream))
        dots = {"fmt": "o", "ms": 3, "mew": 0, "lw": 0.8, **look, "linestyle": ""}
        time = d.time[k]
        ax.errorbar(on_axis(time), factor * distance[k], factor * error[k], **dots)
        t = np.linspace(*time[[0, -1]], 50)
        fitted = factor * np.hypot(*motion.at(t).T)
        ax.plot(on_axis(t), fitted, **{"linewidth": 1.2, **look})
        if lower is not None:
            left = distance[k] - np.hypot(*motion.at(time).T)
            lower.errorbar(on_axis(time), factor * left, factor * error[k], **dots)
        places = zip(on_axis(time[[0, -1]]), fitted[[0, -1]], strict=True)
        ends.append((*places, look["color"]))
    return ends


def _draw_ejections(ax, ejected, ends, on_axis):
    """Draw the ejections of features by their numbers, and dashes that lead there."""
    for number, (date, error) in ejected.items():
        (x, y), _, color = ends[number]
        back = {"color": color, "lw": 0.6, "ls": "--", "zorder": 1}
        ax.plot([on_axis(date), x], [0, y], gid="ejection", **back)
        bar = {"fmt": "^", "ms": 4, "elinewidth": 0.8, "clip_on": False}
        width = on_axis(date + error) - on_axis(date)
        ax.errorbar(on_axis(date), 0, xerr=width, color=color, **bar)


def ejections(features, *, earlier=0.3):
    """
    Return date and error of the ejections of secure features by their number.

    Those that are ``earlier`` than the first image, in spans of the images, are left
    out.
    """
    years = features.cube.times.jyear
    earliest = years[0] - earlier * (years[-1] - years[0])
    fwhm, motions = features.detections.fwhm, features.motions
    secure = [k for k in _named(features) if features.secure[k]]
    dates = {k: motions[k].ejection(features.core_error, fwhm) for k in secure}
    # What is not known compares as false.
    return {k: date for k, date in dates.items() if date[0] >= earliest}


def _named(features):
    """Return the features with numbers, first the secure ones and of most epochs."""
    n = features.n_epochs
    order = sorted(range(len(n)), key=lambda k: (~features.secure[k], -n[k]))
    crowded = len(order) > CROWDED
    return [k for k in order[:NAMED] if features.secure[k]] if crowded else order


def _draw_published(ax, published, cube, x, y):
    """Draw the published features during a cube in grey, with a place of each row."""
    # Published dates are often rounded to days.
    first, last = cube.times[0] - 1 * u.day, cube.times[-1] + 1 * u.day
    seen = (published["date"] >= first) & (published["date"] <= last)
    for number in np.unique(published["published"][seen]):
        same = seen & (published["published"] == number)
        ax.plot(
            x[same], y[same], color=style.GREY, lw=0.5, marker=".", ms=2.5, mew=0,
            alpha=0.6, zorder=1, label="published", gid=f"published {number}",
        )  # fmt: skip


def feature_look(features, number, stream=None):
    """Return the look of a feature, pale unless it is secure."""
    look = STRONG if features.secure[number] else PALE
    if stream is None:
        return {"color": style.component_color(number + 1), **look}
    k = int(stream[number])
    color = style.component_color(k) if k else style.BLACK
    return {"color": color, "label": f"stream {k}" if k else style.NONE, **look}


def _lay_out(figure, *, fixed):
    """Place the axes, as numbers need; nothing need be drawn for that."""
    if engine := figure.get_layout_engine():
        engine.execute(figure)
    if fixed:
        # A second layout takes time.
        figure.set_layout_engine("none")


def _write_numbers(ax, features, ends, beta_per_pm=None):
    """
    Write the numbers of features beside places, given with colours.

    If the speed in units of c of 1 mas/yr is known, secure features have theirs.  A
    number covers as few positions as possible; if it covers another, it is left out.
    """
    frame, taken = ax.get_window_extent(), []
    drawn = [np.empty((0, 2)), *(line.get_xydata() for line in ax.lines)]
    points = ax.transData.transform(np.concatenate(drawn))
    for k in _named(features):
        if ends[k] is None:
            continue
        place, color = ends[k]
        name = f"{features.number[k]}"
        if beta_per_pm and features.secure[k] and len(ends) <= CROWDED:
            speed = beta_per_pm * features.motions[k].speed
            name += f" ({float(f'{speed:.2g}'):g} c)"
        text = ax.annotate(
            name, place, (0, 0), textcoords="offset points", fontsize="small",
            va="center", color=color, annotation_clip=True, zorder=4,
            path_effects=style.outline(1.5),
        )  # fmt: skip
        found = []
        for side, *shift in BESIDE:
            text.set(ha=side, position=shift)
            box = text.get_window_extent()
            inside = frame.contains(*box.min) and frame.contains(*box.max)
            if inside and not any(box.overlaps(other) for other in taken):
                found.append((box.count_contains(points), side, shift, box))
        if found:
            _, side, shift, box = min(found, key=lambda one: one[0])
            text.set(ha=side, position=shift)
            taken.append(box.padded(3))
        else:
            text.remove()


def plot_tracks(
    features, *, stream=None, published=None, figure=None, unit=None, **look
):
    """
    Draw the paths of features over the mean image.

    Contours begin at three times its noise, and each is twice the one before.  Each
    path is a line through the positions of a feature, with one dot per epoch, an
    arrow head at the last one and the number of the feature.  Those of features that
    are not secure are pale and dotted.  If paths near the core hide one another, a
    second panel shows what is framed larger.

    Parameters
    ----------
    features : `~astro_scc.features.Features`
    stream : array_like of int, shape (n,), optional
        Stream of each, 0 for none, which gives its colour.
    published : `~astropy.table.QTable`, optional
        Features to compare with, in grey, see `plot_separation`.
    figure : `matplotlib.figure.Figure`, optional
        Figure to draw on instead of a new one, without a second panel.
    unit : `~astropy.units.Unit`, optional
        Unit of the offsets.
    **look
        Keywords of the paths, see `matplotlib.lines.Line2D`.

    Returns
    -------
    `matplotlib.figure.Figure`

    Raises
    ------
    ValueError
        If the unit is not an angle.
    """
    place = np.concatenate([features.detections.place, features.core.place])
    points = {"place": place.T, "weight": np.ones(len(place))}
    view, drawn, ax = images.draw_mean_image(features.cube, points, figure, unit)
    axes, inner = [ax], []
    if figure is None:
        inner, box = _inner_paths(features, view)
    if len(inner):
        axes.append(_add_panel(drawn, ax, view, box))
    for panel in axes:
        if published is not None:
            place = images.sky_place(published) * view.factor
            _draw_published(panel, published, features.cube, *place)
        last = _draw_paths(panel, features, view, stream, look)
    style.legend_above(ax)
    _lay_out(drawn, fixed=figure is None)
    for panel in axes:
        shown = panel is not ax
        ends = [end if (k in inner) == shown else None for k, end in enumerate(last)]
        _write_numbers(panel, features, ends)
    return drawn


def _inner_paths(features, view, *, inner=0.3, close=0.02):
    """
    Return the features near the core if paths hide one another there, their box.

    They are near within a share ``inner`` of the image, and hide one another within
    ``close``.
    """
    from scipy.spatial.distance import cdist

    d, size = features.detections, np.ptp(view.limits, axis=1).max()
    paths = [view.factor * d.place[track] for track in features.tracks]
    far = np.array([np.hypot(*path.T).max() for path in paths])
    near = np.flatnonzero(far < inner * size)
    apart = [cdist(paths[a], paths[b]).min() for a, b in combinations(near, 2)]
    if min(apart, default=np.inf) > close * size or len(near) == len(paths):
        return [], None
    every = np.concatenate([*(paths[k] for k in near), np.zeros((1, 2))])
    low, high = every.min(axis=0), every.max(axis=0)
    # A narrow strip shows nothing.
    half = np.maximum(0.6 * (high - low), 0.2 * (high - low).max())
    return near, np.stack([(low + high) / 2 - half, (low + high) / 2 + half], axis=1)


def _add_panel(figure, ax, view, box, *, gap=0.1):
    """Add axes below others, with a gap, that show a part larger; return them."""
    from matplotlib.patches import Rectangle

    (wide, high), aspect = np.ptp(box, axis=1), np.divide(*np.ptp(view.limits, axis=1))
    height, gap = high / wide * aspect, gap * aspect
    panel = ax.inset_axes((0.0, -gap - height, 1.0, height))
    added = (figure.get_figwidth() - 0.6) / aspect * (gap + height)
    figure.set_figheight(figure.get_figheight() + added)
    images.draw_image(panel, view, ax.images[0].get_array()).set_alpha(0.5)
    images.draw_contours(panel, view)
    panel.set(xlim=box[0, :: -1 if view.to_the_left else 1], ylim=box[1])
    frame = {"fill": False, "edgecolor": style.BLACK, "lw": 0.8, "gid": "larger below"}
    ax.add_patch(Rectangle(box[:, 0], wide, high, **frame))
    return panel


def _draw_paths(ax, features, view, stream, given):
    """Draw the paths of features; return the last place and the colour of each."""
    head = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, "mutation_scale": 7}
    head, last = head | {"linewidth": 0.9}, []
    for number, track in enumerate(features.tracks):
        look = style.look_of("line", given, **feature_look(features, number, stream))
        place = view.factor * features.detections.place[track].T
        dots = {"marker": "o", "markersize": 2, "markeredgewidth": 0, "linewidth": 0.9}
        # The arrow is the last step: drawn twice, a dotted one looks solid.
        ax.plot(*place[:, :-1], **dots | look)
        line = {k: look[k] for k in ("color", "alpha", "zorder", "linestyle")}
        ends = place.T[-1:-3:-1]
        ax.annotate("", *ends, arrowprops=head | line, annotation_clip=True)
        last.append((place[:, -1], look["color"]))
    return last


# -- speeds ---------------------------------------------------------------------------


def draw_feature_speeds(ax, result, place, speed, error, given=None):
    """Draw the speeds of the features of a result at places, as `feature_look` says."""
    # Edges over faces would be twice as dark.
    point = {"ms": 5, "mew": 0, "lw": 0.8, "marker": "o"}
    streams = result.features["stream"]
    for k in np.flatnonzero(np.isfinite(speed)):
        look = feature_look(result.tracked_features, k, streams) | point
        look = style.look_of("line", given or {}, **look | {"linestyle": ""})
        ax.errorbar(place[k], speed[k], error[k], **look)


def plot_feature_speeds(result, *, profile=None, beta_per_pm=None, ax=None, **look):
    """
    Draw the radial speed of each feature against its separation from the core.

    Features have the colours of their streams; those that are not secure are pale.
    Further keywords are those of their symbols.
    """
    figure, ax = style.figure_and_axes(ax, (style.WIDTH, 3.4))
    table = result.features
    separation, speeds = table["separation"].to_value(u.mas), table["pm"].unit
    unit = offset_unit(separation.max(initial=1.0))
    speed, error = (table[k].value for k in ("pm_radial", "pm_radial_err"))
    error = np.minimum(error, LARGE_ERROR * np.median(error) if len(error) else 0.0)
    draw_feature_speeds(ax, result, separation * u.mas.to(unit), speed, error, look)
    if profile is not None and len(profile):
        mean = {"fmt": "none", "color": style.BLACK, "elinewidth": 1.6, "zorder": 3}
        style.draw_bins(ax, profile, unit, speeds, {"label": "mean of bin", **mean})
    ax.axhline(0, color=style.GREY, lw=0.6, zorder=0)
    ax.set_xlim(left=0)
    style.label_distances(ax, unit, "Radial proper motion", speeds, beta_per_pm)
    return figure


# -- of many sources -----------------------------------------------------------------


def population(features, *, significant=3.0, often=10):
    """
    Return which features of many sources show what.

    Parameters
    ----------
    features : `~astropy.table.QTable`
        ``features.ecsv`` of a survey.
    significant : float, optional
        What differs from zero by so many standard errors is not zero.
    often : int, optional
        Fewest epochs of a feature whose acceleration is judged, or that stands still.

    Returns
    -------
    dict of `~numpy.ndarray` of bool, shape (n,)
        ``moving``, secure and significantly fast; of these ``inward`` and, in often
        enough epochs, ``judged``; of the latter ``accelerated``.  ``at rest`` are
        features of as many epochs that are false with a probability of at most 0.3 and
        not significantly fast; secure ones have moved by a beam.
    """

    def ratio(name):
        value, error = (_plain(features[k]) for k in (name, f"{name}_err"))
        return value / error

    speed = ratio("pm")
    change = [np.abs(ratio(f"acc_{k}")) for k in ("parallel", "perpendicular")]
    moving = np.asarray(features["secure"], dtype=bool) & (speed >= significant)
    often = np.asarray(features["n_epochs"]) >= often
    true = np.asarray(features["p_false"]) <= MOST_FALSE
    return {
        "moving": moving,
        "at rest": often & true & (speed < significant),
        "inward": moving & (ratio("pm_radial") <= -significant),
        "judged": moving & often,
        # Only of those whose motion is better described so is it measured.
        "accelerated": moving & often & (np.max(change, axis=0) >= significant),
    }


def fastest_of(features, column):
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
    edges = np.histogram_bin_edges(np.append(every, 0.0), bins=20)
    ax.hist(parts, edges, color=colors, label=names, stacked=True)
    ax.yaxis.get_major_locator().set_params(integer=True)
    if sum(len(part) > 0 for part in parts) > 1:
        ax.legend(frameon=False)


def _plain(values):
    """Return the numbers of a column, NaN where it is masked."""
    values = getattr(values, "filled", lambda _: values)(np.nan)
    return np.asarray(u.Quantity(values).value, dtype=float)
