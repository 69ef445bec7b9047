# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Component lists in difmap models and in AIPS CC tables."""

import re
import warnings
from contextlib import suppress

import astropy.units as u
import numpy as np

from astro_scc.epochs.components.tables import require_finite, row_date
from astro_scc.epochs.fits import open_fits
from astro_scc.epochs.headers import header_facts

__all__ = ["read_aips", "read_difmap"]


FILE_DATE = re.compile(
    r"(?<!\d)(?=((?:19|20)\d\d)([-_.]?)(0[1-9]|1[0-2])\2([0-3]\d)(?!\d))"
)


def read_difmap(path, *, source, date):
    """
    Read a difmap model.

    Lines are flux, radius, theta, major axis, axial ratio, phi, type; a 'v'
    marks a value that was free in the fit; three values are a point.
    """
    if date is None:
        date = _date_in_name(path.name)
        if date is None:
            raise ValueError(
                f"{path}: no date in the file's name; rename it like "
                "source_2006-03-09.mod, or give dates"
            )
        date = row_date(date, path)
    scale, meta, rows = 1.0, {}, []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        raise OSError(f"{path}: not a difmap model, it is not text") from None
    for number, line in enumerate(lines, start=1):
        text, _, comment = line.partition("!")
        if re.search(r"Radius\s*\(arcsec\)", comment):
            scale = u.arcsec.to(u.mas)
        meta.update(_difmap_position(comment))
        words = text.split()
        if not words:
            continue
        try:
            row = [float(word.rstrip("vV")) for word in words[:7]]
        except ValueError:
            raise ValueError(f"{path}, line {number}: not numbers: {text!r}") from None
        if len(row) not in (3, 6, 7) or not np.all(np.isfinite(row)):
            raise ValueError(
                f"{path}, line {number}: expected 3, 6 or 7 finite values (flux, "
                f"radius, theta, major, ratio, phi, type), got {len(row)}"
            )
        # Without a type, a size makes it a Gaussian.
        row += [0.0] * (6 - len(row))
        row += [float(row[3] > 0)] * (7 - len(row))
        _check_type(row[6], f"{path}, line {number}")
        if row[6] == 0:
            row[3:6] = 0.0, 1.0, 0.0
        if row[3] < 0 or not 0 <= row[4] <= 1:
            raise ValueError(
                f"{path}, line {number}: a size must not be negative, an axial "
                f"ratio must lie between 0 and 1, got {row[3]:g} and {row[4]:g}"
            )
        rows.append(row)
    if not rows:
        raise ValueError(f"{path}: no components in the file")
    flux, radius, theta, major, ratio, phi, _ = np.transpose(rows)
    columns = {
        "date": [date] * len(rows),
        "flux": flux,
        "east": scale * radius * np.sin(np.radians(theta)),
        "north": scale * radius * np.cos(np.radians(theta)),
        "major": scale * major,
        "minor": scale * major * ratio,
        "pa": phi,
    }
    return columns, False, meta


def _date_in_name(name):
    """Date in the name of a file, as 2006-03-09."""
    found = FILE_DATE.search(name)
    if found is None:
        return None
    year, _, month, day = found.groups()
    return f"{year}-{month}-{day}"


def _difmap_position(comment):
    found = re.search(r"Center RA:\s*(.+?),\s*Dec:\s*(.+?)\s*\(2000", comment)
    if not found:
        return {}
    from astropy.coordinates import SkyCoord

    return {"position": SkyCoord(*found.groups(), unit=(u.hourangle, u.deg))}


def _check_type(code, where):
    if code not in (0, 1):
        raise ValueError(
            f"{where}: component type {code:g} is neither a point (0) nor a Gaussian "
            "(1); replace it by one of these"
        )


class _NoTableError(Exception):
    """The file is FITS, but has no CLEAN components."""


def _aips_columns(path):
    """The header of the image, and the columns and units of the components."""
    with warnings.catch_warnings():
        # AIPS files break small rules of the standard throughout.
        warnings.simplefilter("ignore")
        try:
            # astropy.io.fits forgets to close files that it fails to open.
            with path.open("rb") as file, open_fits(file) as hdus:
                return _columns(hdus)
        except _NoTableError:
            raise ValueError(
                f"{path}: no AIPS CC table in the file; it cannot be restored"
            ) from None
        except Exception as error:
            # A damaged file can fail anywhere inside astropy.io.fits.
            reason = str(error).strip().splitlines() or [type(error).__name__]
            raise OSError(f"{path}: not a readable FITS file: {reason[0]}") from None


def _columns(hdus):
    from astropy.io.fits import VerifyError

    tables = [h for h in hdus[1:] if h.name.strip().startswith("AIPS CC")]
    if not tables:
        raise _NoTableError
    hdu = max(tables, key=lambda h: h.ver)
    units = {
        str(hdu.header.get(f"TTYPE{i}", "")).strip(): str(
            hdu.header.get(f"TUNIT{i}", "")
        ).strip()
        for i in range(1, hdu.header["TFIELDS"] + 1)
    }
    data = {
        name.strip(): np.array(hdu.data[name], dtype=float).ravel()
        for name in hdu.data.names
    }
    header = {}
    for card in hdus[0].header.cards:
        # Cards are parsed at first use, where broken ones raise.
        with suppress(ValueError, VerifyError):
            header.setdefault(card.keyword, card.value)
    return header, data, units


def read_aips(path, *, source, date):
    header, data, units = _aips_columns(path)
    missing = {"FLUX", "DELTAX", "DELTAY"} - data.keys()
    if missing:
        raise ValueError(
            f"{path}: the AIPS CC table has no column {', '.join(sorted(missing))}"
        )
    n = data["FLUX"].size
    if n == 0:
        raise ValueError(f"{path}: the AIPS CC table is empty")
    for name, expected in (("FLUX", "JY"), ("DELTAX", "DEG"), ("DELTAY", "DEG")):
        unit = units.get(name, "")
        if unit and not unit.upper().startswith(expected):
            raise ValueError(
                f"{path}: column {name} of the AIPS CC table is in {unit!r}, "
                f"expected {expected}"
            )
    for name in ("FLUX", "DELTAX", "DELTAY"):
        require_finite(data[name], name, path)
    kinds = data.get("TYPE OBJ", np.zeros(n))
    for i in np.flatnonzero(~np.isin(kinds, (0, 1))):
        _check_type(kinds[i], f"{path}, row {i + 1}")
    point = kinds == 0
    to_mas = u.deg.to(u.mas)
    zeros = np.zeros(n)
    axes = [
        np.where(point, 0.0, data.get(name, zeros)) * to_mas
        for name in ("MAJOR AX", "MINOR AX")
    ]
    if date is None:
        if not str(header.get("DATE-OBS", "")).strip():
            raise ValueError(f"{path}: no DATE-OBS in the header; give dates")
        date = row_date(header["DATE-OBS"], path)
    columns = {
        "date": [date] * n,
        "flux": data["FLUX"],
        "east": data["DELTAX"] * to_mas,
        "north": data["DELTAY"] * to_mas,
        "major": axes[0],
        "minor": axes[1],
        "pa": np.where(point, 0.0, data.get("POSANGLE", zeros)),
    }
    return columns, False, _aips_meta(header)


def _aips_meta(header):
    from astropy.coordinates import SkyCoord

    meta = header_facts(header)
    axes = {
        str(header.get(f"CTYPE{i}", "")).split("-")[0].strip(): header.get(f"CRVAL{i}")
        for i in range(1, header.get("NAXIS", 0) + 1)
    }
    if axes.get("RA") is not None and axes.get("DEC") is not None:
        meta["position"] = SkyCoord(axes["RA"] * u.deg, axes["DEC"] * u.deg)
    return meta
