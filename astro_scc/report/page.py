# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Write a measurement, or a survey, as one page; the templates have the sentences."""

from base64 import b64encode
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from astropy.table import QTable

from astro_scc.columns import cell
from astro_scc.flow import feature_profile, measure_acceleration
from astro_scc.flow.speeds import compare_scales
from astro_scc.kinematics.cosmology import beta_per_pm, table_in_c_as
from astro_scc.measurement import SCCResult
from astro_scc.measurement.tables import printed
from astro_scc.products.folder import write_files
from astro_scc.report import answer, tables
from astro_scc.stacking.stack import number_of_permutations
from astro_scc.units import in_speed_unit, unit_name
from astro_scc.visualization import speeds, style
from astro_scc.writing import make_folder

#: Products of a measurement beside report and figures, in the order of the page.
PRODUCTS = (
    "components.ecsv features.ecsv positions.ecsv sensitivity.ecsv epochs.ecsv "
    "ssps.ecsv scc.fits publication config.toml"
).split()
#: Speeds above this fraction of the largest one searched are pointed out.
EDGE = 0.9


def write_report(
    result: SCCResult, directory: Path | str, *, components: QTable | None = None,
    title: str | None = None, warnings: Sequence[str] = (),
    left_out: Sequence[str | tuple[str, str]] = (), chosen: Sequence[str] = (),
    rerun: str | None = None, explore: str | None = None, all_figures: bool = False,
    pdf: bool = False, published: QTable | None = None,
) -> Path:  # fmt: skip
    """
    Write a self-contained HTML page on a measurement, and its figures.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    directory : path
        Folder for ``report.html``, and for ``separation.png``, ``tracks.png``,
        ``diagram.png`` and ``speeds.png``, which the page holds too.  It is made if
        need be; files of these names are replaced, each when the new one is complete.
    components : `~astropy.table.QTable`, optional
        By default ``result.components``; the table of ``result.components_in_c``
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
        Draw ``velocity_map.png``, ``significance.png``, ``members.png``,
        ``epochs.png``, ``intervals.png`` and ``sensitivity.png``, too, which take
        longer than the others.
    pdf : bool, optional
        Write each figure as a PDF file, too, as wide as a column of a journal and
        with letters of 8 pt.
    published : `~astropy.table.QTable`, optional
        Published features to compare with, see
        ``astro_scc.products.published.published_positions``.

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
    >>> result = scc(simulate_two_fluid(n_epochs=5, rng=1).cube, n_trials=50, rng=1)
    >>> path = write_report(result, "out", title="Two fluids")
    >>> path.name
    'report.html'
    """
    directory = Path(directory)
    components = result.components if components is None else components
    make_folder(directory, directory)
    how = {"every": all_figures, "pdf": pdf, "published": published}
    shown = printed(components)
    # Of all rows that the figures mark they need the places.
    jet = components[np.isin(components["component"], shown["component"])]
    files = draw_figures(result, jet, **how)
    features = table_in_c_as(printed(result.features), components)
    meta = {**result.meta, **components.meta}
    page = _template("report.html").render(
        result=result,
        title=title or result.cube.meta.get("object") or "Velocity components",
        components=shown,
        headline=answer.headline(components),
        tables=tables.component_tables(shown),
        zip=zip,
        features=tables.feature_rows(features),
        notes=answer.notes(components, result.features),
        settings=meta.pop("settings", {}) | meta,
        smallest_of_epochs=1 / number_of_permutations(len(result.cube)),
        fast=fast_components(result, components),
        flow=flow_lines(result),
        depends=result.sensitivity_line,
        files=files,
        warnings=warnings,
        left_out=left_out,
        chosen=chosen,
        rerun=rerun,
        explore=explore,
        has_explore=(directory / "explore.html").is_file(),
        products=[k for k in (*PRODUCTS, "region.reg") if (directory / k).exists()],
    )
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
        "address": lambda png: f"data:image/png;base64,{b64encode(png).decode()}",
        "listed": _listed,
        "plural": lambda word, n: word if n == 1 else f"{word}s",
        "text": tables.setting_text,
        "unit": unit_name,
        "printed": lambda text: text.replace("+-", "±").replace("^2", "²"),
        "cell": cell,
    }
    return environment.get_template(name)


def write_overview(table, features, parts, folder, *, published):
    """
    Write ``overview.html``, a page with a row for each source of a survey.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        Of `~astro_scc.cli.survey.run_survey`, which is in this folder too.
    features : `~astropy.table.QTable`
        The features of all sources.
    parts : sequence of `~astro_scc.cli.survey.Outcome`
        The regions and scale groups of the sources; their products are read.
    folder : path
        Folder of the survey.
    published : dict of str to `~astropy.units.Quantity` or None
        Published speed of each source, with its error if there are two numbers.

    Returns
    -------
    `~pathlib.Path`
        Path of the page.
    """
    folder, files = Path(folder), {}
    found = speeds.population(features)
    if found["moving"].any():
        plot = partial(speeds.plot_population, features)
        files = style.figure_files({"population": plot})
    names = ("survey.ecsv", "features.ecsv", "publication", "survey.toml")
    page = _template("survey.html").render(
        **tables.overview(table, features, parts, folder, published),
        title="Survey of proper motions",
        population={name: int(use.sum()) for name, use in found.items()},
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


def draw_figures(result, components, *, every=False, pdf=False, published=None):
    """
    Return the figures as PNG files, and as PDF, without those that are empty.

    Only the four that the page shows at once are drawn, unless ``every`` is True.
    """
    per_pm, rows = {"beta_per_pm": beta_per_pm(components)}, {"components": components}
    options = {"diagram": rows}
    if len(result.features):
        own = {"component": printed(result.features)["component"]}
        options["speeds"] = {"profile": feature_profile(result), **per_pm, **own}
        own["published"] = published
        options |= {"tracks": own, "separation": own | per_pm}
    if every:
        options |= dict.fromkeys(("velocity_map", "significance"), rows | per_pm)
        options |= {"epochs": {}, "intervals": {}}
    if every and len(components):
        options["members"] = rows
    if every and len(result.sensitivity):
        options["sensitivity"] = per_pm
    figures = {kind: partial(result.plot, kind, **how) for kind, how in options.items()}
    return style.figure_files(figures, pdf=pdf)


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
    lines = [f"Stream {k + 1}: {measure_acceleration(result, row=k)}" for k in moving]
    if moving and (of_scales := compare_scales(result)) is not None:
        in_speed_unit(of_scales, result.cube.speed_unit)
        # With two streams, scales whose speeds do not differ need not share one speed.
        differ = of_scales["p_value"] <= result.meta["settings"]["alpha"]
        lines += answer.scale_lines(of_scales[differ] if moving[1:] else of_scales)
    return lines


def fast_components(result, components):
    """Return the numbers of moving streams near the largest speed searched."""
    fastest = result.search.permutations.speed.max()
    moving = components["component"][components["kind"] == "moving"]
    streams = result.search.streams
    return [n for n in moving if abs(streams[n - 1].along.mean) > EDGE * fastest]
