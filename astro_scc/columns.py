# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Columns of tables, each once in ``columns.csv``, and their cells as text.

A row of the file is a column of a table: its type or unit, its meaning and that of its
``_err`` column, its UCD, its headings in LaTeX, in reports and, where it is another
one, on the terminal, with {unit}, and its format without an error.  What a name has in
all tables stands in its first row.
"""

import csv
from collections import defaultdict
from functools import cache
from importlib import resources

import astropy.units as u
import numpy as np
from astropy.table import QTable, Table
from astropy.utils.masked import Masked

from astro_scc.exceptions import refusing
from astro_scc.quantities import decimals, with_error
from astro_scc.units import unit_name

#: Types of columns without a unit; of an empty one the values decide.
TYPES = {"int": int, "float": float, "bool": bool, "text": str, "word": "U15"}
TYPES |= {"ratio": u.one, "": None}
#: What is known of a column that is in no table of the file.
UNKNOWN = dict.fromkeys("meaning ucd latex heading terminal format".split(), "")


def _filled(kind, values):
    """Return values with their unit or type; those that are None are masked."""
    is_unit = isinstance(kind, u.UnitBase)
    missing = np.array([value is None for value in values], dtype=bool)
    values = [0.0 if value is None else value for value in values]
    column = np.array(values, dtype=float if is_unit else kind)
    if is_unit:
        column = column * kind
    if missing.any():
        masked = Masked if is_unit else np.ma.MaskedArray
        column = masked(column, mask=missing)
    return column


@cache
def _tables():
    """Return the columns of each table by their names, in the order of the file."""
    found, kinds = defaultdict(dict), cache(u.Unit)
    with resources.files("astro_scc").joinpath("columns.csv").open() as file:
        for row in csv.DictReader(file):
            name, table, error = map(row.pop, ("name", "table", "error"))
            kind = row["kind"]
            row["kind"] = TYPES[kind] if kind in TYPES else kinds(kind)
            found[table][name] = row
            if error:
                ucd = f"stat.error;{row['ucd']}" if row["ucd"] else ""
                about = {"kind": row["kind"], "meaning": error.format(name), "ucd": ucd}
                found[table][f"{name}_err"] = UNKNOWN | about
    return dict(found)


def columns_of(of_table):
    """Return the rows of a table in ``columns.csv`` by their names."""
    return _tables()[of_table]


@cache
def column_of(name):
    """Return what is known of a column in all tables."""
    every = (columns[name] for columns in _tables().values() if name in columns)
    return next(every, UNKNOWN)


def describe(table, of_table):
    """Set the meanings of the columns of a table in ``columns.csv``; return it."""
    for name in columns_of(of_table).keys() & set(table.colnames):
        table[name].info.description = columns_of(of_table)[name]["meaning"]
    return table


def build_table(of_table, rows=(), **columns):
    """
    Build a table in ``columns.csv`` from dicts of plain values and whole columns.

    Values that are None are masked.
    """
    table = QTable()
    for name, known in columns_of(of_table).items():
        if name not in columns:
            columns[name] = _filled(known["kind"], [row[name] for row in rows])
        table[name] = columns[name]
    return describe(table, of_table)


def with_errors(**pairs):
    """Return pairs of a value and its error as values of two columns each."""
    errors = {f"{name}_err": error for name, (_, error) in pairs.items()}
    return {name: value for name, (value, _) in pairs.items()} | errors


def round_to_errors(table):
    """
    Set formats that round columns to their errors when a table is printed, in place.

    Parameters
    ----------
    table : `~astropy.table.Table`
        A column and its error, of which the name ends with ``_err``, show the smallest
        error to two significant digits.  Other numbers show four, p-values two.

    Returns
    -------
    `~astropy.table.Table`
        The same, with the same numbers.
    """
    for name in table.colnames:
        column = table[name]
        if getattr(getattr(column, "dtype", None), "kind", "") != "f":
            continue
        error = f"{name.removesuffix('_err')}_err"
        is_p = name.startswith("p_")
        form = column_of(name)["format"] or (".2g" if is_p or "_err" in name else ".4g")
        if error in table.colnames and not is_p:
            errors = np.asarray(getattr(table[error], "unmasked", table[error]))
            errors = errors[np.isfinite(errors) & (errors > 0)]
            form = f".{decimals(errors.min())}f" if errors.size else form
        # Years have more digits before the point.
        column.info.format = None if column.unit == "yr" and form[-1] == "g" else form
    return table


def cell(row, name, sign="±", form=None):
    """
    Return an entry of a row of a table as text; "-" if there is nothing to say.

    Parameters
    ----------
    row : `~astropy.table.Row`
    name : str
    sign : str, optional
        What stands between a value and its error.
    form : str, optional
        Format instead of the error, or of that of the column.

    Returns
    -------
    str
        A value with an error is rounded to its error; of a probability that may be
        zero, the upper limit.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.table import QTable
    >>> from astro_scc.columns import cell
    >>> table = QTable({"pm": [2.1279], "pm_err": [0.072]}, units=[u.mas / u.yr] * 2)
    >>> cell(table[0], "pm"), cell(table[0], "pm", form=".1f")
    ('2.128 ± 0.072', '2.1')
    """
    value, names = row[name], row.colnames
    # What stands still is not tested.
    still = name.startswith("p_") and "kind" in names and row["kind"] == "stationary"
    if still or np.any(getattr(value, "mask", False)):
        return "-"
    kind = np.asarray(value).dtype.kind
    if kind == "b":
        return "yes" if value else "no"
    if kind != "f":
        return str(value)
    value = _plain(value)
    if not np.isfinite(value):
        return "-"
    # The adjusted probability has the relative error of that of the trials.
    counted = "p_global" if name == "p_fdr" else name
    if counted.startswith("p_") and f"{counted}_err" in names:
        p, error = _plain(row[counted]), _plain(row[f"{counted}_err"])
        # One of all trials and the data has an error of just its value.
        if error >= p * (1 - 1e-9):
            return f"<{value * (1 + error / p) if p > 0 else error:.1g}"
    if form is None and f"{name}_err" in names:
        return with_error(value, _plain(row[f"{name}_err"]), sign)
    return f"{value:{form or row.table[name].info.format or ''}}"


def cells(table, names, *, sign="±", forms=None):
    """
    Return those columns that a table has as lists of text by their names, see `cell`.

    ``forms`` has by their names the formats of columns that are shown without error.
    """
    # Rows of plain columns are read many times faster than those of quantities.
    table = Table(round_to_errors(table.copy(copy_data=False)), copy=False)
    forms = forms or {}
    shown = [k for k in names if k in table.colnames and _says_something(table, k)]
    return {k: [cell(row, k, sign, forms.get(k)) for row in table] for k in shown}


def _says_something(table, name):
    """Return whether a column belongs in print: speeds in km/s stand for those in c."""
    if name == "beta_app":
        return "v_app" not in table.colnames
    return not name.startswith("acc_") or bool(np.any(np.isfinite(table[name])))


def headed(table, names, *, of_table=None, terminal=False, forms=None):
    """
    Return heading, meaning and cells of those columns that a table has, by their names.

    Headings are those of a table in ``columns.csv``, or else of any; on the
    ``terminal`` they may be others.  See `cells` on ``forms``.
    """
    found, sign = {}, "+-" if terminal else "±"
    for name, texts in cells(table, names, sign=sign, forms=forms).items():
        about = table[name].info
        unit = about.unit if terminal else unit_name(about.unit or "")
        text = heading_of(name, unit, of_table, terminal=terminal)
        found[name] = text, about.description or "", texts
    return found


def heading_of(name, unit, of_table=None, *, terminal=False):
    """Return the heading of a column, see `headed`."""
    known = _tables().get(of_table, {}).get(name) or column_of(name)
    heading = (terminal and known["terminal"]) or known["heading"] or name
    return heading.format(unit=unit)


def table_lines(rows):
    """
    Return a table as aligned lines.

    Parameters
    ----------
    rows : sequence of dict of str
        At least one; all have the headings of the columns as keys.

    Returns
    -------
    list of str

    Examples
    --------
    >>> from astro_scc.columns import table_lines
    >>> for line in table_lines([{"file": "a.fits", "noise": "0.3 mJy"}]):
    ...     print(line)
    file      noise
    a.fits  0.3 mJy
    """
    texts = [list(rows[0]), *(row.values() for row in rows)]
    widths = [max(map(len, column)) for column in zip(*texts, strict=True)]
    # The first column is text, aligned left; the others are numbers, aligned right.
    shape = "  ".join(f"{{:{'>' if i else '<'}{w}}}" for i, w in enumerate(widths))
    return [shape.format(*row).rstrip() for row in texts]


def _plain(value):
    """Return an entry without unit and mask."""
    value = getattr(value, "unmasked", value)
    return getattr(value, "value", value)


def numbers(column, unit, own_unit=None):
    """
    Return a column as floats in ``unit``, blanks as NaN.

    ``own_unit`` replaces the unit of the column.  If ``unit`` is
    `astropy.units.one`, the numbers are returned as they are.
    """
    name = column.info.name
    with refusing(f"column {name!r} is not numeric; correct it", TypeError, ValueError):
        values = np.array(np.ma.filled(np.ma.asarray(column, dtype=float), np.nan))
    if values.ndim > 1:
        raise ValueError(f"column {name!r} has several numbers in a row; keep one")
    for i in np.flatnonzero(np.isinf(values)):
        raise ValueError(f"row {i + 1}: {name} is infinite")
    if unit == u.one:
        return values
    own_unit = own_unit or column.unit
    if own_unit is None:
        raise ValueError(f"column {name!r} has no unit, such as {unit}")
    wrong = f"column {name!r} has the unit {own_unit}, expected one like {unit}"
    with refusing(wrong, u.UnitConversionError, TypeError, ValueError):
        return values * u.Unit(own_unit).to(unit)
