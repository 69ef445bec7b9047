# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Positions of the core, or of anything else to align on, from a table."""

import os
import re
import warnings
from pathlib import Path

import astropy.units as u
import numpy as np
from astropy.table import Table
from astropy.time import Time

__all__ = ["offsets_from_table"]

TOLERANCE = 1 * u.day
DATES = ("epoch", "date", "date_obs", "date-obs", "time", "mjd", "jd", "year")
FORMATS = {"mjd": "mjd", "jd": "jd"}
UNITS = {
    "deg": u.deg,
    "arcsec": u.arcsec,
    "mas": u.mas,
    "uas": u.uas,
    "marcsec": u.mas,
    "uarcsec": u.uas,
}


def offsets_from_table(table, times, labels):
    """
    Look up an offset for every epoch.

    Parameters
    ----------
    table : path-like or `~astropy.table.Table`
        CSV or ECSV.  A column of dates (``epoch``, ``date``, ``date_obs``,
        ``time``, ``mjd``, ``jd`` or ``year``: a Time, ISO dates, or numbers)
        and two of offsets, which have ``east`` and ``north`` as a part of
        their names.  Their unit is the column's, or else a part of the name
        as in ``core_x_mas_east``.  Two more with ``err`` or ``error`` in
        their names, if there are, are the errors.
    times : `~astropy.time.Time`, shape (n,)
    labels : sequence of str, length n
        For messages.

    Returns
    -------
    offsets, errors : `~astropy.units.Quantity`, shape (n, 2)
        (east, north) in mas.  Errors are NaN where there are none.

    Raises
    ------
    ValueError
        If a column or its unit is missing or dates cannot be understood,
        no row is within a day of an epoch, its values are blank, or two
        rows are equally near to it and differ.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> from astropy.table import Table
    >>> from astropy.time import Time
    >>> table = Table({
    ...     "epoch": ["2006-03-09", "2006-12-01"],
    ...     "core_x_mas_east": [-0.05, -0.09],
    ...     "core_y_mas_north": [0.02, 0.07],
    ... })
    >>> offsets_from_table(table, Time(["2006-12-01"]), ["b.fits"])[0]
    <Quantity [[-0.09,  0.07]] mas>
    """
    name, table = _read(table)
    dates = _dates(table, name)
    values, errors = [], []
    for axis in ("east", "north"):
        columns = [c for c in table.colnames if axis in _words(c)]
        wrong = [c for c in columns if {"err", "error"} & set(_words(c))]
        columns = [c for c in columns if c not in wrong]
        if len(columns) != 1:
            raise ValueError(
                f"{name}: {len(columns)} columns have '{axis}' as a part of their "
                f"names, one is needed, such as 'core_mas_{axis}'; "
                f"it has {', '.join(table.colnames)}"
            )
        values.append(_angles(table, columns[0], name))
        errors.append(
            _angles(table, wrong[0], name) if wrong else np.full(len(table), np.nan)
        )
    values, errors = np.stack(values, axis=1), np.stack(errors, axis=1)

    rows = []
    for time, label in zip(times, labels, strict=True):
        apart = np.abs((dates - time).to_value(u.day))
        if len(apart) == 0 or not apart.min() <= TOLERANCE.value:
            raise ValueError(
                f"{name}: no row within {TOLERANCE:g} of {time.isot[:10]} ({label}); "
                "add one, or leave the epoch out"
            )
        nearest = np.flatnonzero(apart <= apart.min() + 1e-6)
        found = values[nearest]
        if not np.all(np.isfinite(found)):
            raise ValueError(
                f"{name}: the row for {time.isot[:10]} ({label}) has no numbers"
            )
        if np.any(found != found[0]):
            raise ValueError(
                f"{name}: rows that differ for {time.isot[:10]} ({label}); keep one"
            )
        rows.append(nearest[0])
    return values[rows] * u.mas, errors[rows] * u.mas


def _read(table):
    if isinstance(table, Table):
        return "table", table
    if not isinstance(table, str | os.PathLike):
        raise TypeError(
            f"table must be a path or an astropy Table, got {type(table).__name__}"
        )
    path = Path(table)
    try:
        text = path.read_text(encoding="utf-8")
        kind = "ascii.ecsv" if text.startswith("# %ECSV") else "ascii.csv"
        return str(path), Table.read(text.splitlines(), format=kind)
    except OSError:
        raise
    except Exception as error:
        # Astropy's readers of tables raise all sorts, in many lines.
        first = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise ValueError(f"{path}: is neither CSV nor ECSV ({first})") from error


def _words(name):
    return re.split(r"[^a-z]+", name.lower())


def _dates(table, name):
    columns = [c for c in table.colnames if c.lower() in DATES]
    if len(columns) != 1:
        raise ValueError(
            f"{name}: {len(columns)} columns of dates, one is needed, "
            f"called one of {', '.join(DATES)}; it has {', '.join(table.colnames)}"
        )
    column = table[columns[0]]
    if isinstance(column, Time):
        return column
    kind = FORMATS.get(columns[0].lower())
    if kind is None and column.dtype.kind in "fi":
        kind = "jyear"
    try:
        values = np.asarray(column).astype(float if kind else str)
        with warnings.catch_warnings(record=True) as dubious:
            # ERFA calls dates dubious for which leap seconds are unknown.
            warnings.simplefilter("always")
            times = Time(values, format=kind, scale="utc")
            atomic = times.tai
        return atomic if dubious else times
    except ValueError as error:
        raise ValueError(
            f"{name}: the dates in column {columns[0]!r} are not understood "
            f"({str(error).splitlines()[0]}); write them as 2006-03-09"
        ) from error


def _angles(table, column, name):
    """A column in mas, blanks as NaN."""
    values = table[column]
    unit = getattr(values, "unit", None)
    if unit is None:
        units = [UNITS[word] for word in _words(column) if word in UNITS]
        if len(units) != 1:
            raise ValueError(
                f"{name}: column {column!r} has no unit; give it one in an ECSV table "
                f"or in its name, as in {column + '_mas'!r}"
            )
        unit = units[0]
    blank = np.ma.getmaskarray(values) if hasattr(values, "mask") else False
    try:
        numbers = np.ma.getdata(getattr(values, "value", values)).astype(float)
        return np.where(blank, np.nan, (numbers * unit).to_value(u.mas))
    except (ValueError, u.UnitConversionError) as error:
        raise ValueError(
            f"{name}: column {column!r} must hold angles as numbers ({error})"
        ) from error
