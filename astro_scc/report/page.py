# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A measurement as one page to read, the answer first."""

from importlib import resources
from pathlib import Path

from astro_scc.partial import replace_when_complete
from astro_scc.report.answer import answers, chances, edge_remarks, facts, headline
from astro_scc.report.figures import draw_pictures
from astro_scc.report.tables import (
    component_rows,
    epoch_rows,
    feature_rows,
    in_easy_units,
    setting_rows,
)

__all__ = ["write_report"]

#: What else may be in the folder, in this order.
PRODUCTS = (
    "components.ecsv",
    "features.ecsv",
    "components.vot",
    "ssps.ecsv",
    "ssps.vot",
    "scc.fits",
    "config.toml",
    "region.reg",
)


def write_report(
    result,
    components,
    directory,
    *,
    title,
    warnings=(),
    left_out=(),
    rerun=None,
    config_text=None,
):
    """
    Write a measurement as an HTML page that stands alone, and its figures.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    components : `~astropy.table.QTable`
        ``result.components``, or the table with apparent speeds of
        ``result.components_in_c``.
    directory : path
        Gets ``report.html``, and ``diagram.png``, ``velocity_map.png``,
        ``significance.png``, ``members.png``, ``epochs.png`` and
        ``intervals.png``, which the page holds too.  It is made if need be;
        files of these names are replaced, each when the new one is complete.
    title : str
        Heading of the page, the name of the object.
    warnings : sequence of str, optional
        What the reader must know, in plain words.
    left_out : sequence of str or of (str, str), optional
        Epochs that were not used, each with the reason.
    rerun : str, optional
        The command that does the measurement again.
    config_text : str, optional
        The configuration as text.

    Returns
    -------
    `~pathlib.Path`
        Of ``report.html``.

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
    >>> path = write_report(result, result.components, "out", title="Two fluids")
    >>> path.name
    'report.html'
    """
    import jinja2

    from astro_scc.visualization.style import component_kinds

    directory = Path(directory)
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise OSError(f"{directory}: is a file; choose another folder") from None
    kinds = component_kinds(components)
    pictures = draw_pictures(result, components)
    easy = in_easy_units(components)
    tables, notes = component_rows(easy, kinds)
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    template = resources.files("astro_scc.report").joinpath("page.html")
    page = environment.from_string(template.read_text(encoding="utf-8")).render(
        title=str(title),
        facts=facts(result),
        headline=headline(kinds),
        answers=answers(easy, kinds),
        chances=chances(result, components, kinds),
        warnings=[str(w) for w in warnings] + edge_remarks(result, components, kinds),
        figures=pictures,
        kinds=kinds,
        tables=tables,
        notes=notes,
        epochs=epoch_rows(result),
        features=feature_rows(easy, result.features),
        left_out=[(w, "") if isinstance(w, str) else tuple(w) for w in left_out],
        settings=setting_rows(result, components),
        rerun=rerun,
        config_text=config_text,
        history=[str(line) for line in result.cube.meta.get("history", ())],
        versions=", ".join(f"{k} {v}" for k, v in _versions(result).items()),
        products=[name for name in PRODUCTS if (directory / name).is_file()],
    )
    files = {f"{picture.name}.png": picture.png for picture in pictures}
    files["report.html"] = page.encode("utf-8")
    for name, content in files.items():
        with replace_when_complete(directory / name, overwrite=True) as part:
            part.write_bytes(content)
    return directory / "report.html"


def _versions(result):
    return {str(k): str(v) for k, v in result.meta.get("versions", {}).items()}
