# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Measurement: what an array of matches means in angles, years and tables."""

from astro_scc.epochs import beam_fwhm, position_errors, ssp_offsets
from astro_scc.measurement.errors import alignment_errors, angular_displacements
from astro_scc.measurement.exports import write_epoch_regions, write_votables
from astro_scc.measurement.false_discovery import false_discovery_rate
from astro_scc.measurement.match_files import (
    MatchCache,
    read_matches,
    write_matches,
)
from astro_scc.measurement.patterns import (
    ssp_regions,
    ssp_segmentation,
    write_ssp_regions,
)
from astro_scc.measurement.products import (
    product_folder,
    velocity_hdus,
    write_products,
)
from astro_scc.measurement.provenance import match_provenance
from astro_scc.measurement.result import MatchedEpochs, SCCResult
from astro_scc.measurement.selection import select_ssps, ssp_distances
from astro_scc.measurement.stacking import stack_matches, velocity_frame
from astro_scc.measurement.tables import (
    component_table,
    feature_table,
    ssp_table,
    versions,
)
from astro_scc.measurement.votable import write_votable

__all__ = [
    "MatchCache",
    "MatchedEpochs",
    "SCCResult",
    "alignment_errors",
    "angular_displacements",
    "beam_fwhm",
    "component_table",
    "false_discovery_rate",
    "feature_table",
    "match_provenance",
    "position_errors",
    "product_folder",
    "read_matches",
    "select_ssps",
    "ssp_distances",
    "ssp_offsets",
    "ssp_regions",
    "ssp_segmentation",
    "ssp_table",
    "stack_matches",
    "velocity_frame",
    "velocity_hdus",
    "versions",
    "write_epoch_regions",
    "write_matches",
    "write_products",
    "write_ssp_regions",
    "write_votable",
    "write_votables",
]
