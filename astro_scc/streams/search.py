# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
The search for streams, and the significance of their speeds.

What is searched are significant structural patterns (SSPs, `find_ssps`), which the
correlation has matched with the images of other epochs.  The displacement of each match
against the interval between its epochs is the displacement-interval diagram.  A speed
is a straight line through its origin, a ray; its excess is the number of matches along
the ray minus the mean of permuted epochs.  Features are chains of matched SSPs on one
straight line in time, and a stream is a group of features whose speeds scatter about
one mean.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from astro_scc.stacking.velocities import VelocitySamples
from astro_scc.streams import chains, dispersion
from astro_scc.streams.chains import Feature
from astro_scc.streams.diagram import SHORT, Diagram, Rays, SearchSettings
from astro_scc.streams.dispersion import Population, feature_speeds, random_effects
from astro_scc.streams.permutations import EpochPermutations, persistence

#: Smallest significance of the speed of a stream's feature, in standard deviations of
#: the permutations.
LEAST_Z = 1.5
#: Most steps in which the axis is turned to the direction of the features; on simulated
#: jets two are enough.
MAX_TURNS = 4
#: Features that are followed from image to image stand for a flow if they are at least
#: this share of the chains of matches of other emission.
FOLLOWED_SHARE = 1 / 3
#: Largest share of static jets of any kind with a secure feature that moves by
#: ``least_motion`` or more (``benchmarks/features.py simulated``).
P_SECURE = 0.01
#: Fewest epochs of a feature that alone stands for a stream and was not followed from
#: image to image, as of the robust features of surveys (Lister et al. 2021, ApJ 923,
#: 30).
LONE_EPOCHS = 5
#: Smallest distance of a moving speed from rest, in errors: 95% of a normal
#: distribution, one-sided.
REST_ERRORS = 1.645
#: What needs more than so many times the epochs is out of reach.
MOST_EPOCHS = 10


@dataclass(frozen=True, eq=False)
class Stream:
    """
    A stream: features whose speeds scatter about one mean.

    Attributes
    ----------
    kind : {"moving", "not confirmed", "stationary", "not significant"}
        Not confirmed: ``p_global`` is at most alpha, but something holds it back.
    reason : str
        Why it is neither moving nor stationary, or what ``p_global`` rests on, or ''.
    angle : float
        Direction of the axis from the first axis of the frame, in radians.
    along, across : ``Population``
        Mean and dispersion of the speeds of its features, in beams/yr.
    z : float
        Excess along its ray in standard deviations of the permutations.
    p_local, p_global : float
        p-values of the permutation test at exactly this speed, see
        `EpochPermutations`.  Where ``p_global`` is above alpha, the evidence of the
        first stream's secure features is added.
    p_distinct : float
        Probability that one stream fewer gives features that separate as
        well; for the first stream its ``p_global``.
    features : tuple of ``Feature``

    Examples
    --------
    >>> from astro_scc.streams.dispersion import random_effects
    >>> from astro_scc.streams.search import Stream
    >>> still = random_effects([0.01, -0.02], [0.02, 0.02])
    >>> Stream("stationary", "", 0.0, still, still).kind
    'stationary'
    """

    kind: str
    reason: str
    angle: float
    along: Population
    across: Population
    z: float = np.nan
    p_local: float = 1.0
    p_global: float = 1.0
    p_distinct: float = 1.0
    features: tuple[Feature, ...] = field(default=(), repr=False)


@dataclass(frozen=True, eq=False)
class Search:
    """
    The result of a search for streams, with the diagram and the permutations.

    Attributes
    ----------
    streams : tuple of `Stream`
        Streams of features that move, the one with more features first, or else
        the strongest speed, which is not significant; then the features that
        stand still.  Empty without matches.
    diagram : ``Diagram``
        Diagram along the direction of the first stream.
    angle : float
        Angle of that direction from the first axis of the frame, in radians.
    permutations : ``EpochPermutations``

    Examples
    --------
    One feature that moves half a beam a year through eight epochs:

    >>> import numpy as np
    >>> from astro_scc.streams import find_streams
    >>> from astro_scc.stacking.velocities import VelocitySamples
    >>> years = np.arange(8.0)
    >>> ssp, to = (k[~np.eye(8, dtype=bool)] for k in np.indices((8, 8)))
    >>> d = VelocitySamples(
    ...     d1=0.5 * (to - ssp), d2=np.zeros(56), weight=np.ones(56),
    ...     reference=ssp, target=to, ssp=ssp, target_ssp=to,
    ...     position=np.outer(0.5 * years, [1, 0]), epoch=np.arange(8),
    ...     scale=np.ones(8), years=years)
    >>> search = find_streams(lambda angle: d, [0.0], 1.5, n_trials=99,
    ...                       rng=np.random.default_rng(1))
    >>> [(stream.kind, round(stream.along.mean, 2)) for stream in search.streams]
    [('moving', 0.5)]
    >>> search.angle, search.diagram.interval
    (0.0, array([1., 2., 3., 4., 5., 6., 7.]))
    """

    streams: tuple[Stream, ...]
    diagram: Diagram
    angle: float
    permutations: EpochPermutations


def find_streams(
    project: Callable, angles: ArrayLike, radius: float, *,
    alpha: float = 0.05, n_trials: int = 1000, rng: np.random.Generator,
    outward: bool = False, fastest: float = np.inf,
    intervals: tuple[float, float] = (0.0, np.inf),
    settings: SearchSettings | None = None, followed: Callable | None = None,
) -> Search:  # fmt: skip
    """
    Find the streams whose motion permuted epochs do not show.

    The search starts at the speed with the largest excess over the permutations
    along the rays of the displacement-interval diagram.  Single features are
    followed in its direction.  A stream is the mean and the dispersion of their
    speeds, and there are two streams if a parametric bootstrap rejects one.  Each
    stream is tested at its own mean speed against the maximum of each permutation.

    Parameters
    ----------
    project : callable
        Returns the ``VelocitySamples`` along an angle in
        radians from the first axis of the frame.
    angles : sequence of float
        Axes to search, evenly over half a turn from the first axis of the
        frame; one axis if the direction of the flow is known.
    radius : float
        Largest displacement in beams.
    alpha : float, optional
        Largest ``p_global`` of a significant stream.
    n_trials : int, optional
        Number of permutations.
    rng : `~numpy.random.Generator`
    outward : bool, optional
        Search positive speeds only.
    fastest : float, optional
        Largest speed, in beams/yr.
    intervals : tuple of float, optional
        Shortest and longest interval between epochs that is used, in years.
    settings : `~astro_scc.streams.SearchSettings`, optional
    followed : callable, optional
        Returns features along an angle that were followed from image to image, and
        which SSPs are theirs.

    Returns
    -------
    ``Search``

    Raises
    ------
    ValueError
        If the separations of no two epochs lie within ``intervals``.

    Examples
    --------
    Ten features that move half a beam a year through eight epochs:

    >>> import numpy as np
    >>> from astro_scc.streams import find_streams
    >>> from astro_scc.stacking.velocities import VelocitySamples
    >>> years = np.arange(8.0)
    >>> epoch, feature = (k.ravel() for k in np.indices((8, 10)))
    >>> place = 3.0 * feature + 0.5 * years[epoch]
    >>> ssp, to = np.nonzero((feature[:, None] == feature) & (epoch[:, None] != epoch))
    >>> d = VelocitySamples(
    ...     d1=place[to] - place[ssp], d2=np.zeros(len(to)),
    ...     weight=np.ones(len(to)), reference=epoch[ssp], target=epoch[to], ssp=ssp,
    ...     target_ssp=to, position=np.stack([place, 0 * place], axis=1), epoch=epoch,
    ...     scale=np.ones(80), years=years)
    >>> found = find_streams(lambda angle: d, [0.0], 1.5, n_trials=99,
    ...                      rng=np.random.default_rng(1))
    >>> stream = found.streams[0]
    >>> stream.kind, round(stream.along.mean, 2), len(stream.features)
    ('moving', 0.5, 10)
    """
    settings = SearchSettings() if settings is None else settings
    test_rng, model_rng = rng.spawn(2)
    data = [_samples(project(angle), followed, angle) for angle in angles]
    rays = Rays.of(data[0][0].years, radius, settings, fastest, intervals)

    def permuted(axes):
        how = {"outward": outward, "one_way": len(angles) == 1}
        return EpochPermutations.of(axes, rays, n_trials, test_rng, **how)

    # 1. The speed with the largest excess over the permutations, along any ray.
    permutations = permuted(data)
    number, speed = permutations.largest()
    axis = _Axis(angles[number], data[number][0], rays, permutations, number, followed)
    if permutations.p_values(number, speed)[1] > alpha:
        axis, speed = _along_followed(axis, speed, data, angles)
    # 2. The features that move at similar speeds, along their own direction.
    axis, speed, features, taken = _turn_to_features(axis, speed, project, len(angles))
    # 3. A second speed, without the SSPs of these features, and both together.
    rest = axis.samples.without_ssps(taken)
    test = permuted([_samples(rest, followed, axis.angle, features)])
    ratio = test.speed / speed
    away = (ratio > 0) & (np.abs(ratio - 1) > settings.same_speed)
    _, other = test.largest(away)
    if away.any() and test.p_values(0, other)[1] <= alpha:
        features, _ = axis.features([speed, other])
    # 4. Their streams: one, or two where a parametric bootstrap rejects one.
    groups = _feature_groups(axis, features, speed, alpha, n_trials, model_rng)
    streams, tested = [], axis
    for group, p_distinct in groups:
        if streams:
            # The second stream is tested without the features of the first.
            other = streams[0].features
            rest = _without(axis.samples, other)
            test = permuted([_samples(rest, followed, axis.angle, other)])
            tested = replace(axis, samples=rest, permutations=test, number=0)
        # 5. The mean speed of a stream's features, and the permutation test at it.
        mean = _population(group, settings)
        beside = bool(streams) and streams[0].kind == "moving"
        streams.append(_stream(tested, *mean, group, alpha, p_distinct, beside))
    if not streams and permutations.z.any():
        along = Population(float(speed), np.nan, np.nan, np.nan)
        across = Population(0.0, np.nan, np.nan, np.nan)
        streams.append(_stream(axis, along, across, (), alpha))
    # 6. The standing features, without the features that move.
    moving = [f for s in streams if s.kind == "moving" for f in s.features]
    still = chains.standing_features(_without(axis.samples, moving), settings)
    if still:
        mean = _population(still, settings)
        own = "stationary", "", axis.angle, *mean
        streams.append(Stream(*own, features=tuple(still)))
    diagram = Diagram.of(axis.samples, rays)
    return Search(tuple(streams), diagram, float(axis.angle), permutations)


@dataclass(frozen=True, eq=False)
class _Axis:
    """
    One axis: the matches along it, and the permutation test there.

    The test is that of the nearest axis that was searched, its ``number``.
    """

    angle: float
    samples: VelocitySamples
    rays: Rays
    permutations: EpochPermutations
    number: int
    followed: Callable | None = None

    def z(self, speed):
        """Return the significance of speeds."""
        return self.permutations.significance(self.number, speed)

    def p_values(self, features, mean):
        """
        Return the local p-value of a mean speed, and the global one of its features.

        The features' speeds differ, so that few may move at their mean.  As the test
        is against the largest value at any speed, the best one in their range counts.
        """
        local, p_global = self.permutations.p_values(self.number, mean)
        own = np.array([f.speed for f in features])
        error = max((f.error for f in features), default=0.0)
        every = self.permutations.speed
        within = np.abs(every - mean) <= np.abs(own - mean).max(initial=0.0) + error
        speeds = every[within & (every * mean > 0)]
        others = (self.permutations.p_values(self.number, v)[1] for v in speeds)
        return local, min((p_global, *others))

    def features(self, speeds):
        """
        Return the features of streams with some speeds, and which SSPs are theirs.

        Where features move less than a beam between epochs they are followed from
        image to image.  Others are chains of matches, and so are those of a flow in
        which hardly any can be followed.
        """
        samples, settings = self.samples, self.rays.settings
        found, taken = chains.find_chains(samples, speeds, self.rays)
        own = []
        if self.followed is not None:
            own, theirs = self.followed(self.angle)
            if not self.followed.diffuse:
                own = [f for f in own if f.speed * speeds[0] > 0]
            taken = taken | theirs
        if own:
            fast = settings.farthest / (self.rays.short / SHORT)
            found = chains.different([*own, *found], samples, settings)[len(own) :]
            if len(own) >= FOLLOWED_SHARE * len(found):
                found = [f for f in found if abs(f.speed) > fast]
        still = chains.standing_features(samples, settings)
        return own + chains.clear_of(found, still, samples, settings), taken

    def moving(self, features, speed):
        """Return the features in the direction of a speed with ``least_z`` or more."""
        if any(f.followed and f.speed * speed < 0 for f in features):
            # They diffuse, and a mean of some would be biased.
            return [f for f in features if f.followed]
        own, test = np.array([f.speed for f in features]), self.permutations
        high = self.z(own) >= LEAST_Z * np.interp(own, test.speed, test.weight)
        each = zip(features, high, strict=True)
        return [f for f, z in each if f.speed * speed > 0 and (f.followed or z)]


def _samples(matches, followed, angle, without=()):
    """Return the matches along an axis and, if there are any, pairs of detections."""
    if followed is None:
        return (matches,)
    return matches, followed.pairs(angle, without)


def _along_followed(axis, speed, data, angles):
    """Return the axis along which features were followed, and their median speed."""
    found = axis.followed(axis.angle)[0] if axis.followed else []
    if not found:
        return axis, speed
    velocity = np.median([(f.speed, f.across) for f in found], axis=0)
    if len(angles) == 1:
        return axis, float(velocity[0])
    angle = (axis.angle + np.arctan2(velocity[1], velocity[0])) % (2 * np.pi)
    number = round(angle * len(angles) / np.pi) % len(angles)
    sign = 1 if np.cos(angle - angles[number]) > 0 else -1
    axis = replace(axis, angle=angles[number], samples=data[number][0], number=number)
    return axis, float(np.hypot(*velocity) * sign)


def _turn_to_features(axis, speed, project, n_axes):
    """Turn an axis to the direction of its features, whose motion it foreshortens."""
    features, taken = axis.features([speed])
    for _ in range(MAX_TURNS if n_axes > 1 else 0):
        near = [f for f in features if f.speed * speed > 0] or features
        if not near:
            break
        mean = np.mean([(f.speed, f.across) for f in near], axis=0)
        turn = np.arctan(mean[1] / mean[0])
        half_turns, number = divmod(round((axis.angle + turn) * n_axes / np.pi), n_axes)
        angle = axis.angle + (turn - half_turns * np.pi)
        speed = float(np.hypot(*mean) * np.sign(mean[0]) * (-1) ** half_turns)
        axis = replace(axis, angle=angle, samples=project(angle), number=number)
        features, taken = axis.features([speed])
        if abs(turn) < np.pi / n_axes / 2:
            break
    return axis, speed, features, taken


def _feature_groups(axis, features, speed, alpha, n_trials, rng):
    """Return the features of each stream, and the p-value of being distinct."""
    moving, settings = axis.moving(features, speed), axis.rays.settings
    if not moving:
        return []
    if any(f.speed * speed < 0 for f in moving):
        return [(moving, None)]
    p_two, is_fast = dispersion.separate_streams(moving, n_trials, rng, settings)
    parts = [], []
    for f, fast in zip(moving, is_fast, strict=True):
        parts[int(fast)].append(f)
    # One feature that was followed is of no other stream, only of another speed.
    alone = any(len(part) == 1 and part[0].followed for part in parts)
    if p_two <= alpha and not alone and _are_apart(*parts, settings):

        def rank(part):
            return len(part), axis.z(_population(part, settings)[0].mean)

        # The stream with more features is first; of equal ones the more significant.
        first, second = sorted(parts, key=rank, reverse=True)
        return [(first, None), (second, p_two)]
    mean = _population(moving, settings)[0].mean
    if axis.p_values(moving, mean)[1] > max(alpha, axis.permutations.smallest_p):
        # The speeds differ so much that no feature moves at their mean.
        near = [f for f in moving if abs(f.speed / speed - 1) <= settings.same_speed]
        return [(near or moving, None)]
    return [(moving, None)]


def _are_apart(one, other, settings):
    """Return whether two groups differ by more than so few features of one flow."""
    (v, _), (w, _) = (feature_speeds(part, settings) for part in (one, other))
    difference = np.log(abs(np.mean(v) / np.mean(w)))
    scatter = settings.lone_dispersion * np.sqrt(1 / len(one) + 1 / len(other))
    return abs(difference) > settings.apart * scatter


def _population(features, settings):
    """Return the mean and dispersion of the speeds along and across the axis."""
    speed, error = feature_speeds(features, settings)
    across = [f.across for f in features], [f.across_error for f in features]
    return random_effects(speed, error, settings), random_effects(*across, settings)


def _stream(axis, along, across, features, alpha, p_distinct=None, beside=False):
    """
    Return a stream, tested at its mean speed.

    A second one, ``beside`` a stream that moves, need not keep its speed.
    """
    p_local, p_global = axis.p_values(features, along.mean)
    z, n_secure, p_keeps = float(axis.z(along.mean)), 0, np.nan
    diffuse = axis.followed is not None and axis.followed.diffuse
    if p_distinct is None and axis.followed and not diffuse:
        far = axis.rays.settings.least_motion
        n_secure = sum(f.followed and f.motion >= far for f in features)
    p_global, note = with_secure(p_global, n_secure, alpha)
    if not diffuse and not beside:
        p_keeps = persistence(axis.samples, along.mean, axis.rays.settings)
    of = along, z, p_global, features, axis.permutations, alpha, axis.rays.settings
    kind, reason = classify(*of, p_keeps=p_keeps, beside=beside)
    reason = "; ".join(filter(None, (note, reason)))
    p_distinct = p_global if p_distinct is None else p_distinct
    p = p_local, p_global, p_distinct
    return Stream(kind, reason, axis.angle, along, across, z, *p, tuple(features))


def _without(samples, features):
    """Return the samples of other SSPs than those of the features."""
    return samples.without_ssps(chains.ssps_of(features, len(samples.epoch)))


def classify(
    along, z, p_global, features, permutations, alpha, settings, *, p_keeps=np.nan,
    beside=False,
):  # fmt: skip
    """
    Return the kind of a stream; if it is not significant, why and what is needed.

    The matches of a stream grow in proportion to the number of epochs, and their
    scatter under permutations as its square root, so ``(z_alpha / z)^2`` times as
    many epochs give a significance ``z_alpha``.

    Parameters
    ----------
    along : ``Population``
    z, p_global : float
        Significance of the mean speed, and its probability.
    features : sequence of ``Feature``
    permutations : ``EpochPermutations``
    alpha : float
    settings : `~astro_scc.streams.SearchSettings`
    p_keeps : float
        See `persistence`; NaN if features diffuse.
    beside : bool
        Whether the stream is beside one that moves.

    Returns
    -------
    kind, reason : str
    """
    smallest_p = permutations.smallest_p
    moved = np.hypot.reduce([f.motion for f in features])
    followed = any(f.followed for f in features)
    lone = len(features) == 1 and not followed and not beside
    # Where features diffuse, their mean may have either sign.
    both = len({f.speed > 0 for f in features}) == 2
    rest = REST_ERRORS * (2 if both else 1)
    if smallest_p > alpha:
        reason = f"too few epochs or trials: no p_global below {smallest_p:.2g}"
    elif p_global > alpha:
        reason = f"permuted epochs give as strong a peak (p_global {p_global:.2g})"
        more = (np.quantile(permutations.maxima, 1 - alpha) / max(z, 1e-9)) ** 2
        if 1 < more <= MOST_EPOCHS:
            reason += f"; if it is real, {more:.1f} times as many epochs should show it"
    elif not features:
        reason = "no single feature is seen to move at this speed"
    elif moved < settings.least_motion and not followed:
        reason = (
            f"its features move {moved:.1f} beams (root of the sum of squares), not "
            f"{settings.least_motion:g}: blends of standing features drift as far; "
            f"followed {np.ceil(10 * settings.least_motion / moved) / 10:.1f} times as "
            "long, they would move enough"
        )
    elif lone and len(features[0]) < LONE_EPOCHS:
        reason = (
            f"it rests on a single feature in {len(features[0])} epochs, which was "
            "matched but not followed from image to image; one more feature, or "
            f"{LONE_EPOCHS} epochs of it, would confirm it"
        )
    elif p_keeps > alpha:
        reason = (
            "its patterns do not keep this speed from one interval to the next more "
            f"often than by chance (p {p_keeps:.2g})"
        )
    elif abs(along.mean) <= rest * along.error:
        reason = f"rest is within {rest:g} errors of the speed"
    else:
        return "moving", ""
    passes = max(p_global, smallest_p) <= alpha
    return "not confirmed" if passes else "not significant", reason


def with_secure(p_global, n_secure, alpha):
    """
    Return the p-value of permuted epochs and of secure features together.

    They are combined by Fisher's method (1925, Statistical Methods for Research
    Workers) where the permutations alone do not reject.

    Parameters
    ----------
    p_global : float
        Of the permutation test.
    n_secure : int
        Number of secure features that move with the stream, and far enough.
    alpha : float

    Returns
    -------
    p_global : float
    note : str
        What it rests on, if that is more than the permutation test.
    """
    if n_secure == 0 or p_global <= alpha:
        return p_global, ""
    # Minus twice the logarithm of the product has a chi-square of 4 degrees of freedom.
    product = p_global * P_SECURE
    both = float(product * (1 - np.log(product)))
    if both > alpha:
        return p_global, ""
    some = "a secure feature" if n_secure == 1 else f"{n_secure} secure features"
    note = f"permuted epochs alone give p_global {p_global:.2g}, but {some} moved"
    return both, note
