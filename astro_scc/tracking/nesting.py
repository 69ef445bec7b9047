# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Which larger pattern a pattern lies in."""

import numpy as np

__all__ = ["parents"]


def parents(ssps, width):
    """
    The SSP of the next coarser scale that holds each SSP's maximum.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    width : int
        Pixels in a row of the images.

    Returns
    -------
    `~numpy.ndarray` of int, shape (n,)
        Index of the SSP, of the same epoch, or -1.

    Examples
    --------
    >>> import numpy as np
    >>> from astro_scc.decomposition import Decomposer
    >>> from astro_scc.tracking import parents
    >>> y, x = np.mgrid[:64, :96]
    >>> image = np.exp(-((x - 40) ** 2 + (y - 32) ** 2) / 30)
    >>> parents(Decomposer(scales=[1, 2, 3])(image).ssps, 96).tolist()
    [1, 2, -1]
    """
    found = np.full(len(ssps), -1)
    n_pixels = int(ssps.pixels.max(initial=0)) + 1
    at = np.rint(ssps.y).astype(np.int64) * width + np.rint(ssps.x).astype(np.int64)
    owner = np.repeat(np.arange(len(ssps)), ssps.n_pixels)
    key = ssps.epoch[owner].astype(np.int64) * n_pixels + ssps.pixels
    scales = np.unique(ssps.scale)
    for finer, coarser in zip(scales[:-1], scales[1:], strict=True):
        large = np.flatnonzero(ssps.scale[owner] == coarser)
        large = large[np.argsort(key[large], kind="stable")]
        small = np.flatnonzero((ssps.scale == finer) & (at < n_pixels))
        if len(large) == 0:
            continue
        wanted = ssps.epoch[small].astype(np.int64) * n_pixels + at[small]
        place = np.searchsorted(key[large], wanted)
        hit = large[np.minimum(place, len(large) - 1)]
        same = key[hit] == wanted
        found[small[same]] = owner[hit[same]]
    return found
