# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Results as lines of text."""

import numpy as np

from astro_scc.columns import cells, column_of
from astro_scc.features.trust import LEAST_MOTION, MOST_FALSE, SIGNIFICANT
from astro_scc.kinematics.cosmology import cosmology_text, table_in_c_as
from astro_scc.measurement.tables import printed
from astro_scc.report import answer
from astro_scc.units import offset_unit

EXPLANATION = (
    "p_global: probability that epochs in permuted order would give an equally strong",
    "peak at any velocity",
)
NOTHING = "Other scales, a larger --max-speed or more epochs may show one."
#: Columns of components, features and profiles.
COMPONENTS = "component kind pm pm_pa beta_app dispersion p_global n_features".split()
FEATURES = (
    "feature component dates n_epochs separation pm pm_pa beta_app p_false".split()
)
PROFILE = "bin pm_parallel beta_app p_global p_fdr n_ssp remark".split()
#: Formats of numbers whose errors are not shown.
FORMATS = dict.fromkeys(("dispersion", "p_global", "p_fdr", "p_false"), ".2g")
FORMATS |= {"pm_pa": ".0f", "separation": ".3g"}
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


def column_lines(table, names):
    """Return those of the columns that there are, with headings, as aligned lines."""
    shown = {}
    for name, texts in cells(table, names, sign="+-", forms=FORMATS).items():
        known = column_of(name)
        heading = known.terminal or known.heading or name
        shown[heading.format(unit=table[name].info.unit)] = texts
    rows = zip(*shown.values(), strict=True)
    return table_lines([dict(zip(shown, row, strict=True)) for row in rows])


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
        lines += ["", *column_lines(rows, COMPONENTS), *EXPLANATION]
    lines += answer.notes(components, features)
    return [*lines, *followed, *meta_lines(components.meta)]


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
    return [
        "",
        f"{said}:",
        *column_lines(_followed(secure[np.sort(longest)]), FEATURES),
        "",
    ]


def _followed(features):
    """Return features with their dates as text, in a unit that is easy to read."""
    shown, separation = features.copy(), features["separation"]
    shown["separation"] = separation.to(offset_unit(separation.to_value("mas").max()))
    # Of less than some days, the times.
    days = (shown["last"] - shown["first"]).to_value("day")
    letters = 10 if days.max() > SOME_DAYS else 16
    shown["dates"] = [
        f"{first[:letters]} to {last[:letters]}"
        for first, last in zip(shown["first"].isot, shown["last"].isot, strict=True)
    ]
    if not np.any(shown["component"]):
        shown.remove_column("component")
    return shown


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
    rows = printed(components)
    rows = rows[(rows["kind"] != "not significant") | rows["main"]]
    if len(rows) == 0:
        return ["No velocity could be tested in any bin."]
    ends = zip(rows["r_min"].value, rows["r_max"].value, strict=True)
    rows["bin"] = [f"{low:g} to {high:g}" for low, high in ends]
    rows["remark"] = np.where(rows["kind"] == "moving", "", rows["kind"])
    lines = column_lines(rows, PROFILE)
    return [*lines, PROFILE_EXPLANATION, *meta_lines(components.meta)]


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
