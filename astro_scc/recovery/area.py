# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Where features are put."""

import numpy as np

__all__ = ["area_for_features"]


def area_for_features(matched, region=None):
    """
    Pixels in which features are put.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
        Of the epochs without features.
    region : `~numpy.ndarray` of bool, shape (ny, nx), optional

    Returns
    -------
    `~numpy.ndarray` of bool, shape (ny, nx)
        Those of the region that exist in any epoch; without a region those
        of SSPs of any epoch and scale, or all if there are none.

    Raises
    ------
    ValueError
        If nothing of the region exists.
    """
    exists = ~matched.cube.mask.all(axis=0)
    if region is not None:
        area = region & exists
        if not area.any():
            raise ValueError(
                "region holds masked pixels only: no feature can be put in"
            )
        return area
    area = np.zeros(exists.shape, dtype=bool)
    area.flat[matched.ssps.pixels] = True
    return area if area.any() else exists
