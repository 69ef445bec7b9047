# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Epochs: the images, how they are read, aligned and brought to one grid and beam."""

from astro_scc.epochs.cube import EpochCube
from astro_scc.epochs.inspection import inspect_epochs, plan_intervals
from astro_scc.epochs.lists import ComponentList, read_components
from astro_scc.epochs.registration import core_positions
from astro_scc.epochs.serialize import write_epochs
from astro_scc.images.beam import Beam
from astro_scc.images.regions import distance_mask

restore = EpochCube.from_components

__all__ = [
    "Beam", "ComponentList", "EpochCube", "core_positions", "distance_mask",
    "inspect_epochs", "plan_intervals", "read_components", "restore", "write_epochs",
]  # fmt: skip
