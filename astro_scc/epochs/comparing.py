# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Comparison of images: which of them do not belong to the others."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from astro_scc.images.validation import as_times, order_of

# Largest ln(frequency ratio) in one band: VLBI bands are a few per cent wide and 30%
# apart.
BAND = 0.1
POLARISED = ("Q", "U", "V")
#: What to do with an image that does not belong to the others.
UNCHECKED = "leave it out (in Python, check=False reads it)"
UNNAMED = {"", "UNKNOWN", "NONE", "N/A"}


@dataclass(frozen=True)
class Problem:
    """What is odd about the image of an index, and what to do with it."""

    index: int
    what: str
    advice: str = UNCHECKED
    refused: bool = True


def problems(planes, check=True):
    """
    Return the `Problem` of each image that does not belong to the others.

    It is of another unit, object, band or polarisation, or of the date of another one.
    Another name for the same place, and the same date, need only a warning.  Without
    ``check``, only units and dates count.
    """
    found = [*_other_units(planes), *_same_dates(planes)]
    if check:
        found += [*_other_objects(planes), *_other_light(planes), *_other_band(planes)]
    return sorted(found, key=lambda problem: (problem.index, problem.what))


def _other_units(planes):
    first = planes[0].unit
    for i, plane in enumerate(planes):
        if not plane.unit.is_equivalent(first):
            own, other = (unit.to_string() or "none" for unit in (plane.unit, first))
            what = f"its unit is {own}, that of others is {other}"
            yield Problem(i, what, "leave one out")


def _same_dates(planes):
    """Yield images of the date of another one, to the second."""
    dated = [i for i, plane in enumerate(planes) if plane.time is not None]
    if not dated:
        return
    times = as_times([planes[i].time for i in dated], len(dated))
    order = order_of(times)
    gaps = np.diff((times - times[0]).sec[order])
    for k in np.flatnonzero(gaps < 1):
        one, other = (dated[order[n]] for n in (k, k + 1))
        date = times[order[k]].to_value("iso", subfmt="date")
        what = f"is of {date}, as is {Path(planes[one].name).name}"
        advice = "leave one out if it is a stack or another image of the same data"
        yield Problem(other, what, advice, refused=False)


def _other_objects(planes):
    names = [str(plane.facts.get("object", "")).strip() for plane in planes]
    names = [None if name.upper() in UNNAMED else name for name in names]
    for i, mine, others in _minority(names):
        one, other = planes[i], planes[names.index(others)]
        same = bool(separation(one.wcs, other.wcs) < max(one.extent, other.extent))
        where = "at the same place" if same else "somewhere else"
        what = f"shows {mine}, {where}, where others show {others}"
        advice = "leave it out if it is another object" if same else UNCHECKED
        yield Problem(i, what, advice, refused=not same)


def _other_light(planes):
    filters = [plane.facts.get("filter") for plane in planes]
    stokes = [plane.facts.get("stokes") for plane in planes]
    stokes = [s if s in POLARISED else s and "I" for s in stokes]
    for what, values in (("the filter", filters), ("Stokes", stokes)):
        for i, mine, others in _minority(values):
            yield Problem(i, f"is of {what} {mine}, others are of {others}")


def _other_band(planes):
    known = [plane.facts.get("frequency") or np.nan for plane in planes]
    known = np.array(known, dtype=float)
    near = np.abs(np.log(known[:, None] / known)) < BAND
    usual = int(np.argmax(near.sum(axis=1)))
    for i in np.flatnonzero(~near[usual] & ~np.isnan(known)):
        mine, others = (f"{known[k] / 1e9:.4g}" for k in (i, usual))
        yield Problem(int(i), f"is at {mine} GHz, others are at {others}")


def _minority(values):
    """Return the entries that differ from the most common value (first of equals)."""
    keys = [v and v.upper().replace(" ", "").replace("_", "") for v in values]
    count = Counter(key for key in keys if key)
    if len(count) < 2:
        return []
    usual = count.most_common(1)[0][0]
    name = values[keys.index(usual)]
    return [(i, values[i], name) for i, key in enumerate(keys) if key and key != usual]


def separation(one, other):
    """Return the distance of the reference pixels of two WCS on the sky, in degrees."""
    (lon, lat), (lon_0, lat_0) = one.wcs.crval, other.wcs.crval
    east = (lon - lon_0 + 180) % 360 - 180
    return np.hypot(east * np.cos(np.radians(lat_0)), lat - lat_0)
