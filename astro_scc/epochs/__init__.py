# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Epochs: the images, where they come from and how they are laid on one another."""

from astro_scc.epochs.alignment import align
from astro_scc.epochs.beam import Beam
from astro_scc.epochs.component_files import read_components
from astro_scc.epochs.components import ComponentList
from astro_scc.epochs.core import core_positions
from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.cutout import crop, distance_mask, region_mask
from astro_scc.epochs.epoch_files import write_epochs
from astro_scc.epochs.fits import read_vlbi_fits
from astro_scc.epochs.inspection import inspect_epochs
from astro_scc.epochs.intervals import IntervalPlan, plan_intervals
from astro_scc.epochs.noise import correlated_noise
from astro_scc.epochs.positions import beam_fwhm, position_errors, ssp_offsets
from astro_scc.epochs.reprojection import reproject_cube, shared_grid
from astro_scc.epochs.restoring import offset_wcs, restore
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
    "offset_wcs",
    "plan_intervals",
    "position_errors",
    "read_components",
    "read_vlbi_fits",
    "region_mask",
    "reproject_cube",
    "restore",
    "shared_grid",
    "smallest_common_beam",
    "ssp_offsets",
    "write_epochs",
]
