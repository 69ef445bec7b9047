# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The uncertainty of a velocity from the scatter of the features that have it."""

import numpy as np

from astro_scc.stacking.components import fit_gaussian
from astro_scc.stacking.stack import velocities

__all__ = ["feature_scatter"]

#: Matches further than this many standard errors from the box add nothing.
NEAR = 5.0


def feature_scatter(displacements, pairs, group, component, grid):
    r"""
    Covariance of a fitted velocity, its features being independent.

    Each feature is left out in turn, with all its matches, and the Gaussian
    is fitted again to the same grid points; the covariance is that of the
    jackknife with clusters,

    .. math:: \mathrm{cov}(v) = \frac{n - 1}{n} \sum_f
              (v_{-f} - \bar v)(v_{-f} - \bar v)^T

    (Efron & Stein 1981, Ann. Statist. 9, 586; Lipsitz et al. 1994).  It
    holds whatever the features' velocities scatter by: position errors,
    motion of their own, or chance matches.  A maximum that leaves the box
    without a feature counts as being at the side of the box, and one that
    is none any more as half a box away on both axes.

    Parameters
    ----------
    displacements : `~astro_scc.stacking.Displacements`
    pairs : `~astro_scc.stacking.DatePairs`
    group : array_like of int, shape (n_matches,)
        Feature of each match; -1 stands for one of its own.
    component : `~astro_scc.stacking.Component`
    grid : `~astro_scc.stacking.VelocityGrid`
        That the component was found on.

    Returns
    -------
    `~numpy.ndarray`, shape (2, 2)
        If fewer than two features are near, or no Gaussian was fitted, the
        mean square of the matches' own errors.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import (
    ...     Displacements, VelocityGrid, component_near, consecutive_pairs,
    ...     feature_scatter, stack)
    >>> rng = np.random.default_rng(1)
    >>> n = 100
    >>> one, none = np.ones(n), np.zeros(n, int)
    >>> d = Displacements(
    ...     d1=rng.normal(3, 0.1, n), d2=rng.normal(0, 0.1, n), s1=one, s2=one,
    ...     weight=one, reference=none, target=none + 1, ssp=np.arange(n),
    ...     target_ssp=np.arange(n), n_ssps=np.array([n, n]))
    >>> pairs, grid = consecutive_pairs([0, 1]), VelocityGrid.covering(6, 0.25)
    >>> peak = component_near(stack(d, pairs, grid), grid, (5, 5), 3, 0)
    >>> covariance = feature_scatter(d, pairs, np.arange(n), peak, grid)
    >>> np.sqrt(np.diag(covariance)).round(2)
    array([0.01, 0.01])
    """
    index, x, y, sx, sy, weight = velocities(displacements, pairs)
    if not component.fitted or len(index) == 0:
        return _own_errors(x - component.v1, y - component.v2, sx, sy)
    columns, rows, used = component.points
    v1, v2 = grid.v1[columns], grid.v2[rows]
    near = (
        (x >= v1[0] - NEAR * sx)
        & (x <= v1[-1] + NEAR * sx)
        & (y >= v2[0] - NEAR * sy)
        & (y <= v2[-1] + NEAR * sy)
    )
    index, x, y, sx, sy, weight = (a[near] for a in (index, x, y, sx, sy, weight))
    owner = np.asarray(group)[index]
    owner = np.where(owner < 0, -1 - np.arange(len(owner)), owner)
    features, owner = np.unique(owner, return_inverse=True)
    profile1 = np.exp(-0.5 * ((v1 - x[:, None]) / sx[:, None]) ** 2)
    profile2 = np.exp(-0.5 * ((v2 - y[:, None]) / sy[:, None]) ** 2)
    total = (profile2 * weight[:, None]).T @ profile1
    n = len(features)
    if n < 2:
        return _own_errors(x - component.v1, y - component.v2, sx, sy)
    without, lost = [], 0
    for feature in range(n):
        of = owner == feature
        part = (profile2[of] * weight[of, None]).T @ profile1[of]
        fit = fit_gaussian(np.where(used, total - part, 0.0), v1, v2)
        # Without a feature that holds most of it the maximum may be lost:
        # all that is known then is that it was in the box.
        if fit is None:
            lost += 1
        else:
            without.append(np.clip(fit[:2], (v1[0], v2[0]), (v1[-1], v2[-1])))
    half = 0.5 * np.array([v1[-1] - v1[0], v2[-1] - v2[0]])
    squares = lost * np.diag(half**2)
    if without:
        apart = np.array(without) - np.mean(without, axis=0)
        squares += apart.T @ apart
    return (n - 1) / n * squares


def _own_errors(x, y, sx, sy):
    near = np.hypot(x / sx, y / sy) <= 1.5
    if not near.any():
        near = np.ones(len(x), dtype=bool)
    if not near.any():
        return np.full((2, 2), np.inf)
    return np.diag([np.mean(sx[near] ** 2), np.mean(sy[near] ** 2)])
