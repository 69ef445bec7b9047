# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features and tracks as tables of quantities."""

import astropy.units as u
import numpy as np
from astropy.coordinates import SkyCoord
from astropy.table import QTable
from astropy.time import Time
from astropy.utils.masked import Masked

from astro_scc.columns import MOTION, build_table
from astro_scc.epochs.positions import axis_words, name_by_frame
from astro_scc.kinematics.frames import axes_along
from astro_scc.tracking.motion import (
    SIGNIFICANT,
    ejection_epoch,
    projected_errors,
    turn_between,
)
from astro_scc.units import PM_UNIT, round_to_errors

PM_DOT_UNIT = u.mas / u.yr**2

#: Columns of the tracks: unit or type, and description.  Dates are given by the number
#: of the epoch, and fluxes have the unit of the cube.
COLUMNS = {
    "track": ("U64", "name: date, scale and place of the first feature"),
    "scale": (float, "wavelet scale number"),
    "n_epochs": (int, "epochs at which the feature is seen"),
    "first": (int, "date of the first one"),
    "last": (int, "date of the last one"),
    "n_gaps": (int, "epochs between them at which it is not seen"),
    "flux": (None, "median of the fluxes, sums of wavelet coefficients"),
    "r": (u.mas, "mean distance from the reference pixel"),
    "pa": (u.deg, "position angle of the mean position, north through east"),
    "middle": (u.yr, "Julian year that position and motion refer to"),
    "east": (u.mas, "fitted offset to the east at that date"),
    "north": (u.mas, "fitted offset to the north at that date"),
    **MOTION,
    "turn": (u.deg, "angle between the position angle and the motion"),
    "scatter_east": (u.mas, "robust scatter about the straight line"),
    "scatter_north": (u.mas, "robust scatter about the straight line"),
    "pm_dot_parallel": (PM_DOT_UNIT, "acceleration along the motion"),
    "pm_dot_parallel_err": (PM_DOT_UNIT, "standard error of pm_dot_parallel"),
    "pm_dot_transverse": (PM_DOT_UNIT, "acceleration to larger position angles"),
    "pm_dot_transverse_err": (PM_DOT_UNIT, "standard error of pm_dot_transverse"),
    "accelerated": (bool, "an acceleration of three standard errors or more"),
    "t_ej": (u.yr, "Julian year at which the feature passed the reference pixel"),
    "t_ej_err": (u.yr, "standard error of t_ej"),
    "coefficient": (float, "mean correlation of its links"),
    "gain": (float, "mean log-likelihood by which its links better no link"),
    "n_merges": (int, "other features that went into it"),
    "n_splits": (int, "other features that came out of it"),
    "merges_into": ("U64", "track that it goes into at its end"),
    "splits_from": ("U64", "track that it comes out of at its beginning"),
}
#: Prefixes of the columns that not every track has.
PARTIAL = ("pm_dot", "t_ej")


def track_table(tracking):
    """Return the table of tracks, one row each, with all columns even if empty."""
    cube = tracking.cube
    rows = [
        dict(zip(COLUMNS, _motion_row(tracking, number), strict=True))
        for number in range(tracking.n_tracks)
    ]
    table = build_table(rows, COLUMNS | {"flux": (cube.unit, COLUMNS["flux"][1])})
    for name, (_, description) in COLUMNS.items():
        if name in ("first", "last"):
            table[name] = Time(cube.times[table[name]], format="isot")
        elif name.startswith(PARTIAL):
            table[name] = Masked(table[name])
        table[name].info.description = description
    return name_by_frame(round_to_errors(table), cube)


def _motion_row(tracking, number):
    """Return the entries of a track: plain numbers or None, epoch indices for dates."""
    own = tracking.members(number)
    ssps, links = tracking.ssps, tracking.links
    fit = tracking.fits[number]
    epochs = ssps.epoch[own]
    east, north = tracking.offsets[:, own]
    start = tracking.cube.times[0].jyear
    (x, vx), (y, vy) = fit.coefficients
    speed_err, angle_err = fit.velocity_errors
    *acceleration, accelerated = _acceleration(tracking.accelerated_fits[number])
    epoch, epoch_err = ejection_epoch(fit, tracking.fwhm.value, accelerated=accelerated)
    starts, ends = np.isin(links.source, own), np.isin(links.target, own)
    is_link = (links.kind == "link") & starts & ends
    mean = east.mean(), north.mean()
    # The order is that of `COLUMNS`.
    return [
        tracking.names[number], ssps.scale[own[0]], len(own), epochs[0], epochs[-1],
        int(epochs[-1] - epochs[0] + 1 - len(own)), np.median(ssps.flux[own]),
        np.mean(np.hypot(east, north)), _angle(*mean), start + fit.middle, x, y,
        vx, fit.errors[0, 1], vy, fit.errors[1, 1], np.hypot(vx, vy), speed_err,
        _angle(vx, vy), min(np.degrees(angle_err), 180.0),
        turn_between(mean, (vx, vy)), *fit.scatter, *acceleration, accelerated,
        None if epoch is None else start + epoch, epoch_err,
        links.coefficient[is_link].mean(), links.gain[is_link].mean(),
        int(np.sum(ends & (links.kind == "merge"))),
        int(np.sum(starts & (links.kind == "split"))),
        _name(tracking, links.target, links.source == own[-1], "merge"),
        _name(tracking, links.source, links.target == own[0], "split"),
    ]  # fmt: skip


def _name(tracking, other, at, kind):
    """Return the name of the track at the other end of a merge or split, or ''."""
    track = tracking.track[other[at & (tracking.links.kind == kind)]][:1]
    return tracking.names[track[0]] if np.any(track >= 0) else ""


def _angle(east, north):
    return float(np.degrees(np.arctan2(east, north)) % 360)


def _acceleration(fit):
    """Return the acceleration on both axes with errors, and if it is significant."""
    if fit is None:
        return None, None, None, None, False
    velocity = fit.coefficients[:, 1]
    speed = np.hypot(*velocity)
    axes = axes_along(*velocity / speed) if speed > 0 else np.eye(2)[::-1]
    a, b = (axis @ fit.coefficients[:, 2] for axis in axes)
    a_err, b_err = projected_errors(axes, fit.errors[:, 2])
    significant = abs(a) >= SIGNIFICANT * a_err or abs(b) >= SIGNIFICANT * b_err
    return a, a_err, b, b_err, significant


def feature_table(tracking):
    """Return the features of all tracks, one row per feature and epoch."""
    ssps, cube = tracking.ssps, tracking.cube
    own = np.flatnonzero(tracking.track >= 0)
    own = own[np.lexsort((ssps.epoch[own], tracking.track[own]))]
    track = tracking.track[own]
    east, north = tracking.offsets[:, own]
    errors = tracking.offset_errors[:, own]
    first = np.diff(track, prepend=-1) != 0
    after = np.diff(ssps.epoch[own], prepend=0)
    table = QTable(
        {
            "track": np.array([*tracking.names, ""], dtype="U64")[track],
            "epoch": ssps.epoch[own].astype(int),
            "date": Time(cube.times[ssps.epoch[own]], format="isot"),
            "scale": ssps.scale[own],
            "ssp": own,
            "link": np.where(first, "first", np.where(after > 1, "gap", "link")),
            "east": east * u.mas,
            "north": north * u.mas,
            "east_err": errors[0] * u.mas,
            "north_err": errors[1] * u.mas,
            "r": np.hypot(east, north) * u.mas,
            "pa": np.degrees(np.arctan2(east, north)) % 360 * u.deg,
            "peak": ssps.peak[own] * cube.unit,
            "flux": ssps.flux[own] * cube.unit,
            "snr": ssps.snr[own],
        }
    )
    table["flux"].info.description = "sum of the wavelet coefficients of the pixels"
    round_to_errors(table)
    velocity = np.array([fit.coefficients[:, 1] for fit in tracking.fits], dtype=float)
    vx, vy = velocity.reshape(-1, 2)[track].T * PM_UNIT
    motion = {"pm_ra_cosdec": vx, "pm_dec": vy}
    if axis_words(cube)[0] == "east":
        place = cube.wcs.pixel_to_world(ssps.x[own], ssps.y[own]).icrs
        table["sky"] = SkyCoord(place.ra, place.dec, **motion)
        return table
    lon, lat = cube.wcs.pixel_to_world_values(ssps.x[own], ssps.y[own])
    table.update({"lon": lon * u.deg, "lat": lat * u.deg, **motion})
    return name_by_frame(table, cube)


def plain_table(table: QTable) -> QTable:
    """
    Return a table without objects, which VOTable can hold.

    Parameters
    ----------
    table : `~astropy.table.QTable`

    Returns
    -------
    `~astropy.table.QTable`
        Coordinates become the columns ``ra`` and ``dec``, followed by their
        proper motions; dates become text.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astropy.coordinates import SkyCoord
    >>> from astropy.table import QTable
    >>> from astro_scc.tracking import plain_table
    >>> sky = SkyCoord([1, 2], [3, 4], unit="deg", pm_ra_cosdec=[0, 1] * u.mas / u.yr,
    ...                pm_dec=[0, 1] * u.mas / u.yr)
    >>> plain_table(QTable({"sky": sky})).colnames
    ['ra', 'dec', 'pm_ra_cosdec', 'pm_dec']
    """
    plain = QTable()
    for name, column in table.items():
        if isinstance(column, SkyCoord):
            plain["ra"], plain["dec"] = column.ra.to(u.deg), column.dec.to(u.deg)
            for motion in ("pm_ra_cosdec", "pm_dec"):
                # Empty coordinates have no proper motion.
                plain[motion] = getattr(column, motion) if len(column) else [] * PM_UNIT
        else:
            plain[name] = column.isot if isinstance(column, Time) else column
    return plain
