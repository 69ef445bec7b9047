# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Write a measurement, or a survey, as one page; the templates have the sentences."""

import base64
import io
import math
from collections.abc import Sequence
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc.flow import feature_profile, measure_acceleration
from astro_scc.flow.groups import compare_scales
from astro_scc.measurement import SCCResult
from astro_scc.measurement.sensitivity import sensitivity_line
from astro_scc.partial import replace_when_complete
from astro_scc.quantities import with_error
from astro_scc.report import tables
from astro_scc.report.tables import plain_value, unit_text
from astro_scc.units import in_easy_units

#: Other products that the folder may hold, in the order of the page.
PRODUCTS = (
    "components.ecsv components.tex features.ecsv sensitivity.ecsv components.vot "
    "ssps.ecsv ssps.vot scc.fits config.toml region.reg"
).split()
#: Dots per inch of the figures, which are at most six inches wide.
DPI = 150
#: Speeds above this fraction of the largest one searched are pointed out.
EDGE = 0.9
NUMBERS = "no one two three four five six seven eight nine".split()


def write_report(
    result: SCCResult, directory: Path | str, *, components: QTable | None = None,
    title: str | None = None, warnings: Sequence[str] = (),
    left_out: Sequence[str | tuple[str, str]] = (), chosen: Sequence[str] = (),
    rerun: str | None = None, explore: str | None = None,
    config_text: str | None = None, pdf: bool = False,
) -> Path:  # fmt: skip
    """
    Write a self-contained HTML page on a measurement, and its figures.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    directory : path
        Folder for ``report.html``, and for ``streams.png``, ``diagram.png``,
        ``speeds.png``, ``distances.png``, ``members.png``, ``velocity_map.png``,
        ``significance.png``, ``epochs.png``, ``intervals.png`` and
        ``sensitivity.png``, which the page holds too.  It is made if need be; files
        of these names are replaced, each when the new one is complete.
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
    config_text : str, optional
        The configuration as text.
    pdf : bool, optional
        Write each figure as a PDF file, too.

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
    title = title or result.cube.meta.get("object") or "Velocity components"
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise OSError(f"{directory}: is a file; choose another folder") from None
    files = draw_figures(result, components, pdf=pdf)
    pngs = {name: file for name, file in files.items() if name.endswith(".png")}
    page = _template("report.html").render(
        **_findings(result, components),
        title=str(title),
        warnings=[str(warning) for warning in warnings],
        figures={name[:-4]: _address(png) for name, png in pngs.items()},
        epochs=tables.epoch_rows(result),
        left_out=[(w, "") if isinstance(w, str) else tuple(w) for w in left_out],
        chosen=chosen,
        settings=tables.setting_rows(result, components),
        rerun=rerun,
        explore=explore,
        has_explore=(directory / "explore.html").is_file(),
        config_text=config_text,
        history=[str(line) for line in result.cube.meta.get("history", ())],
        versions=result.meta.get("versions", {}),
        products=[name for name in PRODUCTS if (directory / name).is_file()],
    )
    files["report.html"] = page.encode("utf-8")
    for name, content in files.items():
        with replace_when_complete(directory / name, overwrite=True) as part:
            part.write_bytes(content)
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
    environment.tests["finite"] = math.isfinite
    environment.filters |= {
        "plural": lambda word, n: word if n == 1 else f"{word}s",
        "listed": _listed,
        "with_error": with_error,
        "word": lambda n: NUMBERS[n] if n < len(NUMBERS) else str(n),
    }
    return environment.get_template(name)


def write_overview(table, parts, folder, *, published):
    """
    Write ``overview.html``, a page with a row for each source of a survey.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        Of `~astro_scc.cli.survey.run_survey`, which is in this folder too.
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
    path = Path(folder) / "overview.html"
    found = tables.overview(table, parts, path.parent, published)
    page = _template("survey.html").render(
        **found,
        title="Survey of proper motions",
        products=["survey.ecsv", "survey.toml"],
        versions=table.meta.get("versions", {}),
    )
    with replace_when_complete(path, overwrite=True) as part:
        part.write_text(page, encoding="utf-8")
    return path


def _listed(words):
    """Join words with commas, and the last one with "and"."""
    words = [str(word) for word in words]
    return ", ".join(words[:-1]) + " and " + words[-1] if len(words) > 1 else words[0]


def _address(png):
    """Return a picture as a data URI."""
    return f"data:image/png;base64,{base64.b64encode(png).decode('ascii')}"


def draw_figures(result, components, *, pdf=False):
    """Return the figures as PNG files, and as PDF, without those that are empty."""
    from astro_scc import visualization as show
    from astro_scc.visualization.features import plot_sensitivity

    per_pm = _beta_per_pm(components)
    shared = {"components": components, "beta_per_pm": per_pm}
    figures = {
        "streams": show.plot_streams(result),
        "diagram": show.plot_diagram(result, components=components),
        "speeds": show.plot_feature_speeds(
            result, profile=feature_profile(result), beta_per_pm=per_pm
        ),
        "distances": show.plot_feature_distances(result),
        "members": show.plot_members(result, components=components),
        "velocity_map": show.plot_velocity_map(result, **shared),
        "significance": show.plot_significance(result, **shared),
        "epochs": show.plot_epochs(result.cube, result.ssps),
        "intervals": show.plot_intervals(result.cube, result.pairs),
    }
    if len(components) == 0:
        del figures["members"]
    if len(result.features) == 0:
        del figures["streams"], figures["speeds"], figures["distances"]
    if len(result.sensitivity):
        figures["sensitivity"] = plot_sensitivity(
            result.sensitivity, beta_per_pm=per_pm
        )
    found = {}
    metadata = {"png": None, "pdf": {"CreationDate": None}}
    for name, figure in figures.items():
        for kind in ("png", "pdf") if pdf else ("png",):
            buffer = io.BytesIO()
            figure.savefig(buffer, format=kind, dpi=DPI, metadata=metadata[kind])
            found[f"{name}.{kind}"] = buffer.getvalue()
    return found


def _beta_per_pm(components):
    """Return the apparent speed in units of c of 1 mas/yr, if the table gives it."""
    if "beta_app" not in components.colnames:
        return None
    speed = u.Quantity(components["pm"]).to_value(u.mas / u.yr)
    beta = np.asarray(components["beta_app"], dtype=float)
    usable = (speed > 0) & (beta > 0)
    return float(beta[usable][0] / speed[usable][0]) if usable.any() else None


def _findings(result, components):
    """Return the values that the template needs for sentences, tables and captions."""
    from astro_scc.visualization.style import component_kinds

    kinds = component_kinds(components)
    easy = in_easy_units(components)
    shown, notes = tables.component_rows(easy, kinds)
    names = [name for name in easy.colnames if easy[name].ndim == 1]
    rows = [
        {name: plain_value(row[name]) for name in names} | {"kind": kind}
        for row, kind in zip(easy, kinds, strict=True)
    ]
    fast = fast_components(result, rows)
    inside = np.asarray(result.ssps["in_region"], bool)
    return {
        "components": rows,
        "kinds": kinds,
        "unit": unit_text(easy["pm"].unit),
        "tables": shown,
        "notes": notes,
        "features": tables.feature_rows(easy, result.features),
        "fast": fast,
        "flow": flow_lines(result),
        "depends": sensitivity_line(result.sensitivity),
        "sensitivity": tables.sensitivity_rows(easy, result.sensitivity),
        "dates": result.cube.times.strftime("%Y-%m-%d"),
        "n_pairs": int(result.search.diagram.n_pairs.sum()),
        "n_map_pairs": len(result.pairs),
        "n_ssps": len(inside),
        "n_inside": int(inside.sum()),
        "n_scales": len(np.unique(np.asarray(result.ssps["scale"], dtype=float))),
        "axes": result.frame.axis_names,
        "alpha": result.meta["settings"]["alpha"],
        "n_trials": result.meta["n_trials"],
        "smallest_of_epochs": 2 / math.factorial(min(len(result.cube), 20)),
    }


def flow_lines(result):
    """
    Return the acceleration of the moving components and the speeds of their scales.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`

    Returns
    -------
    list of str
        Sentences without a full stop; empty if nothing moves.
    """
    moving = [k for k, s in enumerate(result.search.streams) if s.kind == "moving"]
    lines = [f"{k + 1}: {measure_acceleration(result, row=k)}" for k in moving]
    if moving and (of_scales := compare_scales(result)) is not None:
        # Where there are two streams, scales of no difference have no common speed.
        differ = of_scales["p_value"] <= result.meta["settings"]["alpha"]
        lines += tables.scale_lines(of_scales[differ] if moving[1:] else of_scales)
    return lines


def fast_components(result, rows):
    """Return the numbers of moving components near the largest speed searched."""
    fastest = result.search.permutations.speed.max()
    moving = [int(row["component"]) for row in rows if row["kind"] == "moving"]
    speeds = [abs(result.search.streams[number - 1].along.mean) for number in moving]
    return [n for n, v in zip(moving, speeds, strict=True) if v > EDGE * fastest]
