# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Interchange of epochs with the file formats and containers of other packages."""

from astro_scc.interchange.containers import (
    from_ndcube,
    from_xarray,
    to_ndcube,
    to_xarray,
)
from astro_scc.interchange.files import read_movie

__all__ = ["from_ndcube", "from_xarray", "read_movie", "to_ndcube", "to_xarray"]
