# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""A cube as NDCube."""

import numpy as np
from astropy.wcs import WCS

from astro_scc.epochs.interchange.optional import optional

__all__ = ["to_ndcube"]
__doctest_requires__ = {"to_ndcube": ["ndcube"]}


def to_ndcube(cube):
    """
    A cube as NDCube of (epoch, latitude, longitude).

    Parameters
    ----------
    cube : `~astro_scc.epochs.EpochCube`

    Returns
    -------
    `ndcube.NDCube`
        Its WCS has the number of the epoch as third axis, whose dates are
        the extra coordinate ``time``.  Beams and noise are in its meta.

    Raises
    ------
    ImportError
        If ndcube is not installed.

    Examples
    --------
    >>> from astro_scc.epochs.interchange import to_ndcube
    >>> from astro_scc.simulation import simulate_static
    >>> to_ndcube(simulate_static(n_epochs=2, rng=1).cube).shape
    (2, 128, 256)
    """
    ndcube = optional("ndcube", "to_ndcube", "ndcube")
    made = ndcube.NDCube(
        cube.data.copy(),
        wcs=_with_epochs(cube.wcs),
        unit=cube.unit,
        mask=cube.mask.copy(),
        meta={
            **cube.meta,
            "labels": list(cube.labels),
            "beams": cube.beams,
            "noise": cube.noise,
        },
    )
    made.extra_coords.add("time", (0,), cube.times)
    return made


def _with_epochs(celestial):
    """A WCS with the number of the epoch, from 0, as third axis."""
    header = celestial.to_header()
    header.update({"WCSAXES": 3, "CTYPE3": "EPOCH", "CRPIX3": 1.0, "CRVAL3": 0.0})
    header["CDELT3"] = 1.0
    for keyword in ("DATE-OBS", "MJD-OBS", "DATEREF", "MJDREF"):
        header.remove(keyword, ignore_missing=True)
    wcs = WCS(header)
    # A header rounds; the numbers themselves do not.
    wcs.wcs.crval = [*celestial.wcs.crval, 0.0]
    wcs.wcs.crpix = [*celestial.wcs.crpix, 1.0]
    wcs.wcs.cdelt = [1.0, 1.0, 1.0]
    matrix = np.eye(3)
    matrix[:2, :2] = celestial.pixel_scale_matrix
    wcs.wcs.pc = matrix
    wcs.wcs.set()
    return wcs
