# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Interchange of epochs with the file formats and containers of other packages."""

from astro_scc.interchange.files import read_movie
from astro_scc.interchange.ndcubes import from_ndcube, to_ndcube
from astro_scc.interchange.xarrays import from_xarray, to_xarray

__all__ = ["from_ndcube", "from_xarray", "read_movie", "to_ndcube", "to_xarray"]
