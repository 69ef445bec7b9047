# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Published features beside those that were measured."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import astropy.units as u
import numpy as np
from astropy.table import MaskedColumn, QTable
from astropy.utils.masked import Masked

from astro_scc.columns import describe, round_to_errors
from astro_scc.epochs import read_components
from astro_scc.exceptions import warn
from astro_scc.units import PM_UNIT

if TYPE_CHECKING:
    from astro_scc.epochs import EpochCube
    from astro_scc.features import Features

#: A published feature has at least so many epochs, and so many of those in common.
LEAST = 3
#: Features are the same if their paths are apart by at most so many beams.
SAME = 0.5
#: A day, in years.
DAY = 1 / 365.25


def published_positions(path: Path | str, cube: EpochCube) -> QTable:
    """
    Read the published features of the source of a cube.

    Parameters
    ----------
    path : path
        A table of the positions of features by epoch, see
        `~astro_scc.epochs.read_components`.  Of several sources, it is the one with the
        name of the cube's object.
    cube : `~astro_scc.EpochCube`

    Returns
    -------
    `~astropy.table.QTable`
        A row for each feature and epoch: ``published``, its number,
        ``date``, ``separation``, ``ra_offset`` and ``dec_offset``.  The core and
        what was not identified are left out.

    Raises
    ------
    OSError, ValueError
        If the table cannot be read, or numbers no features of the source.
    """
    name = cube.meta.get("object")
    try:
        found = read_components(path, source=name and str(name))
    except ValueError as error:
        if not name:
            raise
        try:
            # A table of one source may give it another name.
            found = read_components(path)
        except ValueError:
            raise error from None
        if other := found.meta.get("object"):
            warn(
                f"{path}: its source is {other}, that of the images {name}; its "
                "features are compared nevertheless"
            )
    years, kept = found.times.jyear[found.epoch], found.feature > 0
    if not kept.any():
        raise ValueError(
            f"{path}: numbers no features; give a table of features by epoch that has "
            "a column feature"
        )
    east, north = found.east[kept].to(u.mas), found.north[kept].to(u.mas)
    order = np.lexsort((years[kept], found.feature[kept]))
    table = QTable(
        {
            "published": found.feature[kept],
            "date": found.times[found.epoch[kept]],
            "separation": np.hypot(east, north),
            "ra_offset": east,
            "dec_offset": north,
        }
    )
    return table[order]


def with_published(table: QTable, features: Features, published: QTable) -> QTable:
    """
    Return a table of features with the published ones and their proper motions.

    A published feature is the same if it is within half a beam of the measured one
    in most of the epochs that both have; it is interpolated to their dates.  Its proper
    motion is that in the time in which the measured one is seen, if it has three epochs
    there, since features accelerate.

    Parameters
    ----------
    table : `~astropy.table.QTable`
        Of the features.
    features : `~astro_scc.features.Features`
    published : `~astropy.table.QTable`
        See `published_positions`.

    Returns
    -------
    `~astropy.table.QTable`
        With the columns ``published``, ``published_pm`` and ``published_pm_err``,
        masked where no published feature is the same.
    """
    d, paths = features.detections, {}
    for number in np.unique(published["published"]).tolist():
        own = published[published["published"] == number]
        if len(own) >= LEAST:
            place = [own[k].to_value(u.mas) for k in ("ra_offset", "dec_offset")]
            paths[number] = own["date"].jyear, np.stack(place)
    rows = []
    for track in features.tracks:
        time, place = d.time[track.detection], d.place[track.detection].T
        apart = {SAME * d.fwhm: None}
        for number, (years, published_place) in paths.items():
            both = (time >= years[0]) & (time <= years[-1])
            if both.sum() >= max(LEAST, len(time) / 2):
                there = np.stack([np.interp(time, years, k) for k in published_place])
                off = np.hypot(*(there - place)[:, both])
                if 2 * np.sum(off <= SAME * d.fwhm) > len(off):
                    apart[np.median(off)] = number
        best = apart[min(apart)]
        rows.append((best, *(_speed_at(time, *paths[best]) if best else (0.0, 0.0))))
    numbers, *speeds = zip(*rows, strict=True) if rows else ((), (), ())
    missing = np.array([number is None for number in numbers], dtype=bool)
    table = table.copy()
    numbers = np.array([number or 0 for number in numbers], dtype=int)
    table["published"] = MaskedColumn(numbers, mask=missing)
    unit = features.cube.speed_unit
    for name, speed in zip(("published_pm", "published_pm_err"), speeds, strict=True):
        speed = (np.array(speed, dtype=float) * PM_UNIT).to(unit)
        table[name] = Masked(speed, mask=missing)
    return round_to_errors(describe(table, "added"))


def _speed_at(time, years, place):
    """Return the speed and its error in the time of a feature, or of all if few."""
    inside = (years >= time[0] - DAY) & (years <= time[-1] + DAY)
    if inside.sum() < LEAST:
        inside[:] = True
    return speed_of(years[inside], place[:, inside])


def speed_of(years, place):
    """Return the speed of a straight line, and its error, in mas/yr."""
    (velocity, _), covariance = np.polyfit(years - years.mean(), place.T, 1, cov=True)
    speed = float(np.hypot(*velocity))
    return speed, float(np.sqrt(velocity**2 @ covariance[0, 0])) / (speed or 1.0)
