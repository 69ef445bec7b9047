# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams and their features: those that move, with mean speeds, and that stand."""

from dataclasses import dataclass, field, replace

import numpy as np

from astro_scc.features.motion import (
    LEAST_EPOCHS,
    SIGNIFICANT,
    is_walk,
    measure_diffusion,
)
from astro_scc.intervals import median_interval

#: Where images share less than ``ALIKE`` and p_global is above alpha, no feature is
#: secure unless secure ones make up such a share of all detections: this tells those of
#: ``simulate_ballistic`` (seeds 20 to 55) from those of scrambled jets (seeds 6200 to
#: 6409) in 86 of 90.
BEYOND_CHANCE = 0.15
#: Features speak for a flow if they are this share of all detections.
COVERAGE = 0.1
#: A feature is not secure if the flow, in its median interval, moves by a beam and
#: passes it by so many, and is faster by so many errors: of those of 3C 111, 3C 120 and
#: 3C 273 in 8 to 32 of their epochs, and of three more sources in 8 to 14, 6 of 93
#: agree with what all epochs show.  They make up to 0.17 of all detections; where they
#: are more than such a share, as of ``lognormal-8``, the spectrum is wrong.
PASSING, AS_WELL, MOST_PASSED = 0.5, 2.0, 0.3
#: Why features are not secure, beyond what they show by themselves.
PASSED = f"slower than the flow by {PASSING:g} beams or more between images"
DIFFERENT = "what changes in images of neighbouring dates has little in common"
#: A secure feature that moves, along a direction: speeds, errors, epochs, number, and
#: 1 on the side of the jet, -1 on that of a counter-jet.
MOVING = {
    "names": "along along_err across across_err weight number side".split(),
    "formats": [float] * 5 + [int] * 2,
}

#: Features tell of a flow if there are so many, and of two streams if such a share of
#: them is on either side of the middle.
FEWEST, LEAST_SIDE = 5, 0.2
#: Scatter of the speeds of features to which theirs is drawn, relative to their mean,
#: and the number of features that it counts as.
SCATTER, PRIOR = 0.3, 2.0
#: Largest motion of a standing feature, in beams, and its fewest epochs.
STANDING, STANDING_EPOCHS = 0.5, 5
#: A stream of no feature is not confirmed where more than such a share of all
#: detections are of standing features: periodic fluxes look like motion.  In the
#: survey's sources whose speed is right, it is at most 0.46.
MOSTLY = 0.5
STANDING_STILL = (
    "stand still, and no feature moves: fluxes that vary in turn look like motion"
)
#: Standing features do not stand still if their mean is so many errors from zero, of
#: two dimensions: as rare by chance as three errors in one.
TOGETHER = 3.44
#: How that is said.
MOVE_TOGETHER = (
    "its features, none of which moves significantly, move together by {:.1f} standard "
    "errors: they do, or the reference, the core, does"
)
#: A pair of numbers that are not known.
UNKNOWN = (np.nan, np.nan)


@dataclass(frozen=True, eq=False)
class MeasuredStream:
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
    counter : bool
        Whether it is a stream of the counter-jet.
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
    spectrum: tuple[float, float] = UNKNOWN
    features: tuple[float, float] = UNKNOWN
    members: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    slowest: float = np.nan
    fastest: float = np.nan
    angle: float = 0.0
    counter: bool = False


def moving_features(features, frame, angle, inside=None, walk=None, *, folded=False):
    """
    Return the secure features that move, with speeds in mas/yr, as a record array.

    If they diffuse, ``walk`` is the variance of their speeds times years, and all that
    are followed count: a random walk cannot be told from motion by one of them.  If
    both sides of a core are ``folded``, the directions of those of the counter-jet are
    turned by 180 degrees.
    """
    motions, places, n = features.motions, features.places, len(features)
    epochs = features.n_epochs
    error = np.reshape([motion.velocity_err for motion in motions], (-1, 2))
    local = turn_to_flow(angle) @ np.asarray(frame.matrix(*places.T))
    behind = folded & ((local @ places[..., None])[:, 0, 0] < 0)
    side = np.where(behind, -1, 1)
    along, across = side * (local @ features.velocities[..., None])[..., 0].T
    errors = np.hypot(*np.moveaxis(local * error[:, None], -1, 0)).T
    use = (epochs >= LEAST_EPOCHS) & np.isfinite(local).all(axis=(1, 2))
    if inside is not None:
        use &= inside
    if walk is not None:
        spans = np.array([motion.span for motion in motions])
        errors = np.hypot(errors, np.sqrt(walk / spans))
    else:
        slow = [motion.speed < SIGNIFICANT * motion.speed_err for motion in motions]
        use &= features.secure & ~np.array(slow, dtype=bool)
        use &= np.abs(along) >= np.maximum(SIGNIFICANT * errors[0], np.abs(across))
    columns = along, errors[0], across, errors[1], epochs, np.arange(n), side
    return np.rec.fromarrays([column[use] for column in columns], dtype=MOVING)


def speaks_for(moving, features):
    """Return whether features that move are enough to speak for a flow."""
    least = COVERAGE * len(features.detections)
    return len(moving) > 0 and moving.weight.sum() >= least


def without_unlike(features):
    """Return features of images that are unlike, none secure if that may be chance."""
    if features.coverage >= BEYOND_CHANCE:
        return features
    return _doubted(features, features.secure, DIFFERENT)


def without_passed(features, flow, rows):
    """
    Return features, none secure that the slowest stream passes between its images.

    Other emission may be in its place.  Rows begin with a speed and its error in
    mas/yr, as those of features on the axes of the frame of the flow.
    """
    speed, error = min((abs(row[0]), row[1]) for row in rows)
    d, passed = features.detections, np.zeros(len(features), dtype=bool)
    velocities, covariances = frame_velocities(flow.frame, features)
    for k in np.flatnonzero(features.secure):
        length = np.hypot(*velocities[k])
        way = velocities[k] / length
        scatter = np.sqrt(way @ covariances[k] @ way + error**2)
        interval = median_interval(d.years[d.epoch[features.tracks[k]]])
        least = max(AS_WELL * scatter, PASSING * flow.beam / interval)
        passed[k] = speed * interval >= flow.beam and speed - length >= least
    if features.n_epochs[passed].sum() > MOST_PASSED * len(d):
        return features
    return _doubted(features, passed, PASSED)


def _doubted(features, which, reason):
    """Return features with a reason why some are not secure, if any are."""
    if not which.any():
        # What is not changed keeps what it has computed.
        return features
    doubts = features.doubts | {reason: features.number[which].tolist()}
    return replace(features, doubts=doubts)


def moving_with(flow, features, inside, sign):
    """
    Return the features that move with a flow, and what most of them contradict.

    The latter is in words, or empty; whether features diffuse is returned beside it.
    """
    diffusion = measure_diffusion(features)
    walk = diffusion["variance"] if is_walk(diffusion) else None
    moving = moving_features(
        features, flow.frame, flow.angle, inside, walk,
        folded=flow.grids[0].counter.any(),
    )  # fmt: skip
    if flow.grids[0].bends:
        # Along the lines, the speed is the length of the velocity.
        length = np.hypot(moving.along, moving.across)
        moving.along = np.copysign(length, moving.along)
    if walk is not None:
        return moving, "", True
    opposed = _opposed(features, inside, moving, sign)
    return moving[moving.along * sign > 0], opposed, False


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


def passing_features(features, beam, *, aligned=0.7):
    """
    Return the reliable features that move towards the reference position and past it.

    From a core nothing comes that is a beam or more behind it and moves as what is
    before it does.  Where there are more of those that move away behind it, it has a
    counter-jet.

    Parameters
    ----------
    features : `~astro_scc.features.Features`
    beam : float
        In mas.
    aligned : float, optional
        Least cosine of the angle between a velocity and the mean direction, and between
        it and the way to the reference position.

    Returns
    -------
    list of int
        Those behind the reference position; empty if none are before it.
    """
    secure = np.flatnonzero(features.secure_without_core)
    weight = features.n_epochs[secure]
    velocity = features.velocities[secure]
    ways = velocity / np.hypot(*velocity.T)[:, None]
    mean = weight @ ways
    mean /= max(np.hypot(*mean), 1e-9)
    place = features.places[secure]
    along, at = ways @ mean, place @ mean
    outward = (place * ways).sum(axis=1) / np.hypot(*place.T)
    behind, with_flow = at < -beam, along > aligned
    moving = behind & with_flow & (outward < -aligned)
    away = behind & (along < -aligned)
    if not np.any(with_flow & (at > 0)) or weight @ moving <= weight @ away:
        return []
    return secure[moving].tolist()


def frame_velocities(frame, features):
    """
    Return the velocities of features along the axes of a frame.

    Parameters
    ----------
    frame : frame of `astro_scc.kinematics`
    features : `~astro_scc.features.Features`

    Returns
    -------
    velocity, covariance : `~numpy.ndarray`, shapes (n, 2) and (n, 2, 2)
        In mas/yr and its square; NaN where the frame has no axes.
    """
    error = np.reshape([motion.velocity_err for motion in features.motions], (-1, 2))
    axes = np.asarray(frame.matrix(*features.places.T))
    velocity = (axes @ features.velocities[..., None])[..., 0]
    turned = axes * error[:, None, :]
    return velocity, turned @ turned.swapaxes(-1, -2)


def turn_to_flow(angle):
    """Return the matrix that turns axes of the frame into those along the flow."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def divided(moving, speeds):
    """Return the features of each of two streams: the nearer one by ratio."""
    slow = np.abs(moving.along) < np.sqrt(np.prod(speeds))
    return [moving[slow], moving[~slow]]


def standing_streams(features, flow, streams, inside, shift):
    """
    Return the stream of the features that stand still, if there are any.

    Each of them may, but if their mean moves by more than its error, all features or
    the core, the reference, do: images do not tell which.
    """
    velocities, _ = frame_velocities(flow.frame, features)
    weight = features.n_epochs.astype(float)
    speed, error = np.reshape(
        [(m.speed, m.speed_err) for m in features.motions], (-1, 2)
    ).T
    still = (speed < SIGNIFICANT * error) & (features.moved < STANDING)
    still &= (weight >= STANDING_EPOCHS) & (features.p_false <= 0.5)
    still &= np.isfinite(velocities).all(axis=1)
    # Axes may have a scale.
    axes = np.asarray(flow.frame.matrix(*features.places.T))
    error = error * np.hypot(*axes[:, 0].T)
    if inside is not None:
        still &= inside
    for stream in streams:
        still[stream.members] = False
        if stream.kind == "moving":
            # What may as well move with a stream does not show that it stands.
            off = np.hypot(*(velocities - stream.velocity).T)
            still &= ~(off < AS_WELL * error)
    members = np.flatnonzero(still)
    if len(members) == 0:
        return []
    (first, second), error = velocities[still].T, error[still]
    share = weight[still] / weight[still].sum()
    velocity = np.array([share @ first, share @ second])
    scatter = share @ ((first - velocity[0]) ** 2 + (second - velocity[1]) ** 2) / 2
    variance = (share**2).sum() * max(scatter, share @ error**2)
    speeds, covariance = np.hypot(first, second), np.eye(2) * variance + shift
    errors = np.sqrt(velocity @ np.linalg.solve(covariance, velocity))
    kind, reason = "stationary", ""
    if len(members) > 1 and errors > TOGETHER:
        kind, reason = "not confirmed", MOVE_TOGETHER.format(errors)
    return [
        MeasuredStream(
            kind, reason, velocity, covariance, shift, source="features",
            features=(float(np.hypot(*velocity)), float(np.sqrt(variance))),
            members=members, slowest=speeds.min(), fastest=speeds.max(),
        )
    ]  # fmt: skip


def with_standing(search, streams, inside, shift):
    """Return streams with that of the standing features, and those beside it."""
    standing = standing_streams(search.features, search.flow, streams, inside, shift)
    return _beside_standing(streams + standing, search.features)


def _beside_standing(streams, features):
    """Return streams, none without features moving if most of what is seen stands."""
    weight, number = features.n_epochs, max(len(features.detections), 1)
    share = sum(weight[s.members].sum() for s in streams if s.kind == "stationary")
    if share <= MOSTLY * number:
        return streams
    doubt = f"{share / number:.0%} of detections {STANDING_STILL}"
    return [
        replace(stream, kind="not confirmed", reason=doubt)
        if stream.kind == "moving" and not len(stream.members)
        else stream
        for stream in streams
    ]


# -- mean and scatter of speeds ------------------------------------------------------


def separation(speed):
    """
    Return how well speeds divide into two groups.

    It is the largest share of the variance of their logarithms that lies between two
    groups (Otsu 1979, IEEE Trans. SMC 9, 62): 0.64 for a normal distribution, 0.75 for
    a uniform one, and 1 for two speeds.

    Parameters
    ----------
    speed : array_like, shape (n,)
        Positive.

    Returns
    -------
    float
    """
    return float(_separation(np.log(np.asarray(speed, float))[None])[0])


def chance_of_separation(speed, n_trials, rng):
    """
    Return the probability that the speeds of one stream are as separate.

    They are drawn from a uniform distribution: of all distributions without a gap, it
    looks most like two.

    Parameters
    ----------
    speed : array_like, shape (n,)
        Positive.
    n_trials : int
    rng : `~numpy.random.Generator`

    Returns
    -------
    float
    """
    found = separation(speed)
    trials = _separation(rng.uniform(size=(n_trials, len(speed))))
    return float((1 + np.sum(trials >= found)) / (1 + n_trials))


def _separation(y):
    """Return the separation of each row of values."""
    y = np.sort(y, axis=1)
    n, low = y.shape[1], np.cumsum(y, axis=1)[:, :-1]
    number = np.arange(1, n)
    apart = (low[:, -1:] + y[:, -1:] - low) / (n - number) - low / number
    between = (number * (n - number) / n**2 * apart**2).max(axis=1, initial=0.0)
    total = y.var(axis=1)
    return np.divide(between, total, out=np.zeros(len(y)), where=total > 0)


def unknown_scatter(mean, number):
    """
    Return the part of the error of a mean speed that few features cannot show.

    Their scatter is drawn to three tenths of the mean as in `mean_speed`, of which this
    is the part beyond what is seen,

    .. math:: \\sigma^2 = \\frac{1}{n} \\frac{2}{n + 2} (0.3 \\bar v)^2.

    Parameters
    ----------
    mean, number : array_like
        Mean speed, and number of features.

    Returns
    -------
    `~numpy.ndarray`

    Examples
    --------
    >>> from astro_scc.streams.members import unknown_scatter
    >>> unknown_scatter(1.0, [1, 4, 20]).round(3)
    array([0.245, 0.087, 0.02 ])
    """
    number = np.maximum(number, 1.0)
    return SCATTER * np.abs(mean) * np.sqrt(PRIOR / (number + PRIOR) / number)


def mean_speed(speed, error, weight):
    """
    Return the mean speed of features, weighted by the number of their epochs.

    Its error holds the features' own errors and their scatter, which for few features
    is drawn to three tenths of the mean,

    .. math:: s^2 = \\frac{\\sum w (v - \\bar v)^2 n / \\sum w + 2 (0.3 \\bar v)^2}
                          {n - 1 + 2}.

    Parameters
    ----------
    speed, error, weight : array_like, shape (n,)

    Returns
    -------
    mean, error : float
    dispersion, dispersion_err : float
        Scatter beyond the errors; NaN with fewer than two features.

    Examples
    --------
    >>> from astro_scc.streams.members import mean_speed
    >>> mean, error, *_ = mean_speed([0.9, 1.0, 1.1], [0.02] * 3, [5, 10, 5])
    >>> float(mean.round(2)), float(error.round(2))
    (1.0, 0.14)
    """
    speed, error, weight = (np.asarray(v, float) for v in (speed, error, weight))
    share, n = weight / weight.sum(), len(speed)
    mean = share @ speed
    square = n * share @ (speed - mean) ** 2
    variance = (square + PRIOR * (SCATTER * mean) ** 2) / (n - 1 + PRIOR)
    total = (share**2).sum() * variance + (share**2) @ error**2
    dispersion = dispersion_err = np.nan
    if n > 1:
        noise = share @ error**2
        dispersion = np.sqrt(max(square / (n - 1) - noise, 0.0))
        width = np.sqrt(max(square / (n - 1), noise))
        dispersion_err = width / np.sqrt(2 * (n - 1))
    return mean, np.sqrt(total), dispersion, dispersion_err


def mean_across(moving, speed):
    """Return the mean speed of features across a flow of a speed, and its error."""
    share = moving.weight / moving.weight.sum()
    across = share @ moving.across
    variance = share @ (moving.across - across) ** 2 * (share**2).sum()
    error = np.sqrt(variance + (share**2) @ moving.across_err**2)
    n = len(share)
    # A few features may agree by chance: directions scatter by ten degrees or more.
    prior = (0.15 * speed) ** 2 * 2 / (n + 1) / n
    return across, np.sqrt(error**2 + prior)
