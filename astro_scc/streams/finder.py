# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""From the velocity spectrum and the features to streams on the sky."""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from astro_scc.features.diffusion import measure_diffusion
from astro_scc.features.motion import SIGNIFICANT
from astro_scc.features.trust import LEAST_EPOCHS
from astro_scc.spectrum.diagram import Diagram, correlate_aside
from astro_scc.spectrum.equations import deconvolve, set_up
from astro_scc.spectrum.errors import SpeedErrors, fit_errors
from astro_scc.spectrum.gaussians import (
    GAIN,
    StreamFit,
    one_stream,
    two_are_better,
    two_streams,
)
from astro_scc.spectrum.maps import VelocityMap, velocity_map
from astro_scc.spectrum.permutations import (
    EVERY,
    INWARD,
    MotionTest,
    permutation_test,
)
from astro_scc.streams.decomposed import DecomposedFlow
from astro_scc.streams.spread import chance_of_separation, mean_speed, separation
from astro_scc.streams.transverse import transverse_speed

#: With a secure feature that moves, this p_global is enough.
WITH_FEATURES = 0.1
#: A single stream with a smaller relative error has the speed of its Gaussian, others
#: the harmonic mean of the spectrum.
WELL_KNOWN = 0.1
#: Error of the speed of a spectrum beyond that of its patterns, relative to it.
MODEL_ERROR = 0.25
#: Fewest epochs: the innovations of fewer have too few orders.
FEWEST_EPOCHS = 6
#: Smallest speed of a stream in errors, and of what the test may take for motion:
#: features that diffuse, and other patterns where they move a beam in an interval.
REST_ERRORS, DOUBTFUL_ERRORS = 1.0, 2.0
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
#: Two streams are one broad one if as many features are less separate, unless the
#: speeds differ by such a factor; if they are more separate, two need explain less.
#: Features tell if such a share of them is on either side of the middle.
FEWEST, SEPARATE, BROAD, LEAST_GAIN, LEAST_SIDE = 5, 0.9, 6.0, 0.03, 0.2
#: Features speak for a flow if they are this share of all detections.
COVERAGE = 0.1
#: Largest motion of a standing feature, in beams, and its fewest epochs.
STANDING, STANDING_EPOCHS = 0.5, 5


@dataclass(frozen=True, eq=False)
class Stream:
    """
    A stream: a velocity of the flow.

    Attributes
    ----------
    kind : {"moving", "not confirmed", "stationary", "not significant"}
    reason : str
        Why it is not moving, or what it rests on, or ''.
    velocity : `~numpy.ndarray`, shape (2,)
        On the axes of the frame, in mas/yr.
    covariance, alignment : `~numpy.ndarray`, shape (2, 2)
        Of the velocity; the second is the part by errors of the alignment.
    source : {"features", "spectrum", ""}
        What the speed is measured from.
    share : float
        Share of the variance that moves.
    dispersion, dispersion_err : float
        In mas/yr.
    p_local, p_global, p_distinct : float
    spectrum, features : (float, float)
        Speed with its error from the velocity spectrum, and from the features.
    members : `~numpy.ndarray` of int
        Its features.
    slowest, fastest : float
        Speeds of its slowest and fastest feature.
    angle : float
        Direction from the first axis of the frame, in radians.
    """

    kind: str
    reason: str
    velocity: np.ndarray
    covariance: np.ndarray
    alignment: np.ndarray
    source: str = ""
    share: float = np.nan
    dispersion: float = np.nan
    dispersion_err: float = np.nan
    p_local: float = np.nan
    p_global: float = np.nan
    p_distinct: float = np.nan
    spectrum: tuple[float, float] = (np.nan, np.nan)
    features: tuple[float, float] = (np.nan, np.nan)
    members: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    slowest: float = np.nan
    fastest: float = np.nan
    angle: float = 0.0


@dataclass(frozen=True, eq=False, repr=False)
class StreamSearch:
    """
    The streams of a flow, with the spectrum and the test that they follow from.

    Attributes
    ----------
    streams : tuple of `Stream`
        The slowest that moves first; then what stands still.
    flow : ``DecomposedFlow``
        Along one direction.
    test : ``MotionTest``
        Along this direction; its ``p_global`` is that of all that were tested.
    angle : float
        Direction of the spectrum from the first axis of the frame, in radians.
    diagram : ``Diagram``
        Along this direction.
    speed, spectrum : `~numpy.ndarray`, shape (n_v,)
        Velocity spectrum: speeds in mas/yr, and the share of the variance that moves
        with each.
    velocities : ``VelocityMap``
        In mas/yr on the axes of the frame.
    fit : ``StreamFit`` or None
    errors : ``SpeedErrors`` or None
    beam : float
        In mas.
    slowest, fastest, unambiguous : float
        Speeds that were searched, and the largest one that the dates do not alias, in
        mas/yr.
    intervals : (float, float)
        Shortest and longest interval that is used, in years.
    """

    streams: tuple[Stream, ...]
    flow: DecomposedFlow
    test: MotionTest
    angle: float
    diagram: Diagram
    speed: np.ndarray
    spectrum: np.ndarray
    velocities: VelocityMap
    fit: StreamFit | None
    errors: SpeedErrors | None
    beam: float
    slowest: float
    fastest: float
    unambiguous: float
    intervals: tuple[float, float]


@dataclass(frozen=True, eq=False)
class MovingFeatures:
    """Secure features that move, along a direction: speeds, errors, epochs, numbers."""

    along: np.ndarray
    along_err: np.ndarray
    across: np.ndarray
    across_err: np.ndarray
    weight: np.ndarray
    number: np.ndarray

    def select(self, use):
        """Return some of the features."""
        return MovingFeatures(*(v[use] for v in vars(self).values()))


def moving_features(features, frame, angle, use=None, walk=None):
    """
    Return the secure features that move, with speeds in mas/yr.

    If they diffuse, ``walk`` is the variance of their speeds times years, and all that
    are followed count: a random walk cannot be told from motion by one of them.
    """
    chosen = features.secure if walk is None else np.ones(len(features.tracks), bool)
    chosen = np.flatnonzero(chosen if use is None else chosen & use)
    turn, rows = _turn(angle), []
    for k in chosen:
        motion = features.motions[k]
        n = len(features.tracks[k].detection)
        slow = motion.speed < SIGNIFICANT * motion.speed_err
        if n < LEAST_EPOCHS or (slow and walk is None):
            continue
        local = turn @ np.asarray(frame.matrix(*motion.place))
        if not np.isfinite(local).all():
            continue
        along, across = local @ motion.velocity
        errors = np.hypot(*(local * motion.velocity_err).T)
        if walk is not None:
            errors = np.hypot(errors, np.sqrt(walk / motion.span))
        elif abs(along) < max(SIGNIFICANT * errors[0], abs(across)):
            continue
        rows.append((along, errors[0], across, errors[1], n, k))
    columns = np.array(rows, dtype=float).reshape(-1, 6).T
    return MovingFeatures(*columns[:5], columns[5].astype(int))


def find_streams(
    flow: DecomposedFlow, features: Any, *, misaligned: np.ndarray,
    alpha: float = 0.01, n_trials: int = 1000, outward: bool = False,
    inside: np.ndarray | None = None, intervals: tuple[float, float] = EVERY,
    root: bool = True, rng: np.random.Generator,
) -> StreamSearch:  # fmt: skip
    """
    Find the streams of a flow.

    Parameters
    ----------
    flow : ``DecomposedFlow``
    features : `~astro_scc.features.Features`
    misaligned : `~numpy.ndarray`, shape (n_epochs, 2)
        Standard error of the alignment of each epoch, in mas.
    alpha : float, optional
        Largest ``p_global`` of a stream that moves.
    n_trials : int, optional
    outward : bool, optional
        Search only speeds away from the core.
    inside : `~numpy.ndarray` of bool, shape (n_features,), optional
        The features of a part of the flow.
    intervals : (float, float), optional
        Shortest and longest interval that is used, in years.
    root : bool, optional
        Fit the streams to the square root of the planes, see
        `FlowPlanes.square_root`; not where scales are compared.
    rng : `~numpy.random.Generator`

    Returns
    -------
    `StreamSearch`
    """
    diagrams = [flow.diagram(k) for k in range(len(flow.planes))]
    map_rng = rng.spawn(1)[0]
    prefer = flow.directed and flow.outward
    inward = 0.0 if outward and flow.directed else (INWARD if prefer else 1.0)
    test = permutation_test(
        diagrams,
        fastest=flow.fastest,
        intervals=intervals,
        n_trials=n_trials,
        inward=inward,
        rng=rng,
    )
    found = test
    if len(flow.planes) > 1:
        # Along the direction of the largest z, outward.
        direction, best = test.best
        flow = _turned(flow, direction, test.speed[best])
        found = permutation_test(
            [flow.diagram(0)], fastest=flow.fastest, intervals=intervals,
            n_trials=n_trials, inward=0.0, rng=rng,
        )  # fmt: skip
        of_all = {k: getattr(test, k) for k in ("p_global", "p_smallest", "level")}
        found = replace(found, **of_all)
    test, best = found, found.best[1]
    grid, years = flow.grids[0], flow.years
    planes = flow.planes[0].square_root() if root else flow.planes[0]
    region, beam = flow.regions[0], flow.beam
    sheet, aside = _sheet(planes, region, 3)
    diagram = sheet[len(sheet) // 2]
    equations = set_up(diagram, fastest=flow.fastest, intervals=intervals)
    least = 1 / np.ptp(years)
    sign = np.sign(test.speed[best])
    angle = _angle_of(flow.frame, grid)
    diffusion = measure_diffusion(features)
    walk = diffusion.variance if diffusion.is_walk else None
    moving = moving_features(features, flow.frame, angle, inside, walk)
    if walk is None:
        moving = moving.select(moving.along * sign > 0)
    one = one_stream(equations, least, sign)
    gaps = np.diff(years)
    search = {
        "flow": flow, "test": test, "angle": angle, "diagram": diagram,
        "speed": equations.speed * beam, "spectrum": deconvolve(equations),
        "beam": beam,
        "slowest": beam * np.abs(test.speed).min(),
        "fastest": beam * np.abs(test.speed).max(),
        "unambiguous": beam / np.median(gaps[gaps > 0]), "intervals": intervals,
    }  # fmt: skip
    fit, p_distinct = one, 1.0
    covered = moving.weight.sum() >= COVERAGE * len(features.detections)
    with_features = len(moving.along) > 0 and covered
    passes = test.p_global <= (WITH_FEATURES if with_features else alpha)
    if passes and one is not None:
        second, p_distinct = test.beside(test.speed[best], least / 2)
        if p_distinct > alpha and walk is None and len(moving.along) >= FEWEST:
            # A second test where the first does not reject.
            chance = chance_of_separation(np.abs(moving.along), n_trials, map_rng)
            p_distinct = min(p_distinct, 2 * chance)
        two = None
        if p_distinct <= alpha and walk is None:
            two = two_streams(equations, one, least, (test.speed[best], second))
        if two is not None and _are_two(equations, one, two, moving, beam):
            fit = two
    errors = None
    if fit is not None:
        errors = fit_errors(planes, diagram, equations, fit, region=region)
    across = partial(transverse_speed, sheet, aside)
    streams = _streams(
        flow, test, equations, fit, errors, moving, covered, across, angle, sign,
        passes, p_distinct, misaligned, search["unambiguous"], walk is not None,
    )  # fmt: skip
    streams += _standing(features, flow, streams, inside)
    fastest = max([np.hypot(*s.velocity) for s in streams if s.kind == "moving"] or [0])
    top = min(3 * fastest or np.inf, search["fastest"])
    places = aside * (np.arange(len(sheet)) - len(sheet) // 2)
    velocities = velocity_map(
        sheet, places, top / beam, angle=angle, beam=beam, rng=map_rng
    )
    return StreamSearch(
        streams=tuple(streams), velocities=velocities, fit=fit, errors=errors, **search
    )


def _are_two(equations, one, two, moving, beam):
    """Return whether spectrum and features show two streams rather than a broad one."""
    slow, fast = np.abs(two.mean) * beam
    speed, middle = np.abs(moving.along), np.sqrt(slow * fast)
    side = min((speed > middle).mean(), (speed < middle).mean()) if len(speed) else 0
    known = len(speed) >= FEWEST and side >= LEAST_SIDE
    apart = separation(speed) if known else np.nan
    if known and apart < SEPARATE and fast < BROAD * slow:
        return False
    gain = LEAST_GAIN if known and apart >= SEPARATE else GAIN
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
        planes = found.planes[0].square_root()
        sheet, aside = _sheet(planes, found.regions[0], 1)
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


def _angle_of(frame, grid):
    """Return the direction of a grid from the first axis of the frame, in radians."""
    if not frame.uniform or not np.isfinite(grid.angle):
        return 0.0
    first, second = np.asarray(frame.matrix(0.0, 0.0)) @ grid.axes[0]
    return float(np.arctan2(second, first))


def _streams(
    flow, test, equations, fit, errors, moving, covered, across_of, angle, sign,
    passes, p_distinct, misaligned, unambiguous, diffusing,
):  # fmt: skip
    """Return the streams that move, or the strongest speed, not significant."""
    direction, best = test.best
    beam, turn = flow.beam, _turn(angle)
    number = 1 if fit is None else len(fit.mean)
    groups = [moving] if number == 1 else _divided(moving, np.abs(fit.mean) * beam)
    found = []
    for k in range(number):
        own = groups[k]
        if fit is None:
            speed, error, share = test.speed[best] * beam, np.nan, np.nan
            dispersion = dispersion_err = np.nan
        else:
            speed, error = fit.mean[k] * beam, errors.mean[k] * beam
            dispersion, share = fit.sd[k] * beam, fit.share[k]
            dispersion_err = dispersion / np.sqrt(2 * max(errors.number[k], 1))
            if number == 1 and not error < WELL_KNOWN * abs(speed):
                speed, error = _harmonic(equations, errors.number[0], sign, speed, beam)
        across, across_err = across_of(speed / beam)
        if not np.isfinite(across_err):
            # A flow that is not resolved across: the direction is that of the grid.
            across_err = error / beam
        velocity = np.array([speed, across * beam])
        covariance = np.diag([error**2, (across_err * beam) ** 2])
        source, of_features = "spectrum", (np.nan, np.nan)
        slowest = fastest = np.nan
        if len(own.along):
            mean = mean_speed(sign * own.along, own.along_err, own.weight)
            of_features = mean.mean, mean.error
            slowest, fastest = (sign * own.along).min(), (sign * own.along).max()
            # Of two streams the spectrum knows which is which.
            if (covered and number == 1) or not np.isfinite(error):
                source = "features"
                side = mean_across(own, mean)
                velocity = np.array([sign * mean.mean, side[0]])
                covariance = np.diag([mean.error**2, side[1] ** 2])
                if len(own.along) > 2:
                    dispersion, dispersion_err = mean.dispersion, mean.dispersion_err
        alignment = _alignment(flow.years, misaligned)
        total = turn.T @ covariance @ turn + alignment
        kind, reason = "not significant", ""
        if passes:
            fast = not len(own.along) and abs(velocity[0]) > unambiguous
            kind, reason = verdict(
                abs(velocity[0]),
                np.sqrt((turn @ total @ turn.T)[0, 0]),
                doubtful=diffusing or fast,
                unlike=source == "spectrum" and _unlike(test),
            )
        v = int(np.abs(test.speed - velocity[0] / beam).argmin())
        found.append(
            Stream(
                kind=kind,
                reason=reason,
                velocity=turn.T @ velocity,
                covariance=total,
                alignment=alignment,
                source=source,
                share=share,
                dispersion=dispersion,
                dispersion_err=dispersion_err,
                p_local=float(test.p_local[direction, v]),
                p_global=test.p_global,
                p_distinct=test.p_global if k == 0 else p_distinct,
                spectrum=(abs(speed), error),
                features=of_features,
                members=own.number,
                slowest=slowest,
                fastest=fastest,
                angle=angle if sign > 0 else angle + np.pi,
            )
        )
    return found


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
    ('not confirmed', 'its speed is within 2 standard errors of rest')
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


def _turn(angle):
    """Return the matrix that turns axes of the frame into those along the flow."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def mean_across(moving, mean):
    """Return the mean speed of features across the flow, and its error."""
    share = moving.weight / moving.weight.sum()
    across = share @ moving.across
    variance = share @ (moving.across - across) ** 2 * (share**2).sum()
    error = np.sqrt(variance + (share**2) @ moving.across_err**2)
    n = len(share)
    # A few features may agree by chance: directions scatter by ten degrees or more.
    prior = (0.15 * mean.mean) ** 2 * 2 / (n + 1) / n
    return across, np.sqrt(error**2 + prior)


def _divided(moving, speeds):
    """Return the features of each of two streams: the nearer one by ratio."""
    limit = np.sqrt(np.prod(speeds))
    slow = np.abs(moving.along) < limit
    return [moving.select(slow), moving.select(~slow)]


def _harmonic(equations, number, sign, speed, beam):
    """
    Return the mean speed of a spectrum and its error, in mas/yr.

    What is the same at v and -v is noise.  The mean is harmonic, as a fast pattern
    covers more of the way in a time.
    """
    v, spectrum = equations.speed, deconvolve(equations)
    half = len(v) // 2
    share = sign * (spectrum[half + 1 :] - spectrum[:half][::-1])
    forward = v[half + 1 :]
    span = equations.interval.max()
    share = np.where(forward >= 1 / span, np.maximum(share, 0), 0)
    if not share.sum() > 0:
        mean = abs(speed)
        return speed, MODEL_ERROR * mean
    share = share / share.sum()
    mean = 1 / (share @ (1 / forward))
    width = mean**2 * np.sqrt(share @ (1 / forward - 1 / mean) ** 2)
    error = np.hypot(width / np.sqrt(max(number, 1)), MODEL_ERROR * mean)
    return sign * mean * beam, error * beam


def _alignment(years, misaligned):
    """Return the covariance of a speed by errors of the alignment, on both axes."""
    off = years - years.mean()
    response = off / (off @ off)
    return np.diag(response**2 @ misaligned**2)


def _standing(features, flow, streams, inside):
    """Return the stream of the features that stand still, if there are any."""
    n = len(features.tracks)
    if n == 0:
        return []
    moved, use = features.moved, np.ones(n, bool) if inside is None else inside
    own, rows = [], []
    taken = np.concatenate([[], *(s.members for s in streams)]).astype(int)
    for k in np.setdiff1d(np.flatnonzero(use), taken):
        motion, track = features.motions[k], features.tracks[k]
        still = motion.speed < SIGNIFICANT * motion.speed_err and moved[k] < STANDING
        if not still or len(track) < STANDING_EPOCHS or features.p_false[k] > 0.5:
            continue
        local = np.asarray(flow.frame.matrix(*motion.place))
        if np.isfinite(local).all():
            own.append(k)
            rows.append((*(local @ motion.velocity), motion.speed_err, len(track)))
    if not own:
        return []
    first, second, error, weight = np.array(rows, float).T
    share = weight / weight.sum()
    velocity = np.array([share @ first, share @ second])
    scatter = share @ ((first - velocity[0]) ** 2 + (second - velocity[1]) ** 2) / 2
    variance = (share**2).sum() * max(scatter, share @ error**2 / 2)
    speeds = np.hypot(first, second)
    return [
        Stream(
            kind="stationary", reason="", velocity=velocity,
            covariance=np.eye(2) * variance, alignment=np.zeros((2, 2)),
            source="features", dispersion=np.nan, members=np.array(own),
            features=(float(np.hypot(*velocity)), float(np.sqrt(variance))),
            slowest=speeds.min(), fastest=speeds.max(),
        )
    ]  # fmt: skip
