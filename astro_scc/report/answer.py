# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What was found, in sentences of the terminal and of the report, and as lines."""

import astropy.units as u
import numpy as np

from astro_scc.columns import cell, headed, table_lines
from astro_scc.features.finder import doubts_in_words
from astro_scc.features.motion import MOST_FALSE, MOTIONS, SAME_SPEED, motions_in_words
from astro_scc.kinematics.cosmology import source_text, table_in_c_as
from astro_scc.measurement.cautions import NO_DIRECTION
from astro_scc.measurement.tables import dates_as_text
from astro_scc.units import offset_unit, unit_name

#: Most features that are named in a sentence, and that the terminal shows.
MOST = 10
EXPLANATION = (
    "p_global: probability that images in which nothing moves show as much motion at "
    "any of the speeds that were searched",
)
#: Along what speeds are measured, unless straight along the direction of the flow.
LINES = {
    "diverging": "Speeds are along lines that diverge from a beam behind the core",
    "bent": "Speeds are along lines that bend as the jet does",
}
#: What makes a feature secure, and what its p_false is.
SECURE = (
    "p_false: probability that it is no feature, or parts of several; secure: p_false "
    f"of at most {MOST_FALSE:g}, moved by {motions_in_words()} or more, and at this "
    f"speed in {SAME_SPEED:.0%} or more of the perturbed assignments to features"
)

#: Columns of streams, features and profiles.
STREAMS = (
    "stream kind share pm pm_pa beta_app v_app dispersion p_global n_features "
    "pm_spectrum"
).split()
FEATURES = (
    "feature stream dates n_epochs separation pm pm_pa beta_app v_app p_false"
).split()
PROFILE = (
    "bin scale_group pm_parallel pm beta_app v_app p_global p_fdr n_features remark"
).split()
OF_PAPER = (
    "stream kind pm pm_pa beta_app v_app coefficient z_score p_global p_normal n_ssp "
    "n_pairs"
).split()
#: Formats of numbers whose errors are not shown.
FORMATS = dict.fromkeys(("share", "dispersion", "p_global", "p_fdr", "p_false"), ".2g")
FORMATS |= {"pm_pa": ".0f", "separation": ".3g", "coefficient": ".2g", "z_score": ".2f"}
PROFILE_EXPLANATION = (
    "p_fdr: p_global adjusted for the number of bins (Benjamini & Hochberg 1995)"
)
#: What the columns of the paper's method are.
PAPER_EXPLANATION = (
    "coefficient, z_score: mean correlation of the patterns (SSPs, maxima on a wavelet "
    "scale) near this velocity",
    "with those of other epochs, and its excess in standard deviations of shuffled "
    "epochs",
    "p_global: fraction of shuffled series of epochs with as large a z-score at any "
    "velocity; n_ssp, n_pairs: patterns and pairs of epochs with a match there",
    "p_normal: probability that normally distributed trials of the velocity look less "
    "normal; if small, its error is not valid",
)


def headline(streams, features=None):
    """
    Return the result of a measurement as a sentence.

    It has all streams that move, and those whose motion is not confirmed, from slow to
    fast; if there are none, that nothing moves significantly, and which speeds were
    searched; but first, that no one direction holds.

    Parameters
    ----------
    streams : `~astropy.table.QTable`
        See `~astro_scc.measurement.SCCResult.streams`.
    features : `~astropy.table.QTable`, optional
        Of which the secure ones of no stream are counted.

    Returns
    -------
    str

    Examples
    --------
    >>> from astro_scc.measurement.tables import stream_table
    >>> from astro_scc.report.answer import headline
    >>> headline(stream_table([]))
    'Nothing moves significantly.'
    """
    parts, kinds = [], np.asarray(streams["kind"], dtype=str)
    cautions = "; ".join(streams["caution"][:1]).split("; ")
    first = [f"N{text[1:]}. " for text in cautions if text.startswith(NO_DIRECTION)]
    for kind, said in (("moving", "Motion: "), ("not confirmed", "Not confirmed: ")):
        if rows := [_motion(row) for row in streams[kinds == kind]]:
            parts.append(said + "; and ".join(rows))
    if parts and np.isfinite(streams["p_global"][kinds != "not significant"]).any():
        n = 0 if features is None else len(_of_no_stream(streams, features))
        more = f"; {_secure(n)} of no stream" if n else ""
        return f"{''.join(first)}{'. '.join(parts)}{more}."
    some, meta = streams[kinds == "not significant"], streams.meta
    more = [f"p_global {some['p_global'][0]:.2g}"] if len(some) else []
    if "unambiguous" in meta:
        unit = streams["pm"].unit
        low, high, safe = (
            f"{meta[name].to_value(unit):.3g}"
            for name in ("slowest", "fastest", "unambiguous")
        )
        more += [
            f"speeds of {low} to {high} {unit_name(unit)} were searched (faster "
            "ones with --max-speed)",
            f"unambiguous to {safe}",
        ]
    nothing = f"Nothing moves significantly{': ' if more else ''}{', '.join(more)}"
    return f"{''.join(first)}{'. '.join([nothing, *parts])}."


def _of_no_stream(streams, features):
    """Return the secure features of no stream, where streams move."""
    moving = np.any(streams["kind"] == "moving")
    return features[features["secure"] & (features["stream"] == 0) & moving]


def _secure(n):
    return f"{n} secure {'feature' if n == 1 else 'features'}"


def _speed(row):
    """Return the speed of a row with its error, in units of c too if it has them."""
    text = f"{cell(row, 'pm', '+-')} {unit_name(row['pm'].unit)}"
    if "v_app" in row.colnames:
        text += f" ({cell(row, 'v_app', '+-')} km/s)"
    elif "beta_app" in row.colnames:
        text += f" ({cell(row, 'beta_app', '+-')} c)"
    return text


def _motion(row):
    """Return the motion of a stream in words."""
    n, angle = row["n_features"], row["pm_pa"].value
    towards = " outward" if row["pm_parallel"] > 0 else " inward"
    if np.isfinite(angle):
        towards = f" towards PA {angle:.0f} deg"
        if "towards the core" in row["caution"]:
            towards += ", which is towards the core"
    followed = f"{n or 'no'} {'feature' if n == 1 else 'features'}"
    if n > 1:
        followed += f" of {row['pm_min'].value:.2g} to {row['pm_max'].value:.2g}"
    return f"{_speed(row)}{towards}, {followed}"


def notes(streams, features):
    """
    Return what has to be known of each stream, and upper limits, as lines.

    Parameters
    ----------
    streams, features : `~astropy.table.QTable`
        Of an `~astro_scc.measurement.SCCResult`.

    Returns
    -------
    list of str
        Without a full stop, and without what the headline says.  An upper limit is
        that of the mean speed of features that are named; there is none if one of
        them is faster.
    """
    lines, said = [], headline(streams, features)
    for row in streams:
        limit, number = row["pm_limit"], row["stream"]
        members = features[features["stream"] == number]
        # The headline has the speeds that were searched.
        known = "speeds of ", NO_DIRECTION
        parts = row["caution"].removeprefix("-").split("; ")
        parts = [part for part in parts if not part.startswith(known)]
        caution = "; ".join(parts)
        if caution and caution not in said:
            lines.append(f"Stream {number} ({row['kind']}): {caution}")
        if len(members) and members["pm"].max() <= limit:
            named = ", ".join(map(str, members["feature"]))
            exact = len(members) == row["n_features"] and len(members) <= MOST
            named = f" ({named})" if exact else ""
            lines.append(
                f"Stream {number}: {limit.value:.2g} {unit_name(limit.unit)} is the "
                f"upper limit (95%) of the mean speed of its features{named}"
            )
    if n := len(alone := _of_no_stream(streams, features)):
        numbers = ", ".join(map(str, alone["feature"][:MOST]))
        lines.append(
            f"{_secure(n)} {'belongs' if n == 1 else 'belong'} to no "
            f"stream ({numbers}{', ...' if n > MOST else ''}): moving by 45 degrees or "
            "more off the flow there, or along it by less than three standard errors"
        )
    return lines


def scale_lines(of_scales):
    """
    Return the comparison of the speeds of groups of scales as lines.

    Parameters
    ----------
    of_scales : `~astropy.table.QTable`
        See `~astro_scc.flow.compare_scales`.

    Returns
    -------
    list of str
        Without pairs of which a speed is not known.
    """
    unit, far = unit_name(of_scales["first_speed"].unit), unit_name(u.mas)
    lines, several = [], bool(np.any(of_scales["stream"] > 1))
    for row in of_scales[np.isfinite(of_scales["p_value"])]:
        where = ""
        if np.isfinite(row["r_max"]):
            where = f"{row['r_min'].value:g} to {row['r_max'].value:g} {far}: "
        if several:
            where += f"stream {row['stream']}: "
        first, second = (
            f"{row[f'{k}_speed'].value:.3g} on {_on(row[k])}"
            + f" (share {row[f'{k}_share']:.2g})" * several
            for k in ("first", "second")
        )
        apart, p = cell(row, "difference", "+-"), row["p_value"]
        lines.append(
            f"{where}{first}, {second}: {apart} {unit} apart; p of equal speeds {p:.2g}"
        )
    return lines


# -- on the terminal -----------------------------------------------------------------


def column_lines(table, names):
    """Return those of the columns that there are, with headings, as aligned lines."""
    columns = headed(table, names, terminal=True, forms=FORMATS).values()
    heads, _, texts = zip(*columns, strict=True)
    rows = zip(*texts, strict=True)
    return table_lines([dict(zip(heads, row, strict=True)) for row in rows])


def stream_lines(streams, features):
    """
    Return what was found in one sentence, and the streams as a table.

    Parameters
    ----------
    streams : `~astropy.table.QTable`
        See `~astro_scc.measurement.SCCResult.streams`.
    features : `~astropy.table.QTable`
        See `~astro_scc.measurement.SCCResult.features`; the secure ones are shown.

    Returns
    -------
    list of str
    """
    followed = feature_lines(table_in_c_as(features, streams))
    lines = [headline(streams, features)]
    if len(streams):
        lines += ["", *column_lines(streams, STREAMS), *EXPLANATION]
        lines += speeds_along(streams.meta)
    lines += notes(streams, features)
    return [*lines, *followed, *speed_lines(streams.meta)]


def speeds_along(meta):
    """Return along what speeds are measured as a line of text, if not straight."""
    text = LINES.get(meta.get("lines"))
    return [text] if text else []


def paper_lines(streams, level):
    """
    Return the streams that the paper's method finds, its peaks, as a table.

    Parameters
    ----------
    streams : `~astropy.table.QTable`
        See `~astro_scc.paper.method.PaperMeasurement.components`.
    level : float
        The z-score that significant ones exceed.

    Returns
    -------
    list of str
    """
    n = np.sum(streams["kind"] != "not significant")
    said = "stream" if n == 1 else "streams"
    lines = [f"Paper's method: {n or 'no'} {said} with a z-score above {level:.2g}."]
    if len(streams):
        lines += ["", *column_lines(streams, OF_PAPER), *PAPER_EXPLANATION]
    return [*lines, *speed_lines(streams.meta)]


def feature_lines(features, most=MOST):
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
    n_secure = np.sum(features["secure"])
    said = f"{feature_count(features)}, {n_secure} of them secure"
    if n_secure == 0:
        return [f"{said}.", *_lacking(features)]
    if most < n_secure:
        said += f"; the {most} secure ones seen in most epochs"
    lines = column_lines(_followed(features[longest(features, most)]), FEATURES)
    return ["", f"{said}:", *lines, *trust_lines(features), ""]


def feature_count(features):
    """Return how many features there are, and of which streams, if of any."""
    n, stream = len(features), np.asarray(features["stream"])
    said = f"{n} {'feature' if n == 1 else 'features'}"
    if not np.any(stream):
        return said
    numbers = sorted(set(stream.tolist()), key=lambda k: (k == 0, k))
    each = (
        f"{np.sum(stream == k)} of {f'stream {k}' if k else 'no stream'}"
        for k in numbers
    )
    return f"{said} ({', '.join(each)})"


def longest(features, most):
    """Return the rows of secure features, of many those seen in most epochs."""
    secure = np.flatnonzero(features["secure"])
    order = np.argsort(-features["n_epochs"][secure], kind="stable")
    return np.sort(secure[order[:most]])


def published_lines(features, *, agree=2):
    """
    Return how the speeds of secure features agree with published ones, as lines.

    Parameters
    ----------
    features : `~astropy.table.QTable`
        See ``astro_scc.products.publication.with_published``.
    agree : float, optional
        Speeds agree within so many errors of both.

    Returns
    -------
    list of str
        One, or none without published or secure features.
    """
    secure = np.asarray(features["secure"], dtype=bool)
    if "published" not in features.colnames or not secure.any():
        return []
    same = features[secure & ~features["published"].mask]
    if len(same) == 0:
        return [f"0 of {secure.sum()} secure features are published ones."]
    pm, unit = same["published_pm"].unmasked, unit_name(same["pm"].unit)
    error = np.hypot(same["pm_err"], same["published_pm_err"].unmasked)
    differs = np.abs(same["pm"] - pm) > agree * error
    others = ", ".join(
        f"{row['feature']} ({cell(row, 'pm', '+-')}, published "
        f"{cell(row, 'published_pm', '+-')} {unit})"
        for row in same[differs]
    )
    return [
        f"{len(same)} of {secure.sum()} secure features are published ones, of which "
        f"{np.sum(~differs)} have the published speed within {agree:g} errors"
        f"{'; not ' if others else ''}{others}."
    ]


def _followed(features):
    """Return features with their dates as text, in a unit that is easy to read."""
    shown, separation = dates_as_text(features), features["separation"]
    shown["separation"] = separation.to(offset_unit(separation.to_value("mas").max()))
    ends = zip(shown["first"], shown["last"], strict=True)
    shown["dates"] = [f"{first} to {last}" for first, last in ends]
    if not np.any(shown["stream"]):
        shown.remove_column("stream")
    return shown


def trust_lines(features):
    """Return what makes features secure, and how many are not for another reason."""
    return [*SECURE.split("; "), *doubts_in_words(features.meta.get("doubts", {}))]


def _lacking(features, *, most_spans=10):
    """
    Return what makes a feature secure, and what the nearest to it lacks.

    One that would have to be seen ``most_spans`` times as long is out of reach.
    """
    if len(features) == 0:
        return ["No detections of four epochs or more are in steady motion."]
    if features.meta.get("doubts"):
        return trust_lines(features)
    motion, false = features["motion"].value, features["p_false"]
    errors = (features["pm"] / features["pm_err"]).value
    beams, sigma, _ = MOTIONS[0]
    shares = MOST_FALSE / false, motion / beams, errors / sigma
    best = np.argmax(np.minimum.reduce(shares))
    share, row = shares[1][best], features[best]
    text = (
        f"The nearest to being secure is feature {row['feature']}: "
        f"p_false {false[best]:.2g}, motion {motion[best]:.2g} beams, "
        f"{errors[best]:.2g} standard errors"
    )
    if 1 / most_spans < share < 1 and share == np.min(shares, axis=0)[best]:
        time = row["pm"].unit.bases[1]
        needed = (row["last"] - row["first"]).to_value(time) / share
        text += f"; at its speed it would have to be seen for {needed:.2g} {time}"
    return [*SECURE.split("; "), f"{text}."]


def profile_lines(streams):
    """
    Return the streams in bins of distance as the lines of a table.

    Parameters
    ----------
    streams : `~astropy.table.QTable`
        See `~astro_scc.flow.Profile.components`.

    Returns
    -------
    list of str
    """
    rows, unit = streams.copy(), streams["r_min"].unit
    ends = zip(rows["r_min"].value, rows["r_max"].value, strict=True)
    rows["bin"] = [f"{low:g} to {high:g}" for low, high in ends]
    tested = set(rows["bin"])
    rows = rows[(rows["kind"] != "not significant") | rows["main"]]
    if len(rows) == 0:
        return ["No speed could be tested in any bin."]
    rows["remark"] = np.where(rows["kind"] == "moving", "", rows["kind"])
    lines = column_lines(rows, PROFILE)
    for low, high in (streams.meta["bins"] * u.mas).to_value(unit):
        name = f"{low:g} to {high:g}"
        if name not in rows["bin"]:
            why = "no speed exceeds its error" if name in tested else "nothing is seen"
            lines.append(f"{name} {unit_name(unit)}: {why}")
    lines += _remarks(rows[rows["kind"] != "not significant"])
    lines += [*EXPLANATION, PROFILE_EXPLANATION, *speeds_along(streams.meta)]
    return [*lines, *speed_lines(streams.meta)]


def _remarks(rows):
    """Return the cautions of rows of a profile, each with all bins that it is on."""
    places = {}
    for row in rows:
        on = _on(row["scale_group"]) if "scale_group" in rows.colnames else ""
        for text in row["caution"].removeprefix("-").split("; "):
            # The table has the number of features.
            if text and not text.startswith("no secure feature"):
                places.setdefault((text, on), []).append(row["bin"])
    unit = unit_name(rows["r_min"].unit)
    return [
        f"{', '.join(dict.fromkeys(bins))} {unit}{on and f' on {on}'}: {text}"
        for (text, on), bins in places.items()
    ]


def _on(group):
    """Return the scales of a group in words."""
    return f"{'scales' if ',' in group else 'scale'} {group}"


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
    >>> from astro_scc.report.answer import misalignment_text
    >>> misalignment_text(0.0312)
    'The epochs are aligned to 0.03 beams.'
    """
    if scatter is None:
        return "The images do not show how well the epochs are aligned."
    return f"The epochs are aligned to {scatter:.2f} beams."


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
    >>> from astro_scc.report.answer import speed_lines
    >>> speed_lines({"redshift": 0.158, "cosmology": "H0=71,Om0=0.27"})[0]
    'speeds in c: redshift 0.158, FlatLambdaCDM with H0 = 71 km/s/Mpc, Om0 = 0.27'
    """
    source = source_text(meta)
    return [f"speeds in c: {source}"] if source else []
