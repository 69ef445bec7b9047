# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Stacking: matches as a map of velocities, its maxima and what they are worth."""

from astro_scc.stacking.components import Component, find_components, fit_gaussian
from astro_scc.stacking.displacements import Displacements
from astro_scc.stacking.grid import VelocityGrid
from astro_scc.stacking.jitter import JitteredVelocity, jitter_positions
from astro_scc.stacking.pair_maps import PairMaps
from astro_scc.stacking.pairs import DatePairs, baseline_pairs, consecutive_pairs
from astro_scc.stacking.shuffle import ShuffledStacks, random_orders, shuffle_epochs
from astro_scc.stacking.stack import gaussian_sum, stack

__all__ = [
    "Component",
    "DatePairs",
    "Displacements",
    "JitteredVelocity",
    "PairMaps",
    "ShuffledStacks",
    "VelocityGrid",
    "baseline_pairs",
    "consecutive_pairs",
    "find_components",
    "fit_gaussian",
    "gaussian_sum",
    "jitter_positions",
    "random_orders",
    "shuffle_epochs",
    "stack",
]
