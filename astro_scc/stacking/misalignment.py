# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""What epochs that are not well aligned do to a velocity."""

import numpy as np

from astro_scc.stacking.refit import Refit

__all__ = ["alignment_scatter"]

#: Epochs are moved by this part of the median error of a displacement.
STEP = 0.1


def alignment_scatter(displacements, pairs, component, grid, errors):
    r"""
    Covariance of a velocity by the errors of the alignment of the epochs.

    An epoch k that lies :math:`\epsilon_k` off moves all that is seen in
    it, by :math:`\pm \epsilon_k / \Delta t` in the velocities of its pairs,
    and no number of features helps.  Each epoch is moved to either side and
    the maximum fitted again; with :math:`J_k = dv / d\epsilon_k`,

    .. math:: \mathrm{cov}(v) = \sum_k J_k\, \mathrm{diag}(\sigma_k^2)\, J_k^T .

    Between consecutive epochs, where later errors undo earlier ones, that
    of a single velocity is :math:`\sqrt{2}\, \sigma / T` over a series of
    length T.

    Parameters
    ----------
    displacements : `~astro_scc.stacking.Displacements`
    pairs : `~astro_scc.stacking.DatePairs`
    component : `~astro_scc.stacking.Component`
    grid : `~astro_scc.stacking.VelocityGrid`
        That the component was found on.
    errors : array_like, shape (n_epochs, 2)
        Standard errors of the alignment along the two axes.

    Returns
    -------
    `~numpy.ndarray`, shape (2, 2)

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.stacking import (
    ...     Displacements, VelocityGrid, alignment_scatter, component_near,
    ...     consecutive_pairs, stack)
    >>> one, none = np.ones(20), np.zeros(20, int)
    >>> d = Displacements(
    ...     d1=3 * one, d2=0 * one, s1=one, s2=one, weight=one, reference=none,
    ...     target=none + 1, ssp=np.arange(20), target_ssp=np.arange(20),
    ...     n_ssps=np.array([20, 20]))
    >>> pairs, grid = consecutive_pairs([0, 1]), VelocityGrid.covering(6, 0.25)
    >>> peak = component_near(stack(d, pairs, grid), grid, (5, 5), 3, 0)
    >>> covariance = alignment_scatter(d, pairs, peak, grid, [[0.1, 0.2]] * 2)
    >>> np.sqrt(np.diag(covariance)).round(3)
    array([0.141, 0.283])
    """
    errors = np.asarray(errors, dtype=float)
    near = Refit.of(displacements, pairs, component, grid)
    covariance = np.zeros((2, 2))
    if near is None or not errors.any():
        return covariance
    rate1 = near.sx / displacements.s1[near.index]
    rate2 = near.sy / displacements.s2[near.index]
    reference = displacements.reference[near.index]
    target = displacements.target[near.index]
    step1 = STEP * np.median(displacements.s1[near.index])
    step2 = STEP * np.median(displacements.s2[near.index])
    for epoch in np.flatnonzero(errors.any(axis=1)):
        sign = (target == epoch).astype(float) - (reference == epoch)
        if not sign.any():
            continue
        response = np.stack(
            [
                _response(near, step1, sign * rate1, 0.0),
                _response(near, step2, 0.0, sign * rate2),
            ],
            axis=1,
        )
        covariance += response @ np.diag(errors[epoch] ** 2) @ response.T
    return covariance


def _response(near, step, dx, dy):
    """Derivative of the maximum as matches move by dx and dy."""
    sides = []
    for way in (-0.5, 0.5):
        moved = near.moved(way * step * dx, way * step * dy)
        sides.append(moved.fit(moved.map()))
    if any(side is None for side in sides):
        weight = near.weight / near.weight.sum()
        return np.array([np.sum(weight * dx), np.sum(weight * dy)])
    return (sides[1] - sides[0]) / step
