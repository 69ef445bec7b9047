# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tables for journals and archives, and published features to compare with."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.io.votable import from_table
from astropy.io.votable.exceptions import W50
from astropy.io.votable.tree import CooSys, Param, TimeSys
from astropy.table import Column, MaskedColumn, QTable, Table
from astropy.time import Time
from astropy.utils.masked import Masked

from astro_scc import writing
from astro_scc.columns import column_of, describe, round_to_errors
from astro_scc.epochs import read_components
from astro_scc.epochs.tables import open_table, source_names
from astro_scc.exceptions import warn
from astro_scc.kinematics.cosmology import source_text
from astro_scc.measurement.tables import paper_table
from astro_scc.units import PM_UNIT
from astro_scc.writing import ascii_line

if TYPE_CHECKING:
    from astro_scc.epochs import EpochCube
    from astro_scc.features import Features

FOLDER = "publication"
#: Captions, with the name of the source in braces.
CAPTIONS = {
    "streams": "Velocities of the streams{}",
    "features": "Features{} and their motions",
    "positions": "Positions of the features{}",
    "profile": "Velocities of the streams{} in bins of core separation",
}
#: Longer tables may break over pages.
ONE_PAGE = 40
#: Of longer VOTables the rows are binary.
MANY_ROWS = 2000
#: Most digits after the point of a number in an archive.
DIGITS = 8
#: A published feature has at least so many epochs, and so many of those in common.
LEAST = 3
#: Features are the same if their paths are apart by at most so many beams.
SAME = 0.5
#: A day, in years.
DAY = 1 / 365.25


def write_publication(
    tables: Mapping[str, QTable], directory: Path | str,
    catalogues: Mapping[str, QTable] | None = None,
) -> list[Path]:  # fmt: skip
    """
    Write tables in the forms of journals and archives.

    Parameters
    ----------
    tables : dict of `~astropy.table.QTable`
        Tables of this package by their names, which become those of the files.
    directory : path
        A folder that exists.
    catalogues : dict of `~astropy.table.QTable`, optional
        Further tables, which are written as VOTable alone.

    Returns
    -------
    list of `~pathlib.Path`
        For each table NAME, ``NAME_aastex.tex`` and ``NAME_aa.tex`` if it has proper
        motions, ``NAME_mrt.txt`` for the AAS and the CDS, and ``NAME.vot``, in the
        folder ``publication``.

    Raises
    ------
    OSError
        If a file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> from astro_scc.products.publication import write_publication
    >>> Path("out").mkdir()
    >>> table = QTable({"pm": [0.5] * u.mas / u.yr})
    >>> paths = write_publication({"speeds": table}, "out")
    >>> sorted(path.name for path in paths)[1:]
    ['speeds_aa.tex', 'speeds_aastex.tex', 'speeds_mrt.txt']
    """
    folder = Path(directory, FOLDER)
    folder.mkdir(exist_ok=True)
    texts = {}
    for name, table in tables.items():
        if "pm" in table.colnames:
            for journal, text in latex_texts_of(table, name).items():
                texts[f"{name}_{journal}.tex"] = text
        description, rows = fixed_width(table)
        texts[f"{name}_mrt.txt"] = _rendered(
            "mrt.txt", name=name, caption=_caption(table, name), rows=rows,
            description=description, facts=facts_of(table.meta),
        )  # fmt: skip
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    paths = [folder / name for name in texts]
    for name, table in {**tables, **(catalogues or {})}.items():
        paths.append(folder / f"{name}.vot")
        write_votable(table, paths[-1], overwrite=True)
    return paths


def facts_of(meta):
    """Return what the meta of a table says of source and images as sentences."""
    facts = []
    if "n_epochs" in meta:
        first, last = meta["first_epoch"], meta["last_epoch"]
        facts.append(f"{meta['n_epochs']} epochs from {first} to {last}.")
    if "beam" in meta:
        facts.append(f"Beam {meta['beam']}.")
    if source := source_text(meta):
        facts.append(f"Apparent speeds are for {source}.")
    return facts


def _caption(table, name):
    source = ascii_line(table.meta.get("object", ""))
    caption = CAPTIONS.get(name, f"{name.capitalize()}{{}}")
    return caption.format(f" of {source}" if source else "")


def _rendered(template, **what):
    """Return a filled template; LaTeX has braces of its own."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("astro_scc", "products/templates"),
        variable_start_string="<<", variable_end_string=">>",
        block_start_string="<%", block_end_string="%>",
        comment_start_string="<#", comment_end_string="#>",
        undefined=jinja2.StrictUndefined, autoescape=jinja2.select_autoescape(),
        keep_trailing_newline=True, trim_blocks=True,
    )  # fmt: skip
    return environment.get_template(template).render(**what)


# -- LaTeX -------------------------------------------------------------------------


def escaped(text):
    """Return text in which what LaTeX reads as commands is escaped."""
    text = re.sub(r"([&%#_${}])", r"\\\1", ascii_line(text).replace("\\", "/"))
    return text.replace("~", r"\textasciitilde{}").replace("^", r"\textasciicircum{}")


def latex_texts_of(table, name):
    """
    Return the main columns of a table in LaTeX, by ``aastex`` and ``aa``.

    Values and errors are rounded to two digits of the error.
    """
    paper = paper_table(table, sign=r"\pm")
    heads = [column_of(column)["latex"] for column in paper.colnames]
    units = [_latex_unit(column, paper[column].unit) for column in paper.colnames]
    cells = zip(*(map(_latex_cell, paper[k]) for k in paper.colnames), strict=True)
    rows = [" & ".join(row) for row in cells]
    about = {k: table[k].info.description for k in paper.colnames}
    about = [f"{column_of(k)['latex']}: {escaped(v)}." for k, v in about.items() if v]
    what = {
        "align": "l" * len(heads),
        "caption": f"{escaped(_caption(table, name))}.",
        "name": name,
        "long": len(rows) > ONE_PAGE,
        "rows": " \\\\\n".join(rows),
        "notes": " ".join([*map(escaped, facts_of(table.meta)), *about]),
    }
    texts = {}
    for journal, head in (("aastex", r"\colhead{{{}}}"), ("aa", "{}")):
        what |= {
            key: " & ".join(map(head.format, row))
            for key, row in (("heads", heads), ("units", units))
        }
        texts[journal] = _rendered(f"{journal}.tex", **what)
    return texts


def _latex_cell(text):
    text = str(text)
    if text == "-":
        return r"\nodata"
    plain = text.split(" (error")[0]
    number = re.fullmatch(r"[-<]?[\d.]+(e[+-]?\d+)?( \\pm .*)?", plain)
    if number is None:
        return escaped(text)
    text = text.replace("(error unknown)", r"\pm \ldots")
    text = re.sub(r"e([+-]?)0*(\d+)", lambda m: rf" \times 10^{{{m[1]}{m[2]}}}", text)
    text = text.replace("{+", "{")
    return f"${text}$" if text[0] in "-<" or "\\" in text else text


def _latex_unit(name, unit):
    if name == "beta_app":
        return "($c$)"
    if name == "t_ej" and unit == u.day:
        return "(MJD)"
    if unit in (None, u.one):
        return ""
    return "(deg)" if unit == u.deg else f"({unit.to_string('latex_inline')})"


# -- machine-readable --------------------------------------------------------------


def fixed_width(table):
    """
    Return the description and the rows of a table in columns of fixed width, as lines.

    Standard errors are labelled ``e_`` and the name of their column, as archives do,
    and what is not known is blank.  Floating-point numbers have as many digits after
    the point as in print, at most eight.
    """
    table = round_to_errors(table.copy(copy_data=False))
    columns, described, begin = [], [], 1
    for name in table.colnames:
        if table[name].ndim == 1:
            cells, form = _cells(table[name])
            width = max(map(len, cells), default=1) or 1
            columns.append([f"{cell:>{width}}" for cell in cells])
            end = begin + width - 1
            place = f"{end:8d}" if width == 1 else f"{begin:3d}-{end:4d}"
            label = re.sub(r"^(.*)_err(?=_|$)", r"e_\1", name)
            unit, about = _cds_unit(table[name].info.unit)
            about = f"{ascii_line(table[name].info.description or name)}{about}"
            blank = "? " if any(not cell.strip() for cell in cells) else ""
            head = f"{place} {form.format(width=width):6s} {unit:7s} {label:21s} "
            indents = {"initial_indent": head, "subsequent_indent": " " * len(head)}
            described += wrap(blank + about, 80, **indents)
            begin = end + 2
    rows = [" ".join(row) for row in zip(*columns, strict=True)]
    return described, rows


def _cells(column):
    """Return the cells of a column as text, and the format of Fortran."""
    hidden = np.broadcast_to(getattr(column, "mask", False), len(column))
    values = getattr(column, "unmasked", column)
    values = np.asarray(values.isot if isinstance(values, Time) else values)
    if values.dtype.kind == "f":
        known = np.isfinite(values) & ~hidden
        form = column.info.format or ".6f"
        size = np.abs(values[known & (values != 0)])
        if form.endswith("g") and size.size:
            form = f".{int(form[1:-1]) - 1 - int(np.floor(np.log10(size.min())))}f"
        digits = int(np.clip(int(form[1:-1]), 1, DIGITS)) if form[-1] == "f" else 1
        cells = [
            f"{v:.{digits}f}" if k else "" for v, k in zip(values, known, strict=True)
        ]
        cells = [cell.rjust(digits + 2) for cell in cells]
        return cells, f"F{{width}}.{digits}"
    if values.dtype.kind == "b":
        values = np.where(values, "Y", "N")
    cells = [
        "" if bad else ascii_line(v) for v, bad in zip(values, hidden, strict=True)
    ]
    return cells, ("I{width}" if values.dtype.kind in "iu" else "A{width}")


def _cds_unit(unit):
    """Return a unit as archives write it; of what they do not know, in words."""
    if unit in (None, u.one, ""):
        return "---", ""
    try:
        return u.Unit(unit).to_string("cds"), ""
    except ValueError:
        return "---", f" ({unit})"


# -- VOTable -----------------------------------------------------------------------


def write_votable(table: Table, path: Path | str, *, overwrite: bool = False) -> None:
    """
    Write a table as VOTable, which TOPCAT, STILTS and Aladin read.

    Parameters
    ----------
    table : `~astropy.table.Table`
        Any table of this package, in memory or read from its ECSV file.
    path : path
        A file, commonly ``.vot`` or ``.xml``.
    overwrite : bool, optional

    Raises
    ------
    OSError
        If the file exists and ``overwrite`` is False, or cannot be written.

    Notes
    -----
    Columns keep their units and descriptions, and have UCDs.  Dates become ISO text
    in a time system, UTC.  Single numbers and texts in the meta become parameters,
    and so does the position of the source, if it is known, in the coordinate system
    ICRS; ECSV keeps the whole meta.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> from astro_scc.products import write_votable
    >>> write_votable(QTable({"pm": [0.5] * u.mas / u.yr}), "streams.vot")
    >>> QTable.read("streams.vot")["pm"].unit
    Unit("mas / yr")
    """
    plain = Table(table)
    dates = [name for name in table.colnames if isinstance(table[name], Time)]
    for name in dates:
        values = table[name]
        # An empty array of dates does not have the type of text.
        texts = np.asarray(values.isot, dtype=str if len(values) else "U23")
        plain[name] = Column(texts, description=values.info.description)
    # Units that the Virtual Observatory lacks, such as DN, are written as they are.
    with warnings.catch_warnings(action="ignore", category=W50):
        votable = from_table(plain)
        _describe_columns(votable, dates)
        _describe_source(votable, table.meta)
        if len(table) > MANY_ROWS:
            votable.get_first_table().format = "binary2"
        path = os.fspath(path)
        with writing.replace_when_complete(path, overwrite=overwrite) as part:
            votable.to_xml(str(part))


def _describe_columns(votable, dates):
    """Give the columns UCDs and units, and those of dates their time system."""
    for field in votable.get_first_table().fields:
        field.ucd = column_of(field.name)["ucd"] or None
        if field.unit is None and field.datatype == "double":
            field.unit = u.one
        if field.name in dates:
            field.ref, field.xtype = "utc", "timestamp"
    if dates:
        # Otherwise astropy warns that it does not know the version.
        known = {"version_1_4_or_later": True}
        utc = TimeSys(ID="utc", timescale="UTC", refposition="TOPOCENTER", config=known)
        votable.resources[0].time_systems.append(utc)


def _describe_source(votable, meta):
    """Add sentences on the source, its position, and what else the meta has."""
    written, position = votable.get_first_table(), meta.get("position")
    written.description = " ".join(facts_of(meta)) or None
    if position is not None:
        votable.resources[0].coordinate_systems.append(CooSys(ID="icrs", system="ICRS"))
        where = SkyCoord(position).icrs
        for name, value in (("ra", where.ra.deg), ("dec", where.dec.deg)):
            about = {"unit": "deg", "ref": "icrs", "ucd": f"pos.eq.{name};meta.main"}
            param = Param(votable, name=name, value=value, datatype="double", **about)
            written.params.append(param)
    kinds = {bool: ("boolean", None), int: ("long", None), float: ("double", None)}
    for name, value in meta.items():
        if isinstance(value, bool | int | float | str) and value not in ("", position):
            kind, size = kinds.get(type(value), ("unicodeChar", "*"))
            about = {"name": name, "ucd": "meta.id;src" if name == "object" else None}
            param = Param(votable, value=value, datatype=kind, arraysize=size, **about)
            written.params.append(param)


# -- published features beside those that were measured -----------------------------


def published_positions(path: Path | str, cube: EpochCube) -> QTable:
    """
    Read the published features of the source of a cube.

    The table has the positions of features by epoch, see
    `~astro_scc.epochs.read_components`; of several sources, it is the one with the name
    of the cube's object.  A row for each feature and epoch has its number,
    ``published``, ``date``, ``separation``, ``ra_offset`` and ``dec_offset``.  The core
    and what was not identified are left out.
    """
    name = cube.meta.get("object")
    try:
        found = read_components(path, source=name and str(name))
    except ValueError:
        names = source_names(open_table(Path(path))[0])
        if names is not None and len({*names}) > 1:
            raise
        # A table of one source may give it another name.
        found = read_components(path)
        if other := found.meta.get("object"):
            warn(
                f"{path}: its source is {other}, that of the images {name}; its "
                "features are compared nevertheless"
            )
    years, kept = found.times.jyear[found.epoch], found.feature > 0
    if not kept.any():
        raise ValueError(f"{path}: numbers no features; give a table that does")
    east, north = found.east[kept].to(u.mas), found.north[kept].to(u.mas)
    order = np.lexsort((years[kept], found.feature[kept]))
    columns = {
        "published": found.feature[kept], "date": found.times[found.epoch[kept]],
        "separation": np.hypot(east, north), "ra_offset": east, "dec_offset": north,
    }  # fmt: skip
    return QTable(columns)[order]


def with_published(
    table: QTable, features: Features, published: QTable | None
) -> QTable:
    """
    Return a table of features with the published ones and their proper motions.

    A published feature is the same if it is within half a beam of the measured one
    in most of the epochs that both have; it is interpolated to their dates.  Its proper
    motion is that in the time in which the measured one is seen, if it has three epochs
    there, since features accelerate.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        Of the features.
    features : `~astro_scc.features.Features`
    published : `~astropy.table.QTable` or None
        See `published_positions`.

    Returns
    -------
    `~astropy.table.QTable`
        With the columns ``published``, ``published_pm`` and ``published_pm_err``,
        masked where no published feature is the same; the table itself for None.
    """
    if published is None:
        return table
    d, paths = features.detections, {}
    for number in np.unique(published["published"]).tolist():
        seen = published[published["published"] == number]
        if len(seen) >= LEAST:
            place = [seen[k].to_value(u.mas) for k in ("ra_offset", "dec_offset")]
            paths[number] = seen["date"].jyear, np.stack(place)
    rows = []
    for track in features.tracks:
        time, place = d.time[track], d.place[track].T
        apart = {SAME * d.fwhm: 0}
        for number, (years, published_place) in paths.items():
            both = (time >= years[0]) & (time <= years[-1])
            if both.sum() >= max(LEAST, len(time) / 2):
                there = np.stack([np.interp(time, years, k) for k in published_place])
                off = np.hypot(*(there - place)[:, both])
                if 2 * np.sum(off <= SAME * d.fwhm) > len(off):
                    apart[np.median(off)] = number
        best = apart[min(apart)]
        rows.append((best, *(_speed_at(time, *paths[best]) if best else (0.0, 0.0))))
    numbers, *speeds = np.reshape(rows, (-1, 3)).T
    # No published feature has the number 0, which is the core.
    table, missing, unit = table.copy(), numbers == 0, features.cube.speed_unit
    table["published"] = MaskedColumn(numbers.astype(int), mask=missing)
    for name, speed in zip(("published_pm", "published_pm_err"), speeds, strict=True):
        table[name] = Masked((speed * PM_UNIT).to(unit), mask=missing)
    return round_to_errors(describe(table, "added"))


def _speed_at(time, years, place):
    """Return the speed and its error in the time of a feature, or of all if few."""
    inside = (years >= time[0] - DAY) & (years <= time[-1] + DAY)
    if inside.sum() < LEAST:
        inside[:] = True
    return speed_of(years[inside], place[:, inside])


def speed_of(years, place):
    """Return the speed of a straight line, and its error, in mas/yr."""
    (velocity, _), covariance = np.polyfit(years - years.mean(), place.T, 1, cov=True)
    speed = float(np.hypot(*velocity))
    return speed, float(np.sqrt(velocity**2 @ covariance[0, 0])) / (speed or 1.0)
