# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Interchange: epochs in the formats and containers of other packages."""

from astro_scc.epochs.interchange.casa import is_casa_image, read_casa_image
from astro_scc.epochs.interchange.movies import is_hdf5, read_movie
from astro_scc.epochs.interchange.ndcubes import from_ndcube, to_ndcube
from astro_scc.epochs.interchange.xarrays import from_xarray, to_xarray

__all__ = [
    "from_ndcube",
    "from_xarray",
    "is_casa_image",
    "is_hdf5",
    "read_casa_image",
    "read_movie",
    "to_ndcube",
    "to_xarray",
]
