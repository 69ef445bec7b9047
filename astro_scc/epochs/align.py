# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Alignment of the epochs, by shifts that are measured or given in a table."""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path
from typing import Any

import astropy.units as u
import numpy as np
from astropy.table import Table
from astropy.time import Time

from astro_scc.columns import numbers
from astro_scc.epochs.registration import core_positions, displacement
from astro_scc.exceptions import MeasurementWarning, naming, naming_all, warn
from astro_scc.images import grid, regions
from astro_scc.images.dates import as_times, times_of_column
from astro_scc.images.series import Series

AXES = "east", "north"
DATES = ("epoch", "date", "date_obs", "date-obs", "time", "mjd", "jd", "year")
# Units by the words in the names of columns.
UNITS = {word: u.Unit(word) for word in ("deg", "arcsec", "mas", "uas")}
UNITS |= {"marcsec": u.mas, "uarcsec": u.uas}


def align(
    cube: Series, method: str = "core", *, table: Path | str | Table | None = None,
    region: Any = None, jet_pa: u.Quantity | None = None,
) -> Series:  # fmt: skip
    """
    Return the cube with its epochs shifted into alignment.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    method : {"core", "correlate", "table", "wcs", "none"}, optional
        "core"
            The core of each epoch, as `~astro_scc.epochs.core_positions`
            measures it, is moved to the reference pixel.
        "correlate"
            Every epoch is registered on the mean of the aligned epochs, which
            is found by iteration, by masked cross-correlation and least squares.
            Motion that the whole region shares is removed, even if it is the
            velocity sought: choose a region that stands still.
        "table"
            The positions in a table are moved to the reference pixel.
        "wcs"
            Absolute coordinates (``cube.epoch_wcs``) are trusted.  In VLBI
            images they jump by more than jets move.  Images that are turned to
            one another are read with ``frame="absolute"`` instead.
        "none"
            Reference pixels stay aligned; nothing is shifted.

        The path of a table means "table" with that table.
    table : path-like or `~astropy.table.Table`, optional
        For "table": CSV or ECSV with dates and the offsets of the core
        from the reference pixel, see
        ``offsets_from_table``.
    region : optional
        For "correlate": the pixels to compare, in any form that
        `EpochCube.region_mask` takes.
    jet_pa : `~astropy.units.Quantity`, optional
        For "core": position angle of the jet at the core.

    Returns
    -------
    `~astro_scc.epochs.EpochCube`
        ``meta["alignment"]`` has a dict for each epoch: ``epoch``, ``date``,
        ``method``, and the shift of the image, ``shift_east_mas`` and
        ``shift_north_mas``, with ``shift_east_err_mas`` and
        ``shift_north_err_mas`` (None if unknown).  Further alignments are
        appended.  ``epoch_wcs`` is shifted as well.

    Raises
    ------
    ValueError
        If the method is unknown, an option does not belong to it, an epoch
        cannot be measured, or its shift moves it off the grid; and if the
        method itself raises one.

    Warns
    -----
    MeasurementWarning
        If the core is blended with the jet.

    Notes
    -----
    Shifts by whole pixels copy the pixels.  Other shifts interpolate with
    cubic splines: pixels from outside the image or next to bad ones are
    masked.  As this smooths noise that varies from pixel to pixel, ``noise``
    is then None and is measured again.

    Examples
    --------
    >>> import astropy.units as u
    >>> import numpy as np
    >>> from astropy.table import Table
    >>> from astro_scc.epochs import EpochCube
    >>> images = np.zeros((2, 9, 9))
    >>> images[0, 4, 4] = images[1, 5, 6] = 1
    >>> cube = EpochCube.from_arrays(
    ...     images, ["2000-01-01", "2001-01-01"], pixel_scale=0.1 * u.mas
    ... )
    >>> table = Table({
    ...     "date": ["2000-01-01", "2001-01-01"],
    ...     "east": [0, -0.2] * u.mas,
    ...     "north": [0, 0.1] * u.mas,
    ... })
    >>> aligned = align(cube, "table", table=table)
    >>> aligned.data[:, 4, 4]
    array([1., 1.])
    >>> aligned.meta["alignment"][1]["shift_east_mas"]
    0.2
    """
    if isinstance(method, Table | os.PathLike) or (
        isinstance(method, str) and method not in METHODS and os.path.isfile(method)
    ):
        if table is not None:
            raise ValueError("give one table, as method or as table")
        method, table = "table", method
    if not isinstance(method, str) or method not in METHODS:
        raise ValueError(f"align {method!r} is none of {', '.join(METHODS)} or a file")
    options = {"jet_pa": jet_pa, "region": region, "table": table}
    given = {name for name, value in options.items() if value is not None}
    measure, option = METHODS[method]
    if strange := sorted(given - {option}):
        raise ValueError(f"align method {method!r} has no option {', '.join(strange)}")
    if measure is None:
        return cube.with_step("aligned by reference pixels (no shifts)")
    return _move(cube, method, *measure(cube, options.get(option)))


def _move(cube, method, pixels, covariance, what):
    """Return the cube with its epochs moved back by their offsets in pixels."""
    data, mask, shifts = np.empty(cube.shape), np.empty(cube.shape, bool), -pixels
    for i, shift in enumerate(shifts):
        data[i], mask[i] = grid.shift_image(cube.data[i], cube.mask[i], shift)
        if mask[i].all():
            raise ValueError(
                f"{cube.labels[i]}: its shift of {shift.round(1).tolist()} pixels "
                "(x, y) takes it off the grid; leave the epoch out"
            )
    epoch_wcs = cube.epoch_wcs and tuple(
        cube.wcs.deepcopy() if method == "wcs" else grid.moved_wcs(wcs, shift)
        for wcs, shift in zip(cube.epoch_wcs, shifts, strict=True)
    )
    whole = grid.whole_pixels(shifts) is not None
    matrix = cube.pixel_matrix.to_value(u.mas)
    # To a billionth of a pixel.
    digits = 9 - int(np.floor(np.log10(cube.pixel_scale.to_value(u.mas))))
    sky = (shifts @ matrix.T + 0.0).round(digits)
    errors = np.sqrt(np.einsum("ij,njk,ik->ni", matrix, covariance, matrix))
    values = np.concatenate([sky, np.where(np.isfinite(errors), errors, None)], axis=1)
    names = [f"shift_{axis}{err}_mas" for err in ("", "_err") for axis in AXES]
    records = []
    each = zip(cube.labels, cube.times.isot, values.tolist(), strict=True)
    for label, date, row in each:
        record = {"epoch": label, "date": date[:10], "method": method}
        records.append(record | dict(zip(names, row, strict=True)))
    east, north = np.sqrt(np.mean(sky**2, axis=0))
    largest = int(np.argmax(np.hypot(*sky.T)))
    most_east, most_north = sky[largest]
    return cube.with_step(
        f"aligned on {what}: shifts of {east:.3g} mas (east) and {north:.3g} "
        f"mas (north) rms, largest ({most_east:+.3g}, {most_north:+.3g}) mas for "
        f"{cube.labels[largest]}",
        data=data,
        mask=mask,
        epoch_wcs=epoch_wcs,
        noise=cube.noise if whole else None,
        meta=cube.meta | {"alignment": [*cube.meta.get("alignment", ()), *records]},
    )


# Functions that measure the offset of each epoch from its aligned position return it
# in pixels (x, y), its covariance (NaN where not known), and what it was measured on.


def _from_sky(cube, offsets, errors, what):
    """Return what is measured from offsets (n, 2) and errors in mas."""
    inverse = np.linalg.inv(cube.pixel_matrix.to_value(u.mas))
    covariance = inverse @ (errors[:, :, None] ** 2 * np.eye(2)) @ inverse.T
    return offsets @ inverse.T, covariance, what


def _by_core(cube, jet_pa):
    found = core_positions(cube, jet_pa=jet_pa)
    if n_blended := int(np.sum(found["blended"])):
        warn(
            f"the core is blended with the jet in {n_blended} of {len(cube)} epochs: "
            "its position may be wrong by some hundredths of the beam and more; if "
            "positions from model fits exist, align with a table of them",
            MeasurementWarning,
        )
    offsets, errors = (
        np.stack([found[f"{axis}{err}"].value for axis in AXES], axis=1)
        for err in ("", "_err")
    )
    return _from_sky(cube, offsets, errors, "the core")


def _by_table(cube, table):
    if table is None:
        raise ValueError(
            "align 'table' needs table=, a path or a Table; with --align name the file"
        )
    offsets, errors = offsets_from_table(table, cube.times, cube.labels)
    return _from_sky(cube, offsets.value, errors.value, "positions of a table")


def pointing_of(cube):
    """
    Return the shifts of epochs to the grid of the cube by their own coordinates.

    Returns
    -------
    steps : `~numpy.ndarray`, shape (n_epochs, 2)
        In pixels along x and y.
    pure : `~numpy.ndarray` of bool, shape (n_epochs,)
        Whether an epoch differs by this shift only.
    """
    shape = cube.shape[1:]
    steps = [grid.grid_step(wcs, cube.wcs, shape) for wcs in cube.epoch_wcs]
    return np.array([step for step, _ in steps]), np.array([pure for _, pure in steps])


def _by_wcs(cube, _):
    if not cube.epoch_wcs:
        raise ValueError(
            "the epochs have no absolute coordinates (epoch_wcs); "
            "read them from FITS files, or choose another alignment"
        )
    steps, pure = pointing_of(cube)
    if not pure.all():
        raise ValueError(
            f"{cube.labels[pure.argmin()]}: is turned or stretched to the others; read "
            "the files with frame='absolute', which aligns them so"
        )
    return -steps, np.full((len(cube), 2, 2), np.nan), "absolute coordinates"


def _by_correlation(cube, region):
    inside, reach = regions.region_mask(cube, region), min(cube.shape[1:]) / 4
    pixels, covariance = np.zeros((len(cube), 2)), np.zeros((len(cube), 2, 2))
    for k in range(5):
        moved = map(grid.shift_image, cube.data, cube.mask, -pixels)
        # Pixels that only some epochs have would make steps in the mean.
        target = np.mean([one for one, _ in moved], axis=0)
        use = inside & np.isfinite(target)
        if not use.any():
            raise ValueError("the mean of the epochs has no good pixel in the region")
        before = pixels.copy()
        for i, label in enumerate(cube.labels):
            start = pixels[i] if k > 1 else None
            with naming(label):
                pixels[i], covariance[i] = displacement(
                    cube.data[i], cube.mask[i], target, use, reach, start
                )
        # The mean image could drift freely, so the mean shift is kept at 0.
        pixels -= pixels.mean(axis=0)
        if np.abs(pixels - before).max() < 0.01:
            break
    if cube.beams is not None:
        areas = u.Quantity([beam.area for beam in cube.beams]) / cube.pixel_scale**2
        covariance *= np.maximum(areas.to_value(u.one) / 2, 1)[:, None, None]
    return pixels, covariance, "their mean"


#: Methods, how each measures the offsets, and its option.
METHODS = {
    "core": (_by_core, "jet_pa"), "correlate": (_by_correlation, "region"),
    "table": (_by_table, "table"), "wcs": (_by_wcs, None), "none": (None, None),
}  # fmt: skip


def alignment_errors(cube, error=None):
    """
    Return the standard error of the alignment of each epoch on both axes.

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`
    error : `~astropy.units.Quantity`, optional
        One error for all epochs, or one per epoch.  The default is the error
        of each epoch's last alignment, or zero without it.

    Returns
    -------
    `~numpy.ndarray`, shape (n_epochs, 2)
        In mas.

    Raises
    ------
    ValueError
        If ``error`` has neither one element nor one per epoch.
    """
    n, names = len(cube), ("shift_east_err_mas", "shift_north_err_mas")
    if error is None:
        last = {record["epoch"]: record for record in cube.meta.get("alignment", ())}
        records = [last.get(label, {}) for label in cube.labels]
        left = [[record.get(name) or 0.0 for name in names] for record in records]
        each = np.sqrt(np.mean(np.square(left, dtype=float), axis=1))
    else:
        each = np.atleast_1d(error.to_value(u.mas)).astype(float)
        if each.shape not in ((1,), (n,)):
            raise ValueError(
                f"alignment_error must be 1 or {n} angles, got {each.size}"
            )
    return np.broadcast_to(each[:, None], (n, 2))


def offsets_from_table(table, times, labels, within=1 * u.day):
    """
    Return the offset of each epoch in a table, and its error, shape (n, 2) in mas.

    The table is in memory or is a CSV or ECSV file.  It has one column of dates
    (``epoch``, ``date``, ``date_obs``, ``time``, ``mjd``, ``jd`` or ``year``: a
    Time, ISO dates, or numbers) and two columns of offsets, with ``east`` and
    ``north`` as parts of their names.  Their unit is that of the column, or else
    a part of the name, as in ``core_x_mas_east``.  Two more columns with ``err``
    or ``error`` in their names are the errors, which are NaN without them.  Each
    epoch takes the row of the nearest date ``within`` a day.
    """
    name, table = _read_table(table)
    with naming(name):
        dates = _dates(table)
        axes = [_axis(table, axis) for axis in AXES]
        values, errors = (np.stack(pair, axis=1) for pair in zip(*axes, strict=True))
        rows = [
            _row_of(f"{time.isot[:10]} ({label})", dates - time, values, within)
            for time, label in zip(times, labels, strict=True)
        ]
    return values[rows] * u.mas, errors[rows] * u.mas


def _row_of(where, apart, values, within):
    """Return the row of the nearest date, of those ``apart`` from that of an epoch."""
    apart = np.abs(apart.to_value(u.day))
    if len(apart) == 0 or not apart.min() <= within.to_value(u.day):
        raise ValueError(
            f"no row within {within:g} of {where}; add one, or leave the epoch out"
        )
    nearest = np.flatnonzero(np.isclose(apart, apart.min(), rtol=1e-9, atol=0))
    found = values[nearest]
    if not np.all(np.isfinite(found)):
        raise ValueError(f"the row for {where} has no numbers")
    if np.any(found != found[0]):
        raise ValueError(f"rows that differ for {where}; keep one")
    return nearest[0]


def _read_table(table):
    if isinstance(table, Table):
        return "table", table
    if not isinstance(table, str | os.PathLike):
        raise TypeError(f"table must be a path or a Table, got {type(table).__name__}")
    path = Path(table)
    text = path.read_text(encoding="utf-8", errors="replace")
    kind = "ascii.ecsv" if text.startswith("# %ECSV") else "ascii.csv"
    with naming_all(f"{path}: is neither CSV nor ECSV"):
        return str(path), Table.read(text.splitlines(), format=kind)


def _dates(table):
    columns = [c for c in table.colnames if c.lower() in DATES]
    if len(columns) != 1:
        raise ValueError(
            f"{len(columns)} columns of dates, one is needed, called one of "
            f"{', '.join(DATES)}; it has {', '.join(map(repr, table.colnames))}"
        )
    column = table[columns[0]]
    where = f"the dates in column {columns[0]!r} are not understood"
    # ERFA warns of years whose leap seconds are unknown.
    with naming(where), warnings.catch_warnings(action="ignore"):
        column = times_of_column(column)
        for row in np.flatnonzero(getattr(column, "mask", False)):
            raise ValueError(f"that of row {row + 1} is missing")
        if not isinstance(column, Time):
            column = [str(value) for value in column]
        return as_times(column, len(table))


def _axis(table, axis):
    """Return the offsets along "east" or "north" in mas, and their errors or NaN."""
    has = ", ".join(map(repr, table.colnames))
    words = {c: re.split(r"[^a-z]+", c.lower()) for c in table.colnames}
    columns = [c for c in words if axis in words[c]]
    wrong = [c for c in columns if {"err", "error"} & set(words[c])]
    columns = [c for c in columns if c not in wrong]
    if len(columns) != 1:
        raise ValueError(
            f"{len(columns)} columns have '{axis}' as a part of their names, one is "
            f"needed, such as 'core_mas_{axis}'; it has {has}"
        )
    found = []
    for column in columns + wrong[:1]:
        units = [UNITS[word] for word in words[column] if word in UNITS]
        unit = getattr(table[column], "unit", None)
        if unit is None and len(units) != 1:
            raise ValueError(
                f"column {column!r} has no unit; give it one in an ECSV table or in "
                f"its name, as in {column + '_mas'!r}"
            )
        found.append(numbers(table[column], u.mas, own_unit=unit or units[0]))
    return found if wrong else [*found, np.full(len(table), np.nan)]
