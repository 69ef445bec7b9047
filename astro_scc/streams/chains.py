# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features: SSPs that follow a straight line through the epochs."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from astro_scc.streams.diagram import DEFAULT, SearchSettings, fit_mixture

#: Motion in beams with which one epoch less than ``least_epochs`` is enough.
FAR_MOTION = 1.5
#: Smallest share of the epochs from its first to its last one in which a feature is
#: seen: at least 0.7 for 95% of those that are followed correctly, while SSPs that lie
#: on a line by chance miss most epochs.
LEAST_SHARE = 0.6
#: Smallest expected number of true matches of an SSP with which a feature begins.
LEAST_SCORE = 0.7
#: Relative dispersion about the speed of a stream of the speeds with which its features
#: begin.
FIRST_DISPERSION = 0.3
#: Fewest SSPs of a feature with an acceleration.
ACCELERATED_EPOCHS = 5
#: Degrees of freedom that ``position_error`` counts as: a straight line through three
#: SSPs has one of its own.
PRIOR_FREEDOM = 3
#: Features closer than so many beams to the line of a longer one are parts of it.
SAME_FEATURE = 0.5
#: Distance in beams within which a standing feature attracts or repels positions.  On
#: simulated jets, speeds at 2 to 3 beams are 7 +- 2% too small without such positions
#: (``benchmarks/calibration/followed.py``).
PULL = 1.6


@dataclass(frozen=True, eq=False)
class Feature:
    """
    SSPs of one scale, or detections in images, on a straight line in time.

    Attributes
    ----------
    ssp : `~numpy.ndarray` of int, shape (n_ssps,)
        Indices of the SSPs, in the order of the epochs.
    epoch : `~numpy.ndarray` of int, shape (n_epochs,)
        Epochs in which it is seen.
    speed, error : float
        Speed along the axis, in beams/yr, and its standard error.
    across, across_error : float
        The same across the axis.
    middle : `~numpy.ndarray`, shape (2,)
        Mean position along and across the axis, in beams.
    date : float
        Mean date, in years.
    motion : float
        Motion while the feature is seen, in beams.
    response : `~numpy.ndarray`, shape (n_epochs,)
        Change of the speed for a displacement in each epoch by one beam.
    acceleration, acceleration_error : float
        Acceleration along the axis, in beams/yr^2, from a parabola; NaN with
        fewer than five SSPs.
    pulled : bool
        Whether standing features are so close that they affect the speed.
    detection : `~numpy.ndarray` of int
        Indices of its detections, if it was followed from image to image, and not by
        matches of SSPs.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.streams.chains import Feature
    >>> years = np.array([0.0, 1.0, 2.0])
    >>> place = np.array([[1.0, 0.0], [1.5, 0.0], [2.0, 0.0]])
    >>> Feature.through(np.arange(3), np.arange(3), years, place).speed
    0.5
    """

    ssp: np.ndarray
    epoch: np.ndarray
    speed: float
    error: float
    across: float
    across_error: float
    middle: np.ndarray
    date: float
    motion: float
    response: np.ndarray
    acceleration: float = np.nan
    acceleration_error: float = np.nan
    pulled: bool = False
    detection: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))

    def __len__(self) -> int:
        return len(self.epoch)

    @property
    def followed(self) -> bool:
        """Whether it was followed from image to image."""
        return len(self.detection) > 0

    @property
    def place(self) -> float:
        """Mean position along the axis, in beams."""
        return float(self.middle[0])

    @classmethod
    def through(
        cls, ssp: np.ndarray, epoch: np.ndarray, years: np.ndarray,
        position: np.ndarray, settings: SearchSettings = DEFAULT,
    ) -> Feature:  # fmt: skip
        """
        Fit a straight line to the positions of SSPs.

        The variance of a position is that of the residuals, drawn towards the
        square of ``position_error`` in the settings, which counts as three more
        measurements.

        Parameters
        ----------
        ssp : `~numpy.ndarray` of int
        epoch : `~numpy.ndarray` of int, shape (n,)
        years : `~numpy.ndarray`, shape (n,)
        position : `~numpy.ndarray`, shape (n, 2)
        settings : `~astro_scc.streams.SearchSettings`, optional

        Returns
        -------
        `Feature`
        """
        velocity, middle, date, response = line_through(years, position)
        time = years - date
        left = position - middle - time[:, None] * velocity

        def variance(left, n_parameters):
            total = (left**2).sum(axis=0) + PRIOR_FREEDOM * settings.position_error**2
            return total / (max(len(years) - n_parameters, 0) + PRIOR_FREEDOM)

        error = np.sqrt(variance(left, 2) * (response @ response))
        bend = bend_error = np.nan
        if len(np.unique(years)) >= ACCELERATED_EPOCHS:
            design = np.stack([np.ones(len(years)), time, time**2 / 2], axis=1)
            inverse = np.linalg.inv(design.T @ design)
            curve = inverse @ design.T @ position[:, 0]
            left = position[:, 0] - design @ curve
            bend, bend_error = curve[2], np.sqrt(inverse[2, 2] * variance(left, 3))
        return cls(
            ssp=ssp, epoch=epoch, speed=float(velocity[0]), error=float(error[0]),
            across=float(velocity[1]), across_error=float(error[1]),
            middle=middle, date=float(date),
            motion=float(abs(velocity[0]) * np.ptp(years)), response=response,
            acceleration=float(bend), acceleration_error=float(bend_error),
        )  # fmt: skip


def line_through(years, position):
    """
    Return the straight line through positions.

    Returned are the velocity, the mean position and the mean date, and the change of
    the velocity for a change of each position.
    """
    time = years - years.mean()
    response = time / (time @ time)
    return response @ position, position.mean(axis=0), years.mean(), response


def find_chains(samples, speeds, rays):
    """
    Find features that move, each with its own speed.

    The SSP whose matches most probably are true ones of a stream begins a feature, with
    the speed that these matches give, drawn towards that of the stream.  The SSPs to
    which its matches lead along the ray of that speed join it, and those to which their
    matches lead, as long as they lie on one line.  Then the next feature begins with
    the remaining SSPs.  Where two epochs are so far apart that the feature moves beyond
    the search radius, no match leads from one to the other: parts of one line before
    and after such a gap are joined.

    Parameters
    ----------
    samples : ``VelocitySamples``
    speeds : sequence of float
        Approximate speeds of the streams, in beams/yr.
    rays : `~astro_scc.streams.diagram.Rays`

    Returns
    -------
    features : list of `Feature`
        A feature that is seen on several scales is there only once.
    taken : `~numpy.ndarray` of bool, shape (n_ssps,)
        SSPs of features, on all scales.
    """
    d, settings = samples, rays.settings
    keep = (np.abs(d.d2) <= settings.across) & (d.target_ssp >= 0) & (d.interval != 0)
    links = _Links(d.select(keep))
    score, speed = first_speeds(d, speeds, rays)
    seeds = np.argsort(-score, kind="stable")
    seeds = seeds[score[seeds] >= LEAST_SCORE]
    found = []
    for chosen in _joined(_chains(seeds, speed, links, d, settings), d, settings):
        feature = _feature(chosen, d, settings)
        fewest = settings.least_epochs - (feature.motion >= FAR_MOTION)
        if len(feature) >= max(fewest, LEAST_SHARE * (np.ptp(feature.epoch) + 1)):
            found.append(feature)
    return different(found, d, settings), ssps_of(found, len(d.epoch))


def ssps_of(features, n_ssps):
    """Return which SSPs are those of some features."""
    taken = np.zeros(n_ssps, dtype=bool)
    taken[[ssp for feature in features for ssp in feature.ssp]] = True
    return taken


def first_speeds(samples, speeds, rays):
    """
    Return the speed of each SSP, from the matches that are true of one stream.

    Parameters
    ----------
    samples : ``VelocitySamples``
    speeds : sequence of float
        See `find_chains`.
    rays : `~astro_scc.streams.diagram.Rays`

    Returns
    -------
    number, speed : `~numpy.ndarray`, shape (n_ssps,)
        Expected number of true matches of the stream that has most of them, from and
        to each SSP, and the speed along the axis that they give.
    """
    d, n, number, own = samples, len(samples.epoch), [], []
    speeds, at, *streams = fit_mixture(d, speeds, rays)
    x, dt, target = d.d1[at], d.interval[at], d.target_ssp[at]
    both = np.concatenate([d.ssp[at], np.where(target < 0, n, target)])

    def per_ssp(values):
        return np.bincount(both, np.tile(values, 2), n + 1)[:n]

    for v, member, s in zip(speeds, *streams, strict=True):
        weight = member / s**2
        # Where nothing moves, the fit may end at rest.
        prior = (FIRST_DISPERSION * max(abs(v), 1e-9)) ** -2
        total = per_ssp(weight * dt**2) + prior
        own.append((per_ssp(weight * x * dt) + prior * v) / total)
        number.append(per_ssp(member))
    which = np.argmax(number, axis=0), np.arange(n)
    return np.array(number)[which], np.array(own)[which]


def standing_features(samples, settings):
    """
    Find features that stand still in at least half of the epochs.

    Parameters
    ----------
    samples : ``VelocitySamples``
    settings : `~astro_scc.streams.SearchSettings`

    Returns
    -------
    list of `Feature`
        Their speeds are at most two standard errors.
    """
    d = samples
    # Images of the same date say nothing about motion.
    close = (np.hypot(d.d1, d.d2) <= settings.nearest) & (d.interval != 0)
    links = _Links(d.select(close & (d.target_ssp >= 0)))
    least = max(settings.least_epochs, len(d.years) / 2)
    number = np.diff(links.start)
    seeds = np.argsort(-number, kind="stable")
    seeds = seeds[number[seeds] + 1 >= least]
    chains = _chains(seeds, np.zeros(len(d.epoch)), links, d, settings)
    found = [_feature(k, d, settings) for k in chains if len(k) >= least]
    found = [f for f in found if abs(f.speed) <= 2 * f.error]
    return different(found, d, settings)


def clear_of(features, standing, samples, settings):
    """
    Fit features again without the SSPs near a standing feature.

    Parameters
    ----------
    features, standing : sequence of `Feature`
    samples : ``VelocitySamples``
    settings : `~astro_scc.streams.SearchSettings`

    Returns
    -------
    list of `Feature`
        With the same SSPs, but those within ``pull`` of a standing feature do not
        affect the speed.  A feature with fewer than ``least_epochs`` other SSPs is
        ``pulled``.
    """
    d, found = samples, []
    places = np.reshape([d.position[f.ssp].mean(axis=0) for f in standing], (-1, 2))
    for f in features:
        away = np.hypot(*(d.position[f.ssp][:, None] - places).T)
        away = away.min(axis=0, initial=np.inf)
        clear = away > PULL
        if clear.all():
            found.append(f)
        elif clear.sum() < settings.least_epochs:
            found.append(replace(f, pulled=True))
        else:
            part, response = _feature(f.ssp[clear], d, settings), np.zeros(len(f))
            response[clear] = part.response
            same = {"ssp": f.ssp, "epoch": f.epoch, "motion": f.motion}
            found.append(replace(part, **same, response=response))
    return found


class _Links:
    """Matches in both directions, sorted by the SSP from which they start."""

    def __init__(self, d):
        ssp = np.concatenate([d.ssp, d.target_ssp])
        order = np.argsort(ssp, kind="stable")
        self.ssp = ssp[order]
        self.to = np.concatenate([d.target_ssp, d.ssp])[order]
        self.along = np.concatenate([d.d1, -d.d1])[order]
        self.weight = np.concatenate([d.weight, d.weight])[order]
        self.interval = d.years[d.epoch[self.to]] - d.years[d.epoch[self.ssp]]
        self.start = np.searchsorted(self.ssp, np.arange(len(d.epoch) + 1))


def _chains(seeds, speed, links, d, settings):
    """Yield the SSPs on a line with each seed; each SSP is in one chain only."""
    free = np.ones(len(d.epoch), dtype=bool)
    for seed in seeds:
        if free[seed]:
            chosen = _follow(seed, speed[seed], links, d, free, settings)
            free[chosen] = False
            yield _on_line(chosen, d, settings)


def _follow(seed, speed, links, d, free, settings):
    """Return the SSPs along a line from a seed, one per epoch."""
    members = {int(d.epoch[seed]): int(seed)}
    front, here, when = [int(seed)], d.position[seed], d.years[d.epoch[seed]]
    velocity = np.array([speed, 0.0])
    while front:
        index = np.concatenate([np.arange(*links.start[s : s + 2]) for s in front])
        to, moved = links.to[index], velocity[0] * links.interval[index]
        off = links.along[index] - moved
        line = here + np.outer(d.years[d.epoch[to]] - when, velocity)
        near = np.abs(d.position[to] - line) <= (settings.line, settings.across)
        new = near.all(axis=1) & (np.abs(off) <= 2 * settings.smoothing)
        new &= free[to] & ~np.isin(d.epoch[to], list(members))
        value = np.exp(-0.5 * (off[new] / settings.smoothing) ** 2)
        total = np.bincount(to[new], links.weight[index[new]] * value)
        which, front = np.unique(to[new]), []
        for ssp in which[np.argsort(-total[which], kind="stable")].tolist():
            epoch = int(d.epoch[ssp])
            if epoch not in members:
                members[epoch] = ssp
                front.append(ssp)
        if len(members) >= 3:
            line = d.years[list(members)], d.position[list(members.values())]
            velocity, here, when, _ = line_through(*line)
    return np.array([members[epoch] for epoch in sorted(members)])


def _on_line(chosen, d, settings):
    """Return the SSPs of a chain without those that lie off its line."""
    for _ in range(3):
        if len(chosen) <= settings.least_epochs:
            break
        off = _off_line(chosen, d)[:, 0]
        limit = max(2.5 * 1.4826 * np.median(off), 2 * settings.position_error)
        good = off <= limit
        if good.all() or good.sum() < settings.least_epochs:
            break
        chosen = chosen[good]
    return chosen


def _joined(chains, d, settings):
    """Yield chains; those of one speed that lie on one line are joined."""
    rest = sorted((c for c in chains if len(c) > 1), key=len, reverse=True)
    sums = np.array([_sums(chain, d) for chain in rest])
    while rest:
        chain, own, sums = rest.pop(0), sums[0], sums[1:]
        while rest and (found := _continuation(chain, own, rest, sums, d, settings)):
            number, chain = found
            del rest[number]
            own, sums = _sums(chain, d), np.delete(sums, number, axis=0)
        yield chain


def _sums(chain, d):
    """Return scale, first and last epoch of a chain, and the sums of its slope."""
    epoch = d.epoch[chain]
    t, x = d.years[epoch] - d.years[0], d.position[chain, 0]
    sums = len(t), t.sum(), x.sum(), t @ t, t @ x
    return np.array([d.scale[chain[0]], epoch[0], epoch[-1], *sums])


def _slopes(sums):
    n, t, x, tt, tx = np.moveaxis(sums[..., 3:], -1, 0)
    return (n * tx - t * x) / (n * tt - t * t)


def _apart(one, others):
    """Return which chains have no dates between the first and the last of another."""
    return (others[:, 1] > one[2]) | (others[:, 2] < one[1])


def _continuation(chain, own, rest, sums, d, settings):
    """
    Return the number of the chain that lies best on one line with another, and both.

    Chains of the same scale, other dates and a similar speed are tried.  None if no
    one lies on a line with it, or if each one that does has another of the same dates
    beside it that does.
    """
    joint = _slopes(own + sums)
    change = np.maximum(abs(_slopes(own) - joint), abs(_slopes(sums) - joint))
    alike = (sums[:, 0] == own[0]) & (change <= settings.same_speed * abs(joint))
    limit = np.array([3 * settings.position_error, settings.across])
    fits = []
    for number in np.flatnonzero(alike & _apart(own, sums)):
        both = np.concatenate([chain, rest[number]])
        both = both[np.argsort(d.epoch[both])]
        off = (_off_line(both, d) / limit).max()
        if off <= 1:
            fits.append((off, number, both))
    for _, number, both in sorted(fits, key=lambda fit: fit[0]):
        others = [k for _, k, _ in fits if k != number]
        if _apart(sums[number], sums[others]).all():
            return number, both
    return None


def _off_line(chosen, d):
    """Return the distances of SSPs from their line along and across the axis."""
    years, position = d.years[d.epoch[chosen]], d.position[chosen]
    velocity, middle, date, _ = line_through(years, position)
    return np.abs(position - middle - (years - date)[:, None] * velocity)


def _feature(chosen, d, settings):
    epoch = d.epoch[chosen]
    return Feature.through(chosen, epoch, d.years[epoch], d.position[chosen], settings)


def different(features, samples, settings):
    """
    Return the features without those near the line of a better one, on any scale.

    Those that were followed from image to image are better than chains, and longer
    ones than shorter ones.

    Parameters
    ----------
    features : sequence of `Feature`
    samples : ``VelocitySamples``
    settings : `~astro_scc.streams.SearchSettings`

    Returns
    -------
    list of `Feature`
    """
    kept, lines, d = [], [], samples

    def rank(feature):
        # Of two equally long ones, the one on the finer scale is blended less.
        scale = 0 if feature.followed else d.scale[feature.ssp[0]]
        return not feature.followed, -len(feature), scale

    for feature in sorted(features, key=rank):
        if lines and not feature.followed:
            years, place = d.years[feature.epoch], d.position[feature.ssp]
            parts = zip(*lines, strict=True)
            velocity, middle, when = (np.array(part)[:, None] for part in parts)
            line = middle + (years - when)[..., None] * velocity
            off = np.median(np.linalg.norm(place - line, axis=-1), axis=1)
            if off.min() < SAME_FEATURE:
                continue
        kept.append(feature)
        lines.append(((feature.speed, feature.across), feature.middle, feature.date))
    return kept
