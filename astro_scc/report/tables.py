# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Components, epochs, settings and sources of a survey as rows of text."""

import re
from collections import defaultdict
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.flow.acceleration import LEAST, MOST_BINS
from astro_scc.kinematics.cosmology import cosmology_text
from astro_scc.measurement.tables import cell_text
from astro_scc.quantities import with_error
from astro_scc.units import PM_UNIT, offset_unit, round_to_errors, speed_unit, unit_name

#: Columns of the page: name, heading with {unit}.
COLUMNS = (
    ("component", "No."),
    ("kind", "kind"),
    ("pm", "speed ({unit})"),
    ("beta_app", "speed (c)"),
    ("pm_pa", "PA ({unit})"),
    ("dispersion", "dispersion ({unit})"),
    ("p_global", "p_global"),
    ("n_features", "features"),
    ("n_ssp", "SSPs"),
    ("n_pairs", "pairs"),
    ("pm_parallel", "along ({unit})"),
    ("pm_transverse", "across ({unit})"),
    ("pm_ra_cosdec", "east ({unit})"),
    ("pm_dec", "north ({unit})"),
    ("pm_lon_coslat", "longitude ({unit})"),
    ("pm_lat", "latitude ({unit})"),
    ("coefficient", "coefficient"),
    ("z_score", "z"),
    ("pm_limit", "upper limit, 95% ({unit})"),
    ("pm_err_jitter", "paper's error of the speed ({unit})"),
    ("pm_err_alignment", "error by alignment ({unit})"),
    ("p_local", "p_local"),
    ("p_distinct", "p_distinct"),
    ("p_smallest", "smallest p_global"),
    ("note", "note"),
)
#: Columns of the page of a survey.
OVERVIEW = {
    "source": "source",
    "n_epochs": "epochs",
    "span": "span",
    "pm": "speed ({unit})",
    "beta_app": "speed (c)",
    "published": "published ({unit})",
    "kind": "kind",
    "p_global": "p_global",
    "p_fdr": "p_fdr",
    "n_features": "features",
    "profile": "profile",
}
#: Kinds of a source that has components of several, the first of those there are.
OF_SOURCE = ("moving", "not significant", "stationary", "empty", "failed")
#: Width and height of a small profile.
SPARK = (144, 34)
#: Entries of a table's meta that are elsewhere on the page.
NO_SETTINGS = ("versions", "history", "configuration")


def plain_value(item):
    """Return a cell as a plain number or text."""
    item = getattr(item, "value", item)
    return item if isinstance(item, str) else float(item)


def unit_text(unit):
    """Return a unit as text without blanks, empty for None."""

    return "" if unit is None else unit_name(unit)


def component_rows(components, kinds):
    """
    Return heads, rows and explanations of the tables of components.

    Parameters
    ----------
    components : `~astropy.table.QTable`
    kinds : sequence of str

    Returns
    -------
    tables : list of (list of str, list of (str, list of str))
        Head and rows, each row with its kind.  The first table has the main
        columns, the second the others; both are narrow enough for paper.
    notes : list of (str, str)
        Headings and what the columns mean.
    """
    components = round_to_errors(components.copy(copy_data=False))
    known = [column for column in COLUMNS if column[0] in components.colnames]
    taken = {name for name, _ in COLUMNS}
    taken |= {f"{name}_err" for name in taken}
    known += [
        (name, name)
        for name in components.colnames
        if name not in taken and components[name].ndim == 1
    ]
    names = [name for name, _ in known]
    first = names.index("pm_parallel") if "pm_parallel" in names else len(known)
    tables, notes = [], []
    for part in (known[:first], [*known[:1], *known[first:]]):
        head, rows = [], [(kind, []) for kind in kinds]
        for name, heading in part:
            unit = unit_text(getattr(components[name], "unit", None))
            head.append(heading.format(unit=unit))
            note = _note(components[name].info.description or "")
            if note and (head[-1], note) not in notes:
                notes.append((head[-1], note))
            for k, (_, cells) in enumerate(rows):
                cells.append(cell_text(components, name, k))
        tables.append((head, rows))
    return tables, notes


def _note(description):
    """Return the description of a column in the words of the page."""
    description = re.sub(r"\bpm_err\b", "the error of the speed", description)
    return re.sub(r"\bpm\b", "the speed", description)


def scale_lines(of_scales):
    """
    Return the comparison of the speeds of groups of scales as lines.

    Parameters
    ----------
    of_scales : `~astropy.table.QTable`
        See `~astro_scc.flow.compare_speeds`.

    Returns
    -------
    list of str
        Without the pairs of which fewer than two features leave one unknown.
    """
    lines = []
    for row in of_scales[np.isfinite(of_scales["p_value"])]:
        speeds = [
            f"{with_error(row[f'{k}_speed'].value, row[f'{k}_speed_err'].value, '+-')} "
            f"({row[f'{k}_n_features']} features)"
            for k in ("first", "second")
        ]
        lines.append(
            f"Speeds of the {row['first']} and {row['second']} scales: {speeds[0]} and "
            f"{speeds[1]} {unit_text(row['first_speed'].unit)}, p {row['p_value']:.2g}"
        )
    return lines


def feature_rows(components, features):
    """
    Return the table of the features that were followed, each with its own speed.

    Parameters
    ----------
    components : `~astropy.table.QTable`
        Components, whose unit of speed is used.
    features : `~astropy.table.QTable`
        See `~astro_scc.measurement.SCCResult.features`.

    Returns
    -------
    head : list of str
    rows : list of list of str
    """
    unit = components["pm"].unit
    head = ["Component", "scale", "epochs", "first", "last",
            f"distance ({unit_text(u.mas)})", f"motion ({unit_text(u.mas)})",
            f"speed ({unit_text(unit)})"]  # fmt: skip
    rows = [
        [
            str(row["component"]), f"{row['scale']:g}", str(row["n_epochs"]),
            *(row[k].strftime("%Y-%m-%d") for k in ("first", "last")),
            *(f"{row[k].to_value(u.mas):.3g}" for k in ("distance", "motion")),
            with_error(row["pm"].to_value(unit), row["pm_err"].to_value(unit)),
        ]
        for row in features
    ]  # fmt: skip
    return head, rows


def sensitivity_rows(components, sensitivity):
    """
    Return the table of the main speed with other choices of the data.

    Parameters
    ----------
    components : `~astropy.table.QTable`
        Components, whose unit of speed is used.
    sensitivity : `~astropy.table.QTable`
        See `~astro_scc.measurement.SCCResult.sensitivity`.

    Returns
    -------
    head : list of str
    rows : list of list of str
    """
    unit = components["pm"].unit
    head = ["Measured from", "features", f"speed ({unit_text(unit)})",
            f"change ({unit_text(unit)})", "change / error", "p"]  # fmt: skip
    rows = []
    for row in sensitivity:
        cells = [
            with_error(row[name].to_value(unit), row[f"{name}_err"].to_value(unit))
            for name in ("pm", "change")
        ]
        cells += [f"{row['change_sigma']:+.1f}", f"{row['p_value']:.2g}"]
        rows.append([str(row["choice"]), str(row["n_features"]), *cells])
    if rows:
        rows[0][3:] = ["-"] * 3
    return head, rows


def epoch_rows(result):
    """Return head and rows of the table of the epochs."""
    table = result.cube.epochs
    epoch = np.asarray(result.ssps["epoch"], dtype=int)
    inside = np.asarray(result.ssps["in_region"], bool)
    days = [date.strftime("%Y-%m-%d") for date in table["date"]]
    times = [date.strftime("%Y-%m-%d %H:%M") for date in table["date"]]
    columns = {"Date": days if len(set(days)) == len(days) else times}
    labels = [str(label) for label in table["label"]]
    if labels != days:
        columns = {"Epoch": labels} | columns
    if "major" in table.colnames:
        columns["Beam (mas, deg)"] = [
            f"{row['major'].to_value(u.mas):.3g} x {row['minor'].to_value(u.mas):.3g} "
            f"at {row['pa'].to_value(u.deg):.0f}"
            for row in table
        ]
    noise = u.Quantity(table["noise"])
    unit = unit_text(noise.unit)
    columns[f"Noise ({unit})" if unit else "Noise"] = [f"{v:.2g}" for v in noise.value]
    counted = {"SSPs": inside}
    if not inside.all():
        counted["SSPs outside the region"] = ~inside
    for name, some in counted.items():
        counts = np.bincount(epoch[some], minlength=len(result.cube))
        columns[name] = [str(count) for count in counts]
    rows = list(zip(*columns.values(), strict=True))
    return {"head": list(columns), "rows": rows}


def setting_rows(result, components):
    """Return settings as pairs of name and text."""
    meta = {**result.meta, **components.meta}
    pairs = meta.pop("settings", {}) | meta
    left = {k: v for k, v in pairs.items() if k not in NO_SETTINGS}
    return [(str(name).replace("_", " "), _text(v)) for name, v in left.items()]


def _text(value):
    if value is None:
        return "not given"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, u.Quantity):
        unit = unit_text(value.unit)
        return f"{', '.join(f'{v:.6g}' for v in np.atleast_1d(value.value))} {unit}"
    if isinstance(value, list | tuple):
        return ", ".join(_text(v) for v in value)
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict) and "cosmology" in value:
        return cosmology_text(value)
    return " ".join(str(value).split())


# -- surveys ---------------------------------------------------------------------


def overview(table, parts, folder, published):
    """
    Return what the page of a survey shows.

    Parameters
    ----------
    table, parts, folder, published
        See `~astro_scc.report.page.write_overview`.

    Returns
    -------
    dict
        ``rows``, one for each part, with text for each of ``columns``; ``kinds``
        of the sources; ``speeds``, the range of those that move; ``compared``,
        their differences from published speeds in standard errors.
    """

    every = np.ma.filled(np.ma.asarray(table["pm"].to_value(PM_UNIT)), np.nan)
    unit = speed_unit(np.nanmax(every, initial=0.0))
    first, kinds = {}, defaultdict(set)
    for row in table:
        first.setdefault(tuple(row["source", "region", "scale_group"]), row)
        measured = row["status"] == "measured"
        kinds[row["source"]].add(str(row["kind" if measured else "status"]))
    rows, moving, compared = [], [], []
    for part in parts:
        row = first[part.source, part.region, part.scale_group]
        known = published[part.source]
        if known is not None:
            known = _value_and_error(known, unit)
        cells = _part_cells(part, row, unit, known)
        if cells["kind"] == "moving":
            moving.append(row["pm"].to_value(unit))
            if known is not None:
                compared.append(abs(_difference(row, known, unit)))
        if row["status"] == "measured":
            report = f"{part.folder}/report.html"
            cells["link"] = report if Path(folder, report).is_file() else ""
            path = Path(folder, part.folder, "features.ecsv")
            cells["profile"] = _small_profile(path, unit)
        rows.append(cells)
    seen = {name for cells in rows for name, text in cells.items() if text}
    columns = [
        (name, label.format(unit=unit_text(unit)))
        for name, label in OVERVIEW.items()
        if name in seen
    ]
    speeds = ""
    if moving:
        middle, *ends = (f"{f(moving):.2g}" for f in (np.median, np.min, np.max))
        speeds = f"{' to '.join(ends)} {unit_text(unit)}, median {middle}"
    kinds = {
        source: next(kind for kind in OF_SOURCE if kind in own)
        for source, own in kinds.items()
    }
    return {"rows": rows, "columns": columns, "kinds": kinds, "speeds": speeds,
            "compared": compared}  # fmt: skip


def _part_cells(part, row, unit, published):
    """Return the text of a region and scale group, without its profile."""
    names = (part.region, part.scale_group)
    more = defaultdict(str)
    cells = dict.fromkeys(OVERVIEW, "") | {"link": "", "source": part.source}
    cells["part"] = ", ".join(name for name in names if name != "all")
    cells["more"] = more
    cells["kind"], more["kind"] = part.status, part.message
    if part.n_epochs:
        cells["n_epochs"] = str(part.n_epochs)
        cells["span"], more["span"] = _span(*Time([part.first, part.last]))
    if published is not None:
        known = np.isfinite(published[1])
        cells["published"] = with_error(*published) if known else f"{published[0]:g}"
    if part.status != "measured":
        return cells
    cells["kind"] = str(row["kind"])
    more["kind"] = "" if row["note"] == "-" else str(row["note"])
    cells["pm"] = with_error(*(float(row[k].to_value(unit)) for k in ("pm", "pm_err")))
    if published is not None:
        difference = _difference(row, published, unit)
        more["published"] = f"{difference:+.1f} standard errors"
    if "beta_app" in row.colnames and not np.any(getattr(row["beta_app"], "mask", 0)):
        beta = (row[k].to_value(u.one) for k in ("beta_app", "beta_app_err"))
        cells["beta_app"] = with_error(*map(float, beta))
    cells["n_features"] = str(row["n_features"])
    for name in ("p_global", "p_fdr"):
        tested = cells["kind"] != "stationary"
        cells[name] = f"{row[name]:.2g}" if tested else "-"
    return cells


def _value_and_error(speed, unit):
    """Return a published speed and its error, which is NaN if there is none."""
    value, error, *_ = [*np.atleast_1d(speed.to_value(unit)), np.nan]
    return float(value), float(error)


def _difference(row, published, unit):
    """Return a speed less a published one, in standard errors of both."""
    value, error = (row[name].to_value(unit) for name in ("pm", "pm_err"))
    return (value - published[0]) / np.hypot(error, np.nan_to_num(published[1]))


def _span(first, last):
    """Return the time between two dates in a unit that is easy to read, and both."""
    span = last - first
    unit = next((k for k in (u.yr, u.d, u.h) if span >= 1 * k), u.min)
    form = "%Y-%m" if unit is u.yr else "%Y-%m-%d"
    days = dict.fromkeys(time.strftime(form) for time in (first, last))
    return f"{span.to_value(unit):.3g} {unit}", " to ".join(days)


def _small_profile(path, unit):
    """Return the speeds of features against their distances as parts of an SVG."""
    from astro_scc.visualization.features import LARGE_ERROR

    features = QTable.read(path, format="ascii.ecsv")
    error = features["pm_err"].value
    if len(features) == 0:
        return None
    features = features[error <= LARGE_ERROR * np.median(error)]
    distance, component = features["distance"].to_value(u.mas), features["component"]
    # Outward is positive, also along a component that points to the core.
    speed = np.where(distance < 0, -1, 1) * features["pm"].to_value(unit)
    distance = np.abs(distance)
    low, high = min(speed.min(), 0.0), max(speed.max(), 0.0)
    far = distance.max()

    def place(x, y):
        x = SPARK[0] * x / (far or 1.0)
        return np.round(x, 1), np.round(SPARK[1] * (high - y) / (high - low or 1.0), 1)

    of_first = np.flatnonzero(component == 1)
    of_first = of_first[np.argsort(distance[of_first])]
    bins = np.array_split(of_first, max(min(len(of_first) // LEAST, MOST_BINS), 1))
    line = [
        place(np.median(distance[own]), np.median(speed[own]))
        for own in bins
        if len(own)
    ]
    lengths = offset_unit(far)
    return {
        "points": [
            (*place(x, y), int(k))
            for x, y, k in zip(distance, speed, component, strict=True)
        ],
        "line": " ".join(f"{x},{y}" for x, y in line) if len(line) > 1 else "",
        "zero": place(0, 0.0)[1],
        "range": f"{far * u.mas.to(lengths):.2g} {unit_text(lengths)}, "
        f"{high if high > -low else low:.2g} {unit_text(unit)}",
    }
