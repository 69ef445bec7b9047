# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Constants of the search, the displacement-interval diagram, and its mixture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_array

from astro_scc.stacking.velocities import VelocitySamples

#: Relative width of the bins of the intervals; finer ones change nothing.
INTERVAL_STEP = 0.08
#: Relative step of the grid of speeds; a finer one changes nothing.
SPEED_STEP = 0.05
#: Grid points of the displacement in one blur.
POINTS = 4
#: Intervals that always count, in units of the shorter quarter of those between epochs.
SHORT = 2.1


@dataclass(frozen=True, kw_only=True)
class SearchSettings:
    """
    Constants of the search for streams that matter most; lengths are in beams.

    Others, which change little, stand where they are used.

    They were chosen on simulated jets by ``benchmarks/calibration/design.py``,
    with seeds that the calibration does not use.

    Parameters
    ----------
    radius : float
        Largest displacement between any two epochs that is searched: with
        1.5, neighbours one spacing apart seldom match.
    nearest, farthest : float
        Range of displacements that count for a speed: below 0.2 a standing
        feature overlaps itself, beyond 1 chance matches prevail.
    blur : float
        Standard deviation of the densities of the diagram, so wide that
        speeds with a dispersion and features that wander share a ray.
    smoothing : float
        Scatter of the displacements of one feature.
    across : float
        Largest displacement across the flow, three times ``smoothing``.
    slowest : float
        Smallest motion of a speed within the time span: blends of standing
        features whose fluxes vary drift by up to about one beam.
    drift : float
        Motion within the time span up to which a speed counts less, by its root:
        standing features whose fluxes vary slowly blend and drift.
    line : float
        Largest distance of an SSP from the line of its feature.
    position_error : float
        Error of an SSP's position beyond noise, due to blending.
    least_epochs : int
        Smallest number of epochs in which a feature is seen.
    least_motion : float
        Smallest motion of a stream's features while they are seen, added in
        quadrature: three features that move one beam, or one that moves
        farther than blends of standing features drift.
    apart : float
        Smallest difference of two streams, in standard deviations of the
        difference that a flow with ``lone_dispersion`` gives.
    same_speed : float
        Largest relative difference from the tested speed of the features
        that count if the mean of all is not significant, and of the parts of
        a feature before and after a long interval from its speed.
    error_inflation : float
        Ratio of the errors of features to those from their residuals, as
        blends move smoothly; measured on simulated jets.
    lone_dispersion : float
        Standard deviation of the prior of the dispersion relative to the speed, which
        is 0.29 for the sources of MOJAVE XVIII with three features or more that moved
        by more than a beam (root mean square; ``benchmarks/streams.py``).

    Examples
    --------
    >>> from astro_scc.streams import SearchSettings
    >>> SearchSettings().radius
    1.5
    """

    radius: float = 1.5
    nearest: float = 0.2
    farthest: float = 1.0
    blur: float = 0.2
    smoothing: float = 0.12
    across: float = 0.35
    slowest: float = 1.0
    drift: float = 3.0
    line: float = 0.3
    position_error: float = 0.06
    least_epochs: int = 4
    least_motion: float = 1.75
    apart: float = 1.75
    same_speed: float = 0.35
    error_inflation: float = 1.3
    lone_dispersion: float = 0.3


#: Settings that are used if no others are given.
DEFAULT = SearchSettings()


@dataclass(frozen=True, eq=False, repr=False)
class Diagram:
    """
    Density of matches over displacement and interval, beyond chance.

    ``E(d, tau) = sum_(i<j in tau) (H_ij(d) - <H>(d))``, where ``H_ij`` is
    the density of the displacements from the image at date i to that at date
    j, weighted by the correlation coefficient and smoothed.  ``<H>`` is its
    mean over all ordered pairs of different images, because over all
    permutations of the epochs every pair of images falls on every pair of
    dates equally often.  Features of speed v lie on the ray d = v tau.

    Attributes
    ----------
    displacement : `~numpy.ndarray`, shape (n_d,)
        In beams.
    interval : `~numpy.ndarray`, shape (n_tau,)
        Mean interval of each bin, in years.
    n_pairs : `~numpy.ndarray` of int, shape (n_tau,)
        Number of pairs of dates in each bin.
    excess : `~numpy.ndarray`, shape (n_tau, n_d)
    """

    displacement: np.ndarray
    interval: np.ndarray
    n_pairs: np.ndarray
    excess: np.ndarray

    @classmethod
    def of(cls, samples, rays):
        """
        Return the diagram of the epochs in their observed order.

        Parameters
        ----------
        samples : ``VelocitySamples``
        rays : `Rays`

        Returns
        -------
        `Diagram`
        """
        bins, (grid, pairs, mean) = rays.bins, pair_densities(samples, rays)
        (observed,) = bins.sums(pairs, np.arange(len(samples.years))[None])
        return cls(grid, bins.mean, bins.number, observed - bins.number[:, None] * mean)


def pair_densities(samples, rays):
    """
    Return smoothed densities of the displacements of all ordered pairs of images.

    Returned are the displacements, the densities of the pairs, shape (n_epochs^2, n_d),
    and their mean over the pairs of different images.
    """
    d, radius, settings, n = samples, rays.radius, rays.settings, len(samples.years)
    half = int(np.ceil(POINTS * radius / settings.blur))
    step = radius / half
    grid = step * np.arange(-half, half + 1)
    use = (np.abs(d.d2) <= settings.across) & (np.abs(d.d1) <= radius)
    place = (d.d1[use] + radius) / step
    low = np.clip(np.floor(place).astype(int), 0, 2 * half - 1)
    part = place - low
    row = d.reference[use].astype(int) * n + d.target[use]
    flat = np.concatenate([row * len(grid) + low, row * len(grid) + low + 1])
    weight = np.concatenate([d.weight[use] * (1 - part), d.weight[use] * part])
    pairs = np.bincount(flat, weight, n * n * len(grid)).reshape(n, n, -1)
    # Seen from the later image the same motion has the opposite sign.
    pairs = pairs + pairs.transpose(1, 0, 2)[:, :, ::-1]
    kernel = np.exp(-0.5 * ((grid[:, None] - grid) / settings.blur) ** 2)
    pairs = pairs.reshape(n * n, -1) @ kernel
    return grid, pairs, pairs[~np.eye(n, dtype=bool).ravel()].mean(axis=0)


class IntervalBins:
    """Pairs of dates in bins of their interval, of equal relative width."""

    def __init__(self, years, step, intervals):
        self.n_dates = len(years)
        first, second = np.triu_indices(len(years), 1)
        interval = years[second] - years[first]
        use = (interval > 0) & (interval >= intervals[0]) & (interval <= intervals[1])
        self.first, self.second, interval = first[use], second[use], interval[use]
        number = np.floor(np.log(interval / interval.min(initial=np.inf)) / step + 1e-9)
        _, self.bin = np.unique(number, return_inverse=True)
        self.number = np.bincount(self.bin)
        self.mean = np.bincount(self.bin, interval) / self.number

    def sums(self, pairs, orders):
        """Return the densities of pairs summed over bins, (n_orders, n_tau, n_d)."""
        n, n_bins, size = len(orders), len(self.mean), len(self.bin)
        columns = orders[:, self.first] * self.n_dates + orders[:, self.second]
        # Each order has a row for each bin, in which its pairs are together.
        columns = columns[:, np.argsort(self.bin, kind="stable")].ravel()
        ends = np.cumsum(np.tile(self.number, n))
        shape = n * n_bins, self.n_dates**2
        parts = np.ones(n * size), columns, np.concatenate([[0], ends])
        return (csr_array(parts, shape=shape) @ pairs).reshape(n, n_bins, -1)


@dataclass(frozen=True, eq=False, repr=False)
class Rays:
    """
    The speeds that are searched, and the intervals that are used for each.

    Attributes
    ----------
    speed : `~numpy.ndarray`, shape (n_v,)
        In beams/yr, in both directions and evenly spaced in the
        logarithm.  The slowest moves ``slowest`` beams in the whole time, the
        fastest ``radius`` in the shorter quarter of the intervals between
        epochs.
    bins : ``IntervalBins``
    radius : float
        Largest displacement in beams.
    short : float
        Intervals up to this one count in full while the motion is within the radius,
        in years: 2.1 times the shorter quarter of the intervals between epochs.
    intervals : tuple of float
        Shortest and longest interval that is used.
    settings : `~astro_scc.streams.SearchSettings`

    Examples
    --------
    Six epochs in five years allow speeds of one beam in all to 1.5 in one year.
    A speed of half a beam a year is searched in intervals of up to two years:

    >>> import numpy as np
    >>> from astro_scc.streams import SearchSettings
    >>> from astro_scc.streams.diagram import Rays
    >>> rays = Rays.of(np.arange(6.0), 1.5, SearchSettings())
    >>> rays.speed[rays.speed > 0][[0, -1]]
    array([0.2, 1.5])
    >>> rays.bins.mean
    array([1., 2., 3., 4., 5.])
    >>> rays.weight(0.5 * rays.bins.mean, rays.bins.mean)
    array([1., 1., 0., 0., 0.])
    """

    speed: np.ndarray
    bins: IntervalBins
    radius: float
    short: float
    intervals: tuple[float, float]
    settings: SearchSettings

    @classmethod
    def of(
        cls, years: np.ndarray, radius: float, settings: SearchSettings,
        fastest: float = np.inf, intervals: tuple[float, float] = (0.0, np.inf),
    ) -> Rays:  # fmt: skip
        """
        Return the rays for some dates.

        Parameters
        ----------
        years : `~numpy.ndarray`, shape (n_epochs,)
        radius : float
        settings : `~astro_scc.streams.SearchSettings`
        fastest : float, optional
            Largest speed.
        intervals : tuple of float, optional

        Returns
        -------
        `Rays`

        Raises
        ------
        ValueError
            If the separations of no two epochs lie within ``intervals``.
        """
        bins = IntervalBins(years, INTERVAL_STEP, intervals)
        if len(bins.mean) == 0:
            raise ValueError(
                f"no two epochs are {intervals[0]:g} to {intervals[1]:g} yr apart"
            )
        gaps = np.diff(years)
        gaps = gaps[(gaps > 0) & (gaps >= intervals[0]) & (gaps <= intervals[1])]
        used = bins.mean.min() if len(gaps) == 0 else np.quantile(gaps, 0.25)
        longest = min(years[-1] - years[0], intervals[1])
        fastest = min(radius / used, fastest)
        slowest = min(settings.slowest / longest, 0.25 * fastest)
        n = int(np.ceil(np.log(fastest / slowest) / SPEED_STEP))
        speed = slowest * (fastest / slowest) ** (np.arange(n + 1) / n)
        speed = np.concatenate([-speed[::-1], speed])
        return cls(speed, bins, radius, SHORT * used, intervals, settings)

    def weight(self, motion: ArrayLike, interval: ArrayLike) -> np.ndarray:
        """
        Return the weights of intervals, by the motion of a speed in them.

        Parameters
        ----------
        motion, interval : array_like
            Displacement in beams, and interval in years.

        Returns
        -------
        `~numpy.ndarray`
            Between 0 and 1.
        """
        settings = self.settings
        motion, interval = np.abs(motion), np.abs(interval)
        soft = 0.25 * settings.nearest
        near = np.clip((motion - settings.nearest) / (2 * soft) + 0.5, 0, 1)
        far = np.clip((settings.farthest - motion) / (4 * soft) + 0.5, 0, 1)
        # With one interval alone, a speed that moves near the limit would be lost.
        far = np.where((interval <= self.short) & (motion <= self.radius), 1.0, far)
        used = (interval >= self.intervals[0]) & (interval <= self.intervals[1])
        return near * far * used

    def matrix(self, speed: np.ndarray, grid: np.ndarray) -> csr_array:
        """
        Return the matrix that sums a diagram over rays.

        Parameters
        ----------
        speed : `~numpy.ndarray`, shape (n_v,)
        grid : `~numpy.ndarray`, shape (n_d,)
            Displacements of the diagram.

        Returns
        -------
        `~scipy.sparse.csr_array`, shape (n_v, n_tau * n_d)
        """
        interval = self.bins.mean
        motion = speed[:, None] * interval
        weight = self.weight(motion, interval)
        step, n = grid[1] - grid[0], len(grid)
        place = (np.clip(motion, grid[0], grid[-1]) - grid[0]) / step
        low = np.minimum(np.floor(place).astype(int), n - 2)
        part = place - low
        row, column = np.nonzero(weight)
        cell = column * n + low[row, column]
        value, part = weight[row, column], part[row, column]
        values = np.concatenate([value * (1 - part), value * part])
        where = np.concatenate([row, row]), np.concatenate([cell, cell + 1])
        return csr_array((values, where), shape=(len(speed), len(interval) * n))


#: Motions in beams between which shares and widths are the same.
BINS = np.array([0.0, 0.35, 0.7, 1.2, 1.7, 2.5])
#: Smallest and largest standard deviation of displacements in beams, and the first.
WIDTHS, FIRST_WIDTH = (0.12, 0.4), 0.25
#: Smallest and largest share of SSPs with a true match, and the first.
SHARES, FIRST_SHARE = (0.02, 0.8), 0.4
#: Displacements across the axis that are considered, in beams.
ACROSS = 0.6
#: Motions in beams that affect a speed, whatever the interval.
NEAR = 1.2
#: Steps, and relative change of the speeds at which they end.
STEPS, TOLERANCE = 40, 1e-4


def fit_mixture(
    samples: VelocitySamples, speeds: ArrayLike, rays: Rays
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    r"""
    Fit streams, one at rest and unrelated matches to all matches together.

    Of the matches of an SSP in an image at most one is true, and it belongs to one
    stream, or to what is at rest.  The odds of a match with displacement d over the
    interval t to be a true one of stream k are

    .. math:: \frac{\pi_k}{1 - \pi_k} \left(\frac{c}{\bar c}\right)^2
              \frac{\mathcal N_2(d - v_k t,\ s_k^2)}{\lambda},

    where c is its correlation coefficient and lambda the density of unrelated matches;
    over all streams and matches of the SSP in that image, and none, they are normalised
    to one.  Shares pi and widths s, which depend on the motion, and speeds v are
    found by expectation maximisation (Dempster et al. 1977, J. R. Stat. Soc. B 39, 1).

    Parameters
    ----------
    samples : ``VelocitySamples``
        Along one axis, in beams.
    speeds : sequence of float
        From which the fit starts, in beams/yr.
    rays : ``Rays``

    Returns
    -------
    speed : `~numpy.ndarray`, shape (k,)
        Of each stream, in beams/yr.
    match : `~numpy.ndarray` of int, shape (n,)
        Indices of the matches that are considered.
    membership : `~numpy.ndarray`, shape (k, n)
        Probability of each match to be a true one of each stream; zero where a match
        is no measure of the stream's speed.
    width : `~numpy.ndarray`, shape (k, n)
        Standard deviation of the displacements in beams.
    """
    d, radius = samples, rays.radius
    interval = np.abs(d.interval)
    speeds = np.atleast_1d(np.asarray(speeds, dtype=float))
    slowest = np.abs(speeds).min()
    use = (np.abs(d.d2) <= ACROSS) & (np.abs(d.d1) <= radius) & (interval > 0)
    use &= (interval >= rays.intervals[0]) & (interval <= rays.intervals[1])
    # Where every stream has left the search radius, nothing is learnt.
    use &= (slowest * interval <= radius) | (interval <= rays.short)
    match = np.flatnonzero(use)
    sense = np.sign(d.interval[match])
    x, y, dt = d.d1[match] * sense, d.d2[match] * sense, interval[match]
    if len(match) == 0:
        none = np.zeros((len(speeds), 0))
        return speeds, match, none, none
    # One source of matches for each SSP and image.
    key = d.ssp[match].astype(np.int64) * len(d.years) + d.target[match]
    _, source = np.unique(key, return_inverse=True)
    n = int(source.max()) + 1
    density = len(match) / n / (4 * radius * ACROSS)
    quality = (d.weight[match] / d.weight[match].mean()) ** 2
    y_square, dt_square, x_dt = y**2, dt**2, x * dt
    v = np.array([*speeds, 0.0])
    k, n_bins = len(v), len(BINS)
    share, width = np.full((k, n_bins), FIRST_SHARE), np.full((k, n_bins), FIRST_WIDTH)
    for _ in range(STEPS):
        motion = v[:, None] * dt
        bins = np.digitize(np.abs(motion), BINS) - 1
        inside = np.abs(motion) <= radius
        s = np.take_along_axis(width, bins, axis=1)
        pi = np.where(inside, np.take_along_axis(share, bins, axis=1), 0.0)
        away = (x - motion) ** 2 + y_square
        odds = pi / (1 - pi) * quality * np.exp(-0.5 * away / s**2)
        odds /= 2 * np.pi * s**2 * density
        member = odds / (1 + np.bincount(source, odds.sum(axis=0), n))[source]
        tells = (np.abs(motion) <= NEAR) | ((dt <= rays.short) & inside)
        weight = np.where(tells, member, 0.0) / s**2
        moments = weight @ dt_square
        new = np.divide(weight @ x_dt, moments, out=v.copy(), where=moments > 0)
        new[-1] = 0.0
        for row in range(k):
            # Sources of each bin, sums of memberships and of squares.
            own = bins[row]
            seen = np.zeros(n_bins * n, dtype=bool)
            seen[own * n + source] = True
            number = np.count_nonzero(seen.reshape(n_bins, n), axis=1)
            total = np.bincount(own, member[row], n_bins)
            square = np.bincount(own, member[row] * away[row], n_bins)
            some = total > 1
            share[row, some] = np.clip(total[some] / number[some], *SHARES)
            spread = np.sqrt(square[some] / total[some] / 2)
            width[row, some] = np.clip(spread, *WIDTHS)
        change = np.abs(new - v)[:-1]
        done = (change <= TOLERANCE * np.abs(v[:-1])).all()
        v = new
        if done:
            break
    return v[:-1], match, np.where(tells, member, 0.0)[:-1], s[:-1]
