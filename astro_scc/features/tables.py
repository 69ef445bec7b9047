# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features and their positions as tables of quantities."""

import astropy.units as u
import numpy as np
from astropy.time import Time

from astro_scc.columns import build_table, describe, round_to_errors, with_errors
from astro_scc.images.positions import name_by_frame
from astro_scc.units import in_speed_unit


def feature_table(features, component=0):
    """
    Return the features of a cube as a table.

    Parameters
    ----------
    features : `~astro_scc.features.Features`
    component : int or array_like of int, shape (n,), optional
        Stream that each belongs to, 0 for none.

    Returns
    -------
    `~astropy.table.QTable`
        One row a feature, also without any with all columns and units.  Values
        that are not measured are NaN: accelerations unless a parabola is better
        than a line, and dates of ejection unless the motion is radial.
    """
    rows = [_row(features, k) for k in range(len(features))]
    cube, unit = features.cube, features.cube.speed_unit
    years = np.array([row["date"] for row in rows], dtype=float)
    date = Time(years, format="jyear", scale="utc")
    date.format = "isot"
    own = {
        name: _dates(cube, [row[name] for row in rows]) for name in ("first", "last")
    }
    own["component"] = np.full(len(features), component)
    own["flux"] = np.array([row["flux"] for row in rows], float) * flux_unit(cube)
    table = build_table("features", rows, date=date, **own)
    if unit.bases[1] != u.yr:
        years = table["t_ej"].value
        known = np.isfinite(years)
        table["t_ej"], table["t_ej_err"] = years * u.day, table["t_ej_err"].to(u.day)
        table["t_ej"][known] = (
            Time(years[known], format="jyear", scale="utc").mjd * u.day
        )
        describe(table, "features")
        table["t_ej"].info.description = "MJD at which it was at the core"
    in_speed_unit(table, unit)
    table.meta.update(cube.facts)
    return round_to_errors(name_by_frame(table, cube))


def position_table(features):
    """
    Return where each feature was seen.

    Parameters
    ----------
    features : `~astro_scc.features.Features`

    Returns
    -------
    `~astropy.table.QTable`
        A row for each feature and epoch.
    """
    cube, d = features.cube, features.detections
    number = np.repeat(np.array(features.number, int), list(map(len, features.tracks)))
    own = np.concatenate([[], *(track.detection for track in features.tracks)])
    own = own.astype(int)
    place, error = d.place[own].T * u.mas, d.place_error[own].T * u.mas
    table = build_table(
        "positions",
        feature=number,
        epoch=d.epoch[own],
        date=_dates(cube, d.epoch[own]),
        **with_errors(ra_offset=(place[0], error[0]), dec_offset=(place[1], error[1])),
        flux=d.flux[own] * flux_unit(cube),
        size=d.size[own] * u.mas,
        used=np.concatenate([[], *(m.used for m in features.motions)]).astype(bool),
    )
    table.meta.update(cube.facts)
    return round_to_errors(name_by_frame(table, cube))


def flux_unit(cube):
    """Return the unit of fluxes of images: Jy for images in Jy/beam."""
    return u.Unit(cube.unit) * u.beam if "beam" in str(cube.unit) else cube.unit


def _dates(cube, epoch):
    """Return the dates of epochs by their numbers."""
    return Time(cube.times[np.array(epoch, dtype=int)], format="isot")


def _row(features, number):
    """Return the columns of one feature as plain numbers."""
    d, track = features.detections, features.tracks[number]
    motion, own = features.motions[number], track.detection
    r, v = motion.place, motion.velocity
    distance, speed = np.hypot(*r), motion.speed
    outward = r / distance if distance > 0 else np.array([0.0, 1.0])
    around = np.array([outward[1], -outward[0]])
    along = v / speed if speed > 0 else outward
    across = np.array([along[1], -along[0]])
    across_err = motion.error_along(across)
    tangential = float(np.hypot(*(around * motion.place_err)))
    # Neither direction can be wrong by more than half a turn.
    pm_pa_err = min(across_err / speed, np.pi) if speed > 0 else np.pi
    pa_err = min(tangential / distance, np.pi) if distance > 0 else np.pi
    bend, bend_err = motion.acceleration, motion.acceleration_err
    return {
        "feature": features.number[number],
        "n_epochs": len(own),
        "first": d.epoch[own[0]],
        "last": d.epoch[own[-1]],
        "date": motion.date,
        **with_errors(
            ra_offset=(r[0], motion.place_err[0]),
            dec_offset=(r[1], motion.place_err[1]),
            separation=(distance, np.hypot(*(outward * motion.place_err))),
            position_angle=(np.degrees(np.arctan2(*r)) % 360, np.degrees(pa_err)),
            pm_ra_cosdec=(v[0], motion.velocity_err[0]),
            pm_dec=(v[1], motion.velocity_err[1]),
            pm=(speed, motion.speed_err),
            pm_pa=(np.degrees(np.arctan2(*v)) % 360, np.degrees(pm_pa_err)),
            pm_radial=(v @ outward, motion.error_along(outward)),
            pm_nonradial=(v @ around, motion.error_along(around)),
            acc_parallel=(bend @ along, np.hypot(*(along * bend_err))),
            acc_perpendicular=(bend @ across, np.hypot(*(across * bend_err))),
            t_ej=motion.ejection(features.core_error, d.fwhm),
        ),
        "flux": np.median(d.flux[own]),
        "size": np.median(d.size[own]),
        "motion": features.moved[number],
        "p_false": features.p_false[number],
        "secure": features.secure[number],
        "proven": track.proven,
    }
