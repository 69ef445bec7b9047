# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Products: the files of a result, as tables, maps and regions, and for a paper."""

from astro_scc.products.folder import (
    ssp_regions,
    ssp_segmentation,
    write_epoch_regions,
    write_products,
    write_ssp_regions,
)
from astro_scc.products.publication import write_votable

__all__ = [
    "ssp_regions", "ssp_segmentation", "write_epoch_regions", "write_products",
    "write_ssp_regions", "write_votable",
]  # fmt: skip
