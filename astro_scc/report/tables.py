# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Components, epochs, settings and sources of a survey as rows of text."""

import re
from collections import defaultdict
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.time import Time

from astro_scc.columns import cell, headed, heading_of
from astro_scc.flow.speeds import LEAST, MOST_BINS
from astro_scc.kinematics.cosmology import cosmology_text
from astro_scc.quantities import with_error
from astro_scc.units import offset_unit, unit_name
from astro_scc.visualization.speeds import LARGE_ERROR, population

#: Columns of components that come first, in their order: what is quoted, the rest.
QUOTED = "component kind pm beta_app pm_pa dispersion p_global n_features n_ssp n_pairs"
OTHERS = (
    "pm_parallel pm_transverse pm_ra_cosdec pm_dec pm_lon_coslat pm_lat coefficient "
    "z_score pm_err_jitter pm_err_alignment p_local p_distinct p_smallest"
)
#: Columns of features.
FEATURES = (
    "feature component n_epochs first last separation position_angle pm beta_app t_ej "
    "p_false"
)
#: Largest number of features that are shown at once.
MOST = 20
#: Columns of the page of a survey.
OVERVIEW = (
    "source n_epochs span pm beta_app published kind p_global p_fdr n_features fastest "
    "same profile"
).split()
#: Columns that name the part of a survey.
PART = ("source", "region", "scale_group")
#: Kinds of a source that has components of several, the first of those there are.
OF_SOURCE = (
    "moving",
    "not confirmed",
    "not significant",
    "stationary",
    "empty",
    "failed",
)
#: Width and height of a small profile.
SPARK = (144, 34)


def component_tables(components):
    """
    Return the columns of the two tables of components as text.

    Parameters
    ----------
    components : `~astropy.table.QTable`

    Returns
    -------
    list of list of (str, str, list of str)
        Heading, meaning and cells of each column.  The first table has the main
        columns, the second the others; both are narrow enough for paper.
    """
    first, others = QUOTED.split(), OTHERS.split()
    # The notes say these in words.
    listed = {"caution", "pm_limit", *first, *others}
    listed |= {f"{name}_err" for name in listed}
    rest = (name for name in components.colnames if name not in listed)
    others += [name for name in rest if components[name].ndim == 1]
    return [
        [
            (heading, _in_words(meaning), texts)
            for heading, meaning, texts in headed(components, names).values()
        ]
        for names in (first, ["component", *others])
    ]


def _in_words(meaning):
    """Return the meaning of a column that speaks of the speed instead of its column."""
    meaning = re.sub(r"\bpm_err\b", "the error of the speed", meaning)
    return re.sub(r"\bpm\b", "the speed", meaning)


def feature_rows(features, most=MOST):
    """
    Return headings, rows of secure features, and other rows, and which are secure.

    Of more than ``most`` secure features, the first are those seen in most epochs.
    """
    columns = headed(features, FEATURES.split(), own="features").values()
    heads, _, columns = zip(*columns, strict=True)
    rows = list(zip(*columns, strict=True))
    secure = np.asarray(features["secure"], bool)
    first = np.argsort(-(secure * features["n_epochs"]), kind="stable")[:most]
    first = set(first[secure[first]])
    shown = [row for k, row in enumerate(rows) if k in first]
    others = [(row, secure[k]) for k, row in enumerate(rows) if k not in first]
    return heads, shown, others


def setting_text(value):
    """Return the value of a setting as text."""
    match value:
        case None:
            return "not given"
        case bool() | np.bool_():
            return "yes" if value else "no"
        case u.Quantity():
            numbers = (f"{v:.6g}" for v in np.atleast_1d(value.value))
            return f"{', '.join(numbers)} {unit_name(value.unit)}"
        case list() | tuple():
            return ", ".join(map(setting_text, value))
        case float():
            return f"{value:.6g}"
        case {"cosmology": _}:
            return cosmology_text(value)
    return " ".join(str(value).split())


# -- surveys ---------------------------------------------------------------------


def overview(table, features, parts, folder, published):
    """
    Return what the page of a survey shows.

    Parameters
    ----------
    table, features, parts, folder, published
        See `~astro_scc.report.page.write_overview`.

    Returns
    -------
    dict
        ``rows``, one for each part, with text for each of ``columns``; ``kinds``
        of the sources; ``speeds``, the range of those that move; ``compared``,
        their differences from published speeds in standard errors.
    """
    unit = table["pm"].unit
    every_kind = defaultdict(set)
    for row in table:
        kind = "kind" if row["status"] == "measured" else "status"
        every_kind[row["source"]].add(row[kind])
    first = {tuple(row[list(PART)]): row for row in table[::-1]}
    of_part = defaultdict(list)
    for k, names in enumerate(features[list(PART)] if len(features) else ()):
        of_part[tuple(names)].append(k)
    rows = []
    for part in parts:
        names = part.source, part.region, part.scale_group
        own = first[names], features[of_part[names]]
        rows.append(_part_cells(part, *own, unit, published[part.source], folder))
    moving = [cells for cells in rows if cells["kind"] == "moving"]
    speeds = [cells["speed"] for cells in moving if "speed" in cells]
    if speeds:
        middle, *ends = (f"{f(speeds):.2g}" for f in (np.median, np.min, np.max))
        speeds = f"{' to '.join(ends)} {unit_name(unit)}, median {middle}"
    return {
        "rows": rows,
        "columns": {
            name: heading_of(name, unit_name(unit), "overview")
            for name in OVERVIEW
            if any(cells[name] for cells in rows)
        },
        "kinds": {k: min(v, key=OF_SOURCE.index) for k, v in every_kind.items()},
        "speeds": speeds,
        "compared": [abs(k["difference"]) for k in moving if "difference" in k],
    }


def _part_cells(part, row, features, unit, published, folder):
    """Return the text of a region and scale group, its profile and its speed."""
    more = defaultdict(str, kind=part.message)
    cells = dict.fromkeys(OVERVIEW, "")
    cells |= {"source": part.source, "kind": part.status, "more": more, "link": ""}
    names = (part.region, part.scale_group)
    cells["part"] = ", ".join(name for name in names if name != "all")
    if part.n_epochs:
        cells["n_epochs"] = str(part.n_epochs)
        cells["span"], more["span"] = _span(*Time([part.first, part.last]))
    if published is not None:
        known, known_error, *_ = *np.atleast_1d(published.to_value(unit)), np.nan
        exact = np.isnan(known_error)
        cells["published"] = f"{known:g}" if exact else with_error(known, known_error)
    if part.status != "measured":
        return cells
    cells["kind"], more["kind"] = row["kind"], row["caution"].removeprefix("-")
    cells["n_features"] = str(row["n_features"])
    # What has no feature has no speed.
    if row["n_features"]:
        speed, error = (float(row[name].to_value(unit)) for name in ("pm", "pm_err"))
        cells |= {"pm": cell(row, "pm"), "speed": speed}
        if published is not None and np.isfinite(error + known):
            difference = (speed - known) / np.hypot(error, np.nan_to_num(known_error))
            cells["difference"] = difference
            more["published"] = f"{difference:+.1f} standard errors"
        if "beta_app" in row.colnames:
            beta = cell(row, "beta_app")
            cells["beta_app"] = "" if beta == "-" else beta
    for name in ("p_global", "p_fdr"):
        cells[name] = cell(row, name, form=".2g")
    report = f"{part.folder}/report.html"
    cells["link"] = report if Path(folder, report).is_file() else ""
    cells["profile"] = _small_profile(features, unit)
    if len(features):
        fastest = features["pm"][population(features)["moving"]].to_value(unit)
        cells["fastest"] = f"{max(fastest):.3g}" if len(fastest) else ""
        if "published" in features.colnames:
            cells["same"] = str(np.ma.count(features["published"]))
    return cells


def _span(first, last):
    """Return the time between two dates in a unit that is easy to read, and both."""
    span = last - first
    unit = next((k for k in (u.yr, u.d, u.h) if span >= 1 * k), u.min)
    form = "%Y-%m" if unit is u.yr else "%Y-%m-%d"
    days = dict.fromkeys(time.strftime(form) for time in (first, last))
    return f"{span.to_value(unit):.3g} {unit}", " to ".join(days)


def _small_profile(features, unit):
    """Return the radial speeds of features against separations as parts of an SVG."""
    if len(features) == 0:
        return None
    error = features["pm_radial_err"].value
    features = features[error <= LARGE_ERROR * np.median(error)]
    distance, component = features["separation"].to_value(u.mas), features["component"]
    speed = features["pm_radial"].to_value(unit)
    low, high, far = speed.min(initial=0.0), speed.max(initial=0.0), distance.max()

    def place(x, y):
        x = SPARK[0] * x / (far or 1.0)
        return np.round(x, 1), np.round(SPARK[1] * (high - y) / (high - low or 1.0), 1)

    of_first = np.flatnonzero(component == 1)
    of_first = of_first[np.argsort(distance[of_first])]
    bins = np.array_split(of_first, max(min(len(of_first) // LEAST, MOST_BINS), 1))
    line = [place(np.median(distance[k]), np.median(speed[k])) for k in bins if len(k)]
    lengths = offset_unit(far)
    return {
        "points": [*zip(*place(distance, speed), component.tolist(), strict=True)],
        "line": " ".join(f"{x},{y}" for x, y in line) if len(line) > 1 else "",
        "zero": place(0, 0.0)[1],
        "range": f"{far * u.mas.to(lengths):.2g} {unit_name(lengths)}, "
        f"{high if high > -low else low:.2g} {unit_name(unit)}",
    }
