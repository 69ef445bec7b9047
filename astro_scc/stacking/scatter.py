# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The uncertainty of a velocity from the scatter of its features, or its epochs."""

import numpy as np

from astro_scc.stacking.refit import Refit
from astro_scc.stacking.stack import velocities

__all__ = ["epoch_scatter", "feature_scatter"]


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
    near = Refit.of(displacements, pairs, component, grid)
    if near is None:
        return _own_errors(displacements, pairs, component)
    owner = np.asarray(group)[near.index]
    owner = np.where(owner < 0, -1 - np.arange(len(owner)), owner)
    features = np.unique(owner)
    if len(features) < 2:
        return _own_errors(displacements, pairs, component)
    return near.jackknife([owner == feature for feature in features])


def epoch_scatter(displacements, pairs, component, grid):
    """
    Covariance of a fitted velocity, its epochs being independent.

    The jackknife of `feature_scatter` with each epoch left out in turn, and
    all its pairs with it.  Where what differs from epoch to epoch is the
    epoch's own, as its alignment, calibration and beam are, this is the
    error; where it is the match's own it is too large, by up to the square
    root of two, as a match goes with either of its epochs.

    Parameters
    ----------
    displacements : `~astro_scc.stacking.Displacements`
    pairs : `~astro_scc.stacking.DatePairs`
    component : `~astro_scc.stacking.Component`
    grid : `~astro_scc.stacking.VelocityGrid`
        That the component was found on.

    Returns
    -------
    `~numpy.ndarray`, shape (2, 2)
        Infinite with fewer than three epochs, or if no Gaussian was fitted:
        there is nothing to leave out.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import (
    ...     Displacements, VelocityGrid, component_near, consecutive_pairs,
    ...     epoch_scatter, stack)
    >>> epoch, one = np.repeat(np.arange(4), 9), np.ones(36)
    >>> d = Displacements(
    ...     d1=3 + np.repeat([-0.1, 0.1, -0.1, 0.1], 9), d2=0 * one, s1=one, s2=one,
    ...     weight=one, reference=epoch, target=epoch + 1, ssp=np.arange(36),
    ...     target_ssp=np.arange(36), n_ssps=np.full(5, 9))
    >>> pairs, grid = consecutive_pairs(np.arange(5.0)), VelocityGrid.covering(6, 0.25)
    >>> peak = component_near(stack(d, pairs, grid), grid, (5, 5), 3, 0)
    >>> covariance = epoch_scatter(d, pairs, peak, grid)
    >>> np.sqrt(np.diag(covariance)).round(2)
    array([0.04, 0.  ])
    """
    near = Refit.of(displacements, pairs, component, grid)
    unknown = np.diag([np.inf, np.inf])
    if near is None:
        return unknown
    reference = displacements.reference[near.index]
    target = displacements.target[near.index]
    epochs = np.union1d(reference, target)
    if len(epochs) < 3:
        return unknown
    return near.jackknife([(reference == k) | (target == k) for k in epochs])


def _own_errors(displacements, pairs, component):
    _, x, y, sx, sy, _ = velocities(displacements, pairs)
    x, y = x - component.v1, y - component.v2
    near = np.hypot(x / sx, y / sy) <= 1.5
    if not near.any():
        near = np.ones(len(x), dtype=bool)
    if not near.any():
        return np.full((2, 2), np.inf)
    return np.diag([np.mean(sx[near] ** 2), np.mean(sy[near] ** 2)])
