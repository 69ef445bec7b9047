# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Component lists in ECSV and in the machine-readable tables of AAS and CDS."""

import re
import warnings
from datetime import datetime
from difflib import get_close_matches

import astropy.units as u
import numpy as np
from astropy.time import Time

from astro_scc.epochs.components.lists import CORE
from astro_scc.epochs.headers import parse_date

__all__ = ["read_ecsv", "read_mrt", "require_finite", "require_source", "row_date"]

# What a column is called in a table, and how a machine-readable table
# explains it where its label is not among these.
LABELS = {
    "source": {"name", "source", "iau", "iauname"},
    "feature": {"feature", "id", "comp", "component", "featureid"},
    "epoch": {"epoch", "date", "obsdate", "obs"},
    "year": {"obsy", "year", "obsyear"},
    "month": {"obsm", "month", "obsmonth"},
    "day": {"obsd", "day", "obsday"},
    "flux": {"flux", "i", "s", "fluxdensity"},
    "separation": {"separation", "sep", "r", "dist", "distance", "radius"},
    "position_angle": {"positionangle", "pa", "theta"},
    "east": {"east", "x", "dra"},
    "north": {"north", "y", "ddec"},
    "major": {"majorfwhm", "maj", "major", "fwhm", "majaxis"},
    "minor": {"minorfwhm", "min", "minor", "minaxis"},
    "ratio": {"axialratio", "ratio", "axratio"},
    "pa": {"majorpa", "majpa", "pamaj", "phi"},
    "excluded": {"excludedfromfit", "excluded", "fid", "ffeature"},
}
EXPLANATIONS = {
    "source": r"source name|IAU name",
    "feature": r"(feature|component) (identification|number|ID)",
    "epoch": r"(observation|observing) (date|epoch)|date of observation|epoch",
    "flux": r"flux density",
    "separation": r"position offset|separation|distance from",
    "major": r"FWHM( of)?( the)? major|major axis FWHM",
    "ratio": r"axial ratio",
    "pa": r"major axis position angle|position angle of( the)? major",
    "position_angle": r"position angle",
    "excluded": r".*not used in",
}
#: Names of sources that a message lists.
LISTED = 8
UNITS = {
    "flux": u.Jy,
    "separation": u.mas,
    "position_angle": u.deg,
    "east": u.mas,
    "north": u.mas,
    "major": u.mas,
    "minor": u.mas,
    "pa": u.deg,
}


def _read_table(path, *, source, date, table_format):
    from astropy.table import Table

    options = {}
    if table_format == "ascii.mrt" and not _describes_itself(path):
        readme = path.parent / "ReadMe"
        if not readme.is_file():
            raise OSError(
                f"{path}: has no byte-by-byte description; lay the file ReadMe of CDS "
                "beside it"
            )
        table_format, options = "ascii.cds", {"readme": str(readme)}
    try:
        with warnings.catch_warnings():
            # Of columns that are needed the units are checked below.
            warnings.simplefilter("ignore", u.UnitsWarning)
            table = Table.read(path, format=table_format, **options)
    except Exception as error:  # the parsers of astropy raise all sorts
        reason = str(error).strip().splitlines() or [type(error).__name__]
        raise OSError(
            f"{path}: not a readable {table_format} table: {reason[0]}"
        ) from None
    columns = _find_columns(table)
    table = _select_source(table, columns, source, path)
    if len(table) == 0:
        raise ValueError(f"{path}: the table has no rows")
    has_offsets = {"east", "north"} <= columns.keys()
    needed = {"flux"} | ({"east", "north"} if has_offsets else set())
    if not has_offsets:
        needed |= {"separation", "position_angle"}
    in_parts = "epoch" not in columns and {"year", "month", "day"} <= columns.keys()
    if date is None and not in_parts:
        needed.add("epoch")
    missing = sorted(needed - columns.keys())
    if missing:
        raise ValueError(
            f"{path}: no column for {', '.join(missing)}; the table has "
            f"{', '.join(table.colnames)}"
        )

    values = {
        name: _numbers(table, columns[name], unit, path)
        for name, unit in UNITS.items()
        if name in columns
    }
    out = {"flux": values["flux"]}
    if date is None:
        parts = ("year", "month", "day") if in_parts else ("epoch",)
        rows = zip(*(table[columns[part]] for part in parts), strict=True)
        out["date"] = [
            row_date("-".join(str(value).zfill(2) for value in row), f"{path}, row {i}")
            if in_parts
            else row_date(*row, f"{path}, row {i}")
            for i, row in enumerate(rows, start=1)
        ]
    else:
        out["date"] = [date] * len(table)
    if "feature" in columns:
        out["feature"] = _numbers(table, columns["feature"], None, path)
        require_finite(out["feature"], columns["feature"], path)
        out["feature"] = out["feature"].astype(int)
    relative = not has_offsets and "feature" in out
    if has_offsets:
        out["east"], out["north"] = values["east"], values["north"]
    else:
        separation, angle = values["separation"], values["position_angle"]
        if relative:
            # A core whose offset from the map's centre is blank has none.
            core = out["feature"] == CORE
            blank = core & np.isnan(separation)
            separation = np.where(blank, 0.0, separation)
        angle = np.where((separation == 0) & np.isnan(angle), 0.0, angle)
        out["east"] = separation * np.sin(np.radians(angle))
        out["north"] = separation * np.cos(np.radians(angle))
    for name in ("flux", "east", "north"):
        label = name if name in columns else "separation or position_angle"
        require_finite(out[name], columns.get(name, label), path)

    zeros = np.zeros(len(table))
    out["major"] = np.nan_to_num(values.get("major", zeros))
    if "minor" in values:
        minor = values["minor"]
        out["minor"] = np.where(np.isnan(minor), out["major"], minor)
    else:
        ratio = zeros + 1
        if "ratio" in columns:
            ratio = _numbers(table, columns["ratio"], None, path)
            ratio = np.where(np.isnan(ratio), 1.0, ratio)
        out["minor"] = out["major"] * ratio
    out["pa"] = np.nan_to_num(values.get("pa", zeros))
    for i in np.flatnonzero(out["minor"] > out["major"] * (1 + 1e-6)):
        raise ValueError(f"{path}, row {i + 1}: the minor axis exceeds the major axis")
    if "excluded" in columns:
        out["excluded"] = _flags(table[columns["excluded"]])
    return out, relative, _table_meta(table, columns)


def _find_columns(table):
    """Names of the table's columns by what they hold."""
    found = {}
    for name in table.colnames:
        plain = re.sub(r"[^a-z]", "", name.lower())
        for what, labels in LABELS.items():
            if plain in labels and what not in found:
                found[what] = name
                break
    for what, pattern in EXPLANATIONS.items():
        if what in found:
            continue
        for name in table.colnames:
            explanation = table[name].info.description or ""
            if name not in found.values() and re.match(
                pattern, explanation, re.IGNORECASE
            ):
                found[what] = name
                break
    return found


def _describes_itself(path):
    """Whether a machine-readable table has its description in it."""
    with path.open(encoding="utf-8", errors="replace") as file:
        # Titles, authors and abstracts come first.
        return "Byte-by-byte" in file.read(100_000)


def _select_source(table, columns, source, path):
    """The rows of one source; of tables without a column the meta names it."""
    if "source" not in columns:
        names = [str(table.meta[k]) for k in ("source", "name") if k in table.meta]
        require_source(source, names, path)
        return table
    column = np.array([str(name).strip() for name in table[columns["source"]]])
    names = list(dict.fromkeys(column))
    if source is None and len(names) > 1:
        raise ValueError(
            f"{path}: {len(names)} sources in the table ({_some(names)}); say which "
            "one with --source NAME (source= in Python)"
        )
    if source is None:
        return table
    require_source(source, names, path)
    return table[[_plain(name) == _plain(source) for name in column]]


def require_source(source, names, path):
    """
    Refuse a file that is not of the source that is wanted.

    Parameters
    ----------
    source : str or None
    names : sequence of str
        What the file calls its sources.
    path : path

    Raises
    ------
    ValueError
        If a source is given and the file has another one, or does not say.
    """
    if source is None or _plain(source) in map(_plain, names):
        return
    near = get_close_matches(source, names, n=3, cutoff=0.7)
    has = (
        f"did you mean {' or '.join(near)}?"
        if near and len(names) > LISTED
        else f"it has {_some(names)}"
        if names
        else "it does not say of which source it is; leave --source out"
    )
    raise ValueError(f"{path}: no source {source!r}; {has}")


def _plain(name):
    return "".join(str(name).split()).casefold()


def _some(names):
    """The first of names that may be many."""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more


def _numbers(table, name, unit, path):
    """Column as floats in ``unit``, blanks as NaN."""
    column = table[name]
    try:
        values = np.ma.filled(np.ma.asarray(column, dtype=float), np.nan)
    except (TypeError, ValueError):
        raise ValueError(f"{path}: column {name!r} is not numeric") from None
    values = np.array(values, dtype=float)
    for i in np.flatnonzero(np.isinf(values)):
        raise ValueError(f"{path}, row {i + 1}: {name} is infinite")
    if unit is None:
        return values
    if column.unit is None:
        raise ValueError(
            f"{path}: column {name!r} has no unit; give it one, such as {unit}"
        )
    try:
        return values * u.Unit(column.unit).to(unit)
    except (u.UnitConversionError, TypeError, ValueError):
        raise ValueError(
            f"{path}: column {name!r} has the unit {column.unit}, expected one "
            f"like {unit}"
        ) from None


def require_finite(values, name, path):
    for i in np.flatnonzero(~np.isfinite(values)):
        raise ValueError(f"{path}, row {i + 1}: {name} is blank or not finite")


def _flags(column):
    if column.dtype.kind == "b":
        return np.ma.filled(np.ma.asarray(column), False)
    texts = [
        "" if text is np.ma.masked else str(text).strip().lower() for text in column
    ]
    return np.array([text not in ("", "n", "no", "f", "false", "0") for text in texts])


def _table_meta(table, columns):
    meta = {}
    name = table.meta.get("name") or table.meta.get("source")
    if name is None and "source" in columns:
        name = str(table[columns["source"]][0]).strip()
    if name is not None:
        meta["object"] = str(name)
    if "redshift" in table.meta:
        meta["redshift"] = float(table.meta["redshift"])
    if "frequency" in table.meta:
        meta["frequency"] = u.Quantity(table.meta["frequency"], u.Hz).value
    return meta


def read_ecsv(path, *, source, date):
    return _read_table(path, source=source, date=date, table_format="ascii.ecsv")


def read_mrt(path, *, source, date):
    return _read_table(path, source=source, date=date, table_format="ascii.mrt")


def row_date(text, where):
    """
    ISO date and time, UTC, of a date as tables and headers write it.

    Parameters
    ----------
    text : str or `~astropy.time.Time`
        What `~astro_scc.epochs.headers.parse_date` understands, 2006_03_09,
        2006 Mar 09, or a decimal year.
    where : str or path
        File and row, for the message of an error.

    Returns
    -------
    str

    Raises
    ------
    ValueError
        If it is no date.
    """
    if isinstance(text, Time):
        return text.utc.isot
    text = str(text).strip().replace("_", "-")
    with warnings.catch_warnings():
        # ERFA calls dates dubious for which leap seconds are unknown.
        warnings.simplefilter("ignore")
        return _row_date(text, where)


def _row_date(text, where):
    try:
        if re.fullmatch(r"\d{4}\.\d{2,3}|\d{4}\.\d{5,}", text):
            return Time(float(text), format="decimalyear", scale="utc").isot
        if re.fullmatch(r"\d{4}[ -][A-Za-z]{3}[ -]\d{1,2}", text):
            text = datetime.strptime(text.replace("-", " "), "%Y %b %d").isoformat()
        return parse_date(text).utc.isot
    except ValueError:
        raise ValueError(
            f"{where}: {text!r} is no date; write it as 2006-03-09"
        ) from None
