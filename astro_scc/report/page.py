# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Write a measurement, or a survey, as one page; the templates have the sentences."""

import re
from base64 import b64encode
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.columns import cell, headed, heading_of
from astro_scc.epochs.tables import common_names, plain
from astro_scc.flow import feature_profile
from astro_scc.flow.models import accelerations
from astro_scc.flow.speeds import LEAST, MOST_BINS, compare_scales
from astro_scc.kinematics.cosmology import beta_per_pm, cosmology_text, table_in_c_as
from astro_scc.measurement import SCCResult
from astro_scc.measurement.tables import dates_as_text
from astro_scc.products.folder import write_files
from astro_scc.products.publication import with_published
from astro_scc.quantities import with_error
from astro_scc.report import answer
from astro_scc.settings import METHODS
from astro_scc.units import in_speed_unit, offset_unit, unit_name
from astro_scc.visualization import style
from astro_scc.visualization.tracks import LARGE_ERROR, plot_population, population
from astro_scc.writing import make_folder

#: Columns of streams that come first, in their order: what is quoted, the rest.
QUOTED = (
    "stream kind share pm beta_app v_app pm_pa dispersion p_global n_features pm_from"
).split()
OTHERS = (
    "pm_features pm_spectrum pm_parallel pm_transverse pm_ra_cosdec pm_dec "
    "pm_lon_coslat pm_lat pm_err_alignment p_local p_distinct p_smallest"
).split()
#: Columns of features.
FEATURES = (
    "feature stream n_epochs first last separation position_angle pm beta_app v_app "
    "t_ej p_false"
).split()
#: Largest number of features that are shown at once.
MOST = 20
#: Columns of the page of a survey.
OVERVIEW = (
    "source n_epochs span pm beta_app published kind p_global p_fdr n_features fastest "
    "same profile"
).split()
#: Columns that name the part of a survey.
PART = ["source", "region", "scale_group"]
#: Kinds of a source that has streams of several, the first of those there are.
OF_SOURCE = (
    "moving", "not confirmed", "not significant", "stationary", "empty", "failed",
)  # fmt: skip
#: Products of a measurement beside report and figures, in the order of the page.
PRODUCTS = (
    "streams.ecsv components.ecsv spectrum.ecsv features.ecsv positions.ecsv "
    "sensitivity.ecsv epochs.ecsv ssps.ecsv scc.fits publication citations.bib "
    "config.toml"
).split()
#: Width and height of a small profile.
SPARK = (144, 34)


def stream_tables(streams):
    """
    Return the columns of the two tables of streams as text.

    Parameters
    ----------
    streams : `~astropy.table.QTable`

    Returns
    -------
    list of list of (str, str, list of str)
        Heading, meaning and cells of each column.  The first table has the main
        columns, the second the others; both are narrow enough for paper.
    """
    # The notes say these in words.
    listed = {"caution", "pm_limit", *QUOTED, *OTHERS}
    listed |= {f"{name}_err" for name in listed}
    rest = (name for name in streams.colnames if name not in listed)
    others = "stream", *OTHERS, *(k for k in rest if streams[k].ndim == 1)
    return [list(headed(streams, names).values()) for names in (QUOTED, others)]


def _in_words(meaning):
    """Return the meaning of a column that speaks of the speed instead of its column."""
    meaning = re.sub(r"\bpm_err\b", "the error of the speed", meaning)
    return re.sub(r"\bpm\b", "the speed", meaning)


def feature_rows(features, most=MOST):
    """
    Return headings, and rows to show and others, each with whether it is secure.

    Of more than ``most`` secure features, the first are those seen in most epochs.
    """
    shown = dates_as_text(features)
    columns = headed(shown, FEATURES, of_table="features").values()
    heads, _, columns = zip(*columns, strict=True)
    rows = [*zip(zip(*columns, strict=True), features["secure"], strict=True)]
    first = answer.longest(features, most)
    others = np.setdiff1d(np.arange(len(rows)), first)
    return heads, [rows[k] for k in first], [rows[k] for k in others]


def acceleration_text(features):
    """Return the secure features that accelerate, with accelerations, or ''."""
    bent = np.isfinite(features["acc_parallel"]) & np.asarray(features["secure"], bool)
    unit = unit_name(features["acc_parallel"].unit).replace("2", "²")
    each = (f"{row['feature']}: {cell(row, 'acc_parallel')}" for row in features[bent])
    return f"{', '.join(each)} {unit}" if bent.any() else ""


def both_names(name):
    """
    Return a name with that by the coordinates of B1950, or a common one, if known.

    Examples
    --------
    >>> from astro_scc.report.page import both_names
    >>> both_names("0430+052"), both_names("3C 273"), both_names("Crab")
    ('3C 120 (0430+052)', '3C 273 (1226+023)', 'Crab')
    """
    for coordinates, names in common_names().items():
        if plain(name) in (coordinates, *map(plain, names)):
            return f"{names[0] if plain(name) == coordinates else name} ({coordinates})"
    return name


def setting_text(value):
    """Return the value of a setting as text."""
    match value:
        case None:
            return "not given"
        case bool() | np.bool_():
            return "yes" if value else "no"
        case u.Quantity():
            numbers = setting_text(np.atleast_1d(value.value).tolist())
            return f"{numbers} {unit_name(value.unit)}"
        case list() | tuple():
            return ", ".join(map(setting_text, value))
        case float():
            return f"{value:.6g}"
        case {"cosmology": _}:
            return cosmology_text(value)
    return " ".join(str(value).split())


# -- surveys ---------------------------------------------------------------------


def overview(table, features, parts, folder):
    """
    Return what the page of a survey shows.

    Parameters
    ----------
    table, features, parts, folder
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
    # The main stream is that of the largest share of those that move, or the first.
    shares = np.where(np.asarray(table["kind"]) == "moving", table["share"], -1.0)
    order = np.argsort(-shares, kind="stable")[::-1]
    main = {tuple(row[PART]): row for row in table[order]}
    of_part = defaultdict(list)
    for k, names in enumerate(features[PART] if len(features) else ()):
        of_part[tuple(names)].append(k)
    rows = []
    for part in parts:
        names = tuple(getattr(part, name) for name in PART)
        of_features = features[of_part[names]]
        rows.append(_part_cells(part, main[names], of_features, unit, folder))
    moving = [cells for cells in rows if cells["kind"] == "moving"]
    if speeds := [cells["speed"] for cells in moving if "speed" in cells]:
        low, middle, high = (f"{v:.2g}" for v in np.quantile(speeds, [0, 0.5, 1]))
        speeds = f"{low} to {high} {unit_name(unit)}, median {middle}"
    shown = [name for name in OVERVIEW if any(cells[name] for cells in rows)]
    return {
        "rows": rows,
        "columns": {k: heading_of(k, unit_name(unit), "overview") for k in shown},
        "kinds": {k: min(v, key=OF_SOURCE.index) for k, v in every_kind.items()},
        "speeds": speeds,
        "compared": [abs(k["difference"]) for k in moving if "difference" in k],
    }


def _part_cells(part, row, features, unit, folder):
    """Return the text of a region and scale group, its profile and its speed."""
    more = defaultdict(str, kind=part.message)
    cells = dict.fromkeys(OVERVIEW, "")
    cells |= {"source": both_names(part.source), "kind": part.status, "link": ""}
    names = (part.region, part.scale_group)
    cells |= {"more": more, "part": ", ".join(name for name in names if name != "all")}
    if part.n_epochs:
        cells["n_epochs"] = str(part.n_epochs)
        cells["span"], more["span"] = _span(*Time([part.first, part.last]))
    known = known_error = np.nan
    if part.published is not None:
        numbers = np.atleast_1d(part.published.to_value(unit))
        known, known_error, *_ = *numbers, np.nan
        exact = np.isnan(known_error)
        cells["published"] = f"{known:g}" if exact else with_error(known, known_error)
    if part.status != "measured":
        return cells
    cells["kind"], more["kind"] = row["kind"], row["caution"].removeprefix("-")
    cells["n_features"] = str(row["n_features"])
    cells |= {name: cell(row, name, form=".2g") for name in ("p_global", "p_fdr")}
    # Without a feature only what moves has a speed; a scale group has none of its own.
    if row["n_features"] or row["kind"] == "moving" or part.scale_group != "all":
        for name in {"pm", "beta_app"} & {*row.colnames}:
            cells[name] = cell(row, name).removeprefix("-")
        more["pm"] = f"from {row['pm_from']}"
        cells["speed"], error = (row[k].to_value(unit) for k in ("pm", "pm_err"))
        if np.isfinite(error + known):
            off = (cells["speed"] - known) / np.hypot(error, np.nan_to_num(known_error))
            cells["difference"], more["published"] = off, f"{off:+.1f} standard errors"
    report = f"{part.folder}/report.html"
    cells["link"] = report if Path(folder, report).is_file() else ""
    cells["profile"] = _small_profile(features, unit)
    if len(features):
        moving = features["pm"][population(features)["moving"]].to_value(unit)
        cells["fastest"] = f"{max(moving):.3g}" if len(moving) else ""
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
    distance, stream = features["separation"].to_value(u.mas), features["stream"]
    speed = features["pm_radial"].to_value(unit)
    low, high, far = speed.min(initial=0.0), speed.max(initial=0.0), distance.max()

    def place(x, y):
        x = SPARK[0] * x / (far or 1.0)
        return np.round(x, 1), np.round(SPARK[1] * (high - y) / (high - low or 1.0), 1)

    of_first = np.flatnonzero(stream == 1)
    of_first = of_first[np.argsort(distance[of_first])]
    bins = np.array_split(of_first, max(min(len(of_first) // LEAST, MOST_BINS), 1))
    line = [place(np.median(distance[k]), np.median(speed[k])) for k in bins if len(k)]
    lengths = offset_unit(far)
    return {
        "points": [*zip(*place(distance, speed), stream.tolist(), strict=True)],
        "line": " ".join(f"{x},{y}" for x, y in line) if len(line) > 1 else "",
        "zero": place(0, 0.0)[1],
        "range": f"{far * u.mas.to(lengths):.2g} {unit_name(lengths)}, "
        f"{high if high > -low else low:.2g} {unit_name(unit)}",
    }


def write_report(
    result: SCCResult, directory: Path | str, *, streams: QTable | None = None,
    title: str | None = None, warnings: Sequence[str] = (),
    left_out: Sequence[str | tuple[str, str]] = (), chosen: Sequence[str] = (),
    rerun: str | None = None, explore: str | None = None, all_figures: bool = False,
    pdf: bool = False, published: QTable | None = None,
    flow: Sequence[str] | None = None,
) -> Path:  # fmt: skip
    """
    Write a self-contained HTML page on a measurement, and its figures.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    directory : path
        Folder for ``report.html``, and for ``spectrum.png``, ``distance.png``,
        ``diagram.png``, ``separation.png``, ``tracks.png`` and ``speeds.png``, which
        the page holds too.  It is made if need be; files of these names are replaced,
        each when the new one is complete.
    streams : `~astropy.table.QTable`, optional
        By default ``result.streams``; the table of ``result.components_in_c``
        has apparent speeds too.
    title : str, optional
        Heading of the page, by default the name of the object.
    warnings : sequence of str, optional
        What the reader must know, in plain words.
    left_out : sequence of str or of (str, str), optional
        Epochs that were not used, optionally with the reason.
    chosen : sequence of str, optional
        Settings that the images have determined, each with its reason.
    rerun : str, optional
        The command that repeats the measurement.
    explore : str, optional
        The command that writes ``explore.html`` beside the page; the page links to it
        if it is there.
    all_figures : bool, optional
        Draw ``velocity_map.png``, ``significance.png``, ``epochs.png`` and
        ``sensitivity.png``, too, which take longer than the others.
    pdf : bool, optional
        Write each figure as a PDF file, too, as wide as a column of a journal and
        with letters of 8 pt.
    published : `~astropy.table.QTable`, optional
        Published features to compare with, see
        ``astro_scc.products.publication.published_positions``.
    flow : sequence of str, optional
        Sentences on the acceleration and the scales, by default measured here.

    Returns
    -------
    `~pathlib.Path`
        Path of ``report.html``.

    Raises
    ------
    OSError
        If the directory is a file, or cannot be written to.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.report import write_report
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> scc = StackedCrossCorrelation(scales=[1, 2], max_speed=36 * u.mas / u.yr)
    >>> result = scc(simulate_two_fluid(n_epochs=6, rng=1).cube, n_trials=100, rng=1)
    >>> path = write_report(result, "out", title="Two fluids")
    >>> path.name
    'report.html'
    """
    directory = Path(directory)
    features = with_published(result.features, result.tracked_features, published)
    streams = result.streams if streams is None else streams
    make_folder(directory, directory)
    meta = {**result.meta, **streams.meta}
    files = draw_figures(
        result, streams, every=all_figures, pdf=pdf, published=published
    )
    notes = answer.notes(streams, features) + answer.published_lines(features)
    notes += answer.speeds_along(streams.meta)
    in_c = table_in_c_as(features, streams)
    secure = "; ".join(answer.trust_lines(features))
    name = both_names(result.cube.meta.get("object") or "Velocities")
    settings = meta.pop("settings", {}) | meta
    for unused in METHODS["paper"].split():
        settings.pop(unused, None)
    page = _template("report.html").render(
        result=result, title=title or name, streams=streams,
        headline=answer.headline(streams, features), tables=stream_tables(streams),
        aligned=bool(np.any(streams["pm_err_alignment"] > 0)),
        alignment=answer.misalignment_text(settings.pop("misalignment_beams", None)),
        features=feature_rows(in_c), count=answer.feature_count(features),
        secure_words=secure, accelerations=acceleration_text(in_c),
        notes=[line.rstrip(".") for line in notes], settings=settings,
        flow=flow_lines(result) if flow is None else flow,
        depends=result.sensitivity_line, files=files, warnings=warnings,
        left_out=left_out, chosen=[k for k in chosen if "aligned to" not in k],
        rerun=rerun, explore=explore,
        has_explore=(directory / "explore.html").is_file(),
        products=[k for k in (*PRODUCTS, "region.reg") if (directory / k).exists()],
    )  # fmt: skip
    files["report.html"] = page.encode("utf-8")
    write_files(files, directory)
    return directory / "report.html"


def _template(name):
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("astro_scc", "report/templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "in_words": _in_words,
        "address": lambda png: f"data:image/png;base64,{b64encode(png).decode()}",
        "listed": _listed,
        "plural": lambda word, n: word if n == 1 else f"{word}s",
        "text": setting_text,
        "unit": unit_name,
        "signs": lambda text: text.replace("+-", "±").replace("^2", "²"),
        "cell": cell,
    }
    return environment.get_template(name)


def write_overview(table, features, parts, folder):
    """
    Write ``overview.html``, a page with a row for each source of a survey.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        Of `~astro_scc.cli.survey.run_survey`, which is in this folder too.
    features : `~astropy.table.QTable`
        The features of all sources.
    parts : sequence of Part
        Regions and scale groups of the sources, with their outcomes and published
        speeds; their products are read.
    folder : path
        Folder of the survey.

    Returns
    -------
    `~pathlib.Path`
        Path of the page.
    """
    folder, files = Path(folder), {}
    found = population(features) if len(features) else {}
    if found and found["moving"].any():
        files = style.figure_files(("population",), lambda _: plot_population(features))
    names = ("survey.ecsv", "features.ecsv", "publication", "survey.toml")
    page = _template("survey.html").render(
        **overview(table, features, parts, folder),
        title="Survey of proper motions",
        population={name: int(use.sum()) for name, use in found.items()},
        n_jets=len({*features["source"][found["moving"]]}) if found else 0,
        figure=files.get("population.png"),
        in_c="beta_app" in features.colnames,
        products=[name for name in names if (folder / name).exists()],
        versions=table.meta.get("versions", {}),
    )
    files["overview.html"] = page.encode("utf-8")
    write_files(files, folder)
    return folder / "overview.html"


def _listed(words):
    """Join words with commas, and the last one with "and"."""
    *most, last = map(str, words)
    return f"{', '.join(most)} and {last}" if most else last


def draw_figures(result, streams, *, every=False, pdf=False, published=None):
    """
    Return the figures as PNG files, and as PDF, without those that are empty.

    Only those that the page shows at once are drawn, unless ``every`` is True.
    """
    per_pm, rows = {"beta_per_pm": beta_per_pm(streams)}, {"components": streams}
    options = {"spectrum": per_pm, "distance": per_pm, "diagram": rows}
    if len(result.features):
        options["speeds"] = per_pm | {"profile": feature_profile(result)}
        options["tracks"] = {"published": published}
        options["separation"] = per_pm | options["tracks"]
    if every:
        options |= dict.fromkeys(("velocity_map", "significance"), rows | per_pm)
        options |= {"epochs": {}}
        options |= {"sensitivity": per_pm} if len(result.sensitivity) else {}
    return style.figure_files(
        options, lambda kind: result.plot(kind, **options[kind]), pdf=pdf
    )


def flow_lines(result):
    """
    Return the acceleration of the moving streams and the speeds of their scales.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`

    Returns
    -------
    list of str
        Sentences without a full stop; empty if nothing moves.
    """
    moving = [k for k, s in enumerate(result.search.streams) if s.kind == "moving"]
    each = zip(moving, accelerations(result, moving), strict=True)
    lines = [f"Stream {k + 1}: {found}" for k, found in each]
    if moving and (of_scales := compare_scales(result)) is not None:
        in_speed_unit(of_scales, result.cube.speed_unit)
        # With two streams, scales whose speeds do not differ need not share one speed.
        differ = of_scales["p_value"] <= result.meta["settings"]["alpha"]
        lines += answer.scale_lines(of_scales[differ] if moving[1:] else of_scales)
    return lines
