# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which speeds the epochs show: the search for streams and its significance."""

from dataclasses import dataclass, field

import numpy as np

from astro_scc.stacking.diagram import Diagram, Rays
from astro_scc.stacking.features import find_features, standing_features
from astro_scc.stacking.permutations import EpochPermutations
from astro_scc.stacking.search import SearchSettings
from astro_scc.stacking.streams import (
    LONE,
    Population,
    feature_speeds,
    random_effects,
    separate_streams,
)

__all__ = ["Search", "Stream", "find_streams"]

#: Weight of a speed for single features that no permutation test supports.
LEAST_PRIOR = 0.15
#: Speeds less significant than this, in standard deviations of the
#: permutations, are not those of a feature of the stream.
LEAST_Z = 1.5
#: The direction is that of the features after so many steps at most.
TURNS = 4
#: Errors that a speed is from rest: at 95%, one-sided.
REST = 1.645
#: Features that stand still pull at those nearer than so many beams: their speeds are
#: 10% too small on simulated jets, farther out 0.3%.  They do not count if so many are
#: left.
PULL, FEWEST_CLEAR = 2.5, 3
#: Streams differ by so many standard deviations of what a flow scatters.
APART = 3.0


@dataclass(frozen=True, eq=False)
class Stream:
    """
    A stream: features whose speeds scatter about one mean.

    Attributes
    ----------
    kind : {"moving", "stationary", "not significant"}
    reason : str
        Why it is not significant, or ''.
    angle : float
        Direction of the axis from the first axis of the frame, in radians.
    along, across : `~astro_scc.stacking.Population`
        Of the speeds of its features, in beams a year.
    z : float
        Excess along its ray in standard deviations of the permutations.
    p_local, p_global : float
        Of the permutation test at exactly this speed, see `EpochPermutations`.
    p_distinct : float
        How often one stream fewer would give features as separate; of the
        first stream its ``p_global``.
    features : tuple of `~astro_scc.stacking.Feature`

    Examples
    --------
    >>> from astro_scc.stacking import Stream, random_effects
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
    features: tuple = field(default=(), repr=False)


@dataclass(frozen=True, eq=False)
class Search:
    """
    What a search for streams found, and what it was found on.

    Attributes
    ----------
    streams : tuple of `Stream`
        The moving ones, that with more features first, then what stands still;
        or the strongest speed that is not significant.  Empty without matches.
    diagram : `~astro_scc.stacking.Diagram`
        Along the direction of the first stream.
    angle : float
        Of that direction from the first axis of the frame, in radians.
    permutations : `~astro_scc.stacking.EpochPermutations`
    axis : int
        Of the permutations, the one nearest to that direction.
    rays : `~astro_scc.stacking.Rays`

    Examples
    --------
    One feature that moves half a beam a year through eight epochs:

    >>> import numpy as np
    >>> from astro_scc.stacking import AxisDisplacements, find_streams
    >>> years = np.arange(8.0)
    >>> ssp, to = (k[~np.eye(8, dtype=bool)] for k in np.indices((8, 8)))
    >>> d = AxisDisplacements(
    ...     along=0.5 * (to - ssp), across=np.zeros(56), weight=np.ones(56),
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

    streams: tuple
    diagram: Diagram
    angle: float
    permutations: EpochPermutations
    axis: int
    rays: Rays

    def follow(self, displacements):
        """
        Follow the features of some of the SSPs along the first stream.

        Parameters
        ----------
        displacements : `~astro_scc.stacking.AxisDisplacements`
            Along the direction of that stream.

        Returns
        -------
        list of `~astro_scc.stacking.Feature`
            Those that move in the direction of the stream, at speeds that the
            epochs show.
        """
        if not self.streams:
            return []
        found = _follow(displacements, self.rays, self.permutations, self.axis)
        speed = self.streams[0].along.mean
        return _moving(found, self.permutations, self.axis, speed)


def find_streams(
    project,
    angles,
    radius,
    *,
    alpha=0.05,
    n_trials=1000,
    rng,
    outward=False,
    fastest=np.inf,
    intervals=(0.0, np.inf),
    settings=None,
):
    """
    Find the streams whose motion permuted epochs do not show.

    The speed with the largest excess over the permutations, along the rays
    of the displacement-interval diagram, is tested against the largest of
    each permutation.  If it is significant, single features are followed
    along that direction; a stream is the mean and the dispersion of their
    speeds, and there are two streams where a parametric bootstrap rejects
    one.  The probability that a stream is given is of its own mean speed.

    Parameters
    ----------
    project : callable
        The `~astro_scc.stacking.AxisDisplacements` along an angle in radians
        from the first axis of the frame.
    angles : sequence of float
        Axes to search, evenly over half a turn from the first axis of the
        frame; one if the direction of the flow is known.
    radius : float
        Largest displacement in beams.
    alpha : float, optional
        Largest ``p_global`` of what is significant.
    n_trials : int, optional
        Number of permutations.
    rng : `~numpy.random.Generator`
    outward : bool, optional
        Search positive speeds only.
    fastest : float, optional
        Largest speed, in beams a year.
    intervals : tuple of float, optional
        Shortest and longest interval between epochs that is used, in years.
    settings : `~astro_scc.stacking.SearchSettings`, optional

    Returns
    -------
    `Search`

    Raises
    ------
    ValueError
        If no two epochs are as far apart as ``intervals`` ask.

    Examples
    --------
    Ten features that move half a beam a year through eight epochs:

    >>> import numpy as np
    >>> from astro_scc.stacking import AxisDisplacements, find_streams
    >>> years = np.arange(8.0)
    >>> epoch, feature = (k.ravel() for k in np.indices((8, 10)))
    >>> place = 3.0 * feature + 0.5 * years[epoch]
    >>> ssp, to = np.nonzero((feature[:, None] == feature) & (epoch[:, None] != epoch))
    >>> d = AxisDisplacements(
    ...     along=place[to] - place[ssp], across=np.zeros(len(to)),
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
    axes = [project(angle) for angle in angles]
    rays = Rays.of(axes[0].years, radius, settings, fastest, intervals)
    permutations = EpochPermutations.of(
        axes, rays, n_trials, test_rng, settings, outward=outward
    )
    axis, speed = permutations.largest()
    p_local, p_global = permutations.p_values(axis, speed)
    angle, d = angles[axis], axes[axis]
    features = _follow(d, rays, permutations, axis)
    # Displacements along a wrong axis are shorter: along the features' own direction.
    for _ in range(TURNS if len(angles) > 1 else 0):
        near = [f for f in features if f.speed * speed > 0] or features
        if not near:
            break
        mean = np.mean([(f.speed, f.across) for f in near], axis=0)
        turn = np.arctan(mean[1] / mean[0])
        half_turns, axis = divmod(
            round((angle + turn) * len(angles) / np.pi), len(angles)
        )
        angle += turn - half_turns * np.pi
        speed = float(np.hypot(*mean) * np.sign(mean[0]) * (-1) ** half_turns)
        d = project(angle)
        features = _follow(d, rays, permutations, axis)
        if abs(turn) < np.pi / len(angles) / 2:
            break
    still = standing_features(d, settings)
    streams, searched, first_axis = [], permutations, axis
    for group, p_distinct in _groups(
        features, permutations, axis, speed, alpha, n_trials, model_rng
    ):
        along, across = _population(_clear(group, still, d))
        if streams:
            # What the faster or slower one shows beside the first.
            ssps = np.concatenate([f.ssp for f in streams[0].features])
            rest = d.without_ssps(np.isin(np.arange(len(d.epoch)), ssps))
            axis, permutations = (
                0,
                EpochPermutations.of(
                    [rest], rays, n_trials, test_rng, settings, outward=outward
                ),
            )
        p_local, p_global = permutations.p_values(axis, along.mean)
        kind, reason = classify(along, p_global, group, permutations, alpha, settings)
        streams.append(
            Stream(
                kind=kind,
                reason=reason,
                angle=angle,
                along=along,
                across=across,
                z=float(permutations.significance(axis, along.mean)),
                p_local=p_local,
                p_global=p_global,
                p_distinct=p_global if p_distinct is None else p_distinct,
                features=tuple(group),
            )
        )
    if not streams and permutations.z.any():
        streams.append(
            _without_features(permutations, axis, speed, angle, alpha, settings)
        )
    streams += _standing(d, streams, angle, settings)
    return Search(
        streams=tuple(streams),
        diagram=Diagram.of(d, rays, settings),
        angle=float(angle),
        permutations=searched,
        axis=first_axis,
        rays=rays,
    )


def _follow(d, rays, permutations, axis):
    """Features along an axis, of which the significant speeds count more."""

    def prior(speeds):
        z = permutations.significance(axis, speeds)
        return np.clip(z / rays.settings.full_prior, LEAST_PRIOR, 1.0)

    return find_features(d, rays, rays.settings, prior)


def _clear(features, still, d):
    """Without those that features which stand still pull at, if three are left."""
    if not still:
        return features
    places = np.array([d.position[f.ssp].mean(axis=0) for f in still])
    clear = [
        f
        for f in features
        if np.hypot(*(places - d.position[f.ssp].mean(axis=0)).T).min() > PULL
    ]
    return clear if len(clear) >= FEWEST_CLEAR else features


def _moving(features, permutations, axis, speed):
    """Those that move in the direction of a speed, as the epochs show."""
    z = permutations.significance(axis, np.array([f.speed for f in features]))
    return [
        f
        for f, own in zip(features, z, strict=True)
        if f.speed * speed > 0 and own >= LEAST_Z
    ]


def classify(along, p_global, features, permutations, alpha, settings):
    """
    Decide the kind of a stream, and say why it is not significant.

    Parameters
    ----------
    along : `~astro_scc.stacking.Population`
    p_global : float
    features : sequence of `~astro_scc.stacking.Feature`
    permutations : `~astro_scc.stacking.EpochPermutations`
    alpha : float
    settings : `~astro_scc.stacking.SearchSettings`

    Returns
    -------
    kind, reason : str
    """
    if permutations.smallest_p > alpha:
        reason = (
            f"too few epochs or trials: no p_global below {permutations.smallest_p:.2g}"
        )
    elif p_global > alpha:
        reason = "permuted epochs show as much (p_global above alpha)"
    elif not features:
        reason = "no single feature is seen to move at this speed"
    elif (
        moved := np.hypot.reduce([f.motion for f in features])
    ) < settings.least_motion:
        reason = (
            f"its features move {moved:.1f} beams, added in squares, less than "
            f"{settings.least_motion:g}: blends of standing features drift as far"
        )
    elif abs(along.mean) <= REST * along.error:
        reason = "rest is within 1.645 errors of the speed (95%)"
    else:
        return "moving", ""
    return "not significant", reason


def _groups(features, permutations, axis, speed, alpha, n_trials, rng):
    """Features of each stream, and the probability that it is none of its own."""
    moving = _moving(features, permutations, axis, speed)
    if not moving:
        return []
    p_two, second = separate_streams(moving, n_trials, rng)
    parts = [
        [f for f, fast in zip(moving, second, strict=True) if fast == which]
        for which in (False, True)
    ]
    if p_two <= alpha and _apart(*parts):
        # The one with more features first, of equal ones the more significant.
        parts.sort(
            key=lambda part: (
                len(part),
                permutations.significance(axis, _population(part)[0].mean),
            ),
            reverse=True,
        )
        return [(parts[0], None), (parts[1], p_two)]
    mean = _population(moving)[0].mean
    if permutations.p_values(axis, mean)[1] > max(alpha, permutations.smallest_p):
        # Speeds so different that their mean is none of theirs.
        near = [f for f in moving if abs(f.speed / speed - 1) <= 0.35]
        return [(near or moving, None)]
    return [(moving, None)]


def _apart(one, other):
    """Whether the speeds differ by more than those of so few of one flow may."""
    (v, _), (w, _) = map(feature_speeds, (one, other))
    difference = np.log(abs(np.mean(v) / np.mean(w)))
    return abs(difference) > APART * LONE * np.sqrt(1 / len(one) + 1 / len(other))


def _population(features):
    speed, error = feature_speeds(features)
    across = [f.across for f in features], [f.across_error for f in features]
    return random_effects(speed, error), random_effects(*across)


def _without_features(permutations, axis, speed, angle, alpha, settings):
    p_local, p_global = permutations.p_values(axis, speed)
    unknown = Population(0.0, np.nan, np.nan, np.nan)
    along = Population(float(speed), np.nan, np.nan, np.nan)
    kind, reason = classify(along, p_global, (), permutations, alpha, settings)
    z = float(permutations.significance(axis, speed))
    return Stream(kind, reason, angle, along, unknown, z, p_local, p_global, p_global)


def _standing(d, streams, angle, settings):
    """The stream at rest, if features stand still."""
    taken = np.zeros(len(d.epoch), dtype=bool)
    for stream in streams:
        for feature in stream.features if stream.kind == "moving" else ():
            taken[feature.ssp] = True
    still = standing_features(d.without_ssps(taken), settings)
    if not still:
        return []
    along, across = _population(still)
    return [Stream("stationary", "", angle, along, across, features=tuple(still))]
