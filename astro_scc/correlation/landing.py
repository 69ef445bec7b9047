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
    y = ssps.y[matches.ssp] + matches.dy
    x = ssps.x[matches.ssp] + matches.dx
    scale = ssps.scale[matches.ssp]
    for value in np.unique(scale):
        for epoch in np.unique(matches.target[scale == value]):
            there = np.flatnonzero((ssps.epoch == epoch) & (ssps.scale == value))
            if len(there) == 0:
                continue
            k = np.flatnonzero((scale == value) & (matches.target == epoch))
            tree = cKDTree(np.stack([ssps.y[there], ssps.x[there]], axis=1))
            distance, nearest = tree.query(np.stack([y[k], x[k]], axis=1))
            near = distance <= scale_size(value)
            landed[k[near]] = there[nearest[near]]
    return landed
