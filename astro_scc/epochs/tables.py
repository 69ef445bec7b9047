# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Files of model components, the columns of their tables, and the sources in them."""

import csv
import re
import warnings
from contextlib import suppress
from difflib import get_close_matches
from functools import cache, lru_cache
from importlib import resources

import astropy.units as u
import numpy as np
from astropy.coordinates import FK4, SkyCoord
from astropy.table import Table
from astropy.time import ScaleValueError, Time
from astropy.wcs.utils import wcs_to_celestial_frame

from astro_scc.columns import numbers
from astro_scc.exceptions import naming, naming_all, refusing
from astro_scc.images import headers
from astro_scc.images.beam import parse_beam
from astro_scc.images.dates import times_of_column
from astro_scc.images.fits import AS_TABLE, opened, read_header
from astro_scc.images.headers import some
from astro_scc.quantities import parse_date


def _read_columns():
    """
    Return what tables have in their columns, of ``components.csv``.

    Of each content that is its unit (None for text), its labels in tables, and a
    pattern for what machine-readable tables explain of it, which tells what labels such
    as ID mean.
    """
    found = {}
    with resources.files(__package__).joinpath("components.csv").open() as file:
        for row in csv.DictReader(file):
            unit = None if row["unit"] == "-" else u.Unit(row["unit"])
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
NAMES = ("name", "source", "object")
FACTS = ("telescope", "filter", "stokes", "beam", "position_from")
FILE_DATE = re.compile(
    r"(?<!\d)(?=((?:19|20)\d\d)([-_.]?)(0[1-9]|1[0-2])\2([0-3]\d)(?!\d))"
)
#: HHMM+DD, HHMM+DDd (tenths of a degree), HHMM+DDMM or HHMMSS.s+DDMMSS.s behind the
#: name of a catalogue and the letter of the equinox.
_IAU = re.compile(
    r"(?:[A-Za-z0-9]*[A-Za-z][A-Za-z0-9]*[\s_-]+|[A-Za-z]{2,4})?([BJ]?)"
    r"(\d\d)(\d\d)(\d\d(?:\.\d+)?)?([+-])(\d\d)(?:(\d)|(\d\d)(\d\d(?:\.\d+)?)?)?"
)
#: Names tell right ascensions to a minute, declinations to a tenth of a degree, and
#: places of either equinox are told apart no better.
NEAR = 0.5 * u.deg


#: Labels of the position of a source, by preference.
PLACES = (
    ("radeg", "dedeg"), ("radeg", "decdeg"), ("raj2000", "dej2000"),
    ("raj2000", "decj2000"), ("ra", "dec"), ("ra", "de"), ("rab1950", "deb1950"),
    ("ra1950", "dec1950"), ("ra1950", "de1950"), ("rab1950", "decb1950"),
)  # fmt: skip
SEXAGESIMAL = "rah", "ram", "ras", "ded", "dem", "des"


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


def read_rows(table, source, date):
    """
    Return numbers of the components of a source in a table, their dates, and facts.

    A ``date`` is that of all rows, as text, None if the table has dates, "" if there
    should be one.  Features stay the column of their numbers or names.
    """
    columns = _find_columns(table)
    table = _select_source(table, columns, source)
    if len(table) == 0:
        raise ValueError("no components in the file")
    polar = {"separation", "position_angle"}
    needed = {"flux"} | (set() if {"east", "north"} <= columns.keys() else polar)
    if date is None and not columns.keys() >= {"year", "month", "day"}:
        needed.add("epoch")
    if missing := sorted(needed - columns.keys()):
        # In quotes, as columns are no options of the same names.
        lacks, has = (", ".join(map(repr, n)) for n in (missing, table.colnames))
        lacks += " (or 'east', 'north')" if polar & {*missing} else ""
        raise ValueError(f"no column for {lacks}; the table has {has}")
    values = {
        what: numbers(table[columns[what]], unit)
        for what, (unit, *_) in COLUMNS.items()
        if unit is not None and what in columns.keys() - {"feature"}
    }
    if "feature" in columns:
        values["feature"] = table[columns["feature"]]
    return values, _dates(table, columns, date), _meta(table, columns)


def _dates(table, columns, date):
    """Return the date of each row as ISO text; ``date`` applies to all rows."""
    if date == "":
        raise ValueError(UNDATED)
    if date is not None:
        texts = [date] * len(table)
    elif "epoch" in columns:
        column = times_of_column(table[columns["epoch"]])
        if isinstance(column, Time):
            local = f"column {columns['epoch']!r} is of the scale {column.scale!r}"
            with refusing(f"{local}; write it in UTC", ScaleValueError):
                column = column.utc.isot
        texts = [str(text).strip() for text in column]
    else:
        rows = table.iterrows(*(columns[part] for part in ("year", "month", "day")))
        texts = ["-".join(str(value).zfill(2) for value in row) for row in rows]
    known = {}
    # ERFA warns of years whose leap seconds are unknown.
    with warnings.catch_warnings(action="ignore"):
        for text in dict.fromkeys(texts):
            where = "the date" if date is not None else f"row {texts.index(text) + 1}"
            with naming(where):
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


def _select_source(table, columns, source):
    """Return the rows of one source; without a column, the meta names the source."""
    names, mine = _names(table), slice(None)
    column = source_names(table, columns)
    if column is not None:
        names = list(dict.fromkeys(column.tolist()))
        if source is None and len(names) > 1:
            raise ValueError(
                f"{len(names)} sources in the table ({some(names, 8)}); "
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
    raise ValueError(f"no source {source!r}; {has}")


def source_list(path):
    """
    Return the sources of a table.

    Returns
    -------
    list of (str, list of str, list of str)
        The name, the common names, and the dates of each, in order.
    """
    table, date = open_table(path)
    columns = _find_columns(table)
    names = source_names(table, columns)
    if names is None:
        names = np.array([*_names(table), path.stem][:1] * len(table))
    with naming(path):
        dates = np.array(_dates(table, columns, date))
    return [
        (name, also_named(name), np.unique(dates[names == name]).tolist())
        for name in dict.fromkeys(names.tolist())
    ]


def _names(table):
    """Return the names of the source that the meta of a table has."""
    return [str(table.meta[key]) for key in NAMES if table.meta.get(key)]


def _meta(table, columns):
    """Return facts about the source, from the meta and the columns of a table."""
    facts, names = table.meta, _names(table)
    meta = {name: facts[name] for name in FACTS if name in facts}
    if "source" in columns:
        names.append(str(table[columns["source"]][0]).strip())
    if names:
        meta["object"] = names[0]
    known = [name for name in names if place_of(name) is not None]
    if (place := table_position(table)) is not None:
        meta["position"] = place
    elif known:
        meta |= {"position": place_of(known[0]), "position_from": known[0]}
    if isinstance(text := facts.get("beam"), str):
        with naming("beam in its meta"):
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
    wrong = f"{path}: not a difmap model, it is not text"
    with refusing(wrong, UnicodeDecodeError, error=OSError):
        lines = path.read_text(encoding="utf-8").splitlines()
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
    with refusing(f"{where}: not numbers: {text!r}", ValueError):
        row = [float(word.rstrip("vV")) for word in text.split()[:7]]
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
        table, newest = Table(), max(found, key=lambda h: h.ver)
        for column in newest.columns:
            name, unit = column.name.strip(), (column.unit or "").strip()
            usual = {"FLUX": "Jy", "TYPE OBJ": ""}.get(name, "deg")
            if not unit or unit.upper().startswith(usual.upper()):
                unit = usual
            table[name] = np.array(newest.data[column.name], dtype=float).ravel()
            table[name].unit = u.Unit(unit, parse_strict="silent")
        record = read_header(header, hdus)
    beam = record["beam"]
    table.meta = record["facts"] | ({} if beam is None else {"beam": beam})
    with suppress(ValueError):
        wcs = headers.celestial_wcs(header)
        frame = wcs_to_celestial_frame(wcs)
        table.meta["position"] = SkyCoord(*wcs.wcs.crval, unit="deg", frame=frame).icrs
    return table, headers.get(header, "DATE-OBS", kind=str) or ""


def plain(name):
    """Return a name without spaces, in lower case."""
    return "".join(name.split()).casefold()


@cache
def common_names():
    """Return the names by the coordinates of B1950 of well-known sources."""
    text = resources.files(__package__).joinpath("names.csv").read_text("utf-8")
    found = {}
    for row in csv.DictReader(text.splitlines()):
        found.setdefault(row["b1950"], []).append(row["name"])
    return found


def iau_name(name):
    """Return the match of an IAU name, of a common one its name by B1950, or None."""
    for coordinates, names in common_names().items():
        if plain(name) in map(plain, names):
            name = coordinates
    dashes = str.maketrans(dict.fromkeys("\N{MINUS SIGN}\N{EN DASH}", "-"))
    return _IAU.fullmatch(name.strip().translate(dashes))


def place_of(name):
    """
    Return the place that a name tells as SkyCoord, None if it tells none.

    Names of the IAU are of B1950 unless they begin with J or have four digits of
    declination.

    Examples
    --------
    >>> from astro_scc.epochs.tables import place_of
    >>> place_of("0430+052").fk4.to_string("hmsdms", precision=0)
    '04h30m00s +05d12m00s'
    >>> place_of("J0433+0521").to_string("hmsdms", precision=0)
    '04h33m00s +05d21m00s'
    """
    match = iau_name(name)
    if match is None:
        return None
    _, hours, minutes, seconds, sign, degrees, tenths, arcmin, arcsec = match.groups()
    lon = int(hours) + int(minutes) / 60 + float(seconds or 0) / 3600
    lat = int(degrees) + int(tenths or 0) / 10
    lat += int(arcmin or 0) / 60 + float(arcsec or 0) / 3600
    if lon >= 24 or int(minutes) >= 60 or int(arcmin or 0) >= 60 or lat > 90:
        return None
    frame = "icrs" if _is_modern(match) else FK4(equinox="B1950")
    lat = -lat if sign == "-" else lat
    return SkyCoord(lon * u.hourangle, lat * u.deg, frame=frame).icrs


def also_named(name):
    """Return the common names of the source of a name."""
    match = iau_name(name)
    found = common_names().get(_digits(match), []) if match else []
    return [other for other in found if plain(other) != plain(name)]


def same_source(wanted, names):
    """
    Return those of some names that are of the source that is wanted.

    They are spelled as it, or its common name, or its coordinates behind the name of
    a catalogue, or its coordinates in the other equinox if only one is near.
    """
    if same := [name for name in names if plain(name) == plain(wanted)]:
        return same
    match = iau_name(wanted)
    if match is None:
        return []
    named = {name: other for name in names if (other := iau_name(name))}
    same = [name for name, other in named.items() if _digits(other) == _digits(match)]
    if same or (place := place_of(wanted)) is None:
        return same
    near = []
    for name, other in named.items():
        there = place_of(name) if _is_modern(other) != _is_modern(match) else None
        if there is not None and place.separation(there) < NEAR:
            near.append(name)
    return near if len(near) == 1 else []


def first_names(names):
    """Return by each of some names the first one of the same source."""
    found = {}
    for name in dict.fromkeys(names):
        found[name] = (same_source(name, [*found.values()]) or [name])[0]
    return found


def _is_modern(match):
    """Return whether an IAU name is by the coordinates of J2000."""
    return match[1] == "J" or (match[1] == "" and bool(match[4] or match[8]))


def _digits(match):
    """Return the coordinates of an IAU name, with a J if they are of J2000."""
    return ("J" if match[1] == "J" else "") + match[0][match.start(2) - match.start() :]


def table_position(table):
    """Return the position of the source that a table has, None if it has none."""
    firsts = {name: table[name][0] for name in table.colnames}
    blank = {k for k, value in firsts.items() if np.any(getattr(value, "mask", False))}
    facts = dict(table.meta) | {k: firsts[k] for k in firsts.keys() - blank}
    # Columns of dates and places have no unit.
    units = {name: getattr(table[name], "unit", None) for name in table.colnames}
    keys = {re.sub(r"[^a-z0-9]", "", str(key).lower()): key for key in facts}
    place = facts.get(keys.get("position"))
    if isinstance(place, SkyCoord):
        return place.icrs
    found = {label: facts[key] for label, key in keys.items()}
    pairs = [pair for pair in PLACES if found.keys() >= {*pair}]
    # Words that are no angles are none of a position.
    with suppress(TypeError, ValueError, u.UnitsError):
        if isinstance(place, str):
            return SkyCoord(place, unit=(u.hourangle, u.deg))
        if found.keys() >= {*SEXAGESIMAL}:
            words = [f"{float(found[label]):.12g}" for label in SEXAGESIMAL]
            sign = "-" if str(found.get("de", "")).strip() == "-" else ""
            lon, lat = " ".join(words[:3]), sign + " ".join(words[3:])
            return SkyCoord(lon, lat, unit=(u.hourangle, u.deg))
        for pair in pairs:
            lon, lat = (_angle(found[label], units.get(keys[label])) for label in pair)
            old = "1950" in pair[0]
            frame = FK4(equinox="B1950") if old else "icrs"
            text = {"unit": (u.hourangle, u.deg)} if isinstance(lon, str) else {}
            place = SkyCoord(lon, lat, frame=frame, **text).icrs
            if np.isfinite(place.ra + place.dec):
                return place
    return None


def _angle(value, unit):
    """Return an angle of a table, or the text of one in hours or degrees."""
    if isinstance(value, str):
        with suppress(TypeError, ValueError):
            return u.Quantity(value, None if value.strip()[-1:].isalpha() else u.deg)
        return value
    if isinstance(value, u.Quantity):
        return value
    return float(value) * (u.hourangle if unit == u.hour else unit or u.deg)
