# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Names of sources, common ones and those of the IAU, and their places."""

import csv
import re
from contextlib import suppress
from functools import cache
from importlib import resources

import astropy.units as u
from astropy.coordinates import FK4, SkyCoord

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
    >>> from astro_scc.components.names import place_of
    >>> place_of("0430+052").fk4.to_string("hmsdms", precision=0)
    '04h30m00s +05d12m00s'
    >>> place_of("J0433+0521").to_string("hmsdms", precision=0)
    '04h33m00s +05d21m00s'
    """
    match = iau_name(name)
    if match is None:
        return None
    letter, hours, minutes, seconds, sign, degrees, tenths, arcmin, arcsec = (
        match.groups()
    )
    lon = int(hours) + int(minutes) / 60 + float(seconds or 0) / 3600
    lat = int(degrees) + int(tenths or 0) / 10
    lat += int(arcmin or 0) / 60 + float(arcsec or 0) / 3600
    if lon >= 24 or int(minutes) >= 60 or int(arcmin or 0) >= 60 or lat > 90:
        return None
    modern = letter == "J" or (letter == "" and (arcmin or seconds))
    frame = "icrs" if modern else FK4(equinox="B1950")
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
    named = [(name, iau_name(name)) for name in names]
    named = [(name, other) for name, other in named if other]
    same = [name for name, other in named if _digits(other) == _digits(match)]
    place, place_by_name = place_of(wanted), {n: place_of(n) for n, _ in named}
    if same or place is None:
        return same
    near = [
        name
        for name, other in named
        if (other[1] == "J" or bool(other[8])) != (match[1] == "J" or bool(match[8]))
        and place_by_name[name] is not None
        and place.separation(place_by_name[name]) < NEAR
    ]
    return near if len(near) == 1 else []


def _digits(match):
    """Return the coordinates of an IAU name, with a J if they are of J2000."""
    return ("J" if match[1] == "J" else "") + match[0][match.start(2) - match.start() :]


def table_position(table):
    """Return the position of the source that a table has, None if it has none."""
    facts = dict(table.meta) | {name: table[name][0] for name in table.colnames}
    units = {name: table[name].unit for name in table.colnames}
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
            return SkyCoord(lon, lat, frame=frame, **text).icrs
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
