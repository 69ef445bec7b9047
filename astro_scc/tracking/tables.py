# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features and tracks as tables of quantities."""

import astropy.units as u
import numpy as np
from astropy.table import Column, MaskedColumn, QTable
from astropy.time import Time
from astropy.utils.masked import Masked

from astro_scc.epochs.positions import axis_words, name_by_frame
from astro_scc.tracking.ejection import (
    SIGNIFICANT,
    ejection_epoch,
    speed_errors,
    turn_between,
)

__all__ = ["feature_table", "motion_row", "plain_table", "share_table", "track_table"]

PM_UNIT = u.mas / u.yr
PM_DOT_UNIT = u.mas / u.yr**2

#: Name, unit (None for a plain column), and what it is; of the tracks.
COLUMNS = (
    ("track", "U64", "name: date, scale and place of the first feature"),
    ("scale", float, "wavelet scale number"),
    ("n_epochs", int, "epochs at which the feature is seen"),
    ("first", Time, "date of the first one"),
    ("last", Time, "date of the last one"),
    ("n_gaps", int, "epochs between them at which it is not seen"),
    ("flux", "brightness", "median of the fluxes, sums of wavelet coefficients"),
    ("r", u.mas, "mean distance from the reference pixel"),
    ("pa", u.deg, "position angle of the mean position, north through east"),
    ("middle", u.yr, "Julian year that position and motion refer to"),
    ("east", u.mas, "fitted offset to the east at that date"),
    ("north", u.mas, "fitted offset to the north at that date"),
    ("pm_ra_cosdec", PM_UNIT, "proper motion to the east"),
    ("pm_ra_cosdec_err", PM_UNIT, "standard error of pm_ra_cosdec"),
    ("pm_dec", PM_UNIT, "proper motion to the north"),
    ("pm_dec_err", PM_UNIT, "standard error of pm_dec"),
    ("pm", PM_UNIT, "proper motion, its length"),
    ("pm_err", PM_UNIT, "standard error of pm"),
    ("pm_pa", u.deg, "direction of the proper motion, north through east"),
    ("pm_pa_err", u.deg, "standard error of pm_pa"),
    ("turn", u.deg, "angle between the position angle and the motion"),
    ("scatter_east", u.mas, "robust scatter about the straight line"),
    ("scatter_north", u.mas, "robust scatter about the straight line"),
    ("pm_dot_parallel", PM_DOT_UNIT, "acceleration along the motion"),
    ("pm_dot_parallel_err", PM_DOT_UNIT, "standard error of pm_dot_parallel"),
    ("pm_dot_transverse", PM_DOT_UNIT, "acceleration to larger position angles"),
    ("pm_dot_transverse_err", PM_DOT_UNIT, "standard error of pm_dot_transverse"),
    ("accelerated", bool, "an acceleration of three standard errors or more"),
    ("t_ej", u.yr, "Julian year at which the feature passed the reference pixel"),
    ("t_ej_err", u.yr, "standard error of t_ej"),
    ("coefficient", float, "mean correlation of its links"),
    ("gain", float, "mean log-likelihood by which its links better no link"),
    ("n_merges", int, "other features that went into it"),
    ("n_splits", int, "other features that came out of it"),
    ("merges_into", "U64", "track that it goes into at its end"),
    ("splits_from", "U64", "track that it comes out of at its beginning"),
)
#: Columns that not every track has.
PARTIAL = frozenset(
    ("pm_dot_parallel", "pm_dot_parallel_err", "pm_dot_transverse",
     "pm_dot_transverse_err", "t_ej", "t_ej_err")
)  # fmt: skip


def motion_row(tracking, number):
    """
    The entries of a track in the table of tracks.

    Parameters
    ----------
    tracking : `~astro_scc.tracking.Tracking`
    number : int
        Of the track, from 0.

    Returns
    -------
    dict
        Plain numbers, None where there is none; of dates, the epochs.
    """
    own = tracking.members(number)
    ssps, cube, links = tracking.ssps, tracking.cube, tracking.links
    fit = tracking.fits[number]
    epochs = ssps.epoch[own]
    east, north = tracking.offsets[:, own]
    start = cube.times[0].jyear
    (x, vx), (y, vy) = fit.coefficients
    speed_err, angle_err = speed_errors(fit)
    parallel, transverse, accelerated = _acceleration(tracking, number)
    epoch, epoch_err = ejection_epoch(fit, tracking.fwhm.value, accelerated=accelerated)
    is_link = (links.kind == "link") & np.isin(links.source, own)
    is_link &= np.isin(links.target, own)
    into = np.isin(links.target, own) & (links.kind == "merge")
    out = np.isin(links.source, own) & (links.kind == "split")
    return {
        "track": tracking.names[number],
        "scale": ssps.scale[own[0]],
        "n_epochs": len(own),
        "first": epochs[0],
        "last": epochs[-1],
        "n_gaps": int(epochs[-1] - epochs[0] + 1 - len(own)),
        "flux": np.median(ssps.flux[own]),
        "r": np.mean(np.hypot(east, north)),
        "pa": _angle(east.mean(), north.mean()),
        "middle": start + fit.middle,
        "east": x,
        "north": y,
        "pm_ra_cosdec": vx,
        "pm_ra_cosdec_err": fit.errors[0, 1],
        "pm_dec": vy,
        "pm_dec_err": fit.errors[1, 1],
        "pm": np.hypot(vx, vy),
        "pm_err": speed_err,
        "pm_pa": _angle(vx, vy),
        "pm_pa_err": min(np.degrees(angle_err), 180.0),
        "turn": turn_between((east.mean(), north.mean()), (vx, vy)),
        "scatter_east": fit.scatter[0],
        "scatter_north": fit.scatter[1],
        "pm_dot_parallel": parallel[0],
        "pm_dot_parallel_err": parallel[1],
        "pm_dot_transverse": transverse[0],
        "pm_dot_transverse_err": transverse[1],
        "accelerated": accelerated,
        "t_ej": None if epoch is None else start + epoch,
        "t_ej_err": epoch_err,
        "coefficient": links.coefficient[is_link].mean(),
        "gain": links.gain[is_link].mean(),
        "n_merges": int(into.sum()),
        "n_splits": int(out.sum()),
        "merges_into": _name(tracking, links.target, links.source, own[-1], "merge"),
        "splits_from": _name(tracking, links.source, links.target, own[0], "split"),
    }


def _name(tracking, other, own, ssp, kind):
    """Name of the track at the other end of a merge or split, if it has one."""
    at = np.flatnonzero((own == ssp) & (tracking.links.kind == kind))
    if len(at) == 0 or tracking.track[other[at[0]]] < 0:
        return ""
    return tracking.names[tracking.track[other[at[0]]]]


def _angle(east, north):
    return float(np.degrees(np.arctan2(east, north)) % 360)


def _acceleration(tracking, number):
    """Components of the acceleration with errors, and whether it counts."""
    fit = tracking.accelerated_fits[number]
    if fit is None:
        return (None, None), (None, None), False
    velocity = fit.coefficients[:, 1]
    speed = np.hypot(*velocity)
    along = velocity / speed if speed > 0 else np.array([0.0, 1.0])
    # To larger position angles, as in `PositionAngleFrame`.
    across = np.array([along[1], -along[0]])
    pairs = [
        (
            float(axis @ fit.coefficients[:, 2]),
            float(np.sqrt(np.sum((axis * fit.errors[:, 2]) ** 2))),
        )
        for axis in (along, across)
    ]
    return *pairs, any(abs(a) >= SIGNIFICANT * e for a, e in pairs)


def track_table(rows, cube, *, meta=None):
    """
    Tracks as a table.

    Parameters
    ----------
    rows : sequence of dict
        See `motion_row`.  May be empty.
    cube : `~astro_scc.epochs.EpochCube`
    meta : dict, optional

    Returns
    -------
    `~astropy.table.QTable`
        All columns are there even if there is no row.  Accelerations and
        ejection epochs are masked where the track has none.
    """
    table = QTable()
    for name, kind, description in COLUMNS:
        values = [row[name] for row in rows]
        unit = cube.unit if kind == "brightness" else kind
        if isinstance(unit, u.UnitBase):
            missing = [value is None for value in values]
            numbers = np.array([0.0 if v is None else v for v in values], dtype=float)
            column = numbers * unit
            if name in PARTIAL:
                column = Masked(column, mask=np.array(missing, dtype=bool))
            table[name] = column
            table[name].info.description = description
        elif kind is Time:
            at = np.array(values, dtype=int)
            table[name] = Time(cube.times[at], format="isot")
            table[name].info.description = description
        else:
            table[name] = Column(np.array(values, dtype=kind), description=description)
    table.meta.update(meta or {})
    return name_by_frame(table, cube)


def feature_table(tracking):
    """
    The features of all tracks, one row a feature and epoch.

    Parameters
    ----------
    tracking : `~astro_scc.tracking.Tracking`

    Returns
    -------
    `~astropy.table.QTable`
        By track and date, which is a `~astropy.time.Time`.  ``sky`` is a
        `~astropy.coordinates.SkyCoord` with the proper motion of the track; in
        frames without right ascension there are ``lon`` and ``lat`` in its
        place, with ``pm_lon_coslat`` and ``pm_lat``.  ``link`` says how the
        feature follows from the one before it: "first", "link", or "gap" where
        epochs lie between.
    """
    from astropy.coordinates import SkyCoord

    ssps, cube = tracking.ssps, tracking.cube
    own = np.concatenate(
        [np.empty(0, int), *map(tracking.members, range(tracking.n_tracks))]
    )
    track = tracking.track[own]
    east, north = tracking.offsets[:, own]
    errors = tracking.offset_errors[:, own]
    velocity = np.array(
        [fit.coefficients[:, 1] for fit in tracking.fits], dtype=float
    ).reshape(-1, 2)
    first = np.diff(track, prepend=-1) != 0
    after = np.diff(ssps.epoch[own], prepend=0)
    kind = np.where(first, "first", np.where(after > 1, "gap", "link"))
    names = np.array(tracking.names, dtype="U64")
    table = QTable(
        {
            "track": names[track] if len(own) else np.empty(0, "U64"),
            "epoch": ssps.epoch[own].astype(int),
            "date": Time(cube.times[ssps.epoch[own]], format="isot"),
            "scale": ssps.scale[own],
            "ssp": own,
            "link": kind.astype("U5"),
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
    vx, vy = velocity[track].T * PM_UNIT
    if axis_words(cube)[0] == "east":
        place = cube.wcs.pixel_to_world(ssps.x[own], ssps.y[own]).icrs
        motion = {"pm_ra_cosdec": vx, "pm_dec": vy}
        table["sky"] = SkyCoord(ra=place.ra, dec=place.dec, frame="icrs", **motion)
        return table
    lon, lat = cube.wcs.pixel_to_world_values(ssps.x[own], ssps.y[own])
    table["lon"], table["lat"] = lon * u.deg, lat * u.deg
    table["pm_ra_cosdec"], table["pm_dec"] = vx, vy
    return name_by_frame(table, cube)


def share_table(shares):
    """
    Shares of linked SSPs as a table.

    Parameters
    ----------
    shares : sequence of `~astro_scc.tracking.LinkedShare`

    Returns
    -------
    `~astropy.table.QTable`
        Scale 0 stands for all of them together.  What shuffled orders give
        is masked where there were none.
    """
    table = QTable(
        {
            "scale": np.array([s.scale or 0.0 for s in shares], dtype=float),
            "n_ssps": np.array([s.n_ssps for s in shares], dtype=int),
            "n_linked": np.array([s.n_linked for s in shares], dtype=int),
            "share": np.array([s.share for s in shares], dtype=float),
            "share_err": np.array([s.share_err for s in shares], dtype=float),
        }
    )
    for name, attribute in (
        ("share_shuffled", "shuffled"),
        ("share_shuffled_err", "shuffled_err"),
        ("p_value", "p_value"),
    ):
        values = np.array([getattr(s, attribute) for s in shares], dtype=float)
        table[name] = MaskedColumn(np.nan_to_num(values), mask=np.isnan(values))
    return table


def plain_table(table):
    """
    A table without objects, as VOTable can hold it.

    Parameters
    ----------
    table : `~astropy.table.QTable`

    Returns
    -------
    `~astropy.table.QTable`
        Coordinates become the columns ``ra`` and ``dec``, with proper
        motions beside them.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> from astro_scc.tracking import FeatureTracker
    >>> from astro_scc.tracking import plain_table
    >>> cube = simulate_two_fluid(n_epochs=3, rng=1).cube
    >>> decompositions = [Decomposer(scales=[2])(image) for image in cube.data]
    >>> tracker = FeatureTracker(max_speed=36 * u.mas / u.yr)
    >>> tracking = tracker(cube, decompositions)
    >>> table = plain_table(tracking.features)
    >>> "coord" in table.colnames, {"ra", "dec"} <= set(table.colnames)
    (False, True)
    """
    from astropy.coordinates import SkyCoord

    plain = QTable()
    for name in table.colnames:
        column = table[name]
        if isinstance(column, SkyCoord):
            plain["ra"], plain["dec"] = column.ra.to(u.deg), column.dec.to(u.deg)
            plain["pm_ra_cosdec"] = column.pm_ra_cosdec
            plain["pm_dec"] = column.pm_dec
        elif isinstance(column, Time):
            plain[name] = column.isot
        else:
            plain[name] = column
    return plain
