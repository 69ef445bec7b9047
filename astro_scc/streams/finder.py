# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""From the velocity spectrum and the features to streams on the sky."""

from dataclasses import replace
from typing import Any

import numpy as np

from astro_scc.features.motion import SIGNIFICANT, is_walk, measure_diffusion
from astro_scc.spectrum.diagram import correlate_aside
from astro_scc.spectrum.equations import deconvolve, set_up
from astro_scc.spectrum.errors import fit_errors
from astro_scc.spectrum.gaussians import (
    GAIN,
    two_are_better,
    two_streams,
)
from astro_scc.spectrum.maps import velocity_map
from astro_scc.spectrum.permutations import (
    permutation_test,
)
from astro_scc.streams.decomposed import DecomposedFlow
from astro_scc.streams.members import (
    divided,
    mean_across,
    moving_features,
    turn_to_flow,
)
from astro_scc.streams.parts import fit_along_lines, is_behind
from astro_scc.streams.rays import transverse_speed
from astro_scc.streams.search import (
    UNKNOWN,
    MeasuredStream,
    SearchSettings,
    StreamSearch,
)
from astro_scc.streams.spread import (
    chance_of_separation,
    mean_speed,
    unknown_scatter,
)

#: With a secure feature that moves, this p_global is enough.
WITH_FEATURES = 0.1
#: Error of the speed of a spectrum beyond that of its patterns, relative to it, where
#: its Gaussian has at least the other one.
MODEL_ERROR, WELL_KNOWN = 0.25, 0.1
#: A mean over the spectrum is that of speeds within such a factor of the clearest one:
#: in the jets of a survey, restored and CLEANed, it errs least for 4 to 6.
AROUND = 5.0
#: Fewest epochs: the innovations of fewer have too few orders.
FEWEST_EPOCHS = 6
#: Smallest speed of a stream in errors, and of what the test may take for motion:
#: features that diffuse and, where no secure feature moves, other patterns at a beam in
#: an interval, and static sources at p_global above such a fraction of alpha.  Static
#: jets with errors of alignment or fluxes with memory are below alpha in 2%.
REST_ERRORS, DOUBTFUL_ERRORS, ALONE = 1.0, 3.0, 0.2
#: A speed of the spectrum needs images that resemble one another: at least such a part
#: of their variance has no memory, and less than such a share moves.
WHITE, LEAST_MOVING = 0.7, 0.15
UNLIKE = (
    "the images of neighbouring dates have little in common, so that patterns may be "
    "mistaken for one another: shorter intervals are needed"
)
#: Displacement across the flow at which diagrams are compared, in beams.
ASIDE = 0.4
#: Without a known direction, that of the flow is found in so many turns, of at most
#: and at least so many radians.
MOST_TURNS, MOST_TURN, LEAST_TURN = 3, 0.3, 0.03
#: Two streams are one broad one if as many features of one would be as separate more
#: often than so, unless the speeds differ by such a factor; if not, two need explain
#: less.  Features tell if such a share of them is on either side of the middle.
FEWEST, BY_CHANCE, BROAD, LEAST_GAIN, LEAST_SIDE = 5, 0.05, 6.0, 0.03, 0.2
#: Features speak for a flow if they are this share of all detections.
COVERAGE = 0.1
#: Largest motion of a standing feature, in beams, its fewest epochs, and the fewest
#: errors by which its velocity is not that of a stream.
STANDING, STANDING_EPOCHS, AS_WELL = 0.5, 5, 2.0
#: Standing features do not stand still if their mean is so many errors from zero, of
#: two dimensions: as rare by chance as three errors in one.
TOGETHER = 3.44


def find_streams(
    flow: DecomposedFlow, features: Any, settings: SearchSettings, *,
    inside: np.ndarray | None = None, root: bool = True, rng: np.random.Generator,
) -> StreamSearch:  # fmt: skip
    """
    Find the streams of a flow.

    Parameters
    ----------
    flow : ``DecomposedFlow``
    features : `~astro_scc.features.Features`
    settings : `SearchSettings`
    inside : `~numpy.ndarray` of bool, shape (n_features,), optional
        The features of a part of the flow.
    root : bool, optional
        Fit the streams to the square root of the planes, see
        `FlowPlanes.square_root`; not where scales are compared.
    rng : `~numpy.random.Generator`

    Returns
    -------
    `StreamSearch`
    """
    map_rng = rng.spawn(1)[0]
    flow, test = find_motion(flow, settings, rng)
    planes = flow.planes[0].square_root if root else flow.planes[0]
    sheet, aside = _sheet(planes, flow.regions[0], 3)
    sign = float(np.sign(test.speed[test.best[1]]))
    diffusion = measure_diffusion(features)
    walk = diffusion["variance"] if is_walk(diffusion) else None
    folded = bool(flow.grids[0].counter.any())
    moving = moving_features(
        features, flow.frame, flow.angle, inside, walk, folded=folded
    )
    opposed = ""
    if walk is None:
        opposed = _opposed(features, inside, moving, sign)
        moving = moving[moving.along * sign > 0]
    covered = moving.weight.sum() >= COVERAGE * len(features.detections)
    enough = WITH_FEATURES if len(moving) and covered else settings.alpha
    passes, diffusing = test.p_global <= enough, walk is not None
    part = fit_along_lines(
        flow, straight=not passes, sign=sign, root=root, intervals=settings.intervals,
        diagram=sheet[len(sheet) // 2],
    )  # fmt: skip
    one, diagram = None, sheet[len(sheet) // 2]
    if part is None:
        equations = set_up(diagram, fastest=flow.fastest, intervals=settings.intervals)
    else:
        flow, planes, one = part.flow, part.planes, part.fit
        diagram, equations = part.diagram, part.equations
    if flow.grids[0].bends:
        length = np.hypot(moving.along, moving.across)
        moving.along = np.copysign(length, moving.along)
    search = StreamSearch(
        flow, test, diagram, equations.speed * flow.beam, deconvolve(equations),
        settings.intervals,
    )  # fmt: skip
    fit, p = one, 1.0
    if one is not None and passes:
        fit, p = _streams_of(
            search, equations, one, moving, settings, map_rng, diffusing=diffusing
        )
    if fit is not None:
        errors = fit_errors(planes, diagram, equations, fit, region=flow.regions[0])
        search = replace(search, fit=fit, errors=errors)
    shift = _alignment(flow.years, settings.misaligned)
    rows = _of_spectrum(search, equations, settings.whole)
    streams = _streams(
        search, rows, moving, (sheet, aside), shift, covered=covered, p_distinct=p
    )
    if passes and folded:
        streams = [_on_its_side(s, search, moving, planes) for s in streams]
    if passes:
        sure = ALONE * settings.alpha if settings.whole else 1.0
        streams = [
            _judged(s, search, opposed, diffusing=diffusing, sure=sure) for s in streams
        ]
    streams += _standing(features, flow, streams, inside, shift)
    fastest = max([np.hypot(*s.velocity) for s in streams if s.kind == "moving"] or [0])
    velocities = velocity_map(
        sheet, aside * (np.arange(len(sheet)) - len(sheet) // 2),
        min(3 * fastest or np.inf, search.fastest) / flow.beam, angle=flow.angle,
        beam=flow.beam, rng=map_rng,
    )  # fmt: skip
    return replace(search, streams=tuple(streams), velocities=velocities)


def _opposed(features, inside, moving, sign):
    """Return in words that most secure features move against a flow, or elsewhere."""
    secure = features.secure if inside is None else features.secure & inside
    number, with_it = secure.sum(), moving.along * sign > 0
    against, others = moving[~with_it].weight.sum(), number - with_it.sum()
    elsewhere = others >= FEWEST and with_it.sum() < LEAST_SIDE * number
    if not elsewhere and not against > moving[with_it].weight.sum():
        return ""
    few = f"only {with_it.sum()}" if with_it.any() else "none"
    return f"{few} of {number} secure features move in its direction"


def _streams_of(search, equations, fit, moving, settings, rng, *, diffusing):
    """Return one stream or two that are fitted, and the p-value of one."""
    test, least = search.test, 1 / np.ptp(search.flow.years)
    first = test.speed[test.best[1]]
    second, p_distinct = test.beside(first, least / 2)
    if diffusing:
        return fit, p_distinct
    speed, chance = np.abs(moving.along) / search.beam, 1.0
    if len(speed) >= FEWEST:
        chance = chance_of_separation(speed, settings.n_trials, rng)
    if p_distinct > settings.alpha:
        # A second test where the first does not reject.
        p_distinct = min(p_distinct, 2 * chance)
    if p_distinct <= settings.alpha:
        two = two_streams(equations, fit, least, (first, second))
        if two is not None and _are_two(equations, fit, two, speed, chance):
            fit = two
    return fit, p_distinct


def find_motion(flow, settings, rng):
    """
    Return a flow along its direction, and the test for motion along all directions.

    Parameters
    ----------
    flow : ``DecomposedFlow``
    settings : `SearchSettings`
    rng : `~numpy.random.Generator`

    Returns
    -------
    flow : ``DecomposedFlow``
    test : ``MotionTest``
    """
    shared = {"fastest": flow.fastest, "intervals": settings.intervals}
    shared |= {"n_trials": settings.n_trials, "rng": rng}
    diagrams = [flow.diagram(k) for k in range(len(flow.planes))]
    test = permutation_test(diagrams, inward=settings.inward(flow), **shared)
    if len(flow.planes) == 1:
        return flow, test
    # Along the direction of the largest z, outward.
    direction, best = test.best
    flow = _turned(flow, direction, test.speed[best])
    along = permutation_test([flow.diagram(0)], inward=0.0, **shared)
    return flow, replace(
        along, p_global=test.p_global, p_smallest=test.p_smallest, level=test.level
    )


def _are_two(equations, one, two, speed, chance):
    """Return whether spectrum and features show two streams rather than a broad one."""
    slow, fast = np.abs(two.mean)
    sides = np.bincount(speed < np.sqrt(slow * fast), minlength=2)
    known = len(speed) >= FEWEST and sides.min() >= LEAST_SIDE * len(speed)
    if known and chance > BY_CHANCE and fast < BROAD * slow:
        return False
    gain = LEAST_GAIN if known and chance <= BY_CHANCE else GAIN
    return two_are_better(equations, one, two, gain)


def _sheet(planes, region, number):
    """Return diagrams at displacements across the flow, and their distance in beams."""
    lag, n_across = max(1, round(ASIDE / planes.step)), len(planes.across)
    lags = [k * lag for k in range(1, number + 1) if 2 * k * lag < n_across]
    return correlate_aside(planes, lags, region=region), lag * planes.step


def _turned(flow, direction, speed):
    """Return the flow along its own direction, from the best of those tested."""
    angle = flow.grids[direction].angle + (0.0 if speed > 0 else np.pi)
    for _ in range(MOST_TURNS):
        found = flow.along(angle)
        sheet, aside = _sheet(found.planes[0].square_root, found.regions[0], 1)
        across, error = transverse_speed(sheet, aside, abs(speed))
        if not np.isfinite(error):
            break
        # Positive to larger position angles.
        turn = np.arctan2(across, abs(speed))
        turn = float(np.clip(turn, -MOST_TURN, MOST_TURN))
        angle += turn
        if abs(turn) < LEAST_TURN:
            break
    return flow.along(angle)


def _streams(search, rows, moving, sheet, shift, *, covered, p_distinct):
    """Return the streams that move, or the strongest speed, none of them judged yet."""
    beam, turn, sign, test = (
        search.beam,
        turn_to_flow(search.angle),
        search.sign,
        search.test,
    )
    groups = [moving] if len(rows) == 1 else divided(moving, [abs(r[0]) for r in rows])
    found = []
    for row, members in zip(rows, groups, strict=True):
        speed, error, spread, spread_err, share = row
        across, across_err = transverse_speed(*sheet, speed / beam)
        if not np.isfinite(across_err):
            # A flow that is not resolved across: the direction is that of the grid.
            across_err = error / beam
        velocity = np.array([speed, across * beam])
        variance = np.array([error, across_err * beam]) ** 2
        source, features, (slowest, fastest) = "spectrum", UNKNOWN, UNKNOWN
        if len(members):
            mean = mean_speed(sign * members.along, members.along_err, members.weight)
            features = mean.mean, mean.error
            lengths = np.hypot(members.along, members.across)
            slowest, fastest = lengths.min(), lengths.max()
            # Of two streams the spectrum knows which is which.
            if (covered and len(rows) == 1) or not np.isfinite(error):
                source, side = "features", mean_across(members, mean)
                velocity = np.array([sign * mean.mean, side[0]])
                variance = np.array([mean.error, side[1]]) ** 2
                if len(members) > 2:
                    spread, spread_err = mean.dispersion, mean.dispersion_err
        if search.flow.grids[0].bends:
            # The speed along the lines is the length of the velocity.
            velocity *= abs(velocity[0]) / np.hypot(*velocity)
        v = int(np.abs(test.speed - velocity[0] / beam).argmin())
        found.append(MeasuredStream(
            kind="not significant", reason="", velocity=turn.T @ velocity,
            covariance=turn.T @ np.diag(variance) @ turn + shift, alignment=shift,
            source=source, share=share, dispersion=spread, dispersion_err=spread_err,
            p_local=float(test.p_local[test.best[0], v]), p_global=test.p_global,
            p_distinct=p_distinct if found else test.p_global,
            spectrum=(abs(speed), error), features=features, members=members.number,
            slowest=slowest, fastest=fastest,
            angle=search.angle + (0.0 if sign > 0 else np.pi),
        ))  # fmt: skip
    return found


def _on_its_side(stream, search, moving, planes):
    """Return a stream of both sides of a core with the direction of its own side."""
    members = moving[np.isin(moving.number, stream.members)]
    # Where both sides move so, the direction is that of the jet.
    behind = members.weight @ members.side < -members.weight.sum() / 2
    if not len(members):
        speed = search.sign * stream.spectrum[0] / search.beam
        behind = is_behind(search.flow, planes, speed)
    if not behind:
        return stream
    turned = {"velocity": -stream.velocity, "angle": stream.angle + np.pi}
    return replace(stream, counter=True, **turned)


def _of_spectrum(search, equations, whole):
    """Return speed and dispersion with errors, in mas/yr, and share of each stream."""
    fit, errors, beam, test = search.fit, search.errors, search.beam, search.test
    if fit is None:
        return [(test.speed[test.best[1]] * beam, *[np.nan] * 4)]
    speed, error, spread = fit.mean * beam, errors.mean * beam, fit.sd * beam
    largest = WELL_KNOWN if whole else 1.0
    if len(speed) == 1 and not error[0] < largest * abs(speed[0]):
        speed, error = np.reshape(_harmonic(search, equations), (2, 1))
    elif len(speed) == 1 and whole:
        # Few patterns are a small sample of the speeds of one stream.
        error = np.hypot(error, unknown_scatter(speed, errors.number))
    spread_err = spread / np.sqrt(2 * np.maximum(errors.number, 1))
    return list(zip(speed, error, spread, spread_err, fit.share, strict=True))


def _judged(stream, search, opposed="", *, diffusing, sure=1.0):
    """
    Return a stream that the test finds with its kind, and the reason.

    Without secure features, a speed is doubtful if ``p_global`` is above ``sure``.
    """
    turn = turn_to_flow(search.angle)
    speed, alone = abs((turn @ stream.velocity)[0]), not len(stream.members)
    weak, fast = search.test.p_global > sure, speed > search.unambiguous
    kind, reason = verdict(
        speed, np.sqrt((turn @ stream.covariance @ turn.T)[0, 0]),
        doubtful=diffusing or (alone and (weak or fast)),
        unlike=stream.source == "spectrum" and _unlike(search.test),
    )  # fmt: skip
    if alone and weak and kind != "moving" and reason != UNLIKE:
        reason += f"; without secure features this needs p_global of at most {sure:g}"
    # The spectrum reaches beyond what the test searches, features have their own test.
    if stream.source == "spectrum" and not search.tested(speed):
        than = "faster" if speed > search.fastest else "slower"
        kind, reason = "not confirmed", f"it is {than} than what was searched"
    if opposed:
        kind, reason = "not confirmed", opposed
    return replace(stream, kind=kind, reason=reason)


def verdict(speed, error, *, doubtful, unlike):
    """
    Return the kind of a stream that the test finds, and the reason if it is in doubt.

    Parameters
    ----------
    speed, error : float
        In the same unit.
    doubtful : bool
        Whether the test may take something else for motion.
    unlike : bool
        Whether images of neighbouring dates are too unlike each other.

    Returns
    -------
    (str, str)

    Examples
    --------
    >>> from astro_scc.streams.finder import verdict
    >>> verdict(1.5, 1.0, doubtful=False, unlike=False)
    ('moving', '')
    >>> verdict(1.5, 1.0, doubtful=True, unlike=False)
    ('not confirmed', 'its speed is within 3 standard errors of rest')
    """
    least = DOUBTFUL_ERRORS if doubtful else REST_ERRORS
    if not speed > least * error:
        words = f"{least:g} standard errors" if least > 1 else "a standard error"
        return "not confirmed", f"its speed is within {words} of rest"
    return ("not confirmed", UNLIKE) if unlike else ("moving", "")


def _unlike(test):
    """Return whether epochs have so little in common that patterns may be mistaken."""
    white = 1.0 if test.memory == 0 else test.white
    return white >= WHITE and test.amplitude[test.best] < LEAST_MOVING


def _harmonic(search, equations):
    """
    Return the mean speed of the spectrum of one stream and its error, in mas/yr.

    What is the same at v and -v is noise, and so is what is far from the speed at which
    motion is clearest.  The mean is harmonic, as a fast pattern covers more of the way
    in a time.
    """
    sign, spectrum = search.sign, search.spectrum
    clearest = abs(search.test.speed[search.test.best[1]])
    half = len(spectrum) // 2
    forward = equations.speed[half + 1 :]
    share = sign * (spectrum[half + 1 :] - spectrum[:half][::-1])
    used = (forward > clearest / AROUND) & (forward < AROUND * clearest)
    share = np.where(used, np.maximum(share, 0), 0)
    if not share.sum() > 0:
        speed = search.fit.mean[0] * search.beam
        return speed, MODEL_ERROR * abs(speed)
    share = share / share.sum()
    mean = 1 / (share @ (1 / forward))
    width = mean**2 * np.sqrt(share @ (1 / forward - 1 / mean) ** 2)
    number = max(search.errors.number[0], 1)
    error = np.hypot(width / np.sqrt(number), MODEL_ERROR * mean)
    return sign * mean * search.beam, error * search.beam


def _alignment(years, misaligned):
    """Return the covariance of a speed by errors of the alignment, on both axes."""
    off = years - years.mean()
    response = off / (off @ off)
    return np.diag(response**2 @ misaligned**2)


def _standing(features, flow, streams, inside, shift):
    """
    Return the stream of the features that stand still, if there are any.

    Each of them may, but if their mean moves by more than its error, all features or
    the core, the reference, do: images do not tell which.
    """
    n = len(features.tracks)
    if n == 0:
        return []
    moved, use = features.moved, np.ones(n, bool) if inside is None else inside
    members, rows = [], []
    taken = np.concatenate([[], *(s.members for s in streams)]).astype(int)
    moving = [s.velocity for s in streams if s.kind == "moving"]
    for k in np.setdiff1d(np.flatnonzero(use), taken):
        motion, track = features.motions[k], features.tracks[k]
        still = motion.speed < SIGNIFICANT * motion.speed_err and moved[k] < STANDING
        if not still or len(track) < STANDING_EPOCHS or features.p_false[k] > 0.5:
            continue
        local = np.asarray(flow.frame.matrix(*motion.place))
        velocity = local @ motion.velocity
        off = [np.hypot(*(velocity - one)) for one in moving]
        # What may as well move with a stream does not show that it stands.
        with_it = min(off, default=np.inf) < AS_WELL * motion.speed_err
        if np.isfinite(local).all() and not with_it:
            members.append(k)
            rows.append((*velocity, motion.speed_err, len(track)))
    if not members:
        return []
    first, second, error, weight = np.array(rows, float).T
    share = weight / weight.sum()
    velocity = np.array([share @ first, share @ second])
    scatter = share @ ((first - velocity[0]) ** 2 + (second - velocity[1]) ** 2) / 2
    variance = (share**2).sum() * max(scatter, share @ error**2)
    speeds, covariance = np.hypot(first, second), np.eye(2) * variance + shift
    errors = np.sqrt(velocity @ np.linalg.solve(covariance, velocity))
    kind, reason = "stationary", ""
    if len(members) > 1 and errors > TOGETHER:
        kind = "not confirmed"
        reason = (
            "its features, none of which moves significantly, move together by "
            f"{errors:.1f} standard errors: they do, or the reference, the core, does"
        )
    return [
        MeasuredStream(
            kind=kind, reason=reason, velocity=velocity,
            covariance=covariance, alignment=shift,
            source="features", members=np.array(members),
            features=(float(np.hypot(*velocity)), float(np.sqrt(variance))),
            slowest=speeds.min(), fastest=speeds.max(),
        )
    ]  # fmt: skip
