# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Epochs: the images, where they come from and how they are laid on one another."""

from astro_scc.epochs.beam import Beam
from astro_scc.epochs.cube import EpochCube

__all__ = ["Beam", "EpochCube"]
