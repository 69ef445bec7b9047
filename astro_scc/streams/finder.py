# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""From the velocity spectrum and the features to streams on the sky."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from astro_scc.epochs.align import alignment_errors
from astro_scc.intervals import median_interval
from astro_scc.settings import MeasurementSettings
from astro_scc.spectrum.diagram import Diagram
from astro_scc.spectrum.equations import RATIO, deconvolve, harmonic_mean
from astro_scc.spectrum.gaussians import (
    GAIN,
    StreamFit,
    two_are_better,
    two_streams,
)
from astro_scc.spectrum.permutations import MotionTest
from astro_scc.spectrum.rays import VelocityMap, transverse_speed, velocity_map
from astro_scc.streams.decomposed import (
    DecomposedFlow,
    find_motion,
    fit_along_lines,
    is_behind,
    sheet_of,
)
from astro_scc.streams.members import (
    FEWEST,
    LEAST_SIDE,
    MOST_PASSED,
    UNKNOWN,
    MeasuredStream,
    chance_of_separation,
    divided,
    mean_across,
    mean_speed,
    moving_with,
    speaks_for,
    turn_to_flow,
    unknown_scatter,
    with_standing,
    without_passed,
    without_unlike,
)

#: With secure features that move, this p_global is enough, where images of
#: neighbouring dates share such a part of their variance: nine of ten scrambled movies
#: of ``benchmarks/resolved.py`` (seeds 33000 to 33089), in which features are found by
#: chance, share less, and survey sources that need this p_global 0.22 to 0.77.
WITH_FEATURES, ALIKE = 0.1, 0.2
#: Error of the speed of a spectrum beyond that of its patterns, relative to it, where
#: its Gaussian has at least the other one.
MODEL_ERROR, WELL_KNOWN = 0.25, 0.1
#: A mean over the spectrum is that of speeds within such a factor of the clearest one:
#: in the jets of a survey, restored and CLEANed, it errs least for 4 to 6.
AROUND = 5.0
#: Fewest epochs: the innovations of fewer have too few orders.
FEWEST_EPOCHS = 6
#: Features that are slower than the spectrum by so many errors are of several streams,
#: and their mean is between them: of 360 single or double streams of
#: ``benchmarks/calibration`` (seeds 7100 on) none is above 3.8, and eight of twelve of
#: ``benchmarks/resolved.py`` at 5 days (seeds 37000 on), where it is wrong, above 3.7.
BETWEEN = 4.0
#: Smallest speed of a stream in errors, and of what the test may take for motion:
#: features that diffuse and, where no secure feature moves, other patterns at a beam in
#: an interval, and static sources at p_global above such a fraction of alpha.  Static
#: jets with errors of alignment or fluxes with memory are below alpha in 2%.
REST_ERRORS, DOUBTFUL_ERRORS, ALONE = 1.0, 3.0, 0.2
#: A speed of the spectrum needs images that resemble one another: at least such a part
#: of their variance has no memory, and less than such a share moves.
WHITE, LEAST_MOVING = 0.7, 0.15
UNLIKE = (
    "but for what stands still, images of neighbouring dates have little in common, so "
    "that patterns may be mistaken for one another: this needs shorter intervals, or "
    "less noise"
)
#: Two streams are one broad one if as many features of one would be as separate more
#: often than so, unless the speeds differ by such a factor; if not, two need explain
#: less.  Else each has at least so many clusters: in 150 jets of ``lognormal-8`` in
#: ``benchmarks/calibration`` (seeds 6000 on) 10 of 14 second streams had fewer, single
#: features, and none of 29 of ``two-fluid-sparse-region``.
BY_CHANCE, BROAD, LEAST_GAIN, CLUSTERS = 0.05, 6.0, 0.03, 2.5


@dataclass(frozen=True, eq=False, repr=False)
class StreamSearch:
    """
    The streams of a flow, with the spectrum and the test that they follow from.

    Attributes
    ----------
    flow : ``DecomposedFlow``
        Along one direction.
    features : `~astro_scc.features.Features`
        Those that may be seen by chance have ``doubts``.
    test : ``MotionTest``
        Along this direction; its ``p_global`` is that of all that were tested.
    diagram : ``Diagram``
        Along this direction.
    speed, spectrum : `~numpy.ndarray`, shape (n_v,)
        Velocity spectrum: speeds in mas/yr, and the share of the variance that moves
        with each.
    fit : ``StreamFit`` or None
    velocities : ``VelocityMap``
        In mas/yr on the axes of the frame.
    streams : tuple of `MeasuredStream`
        The slowest that moves first; then what stands still.
    """

    flow: DecomposedFlow
    features: Any
    test: MotionTest
    diagram: Diagram
    speed: np.ndarray
    spectrum: np.ndarray
    fit: StreamFit | None = None
    velocities: VelocityMap | None = None
    streams: tuple[MeasuredStream, ...] = ()

    @property
    def beam(self) -> float:
        """The unit of length, in mas."""
        return self.flow.beam

    @property
    def angle(self) -> float:
        """Direction of the spectrum from the first axis of the frame, in radians."""
        return self.flow.angle

    @property
    def pair(self) -> list[tuple[float, float]] | None:
        """Mean and dispersion of both of two streams, in beams/yr, or None."""
        if self.fit is None or len(self.fit.mean) < 2:
            return None
        return list(zip(self.fit.mean, self.fit.sd, strict=True))

    @property
    def sign(self) -> float:
        """Sign of the speed at which motion is clearest."""
        return float(np.sign(self.test.clearest))

    @property
    def slowest(self) -> float:
        """The slowest speed that was searched, in mas/yr."""
        return self.beam * np.abs(self.test.speed).min()

    @property
    def fastest(self) -> float:
        """The fastest speed that was searched, in mas/yr."""
        return self.beam * np.abs(self.test.speed).max()

    def tested(self, speed: float) -> bool:
        """Return whether the test searched a speed in mas/yr, or its neighbour."""
        return bool(self.slowest / RATIO <= abs(speed) <= self.fastest * RATIO)

    @property
    def unambiguous(self) -> float:
        """The largest speed that the dates do not alias, in mas/yr."""
        return self.beam / median_interval(self.flow.years)


def find_streams(
    flow: DecomposedFlow, features: Any, settings: MeasurementSettings, *,
    n_trials: int, whole: bool = True, inside: np.ndarray | None = None,
    rng: np.random.Generator,
) -> StreamSearch:  # fmt: skip
    """
    Find the streams of a flow.

    Parameters
    ----------
    flow : ``DecomposedFlow``
    features : `~astro_scc.features.Features`
    settings : `~astro_scc.settings.MeasurementSettings`
        Its ``alpha``, ``outward`` and ``alignment_error`` count.
    n_trials : int
    whole : bool, optional
        Whether a single stream has the error of few patterns, and the harmonic mean of
        the spectrum where its Gaussian is not well known; parts of a flow have the
        speeds of Gaussians, whose covariance is known, unless their errors are larger.
    inside : `~numpy.ndarray` of bool, shape (n_features,), optional
        The features of a part of the flow.
    rng : `~numpy.random.Generator`

    Returns
    -------
    `StreamSearch`
    """
    map_rng, alpha = rng.spawn(1)[0], settings.alpha
    shift = _of_alignment(flow, alignment_errors(flow.cube, settings.alignment_error))
    flow, test = find_motion(flow, n_trials, rng, outward=settings.outward)
    (sheet, aside), sign = sheet_of(flow, 3), np.sign(test.clearest)
    alike, significant = is_alike(test, flow.years), test.p_global <= alpha
    if whole and not alike and not significant:
        features = without_unlike(features)
    moving, opposed, diffusing = moving_with(flow, features, inside, sign)
    enough = WITH_FEATURES if alike and speaks_for(moving, features) else alpha
    passes, p = test.p_global <= enough, 1.0
    part = fit_along_lines(
        flow, straight=not passes, sign=sign, diagram=sheet[len(sheet) // 2]
    )
    flow, equations = part.flow, part.equations
    if flow.grids[0].bends:
        moving, *_ = moving_with(flow, features, inside, sign)
    if part.fit is not None and passes and not diffusing:
        part, p = _one_or_two(part, test, moving, n_trials, alpha, map_rng)
    search = StreamSearch(
        flow, features, test, part.diagram, equations.speed * flow.beam,
        deconvolve(equations), _fit_with_errors(part),
    )  # fmt: skip
    rows = _of_spectrum(search, equations, whole)
    if whole and significant and part.fit is not None:
        search = replace(search, features=without_passed(features, flow, rows))
        moving, opposed, diffusing = moving_with(flow, search.features, inside, sign)
    streams = _streams(search, rows, moving, (sheet, aside), shift, p_distinct=p)
    if passes:
        doubts = {"diffusing": diffusing, "sure": ALONE * alpha if whole else 1.0}
        streams = [_on_its_side(s, search, moving) for s in streams]
        streams = [_judged(s, search, opposed, **doubts) for s in streams]
    else:
        streams = [_as_tested(s, search) for s in streams]
    streams = with_standing(search, streams, inside, shift)
    return _with_map(search, streams, sheet, aside, map_rng)


def _fit_with_errors(part):
    """Return the fit with the errors of its means, and their numbers of clusters."""
    if part.fit is None:
        return None
    mean_err, number, *_ = part.errors()
    return replace(part.fit, mean_err=mean_err, number=number)


def is_alike(test, years):
    """Return whether images of neighbouring dates share enough of their variance."""
    if not test.memory > 0:
        return False
    return (1 - test.white) * np.exp(-median_interval(years) / test.memory) >= ALIKE


def _with_map(search, streams, sheet, aside, rng):
    """Return a search with its streams, and a map to three times the fastest."""
    moving = [np.hypot(*s.velocity) for s in streams if s.kind == "moving"]
    fastest = min(3 * max(moving, default=np.inf), search.fastest) / search.beam
    aside = aside * (np.arange(len(sheet)) - len(sheet) // 2)
    velocities = velocity_map(
        sheet, aside, fastest, angle=search.angle, beam=search.beam, rng=rng
    )
    return replace(search, streams=tuple(streams), velocities=velocities)


def _one_or_two(part, test, moving, n_trials, alpha, rng):
    """Return a fit of one stream, or of two if they are, and the p-value of one."""
    least, first = 1 / np.ptp(part.flow.years), test.clearest
    second, p_distinct = test.beside(first, least / 2)
    speed, chance = np.abs(moving.along) / part.flow.beam, 1.0
    if len(speed) >= FEWEST:
        chance = chance_of_separation(speed, n_trials, rng)
    if p_distinct > alpha:
        # A second test where the first does not reject.
        p_distinct = min(p_distinct, 2 * chance)
    if p_distinct <= alpha:
        two = two_streams(part.equations, part.fit, least, (first, second))
        if _are_two(part, two, speed, chance):
            part = replace(part, fit=two)
    return part, p_distinct


def _are_two(part, two, speed, chance):
    """Return whether spectrum and features show two streams rather than a broad one."""
    slow, fast = np.abs(two.mean)
    sides = np.bincount(speed < np.sqrt(slow * fast), minlength=2)
    known = len(speed) >= FEWEST and sides.min() >= LEAST_SIDE * len(speed)
    if known and chance > BY_CHANCE and fast < BROAD * slow:
        return False
    gain = LEAST_GAIN if known and chance <= BY_CHANCE else GAIN
    better = two_are_better(part.equations, part.fit, two, gain)
    if not better or chance <= BY_CHANCE:
        return better
    _, number, *_ = replace(part, fit=two).errors()
    return bool(number.min() >= CLUSTERS)


def _streams(search, rows, moving, sheet, shift, *, p_distinct):
    """Return the streams that move, or the strongest speed, none of them judged yet."""
    groups = [moving] if len(rows) == 1 else divided(moving, [abs(r[0]) for r in rows])
    # Of two streams the spectrum knows which is which.
    covered = len(rows) == 1 and speaks_for(moving, search.features)
    found = [
        _stream(search, row, members, sheet, shift, covered=covered)
        for row, members in zip(rows, groups, strict=True)
    ]
    first, *second = found
    return [first, *(replace(one, p_distinct=p_distinct) for one in second)]


def _stream(search, row, members, sheet, shift, *, covered):
    """Return a stream of the spectrum, with the velocity of its features if covered."""
    beam, turn, sign, test = (
        search.beam, turn_to_flow(search.angle), search.sign, search.test
    )  # fmt: skip
    speed, error, spread, spread_err, share = row
    across, across_err = transverse_speed(*sheet, speed / beam)
    # Of a flow that is not resolved across, the direction is that of the grid.
    across_err = across_err if np.isfinite(across_err) else error / beam
    velocity = np.array([speed, across * beam])
    variance = np.array([error, across_err * beam]) ** 2
    source, features, (slowest, fastest) = "spectrum", UNKNOWN, UNKNOWN
    if len(members):
        mean, mean_err, *scatter = mean_speed(
            sign * members.along, members.along_err, members.weight
        )
        features = mean, mean_err
        behind = (abs(speed) - mean) / np.hypot(error, mean_err)
        covered &= not _are_passed(search, members, speed, behind)
        lengths = np.hypot(members.along, members.across)
        slowest, fastest = lengths.min(), lengths.max()
        side = mean_across(members, mean)
        if search.pair and side[1] ** 2 < variance[1]:
            # The other stream may lie beside the ray of this one.
            velocity[1], variance[1] = side[0], side[1] ** 2
        if covered or not np.isfinite(error):
            source = "features"
            velocity = np.array([sign * mean, side[0]])
            variance = np.array([mean_err, side[1]]) ** 2
            if len(members) > 2:
                spread, spread_err = scatter
    if search.flow.grids[0].bends:
        # The speed along the lines is the length of the velocity.
        velocity *= abs(velocity[0]) / np.hypot(*velocity)
    v = int(np.abs(test.speed - velocity[0] / beam).argmin())
    return MeasuredStream(
        kind="not significant", reason="", velocity=turn.T @ velocity,
        covariance=turn.T @ np.diag(variance) @ turn + shift, alignment=shift,
        source=source, share=share, dispersion=spread, dispersion_err=spread_err,
        p_local=float(test.p_local[test.best[0], v]), p_global=test.p_global,
        p_distinct=test.p_global, spectrum=(abs(speed), error), features=features,
        members=members.number, slowest=slowest, fastest=fastest,
        angle=search.angle + (0.0 if sign > 0 else np.pi),
    )  # fmt: skip


def _are_passed(search, members, speed, behind):
    """Return whether the flow passes the features of a stream, by so many errors."""
    # Where a flow moves by more than a beam between images, slow features are often
    # parts of several, unless they are many.
    few = members.weight.sum() <= MOST_PASSED * len(search.features.detections)
    lost = few and behind > 1 and abs(speed) > search.unambiguous
    return lost or behind > BETWEEN


def _on_its_side(stream, search, moving):
    """Return a stream with the direction of its own side of a core."""
    members = moving[np.isin(moving.number, stream.members)]
    # Where both sides move so, the direction is that of the jet.
    behind = members.weight @ members.side < -members.weight.sum() / 2
    if not len(members):
        speed = search.sign * stream.spectrum[0] / search.beam
        behind = is_behind(search.flow, speed)
    if not behind:
        return stream
    turned = {"velocity": -stream.velocity, "angle": stream.angle + np.pi}
    return replace(stream, counter=True, **turned)


def _of_spectrum(search, equations, whole):
    """Return speed and dispersion with errors, in mas/yr, and share of each stream."""
    fit, beam = search.fit, search.beam
    if fit is None:
        return [(search.test.clearest * beam, *[np.nan] * 4)]
    speed, error, spread = fit.mean * beam, fit.mean_err * beam, fit.sd * beam
    largest = WELL_KNOWN if whole else 1.0
    if len(speed) == 1 and not error[0] < largest * abs(speed[0]):
        speed, error = np.reshape(_harmonic(search, equations), (2, 1))
    elif len(speed) == 1 and whole:
        # Few patterns are a small sample of the speeds of one stream.
        error = np.hypot(error, unknown_scatter(speed, fit.number))
    spread_err = spread / np.sqrt(2 * np.maximum(fit.number, 1))
    return list(zip(speed, error, spread, spread_err, fit.share, strict=True))


def _judged(stream, search, opposed="", *, diffusing, sure=1.0):
    """
    Return a stream that the test finds with its kind, and the reason.

    Without secure features, a speed is doubtful if ``p_global`` is above ``sure``.
    """
    turn, test = turn_to_flow(search.angle), search.test
    speed, alone = abs((turn @ stream.velocity)[0]), not len(stream.members)
    weak, fast = test.p_global > sure, speed > search.unambiguous
    by_spectrum = stream.source == "spectrum"
    # Of images without a memory all variance is white.
    white = test.white if test.memory else 1.0
    unlike = white >= WHITE and test.amplitude[test.best] < LEAST_MOVING
    kind, reason = verdict(
        speed, np.sqrt((turn @ stream.covariance @ turn.T)[0, 0]),
        doubtful=diffusing or (alone and (weak or fast)), unlike=by_spectrum and unlike,
    )  # fmt: skip
    if alone and weak and kind != "moving" and reason != UNLIKE:
        reason += f"; without secure features this needs p_global of at most {sure:g}"
        if test.p_smallest > sure:
            reason += ", which so few epochs or trials cannot reach"
    # The spectrum reaches beyond what the test searches, features have their own test.
    if by_spectrum and not search.tested(speed):
        than = "faster" if speed > search.fastest else "slower"
        kind, reason = "not confirmed", f"it is {than} than what was searched"
    if opposed:
        kind, reason = "not confirmed", opposed
    return replace(stream, kind=kind, reason=reason)


def _as_tested(stream, search):
    """Return a stream that the test does not find, with a speed that it searched."""
    turn, test = turn_to_flow(search.angle), search.test
    speed = abs((turn @ stream.velocity)[0])
    if stream.source != "spectrum" or search.tested(speed):
        return stream
    # What the spectrum has beyond it is not lost: ``spectrum`` keeps it.
    along = np.array([test.clearest * search.beam, 0.0])
    return replace(
        stream, velocity=turn.T @ along, covariance=np.full((2, 2), np.nan),
        share=np.nan, dispersion=np.nan, dispersion_err=np.nan,
        p_local=float(test.p_local[test.best]),
    )  # fmt: skip


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


def _harmonic(search, equations):
    """Return the mean speed of the spectrum of one stream and its error, in mas/yr."""
    clearest, fit = search.test.clearest, search.fit
    mean, width = harmonic_mean(equations.speed, search.spectrum, clearest, AROUND)
    if np.isnan(mean):
        speed = fit.mean[0] * search.beam
        return speed, MODEL_ERROR * abs(speed)
    number = max(fit.number[0], 1)
    error = np.hypot(width / np.sqrt(number), MODEL_ERROR * mean)
    return search.sign * mean * search.beam, error * search.beam


def _of_alignment(flow, errors):
    """Return the covariance of a speed by errors of the alignment, on both axes."""
    off = flow.years - flow.years.mean()
    response = off / (off @ off)
    return np.diag(response**2 @ errors**2)
