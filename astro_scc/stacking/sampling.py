# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What the sampling of the images by pixels does to a velocity."""

import numpy as np

from astro_scc.stacking.refit import Refit

__all__ = ["sampling_scatter"]


def sampling_scatter(displacements, pairs, component, grid, error):
    r"""
    Covariance of a velocity by the error that all its displacements share.

    The quadratic through a peak draws it towards the nearest whole pixel.
    Where all pairs of epochs have the same displacement all are drawn alike,
    and no number of features helps:

    .. math:: \mathrm{cov}(v) = \left(\epsilon \, \overline{1 / \Delta t}\right)^2 I ,

    with the mean over the matches near the maximum, by their weights.  Of
    pairs of unlike intervals this is more than is left of it.

    Parameters
    ----------
    displacements : `~astro_scc.stacking.Displacements`
    pairs : `~astro_scc.stacking.DatePairs`
    component : `~astro_scc.stacking.Component`
    grid : `~astro_scc.stacking.VelocityGrid`
        That the component was found on.
    error : float
        Standard error of a displacement, in its unit.

    Returns
    -------
    `~numpy.ndarray`, shape (2, 2)
        Zero if no Gaussian was fitted.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import (
    ...     Displacements, VelocityGrid, component_near, consecutive_pairs,
    ...     sampling_scatter, stack)
    >>> one, none = np.ones(20), np.zeros(20, int)
    >>> d = Displacements(
    ...     d1=3 * one, d2=0 * one, s1=one, s2=one, weight=one, reference=none,
    ...     target=none + 1, ssp=np.arange(20), target_ssp=np.arange(20),
    ...     n_ssps=np.array([20, 20]))
    >>> pairs, grid = consecutive_pairs([0, 0.5]), VelocityGrid.covering(12, 0.5)
    >>> peak = component_near(stack(d, pairs, grid), grid, (10, 10), 6, 0)
    >>> covariance = sampling_scatter(d, pairs, peak, grid, 0.02)
    >>> np.sqrt(np.diag(covariance)).round(3).tolist()
    [0.04, 0.04]
    """
    near = Refit.of(displacements, pairs, component, grid)
    if near is None or near.weight.sum() == 0:
        return np.zeros((2, 2))
    rate = near.sx / displacements.s1[near.index]
    return (error * np.average(rate, weights=near.weight)) ** 2 * np.eye(2)
