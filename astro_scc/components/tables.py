# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Files of model components: tables, difmap models and AIPS CC tables."""

import csv
import re
import warnings
from contextlib import suppress
from difflib import get_close_matches
from functools import lru_cache
from importlib import resources

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import Table
from astropy.time import Time
from astropy.wcs.utils import wcs_to_celestial_frame

from astro_scc.components.names import also_named, place_of, same_source, table_position
from astro_scc.exceptions import naming, naming_all
from astro_scc.images import headers, series
from astro_scc.images.beam import parse_beam
from astro_scc.images.dates import as_times
from astro_scc.images.fits import AS_TABLE, opened, read_header
from astro_scc.images.headers import some
from astro_scc.quantities import parse_date


def _read_columns():
    """
    Return what tables have in their columns, of ``columns.csv``.

    Of each content that is its unit (None for text), its labels in tables, and a
    pattern for what machine-readable tables explain of it, which tells what labels such
    as ID mean.
    """
    found, units = {}, {"-": None, "1": u.one}
    with resources.files(__package__).joinpath("columns.csv").open() as file:
        for row in csv.DictReader(file):
            unit = row["unit"]
            unit = units[unit] if unit in units else u.Unit(unit)
            found[row["content"]] = unit, row["labels"].split(), row["explained"]
    return found


COLUMNS = _read_columns()
# Units of the numbers that describe a component.
UNITS = {what: COLUMNS[what][0] for what in "flux east north major minor pa".split()}
# Advice for files without a date.
UNDATED = (
    "no DATE-OBS in the header, or no date in a name like source_2006-03-09.mod; "
    "write it there, or give dates"
)
#: Suffixes of tables of many epochs, and of difmap models.
ECSV, MACHINE_READABLE, DIFMAP = ".ecsv", (".txt", ".dat", ".mrt"), (".mod", ".mdl")
#: Suffixes of files that have a list and no image.
LISTS = {ECSV, *MACHINE_READABLE, *DIFMAP}
#: Suffixes of files that may have an image, a list, or both.
FITS = (".fits", ".fit", ".fts")
#: What is wrong with a list where images are wanted.
NO_IMAGE = (
    "is a list of components and no image; give lists alone to astro-scc measure or "
    "track, or make images of them with astro-scc restore"
)
#: Keys of the meta that name the source, and other keys that are kept.
NAMES = ("source", "name", "object")
FACTS = ("telescope", "filter", "stokes", "beam", "position_from")
FILE_DATE = re.compile(
    r"(?<!\d)(?=((?:19|20)\d\d)([-_.]?)(0[1-9]|1[0-2])\2([0-3]\d)(?!\d))"
)


def source_names(table, columns=None):
    """Return the name of the source in each row, None without a column of them."""
    column = (columns or _find_columns(table)).get("source")
    if column is None:
        return None
    return np.char.strip(np.ma.filled(table[column].astype(str), "--"))


def open_table(path):
    """
    Return the table in a file, and the date of the file.

    The date is "" if the file should have one and has none, None if the table has the
    dates.
    """
    suffix = path.suffix.lower()
    if suffix == ECSV:
        return _open_ascii(path, "ascii.ecsv"), None
    if suffix in MACHINE_READABLE:
        return _open_mrt(path), None
    if suffix in DIFMAP:
        return _open_difmap(path)
    if suffix in FITS:
        return _open_aips(path)
    known = ", ".join((ECSV, *MACHINE_READABLE, *DIFMAP, *FITS))
    raise ValueError(f"{path}: its suffix is none of {known}; rename it")


def read_fields(path, source, origin, date=None):
    """
    Return the fields of the `~astro_scc.epochs.ComponentList` in a file.

    A ``date``, as text, replaces the date of the file or of all rows.
    """
    table, own_date = open_table(path)
    date = date or own_date
    if date == "":
        raise ValueError(f"{path}: {UNDATED}")
    columns = _find_columns(table)
    table = _select_source(table, columns, source, path)
    if len(table) == 0:
        raise ValueError(f"{path}: no components in the file")
    has_offsets = {"east", "north"} <= columns.keys()
    needed = {"flux"} | (set() if has_offsets else {"separation", "position_angle"})
    if date is None and not columns.keys() >= {"year", "month", "day"}:
        needed.add("epoch")
    if missing := sorted(needed - columns.keys()):
        # In quotes, as columns are no options of the same names.
        lacks, has = (", ".join(map(repr, n)) for n in (missing, table.colnames))
        raise ValueError(f"{path}: no column for {lacks}; the table has {has}")
    values = {
        what: series.numbers(table[columns[what]], unit, path)
        for what, (unit, *_) in COLUMNS.items()
        if unit is not None and what in columns
    }
    dates = _dates(table, columns, date, path)
    days, epoch = np.unique(dates, return_inverse=True)
    if not has_offsets:
        values |= _offsets(values, path)
    relative = not has_offsets and "feature" in values
    if relative or origin == "core":
        _refer(values, epoch, days, relative, origin, path)
    values |= _sizes(values, path)
    fields = {name: values[name] * unit for name, unit in UNITS.items()}
    fields |= {"times": as_times(list(days), len(days)), "epoch": epoch}
    fields |= {"feature": values.get("feature"), "meta": _meta(table, columns, path)}
    return fields | {"labels": () if len(days) > 1 else (path.name,)}


def _refer(values, epoch, days, relative, origin, path):
    """Shift the positions of each epoch to the requested origin, in place."""
    core = values.get("feature", np.full(len(epoch), -1)) == 0
    needed = origin == ("map" if relative else "core")
    for day, n in zip(days, np.bincount(epoch[core], minlength=len(days)), strict=True):
        if n > 1 or (needed and n == 0):
            found = f"{n} core components" if n else "no core component"
            raise ValueError(
                f"{path}: {found} (feature 0) on {day[:10]}, expected one to refer "
                "positions to; correct the file, or give another origin"
            )
    for offsets in (values["east"], values["north"]):
        of_core = np.zeros(len(days))
        of_core[epoch[core]] = offsets[core]
        if relative:
            # The row of the core has its own offset from the map's centre.
            offsets[core] = 0
        if origin == "map":
            offsets += of_core[epoch]
        elif not relative:
            offsets -= of_core[epoch]


def _dates(table, columns, date, path):
    """Return the date of each row as ISO text; ``date`` applies to all rows."""
    if date is not None:
        texts = [date] * len(table)
    elif "epoch" in columns:
        column = table[columns["epoch"]]
        texts = column.utc.isot if isinstance(column, Time) else column
        texts = [str(text) for text in texts]
    else:
        rows = table.iterrows(*(columns[part] for part in ("year", "month", "day")))
        texts = ["-".join(str(value).zfill(2) for value in row) for row in rows]
    known = {}
    # ERFA warns of years whose leap seconds are unknown.
    with warnings.catch_warnings(action="ignore"):
        for text in dict.fromkeys(texts):
            row = "" if date is not None else f", row {texts.index(text) + 1}"
            with naming(f"{path}{row}"):
                known[text] = parse_date(text).isot
    return [known[text] for text in texts]


def _find_columns(table):
    """Return the names of the table's columns, keyed by their content."""
    found = {}
    for what, (*_, pattern) in COLUMNS.items():
        for name in table.colnames if pattern else ():
            explanation = table[name].info.description or ""
            if name not in found.values() and re.match(pattern, explanation, re.I):
                found.setdefault(what, name)
    for what, (_, labels, _) in COLUMNS.items():
        for name in table.colnames:
            label = re.sub(r"[^a-z]", "", name.lower())
            if name not in found.values() and label in labels:
                found.setdefault(what, name)
    return found


def _select_source(table, columns, source, path):
    """Return the rows of one source; without a column, the meta names the source."""
    names = [str(table.meta[k]) for k in NAMES if k in table.meta]
    mine, column = slice(None), source_names(table, columns)
    if column is not None:
        names = list(dict.fromkeys(column.tolist()))
        if source is None and len(names) > 1:
            raise ValueError(
                f"{path}: {len(names)} sources in the table ({some(names, 8)}); "
                "say which, with --source NAME of astro-scc restore or source=; "
                "astro-scc restore TABLE --list lists them"
            )
        if source is not None:
            mine = np.isin(column, same_source(source, names))
    if source is None or same_source(source, names):
        return table[mine]
    has = "it does not say of which source it is; leave --source out"
    near = get_close_matches(source, names, n=3, cutoff=0.7)
    if near and len(names) > 8:
        has = f"did you mean {' or '.join(near)}?"
    elif names:
        has = f"it has {some(names, 8)}"
    if len(names) > 1:
        has = f"{has.rstrip('?')}; astro-scc restore TABLE --list lists all"
    raise ValueError(f"{path}: no source {source!r}; {has}")


def source_list(path):
    """
    Return the sources of a table.

    Returns
    -------
    list of (str, list of str, list of str)
        The name, the common names, and the dates of each, in order.
    """
    table, date = open_table(path)
    if date == "":
        raise ValueError(f"{path}: {UNDATED}")
    columns = _find_columns(table)
    names = source_names(table, columns)
    if names is None:
        name = next((str(table.meta[k]) for k in NAMES if k in table.meta), path.stem)
        names = np.array([name] * len(table))
    dates = np.array(_dates(table, columns, date, path))
    return [
        (name, also_named(name), np.unique(dates[names == name]).tolist())
        for name in dict.fromkeys(names.tolist())
    ]


def _offsets(values, path):
    """Return the offsets given by separations and position angles."""
    separation, angle = values["separation"], values["position_angle"]
    if "feature" in values:
        # A core with a blank offset is at the map's centre.
        blank = (values["feature"] == 0) & np.isnan(separation)
        separation = np.where(blank, 0.0, separation)
    angle = np.radians(np.where((separation == 0) & np.isnan(angle), 0.0, angle))
    for i in np.flatnonzero(np.isnan(separation + angle)):
        raise ValueError(f"{path}, row {i + 1}: separation or position_angle is blank")
    return {"east": separation * np.sin(angle), "north": separation * np.cos(angle)}


def _sizes(values, path):
    """Return the axes and angles; a blank size is a point, a blank ratio a circle."""
    zeros = np.zeros(len(values["flux"]))
    major = values.get("major", zeros)
    minor = values.get("minor", major * values.get("ratio", 1.0))
    minor = np.where(np.isnan(minor), major, minor)
    types = values.get("type", zeros + 1)
    for i in np.flatnonzero(~np.isin(types, (0, 1))):
        what = f"component type {types[i]:g} is neither a point (0) nor a Gaussian (1)"
        raise ValueError(f"{path}, row {i + 1}: {what}; replace it by one of these")
    sizes = {"major": major, "minor": minor, "pa": values.get("pa", zeros)}
    return {name: np.where(types == 0, 0.0, size) for name, size in sizes.items()}


def _meta(table, columns, path):
    """Return facts about the source, from the meta and the columns of a table."""
    facts = table.meta
    meta = {name: facts[name] for name in FACTS if name in facts}
    name = facts.get("name") or facts.get("source") or facts.get("object")
    if name is None and "source" in columns:
        name = str(table[columns["source"]][0]).strip()
    if name is not None:
        meta["object"] = str(name)
    names = [str(facts[key]) for key in NAMES if key in facts] + [str(name or "")]
    places = {one: place_of(one) for one in names}
    known = [one for one in names if places[one] is not None]
    if (place := table_position(table)) is not None:
        meta["position"] = place
    elif known:
        meta |= {"position": places[known[0]], "position_from": known[0]}
    if isinstance(text := facts.get("beam"), str):
        with naming(f"{path}, beam in its meta"):
            meta["beam"] = parse_beam(text)
    if "redshift" in facts:
        meta["redshift"] = float(facts["redshift"])
    if "frequency" in facts:
        meta["frequency"] = u.Quantity(facts["frequency"], u.Hz).value
    return meta


def _open_ascii(path, kind, **options):
    # A survey compares each of its sources with the same table.
    state = path.stat()
    return _opened(path, kind, (state.st_mtime_ns, state.st_size), **options)


@lru_cache(maxsize=1)
def _opened(path, kind, state, **options):
    with (
        naming_all(f"{path}: not a readable {kind} table", OSError),
        # The units of the columns that are needed are checked later.
        warnings.catch_warnings(action="ignore", category=u.UnitsWarning),
    ):
        return Table.read(path, format=kind, **options)


def _open_mrt(path):
    with path.open(encoding="utf-8", errors="replace") as file:
        # Titles, authors and abstracts come before the description.
        if "Byte-by-byte" in file.read(100_000):
            return _open_ascii(path, "ascii.mrt")
    readme = path.parent / "ReadMe"
    if not readme.is_file():
        what = "has no byte-by-byte description; lay the ReadMe of CDS beside it"
        raise OSError(f"{path}: {what}, or {AS_TABLE}")
    return _open_ascii(path, "ascii.cds", readme=str(readme))


def _open_difmap(path):
    """
    Return a difmap model as a table.

    Each line has flux, radius, theta, major axis, axial ratio, phi and type; a
    'v' marks a value that was free in the fit.  Three values describe a point.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        raise OSError(f"{path}: not a difmap model, it is not text") from None
    unit, meta, rows = u.mas, {}, []
    for number, line in enumerate(lines, start=1):
        text, _, comment = line.partition("!")
        if re.search(r"Radius\s*\(arcsec\)", comment):
            unit = u.arcsec
        centre = re.search(r"Center RA:\s*(.+?),\s*Dec:\s*(.+?)\s*\(2000", comment)
        if centre:
            meta["position"] = SkyCoord(*centre.groups(), unit=(u.hourangle, u.deg))
        if text.split():
            rows.append(_difmap_row(text, f"{path}, line {number}"))
    names = ["flux", "radius", "theta", "major", "ratio", "phi", "type obj"]
    units = [u.Jy, unit, u.deg, unit, u.one, u.deg, u.one]
    values = np.reshape(rows, (len(rows), len(names)))
    found = FILE_DATE.search(path.name)
    date = "-".join(found.group(1, 3, 4)) if found else ""
    return Table(values, names=names, units=units, meta=meta), date


def _difmap_row(text, where):
    try:
        row = [float(word.rstrip("vV")) for word in text.split()[:7]]
    except ValueError:
        raise ValueError(f"{where}: not numbers: {text!r}") from None
    if len(row) not in (3, 6, 7) or not np.all(np.isfinite(row)):
        wanted = "(flux, radius, theta, major, ratio, phi, type)"
        what = f"expected 3, 6 or 7 finite values {wanted}, got {len(row)}"
        raise ValueError(f"{where}: {what}")
    row += [0.0] * (6 - len(row))
    # Without a type, a component with a size is a Gaussian.
    return row if len(row) == 7 else [*row, float(row[3] > 0)]


def _open_aips(path):
    """Return the newest AIPS CC table of a FITS file, and its date."""
    with opened(path) as hdus:
        header = hdus[0].header
        found = [h for h in hdus[1:] if h.name.strip().startswith("AIPS CC")]
        if not found:
            raise headers.ContentError("no AIPS CC table in the file; leave it out")
        table = _aips_table(max(found, key=lambda h: h.ver))
        record = read_header(header, hdus)
    beam = record["beam"]
    table.meta = record["facts"] | ({} if beam is None else {"beam": beam})
    with suppress(ValueError):
        wcs = headers.celestial_wcs(header)
        frame = wcs_to_celestial_frame(wcs)
        table.meta["position"] = SkyCoord(*wcs.wcs.crval, unit="deg", frame=frame).icrs
    return table, headers.get(header, "DATE-OBS", kind=str) or ""


def _aips_table(hdu):
    table = Table()
    for column in hdu.columns:
        name, unit = column.name.strip(), (column.unit or "").strip()
        usual = {"FLUX": "Jy", "TYPE OBJ": ""}.get(name, "deg")
        if not unit or unit.upper().startswith(usual.upper()):
            unit = usual
        table[name] = np.array(hdu.data[column.name], dtype=float).ravel()
        table[name].unit = u.Unit(unit, parse_strict="silent")
    return table
