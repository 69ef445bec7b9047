# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features and their positions as tables of quantities."""

import astropy.units as u
import numpy as np
from astropy.time import Time

from astro_scc.columns import MOTION, build_table
from astro_scc.epochs.positions import name_by_frame
from astro_scc.units import ACCELERATION, PM_UNIT, in_speed_unit, round_to_errors

#: Columns of features: unit or type, and meaning.
COLUMNS = {
    "feature": (
        int,
        "number: 100 times that of its first epoch, plus that of its detection there",
    ),
    "component": (int, "stream that it belongs to, 0 for none"),
    "n_epochs": (int, "epochs at which it is seen"),
    "first": (int, "first of them"),
    "last": (int, "last of them"),
    "date": (float, "mean date, to which position and motion refer"),
    "ra_offset": (u.mas, "offset from the core to the east"),
    "ra_offset_err": (u.mas, "standard error of ra_offset"),
    "dec_offset": (u.mas, "offset from the core to the north"),
    "dec_offset_err": (u.mas, "standard error of dec_offset"),
    "separation": (u.mas, "distance from the core"),
    "separation_err": (u.mas, "standard error of separation"),
    "position_angle": (u.deg, "direction from the core, north through east"),
    "position_angle_err": (u.deg, "standard error of position_angle"),
    **MOTION,
    "pm_radial": (PM_UNIT, "proper motion away from the core"),
    "pm_radial_err": (PM_UNIT, "standard error of pm_radial"),
    "pm_nonradial": (PM_UNIT, "proper motion towards larger position angles"),
    "pm_nonradial_err": (PM_UNIT, "standard error of pm_nonradial"),
    "acc_parallel": (ACCELERATION, "acceleration along the motion, if it is better"),
    "acc_parallel_err": (ACCELERATION, "standard error of acc_parallel"),
    "acc_perpendicular": (
        ACCELERATION,
        "acceleration across the motion, towards larger position angles",
    ),
    "acc_perpendicular_err": (ACCELERATION, "standard error of acc_perpendicular"),
    "t_ej": (u.yr, "Julian year at which it was at the core"),
    "t_ej_err": (u.yr, "standard error of t_ej, with that of the core's position"),
    "flux": (None, "median of its fluxes"),
    "size": (u.mas, "median of its full widths at half maximum, without the beam"),
    "motion": (u.one, "motion from the first to the last date, in beams along it"),
    "p_false": (float, "probability that it is no feature, or not one"),
    "secure": (bool, "whether it is one feature that moves, with this speed"),
    "proven": (bool, "whether no better assignment of the detections exists"),
}
#: Columns of positions: unit or type, and meaning.
POSITIONS = {
    "feature": (int, "number of the feature"),
    "epoch": (int, "number of the image, from 0"),
    "date": (int, "date of the image"),
    "ra_offset": (u.mas, "offset from the core to the east"),
    "ra_offset_err": (u.mas, "standard error of ra_offset from noise"),
    "dec_offset": (u.mas, "offset from the core to the north"),
    "dec_offset_err": (u.mas, "standard error of dec_offset from noise"),
    "flux": (None, "flux of the detection"),
    "size": (u.mas, "full width at half maximum, without the beam"),
    "used": (bool, "whether the fit uses it; others are outliers"),
}


def feature_table(features, component=None):
    """
    Return the features of a cube as a table.

    Parameters
    ----------
    features : `~astro_scc.features.Features`
    component : array_like of int, shape (n,), optional
        Stream that each belongs to.

    Returns
    -------
    `~astropy.table.QTable`
        One row a feature, also without any with all columns and units.  Values
        that are not measured are NaN: accelerations unless a parabola is better
        than a line, and dates of ejection unless the motion is radial.
    """
    if component is None:
        component = np.zeros(len(features), dtype=int)
    rows = [
        _row(features, k) | {"component": component[k]} for k in range(len(features))
    ]
    table = build_table(rows, COLUMNS)
    years = np.array([row["date"] for row in rows], dtype=float)
    _with_dates(table, features.cube, ("first", "last"))
    about = table["date"].info.description
    table["date"] = Time(years, format="jyear", scale="utc")
    table["date"].format = "isot"
    table["date"].info.description = about
    table["flux"] = table["flux"] * flux_unit(features.cube)
    table["flux"].info.description = COLUMNS["flux"][1]
    unit = features.cube.speed_unit
    if unit.bases[1] != u.yr:
        years = table["t_ej"].value
        known = np.isfinite(years)
        table["t_ej"], table["t_ej_err"] = years * u.day, table["t_ej_err"].to(u.day)
        table["t_ej"][known] = (
            Time(years[known], format="jyear", scale="utc").mjd * u.day
        )
        table["t_ej"].info.description = "MJD at which it was at the core"
        table["t_ej_err"].info.description = COLUMNS["t_ej_err"][1]
    in_speed_unit(table, unit)
    table.meta.update(features.cube.facts)
    return round_to_errors(name_by_frame(table, features.cube))


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
    d, rows = features.detections, []
    each = zip(features.number, features.tracks, features.motions, strict=True)
    for number, track, motion in each:
        for k, used in zip(track.detection.tolist(), motion.used, strict=True):
            rows.append(
                {
                    "feature": number,
                    "epoch": d.epoch[k],
                    "date": d.epoch[k],
                    "ra_offset": d.place[k, 0],
                    "ra_offset_err": d.place_error[k, 0],
                    "dec_offset": d.place[k, 1],
                    "dec_offset_err": d.place_error[k, 1],
                    "flux": d.flux[k],
                    "size": d.size[k],
                    "used": used,
                }
            )
    table = build_table(rows, POSITIONS)
    _with_dates(table, features.cube, ("date",))
    table["flux"] = table["flux"] * flux_unit(features.cube)
    table["flux"].info.description = POSITIONS["flux"][1]
    table.meta.update(features.cube.facts)
    return round_to_errors(name_by_frame(table, features.cube))


def flux_unit(cube):
    """Return the unit of fluxes of images: Jy for images in Jy/beam."""
    return u.Unit(cube.unit) * u.beam if "beam" in str(cube.unit) else cube.unit


def _with_dates(table, cube, names):
    """Replace numbers of epochs by their dates."""
    for name in names:
        about = table[name].info.description
        table[name] = Time(
            cube.times[np.asarray(table[name], dtype=int)], format="isot"
        )
        table[name].info.description = about


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
    t_ej, t_ej_err = motion.ejection(features.core_error, d.fwhm)
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
        "ra_offset": r[0],
        "ra_offset_err": motion.place_err[0],
        "dec_offset": r[1],
        "dec_offset_err": motion.place_err[1],
        "separation": distance,
        "separation_err": np.hypot(*(outward * motion.place_err)),
        "position_angle": np.degrees(np.arctan2(*r)) % 360,
        "position_angle_err": np.degrees(pa_err),
        "pm_ra_cosdec": v[0],
        "pm_ra_cosdec_err": motion.velocity_err[0],
        "pm_dec": v[1],
        "pm_dec_err": motion.velocity_err[1],
        "pm": speed,
        "pm_err": motion.speed_err,
        "pm_pa": np.degrees(np.arctan2(*v)) % 360,
        "pm_pa_err": np.degrees(pm_pa_err),
        "pm_radial": v @ outward,
        "pm_radial_err": motion.error_along(outward),
        "pm_nonradial": v @ around,
        "pm_nonradial_err": motion.error_along(around),
        "acc_parallel": bend @ along,
        "acc_parallel_err": np.hypot(*(along * bend_err)),
        "acc_perpendicular": bend @ across,
        "acc_perpendicular_err": np.hypot(*(across * bend_err)),
        "t_ej": t_ej,
        "t_ej_err": t_ej_err,
        "flux": np.median(d.flux[own]),
        "size": np.median(d.size[own]),
        "motion": features.moved[number],
        "p_false": features.p_false[number],
        "secure": features.secure[number],
        "proven": track.proven,
    }
