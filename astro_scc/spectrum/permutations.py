# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Whether anything moves along the flow: permutations of innovations."""

from dataclasses import dataclass
from itertools import permutations, product
from math import factorial, prod

import numpy as np

from astro_scc.intervals import median_interval, without_short
from astro_scc.spectrum.diagram import LEAST_NORM, LEAST_OVERLAP, TINY

#: Length in beams over which features keep their shape.
LENGTH = 3.0
#: Slowest and fastest speed: beams in the whole time, and beams in the shorter quarter
#: of the intervals.
SLOWEST, FASTEST = 0.5, 2.0
#: All intervals between dates, in years.
EVERY = 0.0, np.inf
#: Weight of speeds towards the core, against the flow, relative to those away from it.
INWARD = 0.1
#: A second stream is searched beyond this factor from the speed of the first: with 1.3,
#: one in twenty features of one stream is.
BEYOND = 2.0
#: The test compares displacements up to this share of the largest.
TESTED = 0.8
#: Variance by which two epochs of one date differ at least.
SAME = 1e-9
#: White shares of the variance that are tried.
WHITE = (0.0, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8)


@dataclass(frozen=True, eq=False, repr=False)
class MotionTest:
    """
    The permutation test for motion along one or several directions.

    Attributes
    ----------
    speed : `~numpy.ndarray`, shape (n_v,)
        Speeds that were tested, in beams/yr; negative ones are towards the origin.
    z : `~numpy.ndarray`, shape (n_directions, n_v)
        The part of the diagram that is odd under reversal of time, at each speed, in
        standard deviations of the permutations.
    p_local, p_speed : `~numpy.ndarray`, shape (n_directions, n_v)
        Share of permutations with as large a z at this speed, and at any speed.
    p_global : float
        Share of permutations with as large a mean of ``exp(z^2 / 2)`` over all speeds.
    p_smallest : float
        Smallest p-value that permutations and epochs allow.
    level : float
        The largest z of 99% of the permutations, which figures show.
    amplitude : `~numpy.ndarray`, shape (n_directions, n_v)
        Share of the variance of the images that moves with each speed.
    gram, scores : `~numpy.ndarray`, shapes (n_v, n_v) and (n_orders, n_v)
        Products of the filters of two speeds, and sums over the filters for each order,
        in the direction of the largest z.
    memory, white : float
        Time over which the images are correlated, in years, and the share of their
        variance without memory, in the direction of the largest z.
    """

    speed: np.ndarray
    z: np.ndarray
    p_local: np.ndarray
    p_speed: np.ndarray
    p_global: float
    p_smallest: float
    level: float
    memory: float
    white: float
    amplitude: np.ndarray
    gram: np.ndarray
    scores: np.ndarray

    @property
    def best(self) -> tuple[int, int]:
        """
        The direction and the speed of the motion.

        Of directions with nearly the largest z, that in which most of the images
        moves: structures that are elongated look alike in several.
        """
        return _best(self.z, self.amplitude)

    @property
    def clearest(self) -> float:
        """The speed at which motion is clearest, in the best direction."""
        return float(self.speed[self.best[1]])

    def beside(self, speed, least):
        """
        Test for a second stream, with the projection on the first taken out.

        Parameters
        ----------
        speed : float
            Speed of the first stream, in beams/yr.
        least : float
            Smallest difference of the speeds, in beams/yr.

        Returns
        -------
        speed, p_value : float
            Of the second stream; NaN and 1 if no other speed was tested.
        """
        v, scores = self.speed, self.scores
        near = (v * speed > 0) & (v / speed > 1 / BEYOND) & (v / speed < BEYOND)
        near |= np.abs(v - speed) < least
        if near.all() or not near.any():
            return np.nan, 1.0
        gram = self.gram[np.ix_(near, ~near)]
        inside = self.gram[np.ix_(near, near)]
        take = np.linalg.solve(inside + 0.01 * np.eye(near.sum()), gram)
        left = np.sqrt(np.maximum(1 - (take * gram).sum(axis=0), 0.05))
        z = standardised((scores[:, ~near] - scores[:, near] @ take) / left)
        k = int(z[0].argmax())
        return float(v[~near][k]), share_of_larger(z.max(axis=1))


def _best(z, amplitude, nearly=0.8):
    """
    Return the direction and the speed of the motion, see `MotionTest.best`.

    ``nearly`` is the part of the largest z from which directions are alike.
    """
    speed = z.argmax(axis=1)
    every = np.arange(len(z))
    top, moved = z[every, speed], amplitude[every, speed]
    direction = int(np.where(top >= nearly * top.max(), moved, -np.inf).argmax())
    return direction, int(speed[direction])


def memory_of(years, zero, *, shortest=0.3, longest=2.0, number=24):
    """
    Return the correlation of the epochs over time, by restricted maximum likelihood.

    The correlation of a place with itself is modelled by
    ``C(tau) = (1 - g) exp(-tau / T) + g [tau = 0]``.  Its likelihood is that of the
    differences between epochs, as the mean is not known.

    Parameters
    ----------
    years : `~numpy.ndarray`, shape (n,)
    zero : `~numpy.ndarray`, shape (n, n)
        The diagram at zero displacement.
    shortest, longest : float, optional
        Times that are tried, in median intervals and in the whole time.
    number : int, optional
        How many times are tried.

    Returns
    -------
    T, g : float
    factor : `~numpy.ndarray`, shape (n - 1, n - 1)
        Cholesky factor of the covariance of the differences.
    """
    n, tau = len(years), np.abs(years[:, None] - years)
    differ = difference_matrix(n)
    # In these combinations of the epochs the white part is white.
    whiten = np.linalg.inv(np.linalg.cholesky(differ @ differ.T)) @ differ
    data, best = whiten @ zero @ whiten.T, (np.inf,)
    shortest, longest = shortest * median_interval(years), longest * np.ptp(years)
    times = np.geomspace(shortest, longest, number)
    for time in (0.0, *times):
        decay = np.exp(-tau / time) if time else np.eye(n)
        variance, axes = np.linalg.eigh(whiten @ decay @ whiten.T)
        power = np.einsum("ij,ij->j", axes, data @ axes)
        for white in WHITE if time else (0.0,):
            expected = (1 - white) * np.maximum(variance, SAME) + white
            log = np.log(expected).sum()
            log += (n - 1) * np.log(max((power / expected).sum(), TINY))
            if log < best[0] - 1e-9:
                best = log, time, white, (1 - white) * decay + white * np.eye(n)
    covariance = differ @ best[-1] @ differ.T
    jitter = SAME * np.trace(covariance) / len(covariance)
    factor = np.linalg.cholesky(covariance + jitter * np.eye(len(covariance)))
    return *best[1:-1], factor


def difference_matrix(n):
    """Return the matrix of the differences of all epochs from the first, (n - 1, n)."""
    return np.eye(n)[1:] - np.eye(n)[:1]


def within(interval, limits):
    """Return which intervals lie in a range; rounded limits lose none."""
    low, high = limits
    return (interval >= low * (1 - 1e-3)) & (interval <= high * (1 + 1e-3))


def fastest_speed(years, intervals=EVERY):
    """Return the speed of two beams in the shorter quarter of the intervals."""
    gaps = np.diff(years)
    gaps = without_short(gaps[within(gaps, intervals)])
    if len(gaps) == 0:
        every = np.abs(years - years[:, None])
        every = every[(every > 0) & within(every, intervals)]
        gaps = every[:0] if len(every) == 0 else np.array([every.min()])
    return FASTEST / np.quantile(gaps, 0.25) if len(gaps) else FASTEST / np.ptp(years)


def speeds_tested(years, fastest=None, intervals=EVERY, spacing=0.35):
    """
    Return the speeds that are tested, in beams/yr.

    From half a beam in the whole time to two beams in the shorter quarter of the
    intervals, or to ``fastest`` if that is given, in steps of ``spacing`` beams at the
    end of the way.
    """
    span = min(np.ptp(years), intervals[1])
    top = fastest_speed(years, intervals) if fastest is None else fastest
    speeds = [SLOWEST / span, (SLOWEST + 1) / 2 / span, 1 / span]
    while speeds[-1] < top:
        speeds.append(speeds[-1] + spacing * max(1 / span, speeds[-1] / LENGTH))
    if fastest is not None:
        speeds = [*(speed for speed in speeds if speed < fastest), fastest]
    return np.array(speeds)


def orders_of(gaps, n_trials, rng):
    """
    Return the observed order of the innovations first, and permutations of it.

    Inside of a pair or campaign of epochs an innovation is noise, after a long gap it
    is a change of the structure, so both kinds are permuted apart.
    """
    kinds = _kinds_of(gaps)
    if number_of_orders(gaps) <= n_trials + 1:
        drawn = list(product(*map(permutations, kinds)))
    else:
        drawn = [[rng.permutation(kind) for kind in kinds] for _ in range(n_trials)]
        drawn.insert(0, kinds)
    orders = np.empty((len(drawn), len(gaps)), dtype=int)
    orders[:, np.concatenate(kinds)] = [np.concatenate(each) for each in drawn]
    return orders


def number_of_orders(gaps):
    """Return how many orders of the innovations there are, see `orders_of`."""
    return prod(factorial(len(kind)) for kind in _kinds_of(gaps))


def _kinds_of(gaps):
    """Return which gaps are long, and which are those of pairs or campaigns."""
    short = gaps < min(without_short(gaps), default=0.0)
    return np.flatnonzero(~short), np.flatnonzero(short)


def autocorrelation(diagram, farthest=2.2):
    """Return the images' own correlation at displacements up to so many beams."""
    epochs = np.arange(len(diagram.years))
    correlation = diagram.means[epochs, epochs].mean(axis=0).astype(float)
    correlation = (correlation + correlation[::-1]) / 2
    peak = correlation[diagram.zero]
    if not peak > 0:
        return np.zeros_like(correlation)
    return np.where(np.abs(diagram.displacement) <= farthest, correlation / peak, 0.0)


def permutation_test(
    diagrams, *, fastest=None, intervals=EVERY, n_trials=1000, inward=INWARD, rng
):
    """
    Test whether anything moves along the flow.

    If nothing moves, each epoch differs from its best linear prediction from all
    earlier epochs by an innovation, and the order of the innovations does not matter;
    that of the epochs does, as their fluxes have a memory.  Let B be the matrix of the
    innovations, each divided by its norm, and ``U = B (D - D') B'`` the part of the
    diagram that is odd under reversal of time.  For each speed v,

    .. math:: z(v) = \\frac{\\langle F_v, U \\rangle}{\\sigma},\\quad
       F_v = B [R(d - v\\tau) - R(d + v\\tau)] e^{-|v\\tau|/l} B' \\, S^{-1},

    where R is the images' own correlation, l three beams, S the scatter of U over the
    displacements, and the standard deviation is that of the permutations.

    Parameters
    ----------
    diagrams : sequence of ``Diagram``
        One per direction, of the same epochs.
    fastest : float, optional
        Largest speed in beams/yr.
    intervals : (float, float), optional
        Shortest and longest interval that is expected to show motion, in years.
    n_trials : int, optional
        All permutations are taken if they are not more.
    inward : float, optional
        Weight of speeds towards the origin; 1 if no direction is preferred, 0 for
        outward speeds alone.
    rng : `~numpy.random.Generator`

    Returns
    -------
    `MotionTest`
    """
    years = diagrams[0].years
    speed = speeds_tested(years, fastest, intervals)
    orders = orders_of(np.diff(years), n_trials, rng)
    parts = (_scores(one, speed, orders, intervals) for one in diagrams)
    found, grams, shares, memories, whites = zip(*parts, strict=True)
    z = np.array([standardised(scores) for scores in found])
    both = np.concatenate([z, -z], axis=2)
    weight = np.repeat([1.0, inward], len(speed))
    excess = np.exp(np.clip(both, 0, 30) ** 2 / 2)
    evidence = np.log((excess * weight).mean(axis=(0, 2)))
    both = both[:, :, np.repeat([True, inward > 0], len(speed))]
    signs = (1, -1) if inward > 0 else (1,)
    largest = both.max(axis=(0, 2))
    amplitude = np.concatenate([s * np.array(shares) for s in signs], axis=1)
    k, _ = _best(both[:, 0], amplitude)
    scores = np.concatenate([s * found[k] for s in signs], axis=1)
    gram = np.kron(np.outer(signs, signs), grams[k])
    return MotionTest(
        speed=np.concatenate([s * speed for s in signs]),
        z=both[:, 0],
        p_local=(both >= both[:, :1]).mean(axis=1),
        p_speed=(largest[None, :, None] >= both[:, :1]).mean(axis=1),
        p_global=share_of_larger(evidence),
        p_smallest=1 / len(orders),
        level=float(np.quantile(largest[1:], 0.99)),
        memory=memories[k],
        white=whites[k],
        amplitude=amplitude,
        gram=gram,
        scores=scores,
    )


def standardised(scores, floor=0.1):
    """
    Return scores in standard deviations of those of all other orders.

    The observed order is one of equals only if each is compared with the others; left
    out of its own scatter alone, it would seem too large.  To each standard deviation a
    part of the mean over the speeds is added, the ``floor``.
    """
    square = scores**2
    others = np.maximum(square.sum(axis=0) - square, 0.0)
    scatter = np.sqrt(others / (len(scores) - 1))
    scatter += floor * scatter.mean(axis=1, keepdims=True)
    return scores / np.where(scatter > 0, scatter, 1.0)


def share_of_larger(values):
    """Return the share of the orders whose value is as large as the first one's."""
    return float((values >= values[0]).mean())


def _scores(diagram, speed, orders, intervals):
    """
    Return the sums over the filter of each speed for all orders, and their gram.

    The share of the variance that moves with each speed, and the memory of the images,
    see `_innovations`, are returned, too.
    """
    years, zero = diagram.years, diagram.zero
    x, overlap = diagram.displacement[zero:], diagram.overlap[zero:]
    use = (x > 0) & (x <= TESTED * x[-1]) & (overlap > LEAST_OVERLAP)
    overlap = np.maximum(overlap[use], LEAST_NORM)
    correlation = autocorrelation(diagram)[zero:]
    to_innovations, odd, time, white = _innovations(diagram, use)
    n, y = len(years), x[use]
    first, second = np.triu_indices(n - 1, 1)
    scatter = odd[first, second].T @ odd[first, second] / len(first)
    ridge = np.trace(scatter) / max(len(y), 1)
    if not ridge > 0:
        ridge = 1.0
    whiten = np.linalg.inv(np.linalg.cholesky(scatter + ridge * np.eye(len(y))))
    filters = np.empty((len(speed), len(first), len(y)), np.float32)
    norm, pairs = np.empty(len(speed)), np.triu_indices(n, 1)
    tau = (years - years[:, None])[pairs][:, None]
    asked = within(np.abs(tau), intervals)
    expected = np.zeros((n, n, len(y)), np.float32)
    for k, v in enumerate(speed):
        moved = v * tau
        forward = np.interp(np.abs(y - moved), x, correlation, right=0)
        forward -= np.interp(np.abs(y + moved), x, correlation, right=0)
        forward *= np.exp(-np.abs(moved) / LENGTH) * overlap * asked
        expected[pairs], expected[pairs[::-1]] = forward, -forward
        filters[k] = _sandwich(to_innovations, expected)[first, second] @ whiten.T
        norm[k] = np.sqrt(np.square(filters[k], dtype=float).sum())
        filters[k] /= norm[k] if norm[k] > 0 else 1
    scores = _permuted(np.asarray(odd @ whiten.T, np.float32), filters, orders)
    epochs = np.arange(n)
    power = np.mean(diagram.sums[epochs, epochs, zero], dtype=float)
    share = scores[0] / np.where(norm > 0, norm, np.inf) / max(power, TINY)
    filters = filters.reshape(len(speed), -1)
    return scores, (filters @ filters.T).astype(float), share, time, white


def _permuted(odd, filters, orders, numbers=4e6):
    """
    Return the sums of the odd part over each filter, for all orders.

    So many ``numbers`` are permuted at a time as the cache of a processor holds: all
    permutations of a long series are large.
    """
    n, n_pairs = len(odd), filters.shape[1]
    first, second = np.triu_indices(n, 1)
    odd, scores = odd.reshape(n**2, -1), np.zeros((len(orders), len(filters)))
    piece = max(1, int(numbers / len(orders) / max(odd.shape[1], 1)))
    for low in range(0, n_pairs, piece):
        some = slice(low, low + piece)
        rows = orders[:, first[some]] * n + orders[:, second[some]]
        permuted = np.take(odd, rows, axis=0).reshape(len(orders), -1)
        scores += permuted @ filters[:, some].reshape(len(filters), -1).T
    return scores


def _innovations(diagram, use):
    """
    Return the matrix of innovations, and the odd part of the diagram between them.

    Each is divided by its norm.  ``use`` are the displacements, from zero, that are
    compared.  The memory of the images, in years, and the share of their variance
    without memory are returned, too.
    """
    sums = np.asarray(diagram.sums[:, :, diagram.zero :], dtype=float)
    time, white, factor = memory_of(diagram.years, sums[:, :, 0])
    matrix = np.linalg.solve(factor, difference_matrix(len(sums)))
    odd = sums[:, :, use]
    odd = _sandwich(matrix, odd - odd.transpose(1, 0, 2))
    power = np.einsum("ia,ab,ib->i", matrix, sums[:, :, 0], matrix)
    size = np.sqrt(np.maximum(power, TINY))
    size /= np.sqrt(max((size**2).mean(), TINY))
    return matrix, odd / (size[:, None] * size)[..., None], time, white


def _sandwich(matrix, values):
    """Return ``B D(d) B'`` for every displacement d."""
    matrix, values = np.asarray(matrix, np.float32), np.asarray(values, np.float32)
    half = matrix @ values.reshape(matrix.shape[1], -1)
    return matrix @ half.reshape(len(matrix), *values.shape[1:])
