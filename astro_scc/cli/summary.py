# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Results as lines of text."""

import math

import numpy as np

from astro_scc.features.trust import LEAST_MOTION, MOST_FALSE, SIGNIFICANT
from astro_scc.kinematics.cosmology import cosmology_text, table_in_c_as
from astro_scc.measurement.tables import cell_text, printed
from astro_scc.report import answer
from astro_scc.units import offset_unit

EXPLANATION = (
    "p_global: probability that epochs in permuted order would give an equally strong",
    "peak at any velocity",
)
NOTHING = "Other scales, a larger --max-speed or more epochs may show one."
#: Largest number of features that are shown.
MOST_FEATURES = 10
#: Features seen over fewer days have the times of their epochs.
SOME_DAYS = 3
PROFILE_EXPLANATION = (
    "p_fdr: p_global adjusted for all bins, the share of false discoveries up to it"
)


def table_lines(rows):
    """
    Return a table as aligned lines.

    Parameters
    ----------
    rows : sequence of dict of str
        At least one; all have the headings of the columns as keys.

    Returns
    -------
    list of str

    Examples
    --------
    >>> from astro_scc.cli.summary import table_lines
    >>> for line in table_lines([{"file": "a.fits", "noise": "0.3 mJy"}]):
    ...     print(line)
    file      noise
    a.fits  0.3 mJy
    """
    cells = [list(rows[0]), *(row.values() for row in rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    # The first column is text, aligned left; the others are numbers, aligned right.
    shape = "  ".join(f"{{:{'>' if i else '<'}{w}}}" for i, w in enumerate(widths))
    return [shape.format(*row).rstrip() for row in cells]


def component_lines(components, features):
    """
    Return what was found in one sentence, and the components as a table.

    Parameters
    ----------
    components : `~astropy.table.QTable`
        See `~astro_scc.measurement.SCCResult.components`.
    features : `~astropy.table.QTable`
        See `~astro_scc.measurement.SCCResult.features`; the secure ones are shown.

    Returns
    -------
    list of str
    """
    followed = feature_lines(table_in_c_as(printed(features), components))
    lines, rows = [answer.headline(components)], printed(components)
    if len(components) == 0:
        lines.append(NOTHING)
    elif len(rows):
        cells = [_component_cells(row) for row in rows]
        lines += ["", *table_lines(cells), *EXPLANATION]
    lines += answer.notes(components, features)
    return [*lines, *followed, *meta_lines(components.meta)]


def _component_cells(row):
    angle, spread = row["pm_pa"].value, row["dispersion"].value
    unit = row["pm"].unit
    return {
        "stream": str(row["component"]),
        "kind": str(row["kind"]),
        f"proper motion ({unit})": _plus_minus(row, "pm"),
        "PA (deg)": f"{angle:.0f}" if math.isfinite(angle) else "-",
        **_in_c(row),
        f"dispersion ({unit})": f"{spread:.2g}" if math.isfinite(spread) else "-",
        **_p_values(row, "p_global"),
        "features": str(row["n_features"]),
    }


def _plus_minus(row, name):
    """Return a number of a row with its error in ASCII, without the unit."""
    return cell_text(row.table, name, row.index, "+-")


def feature_lines(features, most=MOST_FEATURES):
    """
    Return how many features there are, and the secure ones as a table.

    Parameters
    ----------
    features : `~astropy.table.QTable`
        See `~astro_scc.measurement.SCCResult.features`.
    most : int, optional
        Largest number of secure features in the table, those seen in most epochs.

    Returns
    -------
    list of str
        If no feature is secure, they say what the nearest to it lacks.
    """
    secure = features[np.asarray(features["secure"], dtype=bool)]
    n = len(features)
    said = f"{n} {'feature' if n == 1 else 'features'}, {len(secure)} of them secure"
    if len(secure) == 0:
        return [f"{said}.", *_lacking(features)]
    longest = np.argsort(-secure["n_epochs"], kind="stable")[:most]
    if len(longest) < len(secure):
        said += f"; the {most} that were seen in most epochs"
    rows = feature_rows(secure[np.sort(longest)])
    return ["", f"{said}:", *table_lines(rows), ""]


def _lacking(features):
    """Return what makes a feature secure, and what the nearest to it lacks."""
    if len(features) == 0:
        return ["No detections of four epochs or more are in steady motion."]
    motion = features["motion"].value
    errors = (features["pm"] / features["pm_err"]).value
    shares = (
        MOST_FALSE / features["p_false"],
        motion / LEAST_MOTION,
        errors / SIGNIFICANT,
    )
    best = np.argmax(np.minimum.reduce(shares))
    row = features[best]
    number, false = row["feature"], row["p_false"]
    text = (
        f"The nearest to that is feature {number}: p_false {false:.2g}, motion "
        f"{motion[best]:.2g} beams, {errors[best]:.2g} standard errors"
    )
    if 0 < motion[best] < LEAST_MOTION:
        time = row["pm"].unit.bases[1]
        span = (row["last"] - row["first"]).to_value(time)
        needed = f"{span * LEAST_MOTION / motion[best]:.2g} {time}"
        text += f"; at its speed it would have to be seen for {needed}"
    return [
        f"A secure feature has a p_false of at most {MOST_FALSE:g} and moves by at "
        f"least {LEAST_MOTION:.1f} beams and {SIGNIFICANT:g} standard errors.",
        f"{text}.",
    ]


def feature_rows(features):
    """
    Return the cells of features under their headings.

    Parameters
    ----------
    features : `~astropy.table.QTable`
        At least one.

    Returns
    -------
    list of dict of str
        With the component of each if there are any.
    """
    table = features
    far = offset_unit(table["separation"].to_value("mas").max())
    # Of less than some days, the times.
    days = (table["last"] - table["first"]).to_value("day")
    shown = 10 if days.max() > SOME_DAYS else 16
    of_any = np.any(table["component"])
    return [
        {
            "feature": str(row["feature"]),
            **({"stream": str(row["component"])} if of_any else {}),
            "dates": f"{row['first'].isot[:shown]} to {row['last'].isot[:shown]}",
            "epochs": str(row["n_epochs"]),
            f"separation ({far})": f"{row['separation'].to_value(far):.3g}",
            f"proper motion ({table['pm'].unit})": _plus_minus(row, "pm"),
            "PA (deg)": f"{row['pm_pa'].value:.0f}",
            **_in_c(row),
            "p_false": f"{row['p_false']:.2g}",
        }
        for row in table
    ]


def profile_lines(components):
    """
    Return the components in bins of distance as the lines of a table.

    Parameters
    ----------
    components : `~astropy.table.QTable`
        See `~astro_scc.flow.Profile.components`.

    Returns
    -------
    list of str
    """
    unit = components["pm_parallel"].unit
    rows = [
        {
            "separation (mas)": f"{row['r_min'].value:g} to {row['r_max'].value:g}",
            f"along the jet ({unit})": _plus_minus(row, "pm_parallel"),
            **_in_c(row),
            **_p_values(row, "p_global", "p_fdr"),
            "SSPs": str(row["n_ssp"]),
            "": "" if row["kind"] == "moving" else str(row["kind"]),
        }
        for row in printed(components)
        if row["kind"] != "not significant" or row["main"]
    ]
    if not rows:
        return ["No velocity could be tested in any bin."]
    return [*table_lines(rows), PROFILE_EXPLANATION, *meta_lines(components.meta)]


def misalignment_text(scatter):
    """
    Return a line on how well epochs are aligned.

    Parameters
    ----------
    scatter : float or None
        In beams, see `astro_scc.EpochCube.misalignment`.

    Returns
    -------
    str

    Examples
    --------
    >>> from astro_scc.cli.summary import misalignment_text
    >>> misalignment_text(0.0312)
    'The epochs are aligned to 0.03 beams.'
    """
    if scatter is None:
        return "The images do not show how well the epochs are aligned."
    return f"The epochs are aligned to {scatter:.2f} beams."


def meta_lines(meta):
    """Return lines on the conversion to units of c and on the alignment."""
    scatter = meta.get("misalignment_beams")
    return speed_lines(meta) + ([] if scatter is None else [misalignment_text(scatter)])


def speed_lines(meta):
    """
    Return lines on the redshift and cosmology, or distance, of speeds in units of c.

    Parameters
    ----------
    meta : dict
        Meta of a table, or settings of a measurement.

    Returns
    -------
    list of str
        Empty if there are no such speeds.

    Examples
    --------
    >>> from astro_scc.cli.summary import speed_lines
    >>> speed_lines({"redshift": 0.158, "cosmology": "H0=71,Om0=0.27"})[0]
    'speeds in c: redshift 0.158, FlatLambdaCDM with H0 = 71 km/s/Mpc, Om0 = 0.27'
    """
    if "distance" in meta:
        return [f"speeds in c: distance {meta['distance']:g}"]
    if "redshift" in meta:
        how = cosmology_text(meta["cosmology"])
        return [f"speeds in c: redshift {meta['redshift']:g}, {how}"]
    return []


def _in_c(row):
    """Return the speed of a row in units of c under its heading, if it has one."""
    known = "beta_app" in row.colnames
    return {"speed (c)": _plus_minus(row, "beta_app")} if known else {}


def _p_values(row, *names):
    """Return p-values under their names; what stands still is not tested."""
    tested = row["kind"] != "stationary"
    return {name: f"{row[name]:.2g}" if tested else "-" for name in names}
