# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Measurement: what an array of matches means in angles, years and tables."""

from astro_scc.measurement.matched import MatchedEpochs, select_ssps
from astro_scc.measurement.plan import SearchPlan
from astro_scc.measurement.products import write_products
from astro_scc.measurement.publication import write_votable
from astro_scc.measurement.regions import (
    ssp_regions,
    ssp_segmentation,
    write_epoch_regions,
    write_ssp_regions,
)
from astro_scc.measurement.result import SCCResult
from astro_scc.measurement.tables import component_table as component_table
from astro_scc.measurement.tables import false_discovery_rate
from astro_scc.measurement.tables import versions as versions

__all__ = [
    "MatchedEpochs",
    "SCCResult",
    "SearchPlan",
    "false_discovery_rate",
    "select_ssps",
    "ssp_regions",
    "ssp_segmentation",
    "write_epoch_regions",
    "write_products",
    "write_ssp_regions",
    "write_votable",
]
