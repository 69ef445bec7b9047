# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Whether a displacement grows in proportion to the time between images."""

from dataclasses import dataclass

import numpy as np

from astro_scc.stacking.acceleration import flow_blocks

__all__ = ["LagTest", "lag_test"]

#: Sightings of a velocity are those within so many beams of where it leads...
NEAR = 3.0
#: ...the beam being so many standard errors of a displacement.
BEAM = 5.0
#: Blocks that give an error.
FEWEST_BLOCKS = 4
#: Sightings of one group of lags that are needed for a displacement.
FEWEST = 5


@dataclass(frozen=True, eq=False)
class LagTest:
    """
    Displacements along a velocity in groups of pairs of epochs.

    Attributes
    ----------
    lag : `~numpy.ndarray`, shape (n_groups,)
        Mean time between the images of a group.
    displacement, error : `~numpy.ndarray`, shape (n_groups,)
        Along the velocity; NaN where too few sightings agree.
    coefficient : `~numpy.ndarray`, shape (n_groups,)
        Mean weight of the sightings at the velocity, of an SSP.
    n_sightings : `~numpy.ndarray` of int, shape (n_groups,)
    speed, speed_err : float
        Slope of the straight line through the displacements.
    offset, offset_err : float
        Displacement of the line at no lag, which is none if it is motion.
    p_offset : float
        Probability of so large an offset if there is none.
    n_blocks : int
        Blocks of the flow that were left out in turn for the errors.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Sightings, lag_test
    >>> rng = np.random.default_rng(1)
    >>> n = 500
    >>> lag, one, zero = rng.uniform(0.5, 2.0, n), np.ones(n), np.zeros((n, 2))
    >>> v = 3.0 + rng.normal(0, 0.1, n) / lag
    >>> seen = Sightings(v1=v, v2=0 * one, s1=0.2 / lag, s2=0.2 / lag, weight=one,
    ...                  time=rng.uniform(0, 20, n), interval=lag, middle=zero,
    ...                  velocity=zero, sigma=0.2 * one, first=0 * one,
    ...                  ssp=np.arange(n), match=np.arange(n))
    >>> found = lag_test(seen, 3.0, 0.0)
    >>> round(found.speed, 1), found.lag.shape == found.displacement.shape
    (3.0, True)
    """

    lag: np.ndarray
    displacement: np.ndarray
    error: np.ndarray
    coefficient: np.ndarray
    n_sightings: np.ndarray
    speed: float
    speed_err: float
    offset: float
    offset_err: float
    p_offset: float
    n_blocks: int


def lag_test(sightings, v1, v2, *, distance=None, n_groups=5, edges=None):
    r"""
    Test whether a velocity is the same at short and at long lags.

    What moves is displaced by ``v * lag`` at every lag.  An alias, a pattern
    that is taken for its neighbour, is displaced by the distance between
    the two whatever the lag, and makes a velocity at one lag only.  In each
    group the displacement is the mean of the sightings near ``v * lag``,
    weighted by a Gaussian of the displacement error about itself; then

    .. math:: d = d_0 + v\, \mathrm{lag}

    is fitted.  Errors are those of a jackknife over blocks of the flow, as in
    `fit_acceleration`: one feature is in many pairs of epochs.

    Parameters
    ----------
    sightings : `~astro_scc.stacking.Sightings`
    v1, v2 : float
        Velocity along the two axes.
    distance : array_like, shape (n,), optional
        Distance along the flow of each sighting at its mean date, by default
        along the direction in which those near the velocity move.
    n_groups : int, optional
        Groups with equally many sightings.
    edges : array_like, optional
        Limits of the groups of lags instead.

    Returns
    -------
    `LagTest`
        The probability is NaN where fewer than three groups have a
        displacement, or there are fewer than four blocks.

    Raises
    ------
    ValueError
        If the velocity is zero, or there is no sighting.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import Sightings, lag_test
    >>> rng = np.random.default_rng(1)
    >>> n = 500
    >>> when = rng.uniform(0, 20, n)
    >>> lag, one, zero = rng.uniform(0.5, 2.0, n), np.ones(n), np.zeros((n, 2))
    >>> def seen(d):
    ...     return Sightings(v1=d / lag, v2=0 * one, s1=0.2 / lag, s2=0.2 / lag,
    ...                      weight=one, time=when, interval=lag, middle=zero,
    ...                      velocity=zero, sigma=0.2 * one, first=one,
    ...                      ssp=np.arange(n), match=one)
    >>> noise = rng.normal(0, 0.1, n)
    >>> lag_test(seen(3.0 * lag + noise), 3.0, 0.0).p_offset > 0.01
    True
    >>> lag_test(seen(3.0 + noise), 3.0, 0.0).p_offset < 0.01
    True
    """
    s = sightings
    if len(s) == 0:
        raise ValueError("a test of lags needs sightings, got none")
    length = float(np.hypot(v1, v2))
    if not length > 0:
        raise ValueError("what stands still has no displacement that could grow")
    if edges is None:
        edges = np.quantile(s.interval, np.linspace(0, 1, n_groups + 1))
        edges = np.unique(edges)
        edges = edges if len(edges) > 1 else np.array([edges[0], edges[0]])
    edges = np.asarray(edges, dtype=float)
    unit = np.array([v1, v2]) / length
    along = (unit[0] * s.v1 + unit[1] * s.v2) * s.interval
    across = (unit[1] * s.v1 - unit[0] * s.v2) * s.interval
    n = len(edges) - 1
    group = np.clip(np.searchsorted(edges, s.interval, side="right") - 1, -1, n)
    group[s.interval == edges[-1]] = n - 1
    inside = (group >= 0) & (group < n)
    lag = np.array([_mean(s.interval[group == k]) for k in range(n)])
    x = _distances(s, v1, v2) if distance is None else np.asarray(distance, dtype=float)
    block = flow_blocks(s, x, length)

    def displacements(use):
        found = [
            _displacement(
                along[own], across[own], length * s.interval[own], s.sigma[own],
                s.weight[own],
            )
            for own in (use & (group == k) for k in range(n))
        ]  # fmt: skip
        rest, total, count = (np.array(column) for column in zip(*found, strict=True))
        return length * lag + rest, total, count

    d, total, count = displacements(inside)
    ssps = [len(np.unique(s.ssp[group == k])) for k in range(n)]
    near = inside & s.near(v1, v2, 5 * NEAR)
    blocks = np.unique(block[near])
    others = np.array([displacements(inside & (block != k))[0] for k in blocks])
    return LagTest(
        lag=lag,
        displacement=d,
        coefficient=total / np.maximum(ssps, 1),
        n_sightings=count.astype(int),
        n_blocks=len(blocks),
        **_line(lag, d, others),
    )


def _mean(values):
    return values.mean() if len(values) else np.nan


def _distances(sightings, v1, v2):
    """Places along the direction in which sightings of a velocity move."""
    near = sightings.near(v1, v2, NEAR)
    mean = sightings.velocity[near].sum(axis=0)
    length = np.hypot(*mean)
    return sightings.middle @ (mean / length if length > 0 else mean)


def _displacement(along, across, expected, sigma, weight):
    """How far from what is expected the sightings agree, their weight and number."""
    rest = along - expected
    weight = weight * np.exp(-0.5 * (across / sigma) ** 2)
    near = (np.abs(rest) <= NEAR * BEAM * sigma) & (weight > 1e-3)
    rest, sigma, weight = (a[near] for a in (rest, sigma, weight))
    if len(rest) < FEWEST:
        return np.nan, 0.0, len(rest)
    # Where they agree is the nearest maximum of a smooth density, not a far
    # higher one.
    where = np.linspace(-1, 1, 121) * NEAR * BEAM * np.median(sigma)
    density = weight @ np.exp(-0.5 * ((where - rest[:, None]) / sigma[:, None]) ** 2)
    rises, falls = density[1:-1] >= density[:-2], density[1:-1] >= density[2:]
    maxima = where[1:-1][rises & falls & (density[1:-1] > 0)]
    if len(maxima) == 0:
        return np.nan, 0.0, len(rest)
    middle = maxima[np.abs(maxima).argmin()]
    for _ in range(20):
        own = weight * np.exp(-0.5 * ((rest - middle) / sigma) ** 2)
        middle = np.average(rest, weights=own)
    return middle, own.sum(), int((own > 0.1 * weight).sum())


def _line(lag, d, others):
    """The straight line through the displacements, with jackknife errors."""
    result = dict.fromkeys(("speed", "offset", "p_offset"), np.nan)
    result |= dict.fromkeys(("speed_err", "offset_err"), np.inf)
    result["error"] = np.full(len(d), np.inf)
    n = len(others)
    if n < FEWEST_BLOCKS:
        return result
    # A group that only one block fills has that block's displacement.
    others = np.where(np.isfinite(others), others, d)
    apart = others - others.mean(axis=0)
    result["error"] = np.sqrt((n - 1) / n * (apart**2).sum(axis=0))
    good = np.isfinite(d) & (result["error"] > 0)
    if good.sum() < 2:
        return result
    weight = 1 / result["error"][good]
    design = np.stack([lag[good], np.ones(good.sum())], axis=1) * weight[:, None]
    solve = np.linalg.pinv(design) * weight
    result["speed"], result["offset"] = (float(v) for v in solve @ d[good])
    lines = (solve @ others[:, good].T).T
    lines = lines - lines.mean(axis=0)
    errors = np.sqrt((n - 1) / n * (lines**2).sum(axis=0))
    result["speed_err"], result["offset_err"] = (float(e) for e in errors)
    if good.sum() > 2:
        from scipy.stats import t

        result["p_offset"] = float(2 * t.sf(abs(result["offset"]) / errors[1], n - 2))
    return result
