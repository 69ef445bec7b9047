# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features: SSPs that follow a straight line through the epochs."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from astro_scc.stacking.search_settings import DEFAULT, SearchSettings


@dataclass(frozen=True, eq=False)
class Feature:
    """
    SSPs of one scale on a straight line in time.

    Attributes
    ----------
    ssp : `~numpy.ndarray` of int, shape (n_epochs,)
        Indices of the SSPs, in the order of the epochs.
    speed, error : float
        Speed along the axis, in beams/yr, and its standard error.
    across, across_error : float
        The same across the axis.
    place : float
        Mean position along the axis, in beams.
    motion : float
        Motion while the feature is seen, in beams.
    response : `~numpy.ndarray`, shape (n_epochs,)
        Change of the speed for a displacement of each SSP by one beam.
    acceleration, acceleration_error : float
        Acceleration along the axis, in beams/yr^2, from a parabola; NaN with
        fewer than five SSPs.
    pulled : bool
        Whether standing features are so close that they affect the speed.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Feature
    >>> years = np.array([0.0, 1.0, 2.0])
    >>> place = np.array([[1.0, 0.0], [1.5, 0.0], [2.0, 0.0]])
    >>> Feature.through(np.arange(3), years, place).speed
    0.5
    """

    ssp: np.ndarray
    speed: float
    error: float
    across: float
    across_error: float
    place: float
    motion: float
    response: np.ndarray
    acceleration: float = np.nan
    acceleration_error: float = np.nan
    pulled: bool = False

    def __len__(self) -> int:
        return len(self.ssp)

    @classmethod
    def through(
        cls, ssp: np.ndarray, years: np.ndarray, position: np.ndarray,
        settings: SearchSettings = DEFAULT,
    ) -> Feature:  # fmt: skip
        """
        Fit a straight line to the positions of SSPs.

        The variance of a position is that of the residuals, drawn towards the
        square of ``position_error`` in the settings, which counts as three more
        measurements.

        Parameters
        ----------
        ssp : `~numpy.ndarray` of int, shape (n,)
        years : `~numpy.ndarray`, shape (n,)
        position : `~numpy.ndarray`, shape (n, 2)
        settings : `~astro_scc.stacking.SearchSettings`, optional

        Returns
        -------
        `Feature`
        """
        time = years - years.mean()
        response = time / (time @ time)
        velocity = response @ position
        left = position - position.mean(axis=0) - time[:, None] * velocity

        def variance(left, n_parameters):
            prior = settings.prior_freedom
            total = (left**2).sum(axis=0) + prior * settings.position_error**2
            return total / (max(len(ssp) - n_parameters, 0) + prior)

        error = np.sqrt(variance(left, 2) * (response @ response))
        bend = bend_error = np.nan
        if len(ssp) >= settings.accelerated_epochs:
            design = np.stack([np.ones(len(ssp)), time, time**2 / 2], axis=1)
            inverse = np.linalg.inv(design.T @ design)
            curve = inverse @ design.T @ position[:, 0]
            left = position[:, 0] - design @ curve
            bend, bend_error = curve[2], np.sqrt(inverse[2, 2] * variance(left, 3))
        return cls(
            ssp=ssp,
            speed=float(velocity[0]),
            error=float(error[0]),
            across=float(velocity[1]),
            across_error=float(error[1]),
            place=float(position[:, 0].mean()),
            motion=float(abs(velocity[0]) * np.ptp(years)),
            response=response,
            acceleration=float(bend),
            acceleration_error=float(bend_error),
        )


def find_features(samples, rays, settings, prior):
    """
    Find features that move, each with its own speed.

    For each SSP and speed, the excess is the sum of its matches on the ray of
    that speed less the sum expected under permutations of the epochs.  The SSP
    with the largest excess begins a feature.  The SSPs to which its matches
    lead along the ray join it, and those to which their matches lead, as long
    as they lie on one line.  Then the next feature begins with the remaining
    SSPs.  Where two epochs are so far apart that the feature moves beyond the
    search radius, no match leads from one to the other: parts of one line before
    and after such a gap are joined.

    Parameters
    ----------
    samples : `~astro_scc.stacking.VelocitySamples`
    rays : `~astro_scc.stacking.Rays`
    settings : `~astro_scc.stacking.SearchSettings`
    prior : callable
        Returns weights between 0 and 1 for an array of speeds.

    Returns
    -------
    list of `Feature`
        A feature that is seen on several scales is there only once.
    """
    d = samples
    keep = (np.abs(d.d2) <= settings.across) & (np.abs(d.d1) <= rays.radius)
    keep &= (d.target_ssp >= 0) & (d.interval != 0)
    links = _Links.of(d.select(keep))
    if len(links.ssp) == 0:
        return []
    speeds = _speeds(rays)
    excess = _excess(links, d, speeds, rays) * prior(speeds)
    best, fastest = excess.max(axis=1), speeds[excess.argmax(axis=1)]
    seeds = np.argsort(-best, kind="stable")
    seeds = seeds[best[seeds] >= settings.least_score]
    found = []
    chains = list(_chains(seeds, fastest, links, d, settings))
    for chosen in _joined(chains, d, settings):
        first, last = d.epoch[chosen[0]], d.epoch[chosen[-1]]
        least = max(settings.least_epochs, settings.least_share * (last - first + 1))
        if len(chosen) >= least:
            found.append(_feature(chosen, d, settings))
    return _different(found, d, settings)


def standing_features(samples, settings):
    """
    Find features that stand still in at least half of the epochs.

    Parameters
    ----------
    samples : `~astro_scc.stacking.VelocitySamples`
    settings : `~astro_scc.stacking.SearchSettings`

    Returns
    -------
    list of `Feature`
        Their speeds are at most two standard errors.
    """
    d = samples
    close = (np.hypot(d.d1, d.d2) <= settings.nearest) & (d.target_ssp >= 0)
    # Images of the same date say nothing about motion.
    close &= d.interval != 0
    links = _Links.of(d.select(close))
    least = max(settings.least_epochs, len(d.years) / 2)
    number = np.diff(links.start)
    seeds = np.argsort(-number, kind="stable")
    seeds = seeds[number[seeds] + 1 >= least]
    chains = _chains(seeds, np.zeros(len(d.epoch)), links, d, settings)
    found = [_feature(k, d, settings) for k in chains if len(k) >= least]
    found = [f for f in found if abs(f.speed) <= 2 * f.error]
    return _different(found, d, settings)


def clear_of(features, standing, samples, settings):
    """
    Fit features again without the SSPs near a standing feature.

    Parameters
    ----------
    features, standing : sequence of `Feature`
    samples : `~astro_scc.stacking.VelocitySamples`
    settings : `~astro_scc.stacking.SearchSettings`

    Returns
    -------
    list of `Feature`
        With the same SSPs, but those within ``pull`` of a standing feature do not
        affect the speed.  A feature with fewer than ``least_epochs`` other SSPs is
        ``pulled``.
    """
    if not standing:
        return list(features)
    d = samples
    places = np.array([d.position[f.ssp].mean(axis=0) for f in standing])
    found = []
    for f in features:
        away = np.hypot(*(d.position[f.ssp][:, None] - places).T).min(axis=0)
        clear = away > settings.pull
        if clear.all():
            found.append(f)
            continue
        if clear.sum() < settings.least_epochs:
            found.append(replace(f, pulled=True))
            continue
        part = _feature(f.ssp[clear], d, settings)
        response = np.zeros(len(f))
        response[clear] = part.response
        found.append(replace(part, ssp=f.ssp, motion=f.motion, response=response))
    return found


@dataclass(frozen=True, eq=False)
class _Links:
    """Matches in both directions, sorted by the SSP from which they start."""

    ssp: np.ndarray
    to: np.ndarray
    along: np.ndarray
    weight: np.ndarray
    interval: np.ndarray
    start: np.ndarray

    @classmethod
    def of(cls, d):
        ssp = np.concatenate([d.ssp, d.target_ssp])
        to = np.concatenate([d.target_ssp, d.ssp])
        along = np.concatenate([d.d1, -d.d1])
        weight = np.concatenate([d.weight, d.weight])
        order = np.argsort(ssp, kind="stable")
        ssp, to = ssp[order], to[order]
        interval = d.years[d.epoch[to]] - d.years[d.epoch[ssp]]
        start = np.searchsorted(ssp, np.arange(len(d.epoch) + 1))
        return cls(ssp, to, along[order], weight[order], interval, start)

    def of_ssps(self, ssps):
        """Return the indices of the links from some SSPs."""
        parts = [np.arange(self.start[s], self.start[s + 1]) for s in ssps]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=int)


def _speeds(rays):
    """Return the speeds of single features, a wider range than those of streams."""
    fastest, slowest = 1.1 * rays.speed.max(), 0.5 * np.abs(rays.speed).min()
    n = int(np.ceil(np.log(fastest / slowest) / rays.settings.feature_speed_step))
    speed = slowest * (fastest / slowest) ** (np.arange(n + 1) / n)
    return np.concatenate([-speed[::-1], speed])


def _excess(links, d, speeds, rays):
    """Return the excess of each SSP's matches on rays over permutations."""
    n, n_epochs, sigma = len(d.epoch), len(d.years), rays.settings.smoothing
    step = sigma / 2
    half = np.ceil(rays.radius / step) + 2
    grid = np.arange(-half, half + 1) * step
    cell = np.rint((links.along - grid[0]) / step).astype(int)
    density = np.zeros((n, len(grid)))
    np.add.at(density, (links.ssp, cell), links.weight)
    kernel = np.exp(-0.5 * ((grid[:, None] - grid) / sigma) ** 2)
    density = density @ kernel / (n_epochs - 1)
    found = np.zeros((n, len(speeds)))
    interval = d.years[:, None] - d.years
    for k, speed in enumerate(speeds):
        expected = speed * links.interval
        weight = rays.weight(expected, links.interval)
        use = np.flatnonzero(weight)
        value = weight[use] * links.weight[use]
        value *= np.exp(-0.5 * ((links.along[use] - expected[use]) / sigma) ** 2)
        found[:, k] = np.bincount(links.ssp[use], value, n)
        # Weight of each displacement cell from each date, summed over all others.
        motion = speed * interval
        share = np.where(interval == 0, 0.0, rays.weight(motion, interval))
        cells = np.rint((np.clip(motion, grid[0], grid[-1]) - grid[0]) / step)
        chance = np.zeros((n_epochs, len(grid)))
        row = np.broadcast_to(np.arange(n_epochs), interval.shape)
        np.add.at(chance, (row, cells.astype(int)), share)
        found[:, k] -= np.einsum("sg,sg->s", density, chance[d.epoch])
    return found


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
    across = 0.0
    while front:
        index = links.of_ssps(front)
        index = index[free[links.to[index]]]
        off = links.along[index] - speed * links.interval[index]
        near = np.abs(off) <= 2 * settings.smoothing
        index, off = index[near], off[near]
        to = links.to[index]
        time = d.years[d.epoch[to]] - when
        line = here + np.stack([speed * time, across * time], axis=1)
        away = np.abs(d.position[to] - line)
        new = ~np.isin(d.epoch[to], list(members)) & np.all(
            away <= (settings.line, settings.across), axis=1
        )
        to, off, index = to[new], off[new], index[new]
        value = links.weight[index] * np.exp(-0.5 * (off / settings.smoothing) ** 2)
        which, inverse = np.unique(to, return_inverse=True)
        total = np.bincount(inverse, value, len(which))
        front = []
        for k in np.argsort(-total, kind="stable"):
            epoch = int(d.epoch[which[k]])
            if epoch not in members:
                members[epoch] = int(which[k])
                front.append(int(which[k]))
        if len(members) >= 3:
            (speed, across), here, when = _line(np.array(list(members.values())), d)
    return np.array([members[epoch] for epoch in sorted(members)])


def _line(chosen, d):
    """Return the velocity, the mean position and the mean date of some SSPs."""
    years, place = d.years[d.epoch[chosen]], d.position[chosen]
    time = years - years.mean()
    return time @ place / (time @ time), place.mean(axis=0), years.mean()


def _on_line(chosen, d, settings):
    """Return the SSPs of a chain without those that lie off its line."""
    for _ in range(3):
        if len(chosen) <= settings.least_epochs:
            break
        off = _off_line(chosen, _line(chosen, d), d)[:, 0]
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
        while rest:
            same = np.flatnonzero(_of_one_speed(own, sums, settings))
            found = _continuation(chain, same, rest, d, settings)
            if found is None:
                break
            number, chain = found
            del rest[number]
            own, sums = _sums(chain, d), np.delete(sums, number, axis=0)
        yield chain


def _sums(chain, d):
    """Return scale, first and last epoch of a chain, and the sums of its slope."""
    epoch = d.epoch[chain]
    t, x = d.years[epoch] - d.years[0], d.position[chain, 0]
    ends = d.scale[chain[0]], epoch[0], epoch[-1]
    return np.array([*ends, len(t), t.sum(), x.sum(), t @ t, t @ x])


def _slopes(sums):
    n, t, x, tt, tx = np.moveaxis(sums[..., 3:], -1, 0)
    return (n * tx - t * x) / (n * tt - t * t)


def _of_one_speed(one, others, settings):
    """Return which chains have another's scale, other dates and a similar speed."""
    apart = (others[:, 1] > one[2]) | (others[:, 2] < one[1])
    joint = _slopes(one + others)
    change = np.maximum(abs(_slopes(one) - joint), abs(_slopes(others) - joint))
    return (
        apart & (others[:, 0] == one[0]) & (change <= settings.same_speed * abs(joint))
    )


def _continuation(chain, numbers, rest, d, settings):
    """
    Return the number of the chain that lies best on one line with another, and both.

    None if there is none, or if each one that does has another of the same dates
    beside it that does.
    """
    limit = np.array([3 * settings.position_error, settings.across])
    fits = []
    for number in numbers:
        both = _in_order(chain, rest[number], d)
        off = (_off_line(both, _line(both, d), d) / limit).max()
        if off <= 1:
            fits.append((off, number, both))
    for _, number, both in sorted(fits, key=lambda fit: fit[0]):
        others = (rest[k] for _, k, _ in fits if k != number)
        if all(_in_order(rest[number], k, d) is not None for k in others):
            return number, both
    return None


def _in_order(chain, other, d):
    """Return the SSPs of two chains in the order of time, None if dates overlap."""
    if d.epoch[other[0]] < d.epoch[chain[0]]:
        chain, other = other, chain
    apart = d.epoch[chain[-1]] < d.epoch[other[0]]
    return np.concatenate([chain, other]) if apart else None


def _off_line(chosen, line, d):
    """Return the distances of SSPs from a line along and across the axis."""
    velocity, middle, when = line
    time = d.years[d.epoch[chosen]] - when
    return np.abs(d.position[chosen] - middle - time[:, None] * velocity)


def _feature(chosen, d, settings):
    years, place = d.years[d.epoch[chosen]], d.position[chosen]
    return Feature.through(chosen, years, place, settings)


def _different(features, d, settings):
    """Return the features without those near the line of a longer one, on any scale."""
    kept, lines = [], []
    # Of two features of equal length, the one on the finer scale is blended less.
    for feature in sorted(features, key=lambda f: (-len(f), d.scale[f.ssp[0]])):
        years, place = d.years[d.epoch[feature.ssp]], d.position[feature.ssp]
        if lines:
            when, middle, velocity = (
                np.array(part)[:, None] for part in zip(*lines, strict=True)
            )
            line = middle + (years - when)[..., None] * velocity
            off = np.median(np.linalg.norm(place - line, axis=-1), axis=1)
            if off.min() < settings.same_feature:
                continue
        kept.append(feature)
        lines.append(
            (years.mean(), place.mean(axis=0), (feature.speed, feature.across))
        )
    return kept
