# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What files hold, and what is wrong with them."""

import astropy.units as u
import numpy as np
from astropy.time import Time

from astro_scc.epochs.description import readable_angle
from astro_scc.epochs.files.assembly import find_files
from astro_scc.epochs.files.consistency import (
    find_odd,
    find_same_dates,
    looks_like_mask,
)
from astro_scc.epochs.files.fits import read_image
from astro_scc.epochs.files.headers import header_beam, header_facts, observing_time
from astro_scc.epochs.statistics import measure_noise

__all__ = ["inspect_epochs"]


def inspect_epochs(paths, *, hdu=None):
    """
    Facts of each file, and what is wrong with it; no file is refused.

    Parameters
    ----------
    paths : str, path-like, or sequence of them
        Files or patterns.
    hdu : int or str, optional
        The extension that holds the image, by default the first image.

    Returns
    -------
    `~astropy.table.QTable`
        One row a file, sorted by date, files without one last: ``file``,
        ``date`` (masked where missing), ``nx``, ``ny``, ``pixel``,
        ``major``, ``minor``, ``pa``, ``peak``, ``noise``, ``peak_east``,
        ``peak_north`` (the brightest pixel from the reference pixel),
        ``object``, ``frequency`` and ``problem``, empty where there is
        none.  Numbers that are not known are NaN or 0.

    Raises
    ------
    FileNotFoundError
        If nothing matches a pattern.

    Examples
    --------
    >>> from astro_scc.epochs import inspect_epochs
    >>> table = inspect_epochs("../shared/data/quirks/*.fits")
    >>> print(table["problem"][-1].split(";")[0])
    no date of observation
    """
    from astropy.table import QTable

    files = find_files(paths, missing_ok=True)
    rows = [_inspect(path, hdu) for path in files]
    dated = [row for row in rows if row["date"] is not None]
    dated.sort(key=lambda row: row["date"])
    rows = dated + [row for row in rows if row["date"] is None]
    _compare(rows)

    known = [row["date"] is not None for row in rows]
    mjd = [row["date"].mjd if k else 0.0 for row, k in zip(rows, known, strict=True)]
    date = Time(mjd, format="mjd", scale="utc")
    date.format = "iso"
    if not all(known):
        date[~np.array(known)] = np.ma.masked
    unit = next((row["unit"] for row in rows if row["unit"] is not None), None)
    unit = u.dimensionless_unscaled if unit is None else unit

    def column(name, unit=None):
        values = [row[name] for row in rows]
        return values if unit is None else u.Quantity(values, unit)

    table = QTable({"file": [str(row["path"]) for row in rows]})
    table["date"] = date
    for name in ("nx", "ny"):
        table[name] = column(name)
    table["pixel"] = column("pixel", u.mas)
    table["major"] = column("major", u.mas)
    table["minor"] = column("minor", u.mas)
    table["pa"] = column("pa", u.deg)
    for name in ("peak", "noise"):
        table[name] = u.Quantity([_in_unit(row, name, unit) for row in rows], unit)
    table["peak_east"] = column("peak_east", u.mas)
    table["peak_north"] = column("peak_north", u.mas)
    table["object"] = column("object")
    table["frequency"] = column("frequency", u.GHz)
    table["problem"] = ["; ".join(row["problems"]) for row in rows]
    return table


def _blank(path):
    numbers = "pixel major minor pa peak noise peak_east peak_north frequency".split()
    return {
        "path": path,
        "date": None,
        "nx": 0,
        "ny": 0,
        "object": "",
        "unit": None,
        "facts": {},
        "wcs": None,
        "problems": [],
        **dict.fromkeys(numbers, np.nan),
    }


def _inspect(path, hdu):
    row = _blank(path)
    try:
        image, notes = read_image(path, hdu=hdu)
    except (OSError, ValueError) as error:
        row["problems"].append(str(error).removeprefix(f"{path}: "))
        return row
    row["problems"] += notes
    row["facts"] = header_facts(image.meta)
    row["object"] = row["facts"].get("object", "")
    row["frequency"] = row["facts"].get("frequency", np.nan) / 1e9
    row["ny"], row["nx"] = image.shape
    row["wcs"] = image.wcs
    row["unit"] = image.unit
    matrix = image.wcs.pixel_scale_matrix * u.deg.to(u.mas)
    row["pixel"] = np.sqrt(np.abs(np.linalg.det(matrix)))
    try:
        row["date"] = observing_time(image.meta)
        if row["date"] is None:
            row["problems"].append("no date of observation")
    except ValueError as error:
        row["problems"].append(str(error))
    beam = header_beam(image.meta)
    if beam is not None:
        row["major"] = beam.major.to_value(u.mas)
        row["minor"] = beam.minor.to_value(u.mas)
        row["pa"] = beam.pa.to_value(u.deg)
    if looks_like_mask(image.data):
        row["problems"].append("no more than two different values, a mask")
    values = image.data
    if image.mask is not None:
        values = np.where(image.mask, -np.inf, values)
    y, x = np.unravel_index(np.argmax(values), values.shape)
    row["peak"] = float(values[y, x])
    del values
    row["peak_east"], row["peak_north"] = matrix @ ([x, y] - image.wcs.wcs.crpix + 1)
    row["noise"] = measure_noise(image.data, mask=image.mask)
    return row


def _in_unit(row, name, unit):
    """The number in the unit of the table, NaN if it cannot be."""
    if row["unit"] is None or not row["unit"].is_equivalent(unit):
        return np.nan
    return row["unit"].to(unit, row[name])


def _compare(rows):
    """Add what is wrong with files beside one another."""
    read = [row for row in rows if row["wcs"] is not None]
    odd = find_odd(
        [row["facts"] for row in read],
        [row["wcs"].wcs.crval for row in read],
        [row["pixel"] * max(row["nx"], row["ny"]) * u.mas.to(u.deg) for row in read],
    )
    for i, what, _ in odd:
        read[i]["problems"].append(what)
    dated = [row for row in read if row["date"] is not None]
    if dated:
        for i, k in find_same_dates(Time([row["date"] for row in dated])):
            dated[k]["problems"].append(f"of the date of {dated[i]['path'].name}")
    if not read:
        return
    for row in read[1:]:
        first = read[0]
        if not row["unit"].is_equivalent(first["unit"]):
            row["problems"].append(
                f"its unit is {row['unit'].to_string() or 'none'}, that of others is "
                f"{first['unit'].to_string() or 'none'}"
            )
    beams = np.isfinite([row["major"] for row in read])
    if beams.any() and not beams.all():
        for row, has in zip(read, beams, strict=True):
            if not has:
                row["problems"].append("no beam where others have one")
    usual = _commonest([_grid(row) for row in read])
    for row in read:
        if _grid(row) != usual:
            nx, ny, pixel = usual
            row["problems"].append(
                f"on another grid than most ({nx} x {ny} of {pixel}), resampled"
            )


def _grid(row):
    return row["nx"], row["ny"], readable_angle(row["pixel"] * u.mas)


def _commonest(values):
    return max(values, key=values.count)
