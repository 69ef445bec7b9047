# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A measurement as one page to read, the answer first."""

import base64
import io
import math
import os
from importlib import resources
from pathlib import Path

import astropy.units as u
import numpy as np

__all__ = ["write_report"]

#: Dots per inch of the figures, which are six inches wide.
DPI = 150
NUMBERS = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
PRODUCTS = ("components.ecsv", "ssps.ecsv", "scc.fits", "config.toml", "region.reg")

CAPTIONS = {
    "velocity_map": (
        "Velocity map",
        "How well the patterns of the images agree when they are moved at each "
        "velocity.  A bright spot is a speed that many patterns share; its number is "
        "that of the table, and the ellipse is one standard error.  A square is "
        "structure that stands still; an oblique cross with a dotted ellipse may be "
        "chance.",
    ),
    "significance": (
        "Significance along the jet",
        "The map against those of shuffled epochs, in standard deviations, along the "
        "jet, as in the paper.  It is no probability: that is p_global.  Open signs "
        "are components off the axis.",
    ),
    "members": (
        "Which patterns make which component",
        "Each arrow leads from a pattern (SSP) to its match in a later epoch, drawn on "
        "the mean image.  A speed that is real has arrows in many places or all along "
        "a part of the jet.",
    ),
    "epochs": (
        "Epochs and their patterns",
        "All images on one colour scale with the significant structural patterns "
        "(SSPs), larger circles for larger scales.  The ellipse is the beam.",
    ),
    "intervals": (
        "Dates and pairs of epochs",
        "Ticks are epochs.  Each bar joins two epochs that are compared, as high as "
        "the time between them.",
    ),
}

#: Columns of the page: name, heading with {unit}, decimals where there is no error.
COLUMNS = (
    ("component", "No.", 0),
    ("kind", "kind", 0),
    ("pm", "speed ({unit})", 3),
    ("beta_app", "speed (c)", 3),
    ("pm_pa", "PA ({unit})", 0),
    ("p_global", "p_global", 3),
    ("z_score", "z", 1),
    ("n_ssp", "SSPs", 0),
    ("n_pairs", "pairs", 0),
    ("n_features", "features", 0),
    ("pm_parallel", "along ({unit})", 3),
    ("pm_transverse", "across ({unit})", 3),
    ("pm_ra_cosdec", "east ({unit})", 3),
    ("pm_dec", "north ({unit})", 3),
    ("coefficient", "coefficient", 3),
    ("pm_err_jitter", "paper's error of the speed ({unit})", 3),
    ("pm_err_alignment", "error by alignment ({unit})", 3),
    ("pm_err_epochs", "error by epochs ({unit})", 3),
    ("p_local", "p_local", 3),
    ("p_smallest", "smallest p_global", 3),
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
        Gets ``report.html``, and ``velocity_map.png``, ``significance.png``,
        ``members.png``, ``epochs.png`` and ``intervals.png``, which the page
        holds too.  It is made if need be; files of these names are replaced,
        each when the new one is complete.
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
    pictures = _pictures(result, components)
    environment = jinja2.Environment(
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    template = resources.files("astro_scc").joinpath("templates", "report.html")
    page = environment.from_string(template.read_text(encoding="utf-8")).render(
        title=str(title),
        facts=_facts(result),
        headline=_headline(kinds),
        answers=_answers(components, kinds),
        chances=_chances(result, components, kinds),
        warnings=[str(w) for w in warnings] + _edge_remarks(result, components, kinds),
        figures=[
            {
                "name": name,
                "title": CAPTIONS[name][0],
                "caption": CAPTIONS[name][1],
                "data": base64.b64encode(png).decode("ascii"),
            }
            for name, png in pictures.items()
        ],
        table=_component_rows(components, kinds),
        epochs=_epoch_rows(result),
        left_out=[(w, "") if isinstance(w, str) else tuple(w) for w in left_out],
        settings=_settings(result, components),
        rerun=rerun,
        config_text=config_text,
        history=[str(line) for line in result.cube.meta.get("history", ())],
        versions=", ".join(f"{k} {v}" for k, v in _versions(result).items()),
        products=[name for name in PRODUCTS if (directory / name).is_file()],
    )
    for name, png in pictures.items():
        _write(directory / f"{name}.png", png)
    return _write(directory / "report.html", page.encode("utf-8"))


def _pictures(result, components):
    """The figures as PNG, by name."""
    from astro_scc import visualization as show

    beta = _beta_per_pm(components)
    shared = {"components": components, "beta_per_pm": beta}
    figures = {
        "velocity_map": show.plot_velocity_map(result, **shared),
        "significance": show.plot_significance(result, **shared),
        "members": show.plot_members(result, components=components),
        "epochs": show.plot_epochs(result.cube, result.ssps),
        "intervals": show.plot_intervals(result.cube, result.pairs),
    }
    if len(components) == 0:
        del figures["members"]
    pictures = {}
    for name, figure in figures.items():
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=DPI)
        pictures[name] = buffer.getvalue()
    return pictures


def _write(path, content):
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    return path


# -- words --------------------------------------------------------------------


def _headline(kinds):
    moving, standing = kinds.count("moving"), kinds.count("stationary")
    if moving:
        text = f"{_number(moving).capitalize()} {_plural(moving, 'speed')} "
        text += "stand out" if moving > 1 else "stands out"
        beside = ", beside what does not move within its errors" if standing else ""
        return f"{text}{beside}."
    if standing:
        return "No speed stands out: what patterns share does not move."
    return "No speed stands out" + (" from chance." if kinds else ".")


def _answers(components, kinds):
    """One sentence in two parts for each component that was found."""
    answers = []
    for row, kind in zip(components, kinds, strict=True):
        if kind == "uncertain":
            continue
        unit = _unit(components["pm"].unit)
        speed = f"{with_error(_value(row['pm']), _value(row['pm_err']))} {unit}"
        if "beta_app" in components.colnames:
            beta = with_error(_value(row["beta_app"]), _value(row["beta_app_err"]))
            speed += f" = {beta} c"
        angle, error = _value(row["pm_pa"]), _value(row["pm_pa_err"])
        if kind == "stationary":
            more = "stationary: no motion within the errors"
        elif math.isfinite(angle):
            more = f"towards position angle {with_error(angle, max(error, 1))} deg"
        else:
            more = "outward" if _value(row["pm_parallel"]) > 0 else "inward"
        if "p_global" in components.colnames:
            more += f"; p_global {_value(row['p_global']):.2g}"
        more += (
            f"; {int(row['n_ssp'])} SSPs in {int(row['n_pairs'])} "
            f"{_plural(int(row['n_pairs']), 'pair')} of epochs"
        )
        answers.append((int(row["component"]), speed, more))
    return answers


def _chances(result, components, kinds):
    """Sentences on how sure the answer is."""
    if not len(components) or "p_global" not in components.colnames:
        return []
    level = result.meta["settings"]["level"]
    n_trials = result.meta["n_trials"]
    said = [
        "p_global is the probability that a jet whose features move but share no "
        "speed (scramble), or whose epochs have no order (shuffle), shows as much at "
        "any velocity: the larger of the two; "
        f"{n_trials} trials show none below {1 / (n_trials + 1):.2g}."
    ]
    said += _limits(result, components, kinds, level)
    who, more = _numbers(components, kinds, "stationary")
    if who:
        said.append(
            f"{who} of the table, stationary, {'do' if more else 'does'} not move "
            f"within {'their' if more else 'its'} errors: no discovery of a speed."
        )
    who, _ = _numbers(components, kinds, "uncertain")
    if who:
        said.append(
            f"{who} of the table, with p_global above {level:g}, may be chance."
        )
    return said


def _limits(result, components, kinds, level):
    """Whether epochs or trials are too few for anything to be significant."""
    smallest = [
        _value(row["p_smallest"])
        for row, kind in zip(components, kinds, strict=True)
        if kind != "stationary" and "p_smallest" in components.colnames
    ]
    worst = max(smallest, default=0.0)
    if worst <= level:
        return []
    n = len(result.cube)
    said = f"cannot be below {worst:.2g}"
    if worst <= 2 / math.factorial(min(n, 20)):
        return [
            f"With {n} epochs p_global {said} (2/N!): with so few no component that "
            "moves can be significant; measure more epochs."
        ]
    return [
        f"With {result.meta['n_trials']} trials p_global {said}: with so few no "
        "component can be significant; measure with more."
    ]


def _numbers(components, kinds, kind):
    """The components of a kind as text, and whether they are several."""
    numbers = [
        str(int(number))
        for number, own in zip(components["component"], kinds, strict=True)
        if own == kind
    ]
    if not numbers:
        return "", False
    return f"{_plural(len(numbers), 'Component')} {_list(numbers)}", len(numbers) > 1


def _edge_remarks(result, components, kinds):
    """What to do about components that were found where the map ends."""
    if not len(components):
        return []
    columns = ("pm_parallel", "pm_transverse")
    if tuple(result.frame.axis_names) == ("east", "north"):
        columns = ("pm_ra_cosdec", "pm_dec")
    near = np.zeros(len(components), bool)
    found = [kind != "uncertain" for kind in kinds]
    for name, end, step in zip(
        columns, result.grid.v_max, result.grid.step, strict=True
    ):
        speed = np.abs(u.Quantity(components[name]).to_value(u.mas / u.yr))
        near |= speed > end - 2 * step
    numbers = [str(int(n)) for n in np.asarray(components["component"])[near & found]]
    if not numbers:
        return []
    which = f"{_plural(len(numbers), 'Component')} {_list(numbers)}"
    verb = "is" if len(numbers) == 1 else "are"
    return [
        f"{which} {verb} at the edge of the velocity map, where maxima are cut off: "
        "measure with a larger max_speed before you believe "
        + ("it." if len(numbers) == 1 else "them.")
    ]


def _facts(result):
    cube = result.cube
    dates = cube.times.strftime("%Y-%m-%d")
    used = result.ssps
    if "in_region" in used.colnames:
        used = used[np.asarray(used["in_region"], bool)]
    scales = np.unique(np.asarray(result.ssps["scale"], dtype=float))
    n = len(result.pairs)
    return [
        f"{len(cube)} epochs, {dates[0]} to {dates[-1]}",
        f"{n} {_plural(n, 'pair')} of epochs compared",
        f"{len(used)} significant structural patterns (SSPs) on "
        f"{len(scales)} {_plural(len(scales), 'scale')}",
    ]


# -- tables -------------------------------------------------------------------


def _component_rows(components, kinds):
    """Head, rows and explanations of the table of components."""
    known = [column for column in COLUMNS if column[0] in components.colnames]
    taken = {name for name, *_ in COLUMNS}
    taken |= {f"{name}_err" for name in taken}
    known += [
        (name, name, 3)
        for name in components.colnames
        if name not in taken and components[name].ndim == 1
    ]
    head, notes = [], []
    for name, heading, _ in known:
        column = components[name]
        heading = heading.format(unit=_unit(getattr(column, "unit", None)))
        head.append(heading)
        if column.info.description:
            notes.append((heading, column.info.description))
    rows = [
        (kind, [_cell(components, row, name, digits) for name, _, digits in known])
        for row, kind in zip(components, kinds, strict=True)
    ]
    return {"head": head, "rows": rows, "notes": notes}


def _cell(components, row, name, digits):
    value = _value(row[name])
    if isinstance(value, str):
        return value
    if f"{name}_err" in components.colnames:
        return with_error(value, _value(row[f"{name}_err"]))
    # A probability may be small, but is never rounded to nothing.
    return f"{value:.2g}" if name.startswith("p_") else f"{value:.{digits}f}"


def _epoch_rows(result):
    table = result.cube.epochs
    counts = np.bincount(
        np.asarray(result.ssps["epoch"], dtype=int), minlength=len(result.cube)
    )
    days = [date.strftime("%Y-%m-%d") for date in table["date"]]
    times = [date.strftime("%Y-%m-%d %H:%M") for date in table["date"]]
    head = ["Date"]
    columns = [days if len(set(days)) == len(days) else times]
    labels = [str(label) for label in table["label"]]
    if labels != days:
        head.insert(0, "Epoch")
        columns.insert(0, labels)
    if "major" in table.colnames:
        head.append("Beam (mas, deg)")
        columns.append(
            [
                f"{row['major'].to_value(u.mas):.3g} x "
                f"{row['minor'].to_value(u.mas):.3g} at {row['pa'].to_value(u.deg):.0f}"
                for row in table
            ]
        )
    noise = u.Quantity(table["noise"])
    head.append(f"Noise ({_unit(noise.unit)})" if _unit(noise.unit) else "Noise")
    columns.append([f"{value:.2g}" for value in noise.value])
    head.append("SSPs")
    columns.append([str(count) for count in counts])
    return {"head": head, "rows": list(zip(*columns, strict=True))}


def _settings(result, components):
    """Settings as pairs of name and text."""
    meta = {**result.meta, **components.meta}
    pairs = dict(meta.pop("settings", {}))
    for name in ("versions", "history", "configuration"):
        meta.pop(name, None)
    pairs.update(meta)
    return [
        (str(name).replace("_", " "), _text(value)) for name, value in pairs.items()
    ]


def _text(value):
    if value is None:
        return "not given"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, u.Quantity):
        unit = _unit(value.unit)
        return f"{_list([f'{v:.6g}' for v in np.atleast_1d(value.value)])} {unit}"
    if isinstance(value, list | tuple):
        return ", ".join(_text(v) for v in value)
    if isinstance(value, float):
        return f"{value:.6g}"
    return " ".join(str(value).split())


def _versions(result):
    return {str(k): str(v) for k, v in result.meta.get("versions", {}).items()}


# -- numbers ------------------------------------------------------------------


def with_error(value, error):
    """A value and its error, to two digits of the error."""
    if not math.isfinite(value):
        return "-"
    if not (math.isfinite(error) and error > 0):
        return f"{value:.3g}"
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{digits}f} \N{PLUS-MINUS SIGN} {error:.{digits}f}"


def _value(item):
    """A plain number, or text, of a cell."""
    item = getattr(item, "value", item)
    return item if isinstance(item, str) else float(item)


def _beta_per_pm(components):
    """Apparent speed in units of c of 1 mas/yr, if the table tells."""
    if "beta_app" not in components.colnames:
        return None
    speed = u.Quantity(components["pm"]).to_value(u.mas / u.yr)
    beta = np.asarray(components["beta_app"], dtype=float)
    usable = (speed > 0) & (beta > 0)
    return float(beta[usable][0] / speed[usable][0]) if usable.any() else None


def _unit(unit):
    return "" if unit is None else u.Unit(unit).to_string().replace(" / ", "/")


def _number(n):
    return NUMBERS[n] if n < len(NUMBERS) else str(n)


def _plural(n, word):
    return word if n == 1 else f"{word}s"


def _list(words):
    return ", ".join(words[:-1]) + " and " + words[-1] if len(words) > 1 else words[0]
