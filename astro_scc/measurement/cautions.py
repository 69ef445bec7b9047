# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What a stream depends on: in words, and as its speed in parts of the data."""

from dataclasses import replace
from itertools import combinations

import astropy.units as u
import numpy as np
import scipy
from astropy.stats import circmean, circstd

from astro_scc.columns import with_errors
from astro_scc.epochs.align import pointing_of
from astro_scc.epochs.registration import farthest_upstream
from astro_scc.features.motion import SIGNIFICANT
from astro_scc.grid import has_core
from astro_scc.images.dates import date_labels
from astro_scc.kinematics import PositionAngleFrame, RidgeLine
from astro_scc.spectrum.permutations import INWARD, within
from astro_scc.streams import decomposed, finder
from astro_scc.streams.members import FEWEST, frame_velocities, passing_features
from astro_scc.units import PM_UNIT, offset_unit, unit_name

#: Parts of the limits of the search that are near them, and errors by which two speeds
#: differ.
NEAR, DISAGREE = 0.8, 2.5
#: Difference of directions, in radians, of which a projection loses 5%, and scatter of
#: them over more than half of the circle, about no direction.
DIRECTIONS, ALL = 0.3, 1.0
#: How that is said, which headlines begin with.
NO_DIRECTION = "no one direction holds for the emission"
#: What to do about several directions.
EACH = "give a region for each"


def cautions_of(result, k, row):
    """
    Return what a stream depends on, and why it is not moving.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    k : int
        Number of the stream, from 0.
    row : dict
        Its columns as plain numbers, see ``stream_row``.

    Returns
    -------
    list of str
    """
    search, stream = result.search, result.search.streams[k]
    alpha, unit = result.meta["settings"]["alpha"], result.cube.speed_unit
    said = [stream.reason, *_doubts(result, stream, alpha)]
    if k == 0 and stream.kind != "stationary":
        said += [*_upstream(result, stream, row), *_other_directions(result)]
    if stream.kind == "moving":
        said += _of_pointing(result.cube, row)
        said += _of_both_sides(result, stream)
        said += _cautions(search, stream, row, alpha, unit)
        if k == _main(search):
            said.append(result.sensitivity_line)
    return [text for text in said if text]


def _main(search):
    """Return the stream with the largest share of those that move."""
    shares = [s.share if s.kind == "moving" else -1.0 for s in search.streams]
    return int(np.argmax(shares))


def _shown(speed, unit):
    return f"{(speed * PM_UNIT).to_value(unit):.3g} {unit_name(unit)}"


def _doubts(result, stream, alpha):
    """Return why a stream is not significant, as a list of text."""
    if stream.kind != "not significant":
        return []
    search, unit = result.search, result.cube.speed_unit
    never = search.test.p_smallest > alpha
    low, high = (_shown(speed, unit) for speed in (search.slowest, search.fastest))
    unlike = f"{finder.UNLIKE}, if the dates are right; so no feature is secure"
    unlike = [unlike] if search.features.doubts else []
    one_way, angle = [], np.degrees(result.flow.grids[0].angle) % 360
    if result.meta["settings"]["outward"] and result.flow.directed:
        outward = result.flow.outward
        way = "away from the core" if outward else f"towards PA {angle:.0f} deg"
        one_way = [f"'outward' searches only motion {way}: try without it"]
    return [
        f"p_global {stream.p_global:.2g} is above alpha, {alpha:g}"
        f"{', which so few epochs or trials cannot reach' if never else ''}",
        *unlike,
        *one_way,
        *_inward(search, alpha),
        *_beyond(search, stream, unit),
        f"speeds of {low} to {high} were searched: slower motion needs a longer time, "
        "faster shorter intervals or a larger max_speed (--max-speed)",
    ]


def _inward(search, alpha):
    """Return that motion against the flow needs more, as a list of text."""
    p, inward = search.test.p_local[search.test.best], search.test.clearest < 0
    weighted = search.flow.directed and search.flow.outward and inward and p <= alpha
    said = f"inward motion needs a p-value {1 / INWARD:g} times smaller than outward"
    return [said] if weighted else []


def _beyond(search, stream, unit):
    """Return that the spectrum is beyond what was searched, as a list of text."""
    speed, step = stream.spectrum[0], finder.RATIO - 1
    if search.slowest <= speed <= search.fastest:
        return []
    said = f"the spectrum has {_shown(speed, unit)}, which was not searched"
    if search.tested(speed):
        said = f"its speed is within a step, {step:.0%}, of those that were searched"
    more = ": give a larger max_speed (--max-speed)"
    return [said + (more if speed > search.fastest else "")]


def _upstream(result, stream, row, *, least=1.2):
    """
    Return that emission lies upstream of the reference position, as a list of text.

    Features come from there and move past it, or a local maximum of the mean
    image lies ``least`` beams or more behind a core, and no secure feature moves away
    there as in a counter-jet.
    """
    flow, features = result.flow, result.tracked_features
    cored = flow.outward and has_core(result.cube, flow.beam)
    if not flow.passes and (not cored or stream.kind == "not significant"):
        return []
    place = features.places
    velocity = features.velocities
    coming = passing_features(features, flow.beam) if flow.passes else []
    way = velocity[coming or stream.members].sum(axis=0)
    angle = np.radians(row["pm_pa"])
    if np.isfinite(angle) and not coming:
        way = np.array([np.sin(angle), np.cos(angle)])
    if not np.hypot(*way) > 0:
        return []
    way, ends = way / np.hypot(*way), [*place[coming]]
    peak = farthest_upstream(result.cube, way)
    away = features.secure & (place @ way < 0) & (velocity @ way < 0)
    # More behind than beside.
    behind = -peak @ way > max(least * flow.beam, np.hypot(*peak) / np.sqrt(2))
    if behind and (coming or not away.any()):
        ends.append(peak)
    if not ends:
        return []
    far = ends[np.argmin(ends @ way)]
    distance = np.hypot(*far) * u.mas
    distance = distance.to(offset_unit(distance.value))
    at, to = (round(np.degrees(np.arctan2(*v))) % 360 for v in (far, way))
    passing = ", and features come from there" if coming else ""
    return [
        f"emission lies upstream of the reference position, to {distance:.2g} at PA "
        f"{at} deg{passing}: if the core is there, align on it with a table of its "
        f"positions, or with --align 'core {to} deg'"
    ]


def _of_pointing(cube, row, *, near=0.1):
    """
    Return that a stream moves as the sky does by the epochs' coordinates, as a list.

    Epochs are aligned on their reference pixels, which may drift on the sky.
    """
    if not cube.epoch_wcs:
        return []
    steps, _ = pointing_of(cube)
    years = (cube.years - cube.years.mean()).to_value(u.yr)
    # A place on the sky is where the shift to the common grid comes from.
    drift = -(years @ (steps - steps.mean(axis=0))) / (years @ years)
    at = cube.pixel_to_offset(*np.transpose([[0.0, 0.0], drift]))
    sky = np.array([np.diff(offset.to_value(u.mas))[0] for offset in at])
    off = np.hypot(row["pm_ra_cosdec"] - sky[0], row["pm_dec"] - sky[1])
    if not off <= max(near * np.hypot(*sky), 2 * row["pm_err"]) < np.hypot(*sky):
        return []
    return [
        "what stands still on the sky moves so by the coordinates of the epochs: where "
        "they are to be trusted, use frame='absolute' (--align wcs)"
    ]


def _moving_features(result):
    """Return places and velocities of secure features that move, and places on axes."""
    features, frame = result.tracked_features, result.frame
    velocity, covariance = frame_velocities(frame, features)
    error = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2)
    use = features.secure & (np.hypot(*velocity.T) > SIGNIFICANT * error)
    place = features.places[use]
    local = (np.asarray(frame.matrix(*place.T)) @ place[..., None])[..., 0]
    return place, velocity[use], local


def _other_directions(result):
    """Return that features move in several directions, as a list of text."""
    frame, (place, velocity, local) = result.frame, _moving_features(result)
    if len(place) < FEWEST:
        return []
    # Opposite directions are those of a jet and its counter-jet.
    turns = 2 if result.flow.grids[0].counter.any() else 1
    angle, outward = (turns * np.arctan2(*v.T[::-1]) for v in (velocity, local))
    scatter, about = (
        circstd(angles, method="circular") for angles in (angle, angle - outward)
    )
    everywhere, about_place = scatter > turns * ALL, about < scatter / 2
    off = abs(np.angle(np.exp(1j * (circmean(angle) - turns * result.search.angle))))
    # Where they move the other way, the jet is on the other side.
    aside = 1 < off / turns / (np.pi / 4) < 3 and not everywhere
    if aside and (result.flow.given or not frame.uniform):
        apart = f"{np.degrees(off) / turns:.0f} deg to its direction"
        more = ", along which speeds are measured"
        if frame.uniform:
            more = ": try without a position angle"
        return [f"secure features move at {apart}{more}"]
    # Speeds along lines that bend are lengths.
    if result.flow.grids[0].bends:
        return []
    said = f"directions of secure features scatter by {np.degrees(scatter / turns):.0f}"
    if everywhere:
        # A ridge line does not lead to several sides.
        away = about_place and np.cos(circmean(angle - outward)) > np.cos(ALL)
        opposite = circstd(2 * angle, method="circular") < 2 * DIRECTIONS
        advice = EACH if opposite else _for_all_sides(result, away)
        return [f"{NO_DIRECTION}: {said} deg, {advice}"]
    bends = _bends(angle[np.argsort(np.hypot(*place.T))], turns)
    if not (bends or (scatter > turns * DIRECTIONS and about_place)):
        return []
    return [f"{said} deg with their place, and speeds are {_other_frames(frame)}"]


def _bends(angle, turns):
    """Return whether directions of the inner and of the outer half differ."""
    inner, outer = halves = np.array_split(angle, 2)
    apart = abs(np.angle(np.exp(1j * (circmean(outer) - circmean(inner)))))
    errors = [circstd(half, method="circular") / np.sqrt(len(half)) for half in halves]
    return apart > max(turns * DIRECTIONS, SIGNIFICANT * np.hypot(*errors))


def _other_frames(frame):
    """Return in words along what speeds are, and along what else they may be."""
    others = "'ridge' or 'radial'"
    if not frame.uniform:
        others = "'radial'" if isinstance(frame, RidgeLine) else "'ridge'"
    along = "one" if frame.uniform else "its axes"
    return f"those along {along}: try the position angle {others}"


def _for_all_sides(result, away, *, explained=0.75, near=0.1):
    """
    Return what to do where secure features move to all sides, in words.

    They may come from one place, the centre of an expansion by which this part of
    the variance of their velocities is ``explained``, or move ``away`` from the
    reference position, which counts as the centre if it is as ``near`` to it, in their
    distances.
    """
    features = result.tracked_features
    place, velocity = (
        each[features.secure] for each in (features.places, features.velocities)
    )
    x, v = place - place.mean(axis=0), velocity - velocity.mean(axis=0)
    rate = np.vdot(x, v) / np.vdot(x, x)
    if rate > 0 and rate * np.vdot(x, v) > explained * np.vdot(v, v):
        centre = place.mean(axis=0) - velocity.mean(axis=0) / rate
        away = np.hypot(*centre) < near * np.sqrt(np.vdot(x, x) / len(x))
        if not away:
            unit = offset_unit(np.hypot(*centre))
            shown = ", ".join(f"{one:.3g}" for one in (centre * u.mas).to_value(unit))
            return (
                f"they move away from ({shown}) {unit} of the reference position: in "
                "Python, give the position_angle RadialFrame of this place"
            )
    return "try --position-angle radial" if away else EACH


def _of_both_sides(result, stream, *, least=0.25):
    """
    Return that a stream is that of a jet and its counter-jet, as a list of text.

    Their speeds differ, or such a share of its features at ``least`` is on either side.
    """
    if not result.flow.grids[0].counter.any() or len(stream.members) == 0:
        return []
    velocity, covariance = frame_velocities(result.frame, result.tracked_features)
    way = stream.velocity / np.hypot(*stream.velocity)
    along = (velocity @ way)[stream.members]
    variance = (way @ covariance @ way)[stream.members]
    sides = [np.flatnonzero(along * sign > 0) for sign in (1, -1)]
    if not all(map(len, sides)):
        return []
    jet, counter = (abs(along[side].mean()) for side in sides)
    error = np.sqrt(sum(variance[side].sum() / len(side) ** 2 for side in sides))
    if abs(jet - counter) >= SIGNIFICANT * error:
        unit = result.cube.speed_unit
        return [
            f"it is the mean of the jet, {_shown(jet, unit)}, and the counter-jet, "
            f"{_shown(counter, unit)}: give a region for each"
        ]
    few = min(map(len, sides)) < least * len(along)
    said = "it moves on both sides of the core, and the direction is that of one"
    return [] if few else [f"{said}: give a region for each"]


def _cautions(search, stream, row, alpha, unit):
    """Return what the row of a stream that moves depends on, as a list of text."""
    p, speed = row["p_global"], row["pm"]
    (a, e), (b, f) = ((row[k], row[f"{k}_err"]) for k in ("pm_features", "pm_spectrum"))
    off = np.nan_to_num(abs(a - b) / np.hypot(e, f)) if e > 0 and f > 0 else 0.0
    given = isinstance(search.flow.frame, PositionAngleFrame)
    turned = given and np.cos(search.angle) < 0
    whose = "given" if search.flow.given else "fitted"
    cored = not search.flow.passes and (given or search.flow.cube.beams is not None)
    along, across = row["pm_parallel"] * (-1 if turned else 1), row["pm_transverse"]
    off_axis = np.radians(row["pm_pa"]) - search.flow.grids[0].angle
    if search.flow.outward and np.isfinite(off_axis):
        # A region may have the position angle of the counter-jet.
        along, across = speed * np.cos(off_axis), speed * np.sin(off_axis)
    outward = along * (-1 if stream.counter else 1)
    close = abs(p - alpha) <= 2 * row["p_global_err"] and p > search.test.p_smallest
    cautions = {
        "it is of the counter-jet": stream.counter,
        "moves towards the core": cored and outward < -abs(across),
        f"the jet is on the other side of the core than the {whose} position angle":
            turned and cored,
        f"p_global {p:.2g} is above alpha, {alpha:g}: the motion rests on its secure "
        "features too": p > alpha,
        f"p_global may be above or below {alpha:g} by chance: take more trials":
            close and p <= alpha,
        "no secure feature counts: its speed is that of the spectrum alone":
            row["n_features"] == 0,
        "its features diffuse: all that are followed count, also those not secure":
            not search.features.secure[stream.members].all(),
        "the spectrum has no such stream, so that its share is not known":
            np.isnan(row["share"]),
        f"faster than {_shown(search.unambiguous, unit)}, a beam in the median "
        "interval, patterns could be mistaken for one another":
            speed > search.unambiguous,
        f"near the fastest speed that is searched, {_shown(search.fastest, unit)}: "
        "give a larger max_speed (--max-speed)":
            speed > NEAR * search.fastest,
        f"near the slowest speed that is searched, {_shown(search.slowest, unit)}":
            speed < search.slowest / NEAR,
        f"spectrum and features differ by {off:.1f} errors": off > DISAGREE,
    }  # fmt: skip
    return [text for text, holds in cautions.items() if holds]


# -- parts of the data -------------------------------------------------------------

#: Speeds of two parts differ if their difference is larger than so many errors.
DIFFERENT = 2.0


def parts_of(search):
    """
    Measure the main speed from parts of the data.

    Parameters
    ----------
    search : ``StreamSearch``

    Returns
    -------
    list of dict
        Rows of the table, as plain numbers in mas/yr; the first is the whole.  Empty if
        nothing moves.
    """
    flow, fit = search.flow, search.fit
    if fit is None or all(stream.kind != "moving" for stream in search.streams):
        return []
    main, start = _main(search), list(zip(fit.mean, fit.sd, strict=True))

    def speed_of(part, diagram=None):
        """Return the speed with its error; what has no error is not known."""
        try:
            found = decomposed.fit_part(part, start=start, diagram=diagram)
            error = found.errors(stream=main)[0][0] if found.knows(main) else np.nan
        except (np.linalg.LinAlgError, ValueError):
            error = np.nan
        if not np.isfinite(error):
            return np.nan, np.nan
        return abs(found.fit.mean[main]) * flow.beam, error * flow.beam

    whole = abs(fit.mean[main]) * flow.beam, fit.mean_err[main] * flow.beam
    rows = [_row("the whole spectrum", whole)]
    for pair in _pairs_of_parts(search):
        both = [_row(name, speed_of(*part), whole) for name, *part in pair]
        # Both parts may differ from the whole, if they have other features.
        sigma = largest_difference([*both, rows[0]])
        for row in both:
            change = sigma if np.isfinite(row["pm"]) else np.nan
            p_value = 2 * scipy.special.ndtr(-change)
            row |= {"change_sigma": change, "p_value": p_value}
            row["significant"] = bool(change > DIFFERENT)
        rows += both
    return rows


def largest_difference(rows):
    """Return the largest known difference of two speeds in errors of both, or NaN."""
    off = [
        abs(a["pm"] - b["pm"]) / np.hypot(a["pm_err"], b["pm_err"])
        for a, b in combinations(rows, 2)
    ]
    return np.fmax.reduce(off)


def _row(choice, measured, main=None):
    """Return a row of the table; the whole, ``main``, does not change."""
    speed, error = measured
    change = (0.0, 0.0) if main is None else (speed - main[0], np.hypot(error, main[1]))
    row = {"change_sigma": 0.0, "p_value": 1.0, "significant": False}
    row |= {"choice": choice}
    return row | with_errors(pm=(speed, error), change=change)


def _pairs_of_parts(search):
    """Yield pairs of parts: the name, the flow and, if it is known, the diagram."""
    flow, every = search.flow, search.flow.intervals
    apart = np.abs(flow.years - flow.years[:, None])
    apart = apart[np.triu_indices(len(apart), 1)]
    limit, unit = float(np.median(apart[within(apart, every)])), flow.cube.speed_unit
    shown = f"{(limit * u.yr).to_value(unit.bases[1]):.2g} {unit.bases[1]}"
    ends = (every[0], limit), (limit, every[1])
    short, long = (replace(flow, intervals=limits) for limits in ends)
    yield (
        (f"intervals up to {shown}", short, search.diagram),
        (f"intervals from {shown}", long, search.diagram),
    )
    middle = len(flow.years) // 2
    if middle >= finder.FEWEST_EPOCHS:
        date = date_labels(flow.cube.times)[middle]
        yield (
            (f"epochs before {date}", flow.part(epochs=slice(middle))),
            (f"epochs from {date} on", flow.part(epochs=slice(middle, None))),
        )
    r = flow.grids[0].distances
    seen = flow.planes[0].mask & (decomposed.weight_of(flow) > 0.5)
    if seen.any():
        border = float(np.median(r[seen]))
        unit = offset_unit(border * flow.beam)
        text = f"{(border * flow.beam * u.mas).to_value(unit):.3g} {unit}"
        inner, outer = (flow.part(places=[k * 1.0]) for k in (r < border, r >= border))
        yield (f"inner half, up to {text}", inner), (f"outer half, from {text}", outer)
