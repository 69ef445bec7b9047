# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Files of model components: tables, difmap models and AIPS CC tables."""

import re
import warnings
from datetime import datetime
from difflib import get_close_matches
from functools import partial

import astropy.units as u
import numpy as np
from astropy.time import Time

from astro_scc.epochs.files.fits import open_fits
from astro_scc.epochs.files.headers import header_facts, parse_date
from astro_scc.epochs.keywords import get

CORE = 0  # the number of the feature that is the core
# Units of the numbers that describe a component.
UNITS = {
    "flux": u.Jy,
    "east": u.mas,
    "north": u.mas,
    "major": u.mas,
    "minor": u.mas,
    "pa": u.deg,
}
# What a column holds -> its unit, what it is called in a table, and how a
# machine-readable table explains it where its label is not among these.
COLUMNS = {
    "source": (None, "name source iau iauname", "source name|IAU name"),
    "feature": (
        u.one,
        "feature id comp component featureid",
        "(feature|component) (identification|number|ID)",
    ),
    "epoch": (
        None,
        "epoch date obsdate obs",
        "(observation|observing) (date|epoch)|date of observation|epoch",
    ),
    "year": (None, "obsy year obsyear", None),
    "month": (None, "obsm month obsmonth", None),
    "day": (None, "obsd day obsday", None),
    "flux": (u.Jy, "flux i s fluxdensity", "flux density"),
    "separation": (
        u.mas,
        "separation sep r dist distance radius",
        "position offset|separation|distance from",
    ),
    "east": (u.mas, "east x dra", None),
    "north": (u.mas, "north y ddec", None),
    "major": (
        u.mas,
        "majorfwhm maj major fwhm majaxis",
        "FWHM( of)?( the)? major|major axis FWHM",
    ),
    "minor": (u.mas, "minorfwhm min minor minaxis", None),
    "ratio": (u.one, "axialratio ratio axratio", "axial ratio"),
    "pa": (
        u.deg,
        "majorpa majpa pamaj phi",
        "major axis position angle|position angle of( the)? major",
    ),
    "position_angle": (u.deg, "positionangle pa theta", "position angle"),
    "excluded": (None, "excludedfromfit excluded fid ffeature", ".*not used in"),
}
NEVER_BLANK = ("feature", "flux", "east", "north")
NO = ("", "--", "n", "no", "f", "false", "0")
#: Names of sources that a message lists.
LISTED = 8
FILE_DATE = re.compile(
    r"(?<!\d)(?=((?:19|20)\d\d)([-_.]?)(0[1-9]|1[0-2])\2([0-3]\d)(?!\d))"
)


def read_table(path, source, dates, *, kind):
    """
    Return the columns and meta of an ECSV or machine-readable table.

    Columns are arrays in `UNITS`, with a list of dates and whether the
    positions are relative to the core.
    """
    table = _open_table(path, kind)
    columns = _find_columns(table)
    table = _select_source(table, columns, source, path)
    if len(table) == 0:
        raise ValueError(f"{path}: the table has no rows")
    has_offsets = {"east", "north"} <= columns.keys()
    in_parts = "epoch" not in columns and {"year", "month", "day"} <= columns.keys()
    needed = {"flux"} | (set() if has_offsets else {"separation", "position_angle"})
    if dates is None and not in_parts:
        needed.add("epoch")
    missing = sorted(needed - columns.keys())
    if missing:
        raise ValueError(
            f"{path}: no column for {', '.join(missing)}; the table has "
            f"{', '.join(table.colnames)}"
        )
    values = {
        what: _numbers(table[columns[what]], unit, what in NEVER_BLANK, path)
        for what, (unit, *_) in COLUMNS.items()
        if unit is not None and what in columns
    }
    if "feature" in values:
        values["feature"] = values["feature"].astype(int)
    if dates is None and in_parts:
        parts = zip(*(table[columns[p]] for p in ("year", "month", "day")), strict=True)
        dates = ["-".join(str(value).zfill(2) for value in row) for row in parts]
    elif dates is None:
        column = table[columns["epoch"]]
        dates = list(column.utc.isot if isinstance(column, Time) else column)
    zeros = np.zeros(len(table))
    major = values.get("major", zeros)
    minor = values.get("minor", major * values.get("ratio", 1.0))
    out = {
        "pa": zeros,
        **values,
        **({} if has_offsets else _offsets(values, path)),
        "date": dates,
        "relative": not has_offsets and "feature" in values,
        "major": major,
        # A blank size or ratio is that of a circle.
        "minor": np.where(np.isnan(minor), major, minor),
    }
    if "excluded" in columns:
        flags = (str(flag).strip().lower() for flag in table[columns["excluded"]])
        out["excluded"] = np.array([flag not in NO for flag in flags])
    return out, _table_meta(table, columns)


def _open_table(path, kind):
    from astropy.table import Table

    options = {}
    if kind == "ascii.mrt":
        with path.open(encoding="utf-8", errors="replace") as file:
            # Titles, authors and abstracts come before the description.
            described = "Byte-by-byte" in file.read(100_000)
        readme = path.parent / "ReadMe"
        if not described and not readme.is_file():
            raise OSError(
                f"{path}: has no byte-by-byte description; lay the file ReadMe of CDS "
                "beside it"
            )
        if not described:
            kind, options = "ascii.cds", {"readme": str(readme)}
    try:
        with warnings.catch_warnings():
            # The units of columns that are needed are checked below.
            warnings.simplefilter("ignore", u.UnitsWarning)
            return Table.read(path, format=kind, **options)
    except Exception as error:  # the parsers of astropy raise all sorts
        raise OSError(
            f"{path}: not a readable {kind} table: {first_line(error)}"
        ) from None


def first_line(error):
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def _find_columns(table):
    """Return the names of the table's columns by what they hold."""
    found = {}
    for name in table.colnames:
        plain = re.sub(r"[^a-z]", "", name.lower())
        for what, (_, labels, _) in COLUMNS.items():
            if plain in labels.split():
                found.setdefault(what, name)
    for what, (*_, pattern) in COLUMNS.items():
        for name in table.colnames if pattern else ():
            explanation = table[name].info.description or ""
            if name not in found.values() and re.match(pattern, explanation, re.I):
                found.setdefault(what, name)
    return found


def _select_source(table, columns, source, path):
    """Return the rows of one source; without a column for it, the meta names it."""
    if "source" not in columns:
        names = [str(table.meta[k]) for k in ("source", "name") if k in table.meta]
        require_source(source, names, path)
        return table
    column = [str(name).strip() for name in table[columns["source"]]]
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
    """Refuse a file that has not the source that is wanted, or does not say."""
    if source is None or _plain(source) in map(_plain, names):
        return
    near = get_close_matches(source, names, n=3, cutoff=0.7)
    if near and len(names) > LISTED:
        has = f"did you mean {' or '.join(near)}?"
    elif names:
        has = f"it has {_some(names)}"
    else:
        has = "it does not say of which source it is; leave --source out"
    raise ValueError(f"{path}: no source {source!r}; {has}")


def _plain(name):
    return "".join(str(name).split()).casefold()


def _some(names):
    """Return the first of names that may be many."""
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more


def _numbers(column, unit, never_blank, path):
    """Return a column as floats in ``unit``, blanks as NaN."""
    name = column.info.name
    try:
        values = np.ma.filled(np.ma.asarray(column, dtype=float), np.nan)
    except (TypeError, ValueError):
        raise ValueError(f"{path}: column {name!r} is not numeric") from None
    values = np.array(values, dtype=float)
    for i in np.flatnonzero(~np.isfinite(values) if never_blank else np.isinf(values)):
        problem = "blank or not finite" if never_blank else "infinite"
        raise ValueError(f"{path}, row {i + 1}: {name} is {problem}")
    if unit == u.one:
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


def _offsets(values, path):
    """Return the offsets that have a separation and a position angle."""
    separation, angle = values["separation"], values["position_angle"]
    if "feature" in values:
        # A core whose offset from the map's centre is blank has none.
        blank = (values["feature"] == CORE) & np.isnan(separation)
        separation = np.where(blank, 0.0, separation)
    angle = np.where((separation == 0) & np.isnan(angle), 0.0, angle)
    for i in np.flatnonzero(np.isnan(separation + angle)):
        raise ValueError(
            f"{path}, row {i + 1}: separation or position_angle is blank or not finite"
        )
    return {
        "east": separation * np.sin(np.radians(angle)),
        "north": separation * np.cos(np.radians(angle)),
    }


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


def row_date(text, where):
    """
    Return the ISO date and time, UTC, of a date as tables and headers write it.

    That is what `parse_date` understands, 2006_03_09, 2006 Mar 09, or a decimal
    year; ``where`` names the file and the row if it is none of them.
    """
    if isinstance(text, Time):
        return text.utc.isot
    text = str(text).strip().replace("_", "-")
    try:
        with warnings.catch_warnings():
            # ERFA calls dates dubious for which leap seconds are unknown.
            warnings.simplefilter("ignore")
            if re.fullmatch(r"\d{4}\.\d{2,3}|\d{4}\.\d{5,}", text):
                return Time(float(text), format="decimalyear", scale="utc").isot
            if re.fullmatch(r"\d{4}[ -][A-Za-z]{3}[ -]\d{1,2}", text):
                day = datetime.strptime(text.replace("-", " "), "%Y %b %d")
                return parse_date(day.isoformat()).utc.isot
            return parse_date(text).utc.isot
    except ValueError:
        raise ValueError(
            f"{where}: {text!r} is no date; write it as 2006-03-09"
        ) from None


def read_difmap(path, source, dates):
    """
    Return the columns and meta of a difmap model.

    Lines are flux, radius, theta, major axis, axial ratio, phi, type; a 'v'
    marks a value that was free in the fit; three values are a point.
    """
    if dates is None:
        found = FILE_DATE.search(path.name)
        if found is None:
            raise ValueError(
                f"{path}: no date in the file's name; rename it like "
                "source_2006-03-09.mod, or give dates"
            )
        dates = ["-".join(found.group(1, 3, 4))]
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        raise OSError(f"{path}: not a difmap model, it is not text") from None
    scale, meta, rows = 1.0, {}, []
    for number, line in enumerate(lines, start=1):
        text, _, comment = line.partition("!")
        if re.search(r"Radius\s*\(arcsec\)", comment):
            scale = u.arcsec.to(u.mas)
        centre = re.search(r"Center RA:\s*(.+?),\s*Dec:\s*(.+?)\s*\(2000", comment)
        if centre:
            meta["position"] = _position(*centre.groups(), (u.hourangle, u.deg))
        if text.split():
            rows.append(_difmap_row(text, f"{path}, line {number}"))
    if not rows:
        raise ValueError(f"{path}: no components in the file")
    flux, radius, theta, major, ratio, phi, _ = np.transpose(rows)
    columns = {
        "date": dates,
        "relative": False,
        "flux": flux,
        "east": scale * radius * np.sin(np.radians(theta)),
        "north": scale * radius * np.cos(np.radians(theta)),
        "major": scale * major,
        "minor": scale * major * ratio,
        "pa": phi,
    }
    return columns, meta


def _position(ra, dec, unit):
    from astropy.coordinates import SkyCoord

    return SkyCoord(ra, dec, unit=unit)


def _difmap_row(text, where):
    try:
        row = [float(word.rstrip("vV")) for word in text.split()[:7]]
    except ValueError:
        raise ValueError(f"{where}: not numbers: {text!r}") from None
    if len(row) not in (3, 6, 7) or not np.all(np.isfinite(row)):
        raise ValueError(
            f"{where}: expected 3, 6 or 7 finite values (flux, radius, theta, major, "
            f"ratio, phi, type), got {len(row)}"
        )
    # Without a type, a size makes it a Gaussian.
    row += [0.0] * (6 - len(row))
    row += [float(row[3] > 0)] * (7 - len(row))
    _check_type(row[6], where)
    if row[6] == 0:
        row[3:6] = 0.0, 1.0, 0.0
    if row[3] < 0 or not 0 <= row[4] <= 1:
        raise ValueError(
            f"{where}: a size must not be negative, an axial ratio must lie between 0 "
            f"and 1, got {row[3]:g} and {row[4]:g}"
        )
    return row


def _check_type(code, where):
    if code not in (0, 1):
        raise ValueError(
            f"{where}: component type {code:g} is neither a point (0) nor a Gaussian "
            "(1); replace it by one of these"
        )


def read_aips(path, source, dates):
    """Return the columns and meta of the newest AIPS CC table of a FITS file."""
    header, table, units = _open_aips(path)
    if table is None:
        raise ValueError(f"{path}: no AIPS CC table in the file; it cannot be restored")
    missing = {"FLUX", "DELTAX", "DELTAY"} - table.keys()
    if missing:
        raise ValueError(
            f"{path}: the AIPS CC table has no column {', '.join(sorted(missing))}"
        )
    if table["FLUX"].size == 0:
        raise ValueError(f"{path}: the AIPS CC table is empty")
    for name, expected in (("FLUX", "JY"), ("DELTAX", "DEG"), ("DELTAY", "DEG")):
        if units[name] and not units[name].upper().startswith(expected):
            raise ValueError(
                f"{path}: column {name} of the AIPS CC table is in {units[name]!r}, "
                f"expected {expected}"
            )
    zeros = np.zeros(table["FLUX"].size)
    types = table.get("TYPE OBJ", zeros)
    for i, code in enumerate(types, start=1):
        _check_type(code, f"{path}, row {i}")
    major, minor, pa = (
        np.where(types == 0, 0.0, table.get(name, zeros))
        for name in ("MAJOR AX", "MINOR AX", "POSANGLE")
    )
    if dates is None:
        dates = [get(header, "DATE-OBS", kind=str)]
        if dates == [None]:
            raise ValueError(f"{path}: no DATE-OBS in the header; give dates")
    to_mas = u.deg.to(u.mas)
    columns = {
        "date": dates,
        "relative": False,
        "flux": table["FLUX"],
        "east": table["DELTAX"] * to_mas,
        "north": table["DELTAY"] * to_mas,
        "major": major * to_mas,
        "minor": minor * to_mas,
        "pa": pa,
    }
    meta = header_facts(header)
    axes = {
        (get(header, f"CTYPE{i}", kind=str) or "").split("-")[0]: f"CRVAL{i}"
        for i in range(1, (get(header, "NAXIS") or 0) + 1)
    }
    centre = [
        get(header, axes.get(name, "CRVAL0"), kind=float) for name in ("RA", "DEC")
    ]
    if None not in centre:
        meta["position"] = _position(*centre, u.deg)
    return columns, meta


def _open_aips(path):
    """Return the header of the image, and the columns and units of the table."""
    with warnings.catch_warnings():
        # AIPS files break small rules of the standard throughout.
        warnings.simplefilter("ignore")
        try:
            # astropy.io.fits forgets to close files that it fails to open.
            with path.open("rb") as file, open_fits(file) as hdus:
                header = hdus[0].header
                tables = [h for h in hdus[1:] if h.name.strip().startswith("AIPS CC")]
                if not tables:
                    return header, None, {}
                hdu = max(tables, key=lambda h: h.ver)
                table = {
                    column.name.strip(): np.array(
                        hdu.data[column.name], dtype=float
                    ).ravel()
                    for column in hdu.columns
                }
                units = {c.name.strip(): (c.unit or "").strip() for c in hdu.columns}
                return header, table, units
        except Exception as error:  # a damaged file can fail anywhere
            raise OSError(
                f"{path}: not a readable FITS file: {first_line(error)}"
            ) from None


READERS = {
    "ecsv": partial(read_table, kind="ascii.ecsv"),
    "mrt": partial(read_table, kind="ascii.mrt"),
    "difmap": read_difmap,
    "aips-cc": read_aips,
}
SUFFIXES = {
    ".ecsv": "ecsv",
    ".mod": "difmap",
    ".mdl": "difmap",
    ".fits": "aips-cc",
    ".fit": "aips-cc",
    ".fts": "aips-cc",
    ".txt": "mrt",
    ".dat": "mrt",
    ".mrt": "mrt",
}
