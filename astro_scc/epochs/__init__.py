# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Epochs: the images, how they are read, aligned and brought to one grid and beam."""

from astro_scc.epochs.alignment import align
from astro_scc.epochs.beam import Beam, common_beam, smallest_common_beam
from astro_scc.epochs.components import ComponentList, read_components
from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.cutout import distance_mask
from astro_scc.epochs.fits import read_vlbi_fits
from astro_scc.epochs.grid import reproject_cube, shared_grid
from astro_scc.epochs.inspection import (
    inspect_epochs,
    measure_noise,
    plan_intervals,
)
from astro_scc.epochs.registration import core_positions
from astro_scc.epochs.restoring import correlated_noise, restore
from astro_scc.epochs.serialize import write_epochs

__all__ = [
    "Beam",
    "ComponentList",
    "EpochCube",
    "align",
    "common_beam",
    "core_positions",
    "correlated_noise",
    "distance_mask",
    "inspect_epochs",
    "measure_noise",
    "plan_intervals",
    "read_components",
    "read_vlbi_fits",
    "reproject_cube",
    "restore",
    "shared_grid",
    "smallest_common_beam",
    "write_epochs",
]
