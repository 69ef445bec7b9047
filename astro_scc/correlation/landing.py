# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which SSP of the target epoch a match falls on."""

import numpy as np
from scipy.spatial import cKDTree

from astro_scc.decomposition import scale_size

__all__ = ["landing_ssps"]


def landing_ssps(matches, ssps):
    """
    The SSP of the target epoch nearest to where each match falls.

    Parameters
    ----------
    matches : `~astro_scc.correlation.Matches`
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.

    Returns
    -------
    `~numpy.ndarray` of int, shape (n_matches,)
        Index in ``ssps`` of the SSP of the same scale whose maximum is
        nearest to the SSP's maximum carried along by the displacement, if
        it is within one scale; otherwise -1.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.correlation import Correlator, all_pairs, landing_ssps
    >>> from astro_scc.decomposition import Decomposer, SSPs
    >>> y, x = np.mgrid[:64, :96]
    >>> def image(x0):
    ...     return np.exp(-((x - x0) ** 2 + (y - 32) ** 2) / 30)
    >>> decompose = Decomposer(scales=[2])
    >>> epochs = [decompose(image(x0)) for x0 in (40, 46.5)]
    >>> matches = Correlator()(epochs, all_pairs(2), 12)
    >>> landing_ssps(matches, SSPs.of_epochs(epochs)).tolist()
    [1, 0]
    """
    landed = np.full(len(matches), -1)
    if len(matches) == 0:
        return landed
    scales, level = np.unique(ssps.scale, return_inverse=True)
    n = max(int(ssps.epoch.max()), int(matches.target.max())) + 1
    # Matches and SSPs by scale and epoch, each sorted once.
    order, ends = _grouped(level[matches.ssp] * n + matches.target, len(scales) * n)
    there, starts = _grouped(level * n + ssps.epoch, len(scales) * n)
    for group in np.flatnonzero((np.diff(ends) > 0) & (np.diff(starts) > 0)):
        k = order[ends[group] : ends[group + 1]]
        own = there[starts[group] : starts[group + 1]]
        y = ssps.y[matches.ssp[k]] + matches.dy[k]
        x = ssps.x[matches.ssp[k]] + matches.dx[k]
        tree = cKDTree(np.stack([ssps.y[own], ssps.x[own]], axis=1))
        distance, nearest = tree.query(np.stack([y, x], axis=1))
        near = distance <= scale_size(scales[group // n])
        landed[k[near]] = own[nearest[near]]
    return landed


def _grouped(number, n):
    """Indices by group number, and where each of n groups begins."""
    if n < 2**15:
        # Small integers are sorted without comparisons.
        number = number.astype(np.int16)
    order = np.argsort(number, kind="stable")
    return order, np.searchsorted(number[order], np.arange(n + 1))
