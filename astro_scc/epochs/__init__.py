# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Epochs: the images, where they come from and how they are laid on one another."""

from astro_scc.epochs.alignment import align
from astro_scc.epochs.beam import Beam
from astro_scc.epochs.components import ComponentList, read_components
from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.cutout import crop, distance_mask, region_mask
from astro_scc.epochs.files.epoch_files import write_epochs
from astro_scc.epochs.files.fits import read_vlbi_fits
from astro_scc.epochs.files.inspection import inspect_epochs
from astro_scc.epochs.grid import reproject_cube, shared_grid
from astro_scc.epochs.intervals import IntervalPlan, plan_intervals
from astro_scc.epochs.offset_grid import offset_wcs
from astro_scc.epochs.positions import (
    beam_fwhm,
    name_by_frame,
    position_errors,
    sky_columns,
    ssp_offsets,
)
from astro_scc.epochs.registration import core_positions
from astro_scc.epochs.restoring import correlated_noise, restore
from astro_scc.epochs.smoothing import common_beam, smallest_common_beam
from astro_scc.epochs.statistics import measure_noise

__all__ = [
    "Beam",
    "ComponentList",
    "EpochCube",
    "IntervalPlan",
    "align",
    "beam_fwhm",
    "common_beam",
    "core_positions",
    "correlated_noise",
    "crop",
    "distance_mask",
    "inspect_epochs",
    "measure_noise",
    "name_by_frame",
    "offset_wcs",
    "plan_intervals",
    "position_errors",
    "read_components",
    "read_vlbi_fits",
    "region_mask",
    "reproject_cube",
    "restore",
    "shared_grid",
    "sky_columns",
    "smallest_common_beam",
    "ssp_offsets",
    "write_epochs",
]
