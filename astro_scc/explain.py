# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Explain which step of the way from images to secure features kept or lost one."""

from __future__ import annotations

from collections import Counter

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time
from scipy.ndimage import map_coordinates

from astro_scc.features import Features, TrackSettings
from astro_scc.features.motion import (
    MOST_FALSE,
    SAME_SPEED,
    motions_in_words,
    moves_enough,
    properties,
)
from astro_scc.features.tracks import position_scatter, steady_hypotheses
from astro_scc.images.dates import date_labels
from astro_scc.intervals import median_interval

__all__ = ["explain_feature"]


#: What the properties of `astro_scc.features.motion.properties` are, the first three as
#: logarithms.
PROPERTIES = (
    "{0:.0f} epochs, {1:.2g} beams moved, {2:.2g} beams from the core, cosine "
    "{3:.2f} of the angle between motion and radius, seen in {4:.0%} of the epochs, "
    "next detection at {5:.2g} beams, ln(flux) changes by {6:.2g} between epochs, "
    "positions scatter by {7:.2g} beams"
)


def explain_feature(
    features: Features, *, feature: int | None = None, offset: u.Quantity | None = None,
    date: Time | None = None, published: QTable | None = None,
) -> list[str]:  # fmt: skip
    """
    Explain why an emission is a secure feature, or which step lost it.

    Parameters
    ----------
    features : `~astro_scc.features.Features`
    feature : int, optional
        The number of a feature.
    offset : `~astropy.units.Quantity`, shape (2,), optional
        A place, to the east and to the north of the core, with its ``date``.
    date : `~astropy.time.Time`, optional
        The nearest epoch is explained, which the first sentence names.
    published : `~astropy.table.QTable`, optional
        Rows of one published feature, with ``date``, ``ra_offset`` and
        ``dec_offset``.

    Returns
    -------
    list of str
        Sentences on the steps in their order: whether it is detected, at which
        signal-to-noise ratio and beside what; of which feature the detections are;
        what this feature's trust rests on.

    Raises
    ------
    ValueError
        If there is no such feature, or nothing to be explained is given.

    Examples
    --------
    >>> from astro_scc.explain import explain_feature
    >>> from astro_scc.features import find_features
    >>> from astro_scc.simulation import simulate_jet
    >>> features = find_features(simulate_jet(n_epochs=12, dispersion=0.1, rng=1).cube)
    >>> number = features.number[features.secure][0]
    >>> explain_feature(features, feature=number)[-1]
    'It is secure.'
    """
    years, d, said = features.detections.years, features.detections, []
    if feature is not None:
        epoch, place = _of_feature(features, feature)
    elif published is not None and len(published):
        epoch = np.abs(published["date"].jyear[:, None] - years).argmin(axis=1)
        east, north = published["ra_offset"], published["dec_offset"]
        place = np.stack([east, north], axis=1).to_value(u.mas)
    elif offset is not None and date is not None:
        epoch = np.abs(date.jyear - years).argmin(keepdims=True)
        place = u.Quantity(offset).to_value(u.mas)[None]
        said = [_epoch_line(features.cube, epoch[0], date)]
    else:
        raise ValueError("give a feature, a published one, or an offset with a date")
    seen, signal, lines = _detected(features, epoch, place)
    lines = said + lines
    owner = np.full(len(d), -1)
    for k, track in enumerate(features.tracks):
        owner[track] = k
    if len(seen) == 0:
        return [*lines, f"It is lost: {_why_undetected(signal)}."]
    counts = Counter(owner[seen].tolist()).most_common()
    shares = (
        f"{n} {'is' if n == 1 else 'are'} of {_name(features, k)}" for k, n in counts
    )
    lines.append(f"Of its {_count(len(seen), 'detection')}, {', '.join(shares)}.")
    k, n = next(((k, n) for k, n in counts if k >= 0), (-1, 0))
    if 2 * n < len(seen):
        return [*lines, *_not_linked(features, seen, owner)]
    return [*lines, *_linked(features, k), *_trusted(features, k)]


def _name(features, k):
    return f"feature {features.number[k]}" if k >= 0 else "no feature"


def _count(n, word="epoch"):
    return f"{n} {word}{'' if n == 1 else 's'}"


def _of_feature(features, number):
    """Return the epochs from first to last, and where the feature's fit is in them."""
    (found,) = np.nonzero(features.number == number)
    if len(found) == 0:
        raise ValueError(f"there is no feature {number}; features.ecsv has the numbers")
    d, motion = features.detections, features.motions[found[0]]
    first, last = d.epoch[features.tracks[found[0]][[0, -1]]]
    epoch = np.arange(first, last + 1)
    return epoch, motion.at(d.years[epoch])


def _epoch_line(cube, epoch, date):
    """Return which epoch is the nearest to a date, and how far it is, as a line."""
    days = cube.times.utc.mjd * u.d
    away = abs(date.utc.mjd * u.d - days[epoch])
    unit = next((k for k in (u.yr, u.d, u.h) if away >= 1 * k), u.min)
    far = away > median_interval(days) / 2
    return (
        f"The nearest epoch to the date is {date_labels(cube.times)[epoch]}, "
        f"{away.to_value(unit):.3g} {unit} from it"
        f"{', more than half the median interval' if far else ''}."
    )


# -- is it detected? -----------------------------------------------------------------


def _detected(features, epoch, place, *, same=0.5, rival=1.0, most=6):
    """
    Return the detections at places, the signal-to-noise ratios, and lines on them.

    A detection is of the emission within ``same`` beams, and a rival of another one
    within ``rival`` beams.  At ``most`` so many epochs are named one by one.
    """
    cube, d = features.cube, features.detections
    labels = date_labels(cube.times)
    signal = _signal(cube, epoch, place)
    nearest, away, beside = np.full((3, len(epoch)), np.inf)
    for i, (one, there) in enumerate(zip(epoch, d.to_beams(place), strict=True)):
        here = np.flatnonzero(d.epoch == one)
        if len(here):
            off = np.hypot(*(d.in_beams[here] - there).T)
            nearest[i], away[i] = here[off.argmin()], off.min()
            apart = np.hypot(*(d.in_beams[here] - d.in_beams[here[off.argmin()]]).T)
            beside[i] = np.partition(np.append(apart, np.inf), 1)[1]
    found = away <= same
    said = f"Detected within {same:g} beams in {found.sum()} of {_count(len(epoch))}"
    if found.any():
        low, middle, high = map(_number, np.quantile(signal[found], [0, 0.5, 1]))
        several = f" to {high}, {middle} in the median" if low != high else ""
        said += f", at an S/N of {low}{several}"
    lines = [f"{said}."]
    missed = np.flatnonzero(~found).tolist()
    each = [
        f"{labels[epoch[i]]}, S/N {_number(signal[i])}, "
        f"at {away[i]:.2g} beams" for i in missed[:most]
    ]  # fmt: skip
    each += [f"and {len(missed) - most} more"] * (len(missed) > most)
    if missed:
        head = "Not detected (date, S/N of the image there, nearest detection): "
        lines.append(f"{head}{'; '.join(each)}.".replace("at inf beams", "none"))
    if rivals := np.sum(beside[found] < rival):
        lines.append(
            f"Another detection is within a beam in {rivals} of these epochs, the "
            f"nearest at {beside[found].min():.2g} beams."
        )
    seen = np.unique(nearest[found].astype(int))
    return seen, signal, lines


def _why_undetected(signal, bright=5.0):
    """Return why nothing is detected where images are above so many times the noise."""
    if not np.isfinite(signal).any():
        return "that is outside of the images, or their pixels there are bad"
    if np.all(signal >= bright):
        emission = "though there is emission: blended, or outside of the region"
        return f"nothing is detected there {emission}"
    return "nothing is detected there"


def _number(value):
    if np.isnan(value):
        return "unknown"
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}"


def _signal(cube, epoch, place):
    """Return the brightness of the images at places over the noise."""
    x, y = cube.offset_to_pixel(*(place.T * u.mas))
    signal, noise = np.empty(len(epoch)), cube.noise_rms().value
    for i, one in enumerate(epoch):
        there = [y[i : i + 1], x[i : i + 1]]
        image = cube.data[one] / noise[one]
        signal[i : i + 1] = map_coordinates(image, there, order=1, cval=np.nan)
    return signal


# -- is it linked, and trusted? ------------------------------------------------------


def _not_linked(features, seen, owner):
    """Return why the assignment has not made a feature of detections, as lines."""
    d, settings = features.detections, TrackSettings()
    least = settings.least_epochs
    if len(np.unique(d.epoch[seen])) < least:
        return [f"It is lost: a feature needs detections in {least} epochs."]
    paths, score = steady_hypotheses(d, settings)
    common = np.array([np.isin(path, seen).sum() for path in paths], dtype=int)
    if (most := common.max(initial=0)) < least:
        return [
            f"It is lost: steady motion joins at most {most} of them, and a feature "
            f"needs {least} (links are off by {settings.gate:g} errors or less)."
        ]
    best = np.flatnonzero(common == most)[0]
    taken = Counter(owner[[*paths[best]]].tolist()).most_common()
    others = ", ".join(f"{n} by {_name(features, k)}" for k, n in taken if k >= 0)
    why = f"detections of it are taken by likelier tracks: {others}"
    if not others:
        why = (
            f"its links are in less than {settings.agreed:.0%} of the perturbed "
            "assignments, or it is at the place of a longer feature"
        )
    return [
        f"The likeliest track joins {most} of them; its log likelihood ratio to "
        f"unrelated detections is {score[best]:.1f}.",
        f"It is lost: {why}.",
    ]


def _linked(features, k):
    """Return how well the links of a feature agree with its motion, as a line."""
    d, track, motion = features.detections, features.tracks[k], features.motions[k]
    scatter = position_scatter(d, TrackSettings())[track]
    off = np.hypot(*d.to_beams(motion.residual).T) / scatter
    missed = np.ptp(d.epoch[track]) + 1 - len(track)
    return [
        f"Feature {features.number[k]} links {_count(len(track))} and misses "
        f"{missed}; it is off its line by {np.sqrt((off**2).mean()):.2g} standard "
        f"deviations (rms), at most {off.max():.2g}, and {np.sum(~motion.used)} "
        "positions are set aside."
    ]


def _trusted(features, k):
    """Return what makes a feature secure or not, as lines."""
    track, motion = features.tracks[k], features.motions[k]
    known = properties(features.detections, track, motion)
    # The distance has an offset, see `properties`.
    plain = *np.exp(known[:2]), np.exp(known[2]) - 0.3, *known[3:]
    sigma = motion.speed / motion.speed_err
    false, moved, same = features.p_false[k], features.moved[k], features.same_speed[k]
    checks = {
        f"p_false {false:.2g} (at most {MOST_FALSE:g})": false <= MOST_FALSE,
        f"the same speed in {same:.0%} of the perturbed assignments (at least "
        f"{SAME_SPEED:.0%})": same >= SAME_SPEED,
        f"motion of {moved:.2g} beams and {sigma:.2g} standard errors in "
        f"{_count(len(track))} (at least {motions_in_words()})":
            moves_enough(moved, sigma, len(track)),
    }  # fmt: skip
    for reason, numbers in features.doubts.items():
        if features.number[k] in numbers:
            checks[reason] = False
    failed = [text for text, passed in checks.items() if not passed]
    return [
        f"Its p_false follows from {PROPERTIES.format(*plain)}.",
        f"Checks: {'; '.join(checks)}.",
        f"It is not secure: {'; '.join(failed)}." if failed else "It is secure.",
    ]
