# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Stacking: matches as a diagram and a map of velocities, and what they show."""

from astro_scc.stacking.components import (
    Component,
    component_near,
    find_components,
    fit_gaussian,
)
from astro_scc.stacking.diagram import (
    AxisDisplacements,
    Diagram,
    Rays,
)
from astro_scc.stacking.displacements import Displacements
from astro_scc.stacking.features import Feature, find_features
from astro_scc.stacking.grid import VelocityGrid
from astro_scc.stacking.jitter import JitteredVelocity, jitter_positions
from astro_scc.stacking.pair_maps import PairMaps
from astro_scc.stacking.pairs import DatePairs, baseline_pairs, consecutive_pairs
from astro_scc.stacking.permutations import (
    EpochPermutations,
    number_of_orders,
    permutations_of_epochs,
)
from astro_scc.stacking.search import SearchSettings
from astro_scc.stacking.shuffle import ShuffledStacks, random_orders, shuffle_epochs
from astro_scc.stacking.sightings import Sightings
from astro_scc.stacking.significance import Search, Stream, find_streams
from astro_scc.stacking.stack import gaussian_sum, stack
from astro_scc.stacking.streams import Population, random_effects, separate_streams

__all__ = [
    "AxisDisplacements",
    "Component",
    "DatePairs",
    "Diagram",
    "Displacements",
    "EpochPermutations",
    "Feature",
    "JitteredVelocity",
    "PairMaps",
    "Population",
    "Rays",
    "Search",
    "SearchSettings",
    "ShuffledStacks",
    "Sightings",
    "Stream",
    "VelocityGrid",
    "baseline_pairs",
    "component_near",
    "consecutive_pairs",
    "find_components",
    "find_features",
    "find_streams",
    "fit_gaussian",
    "gaussian_sum",
    "jitter_positions",
    "number_of_orders",
    "permutations_of_epochs",
    "random_effects",
    "random_orders",
    "separate_streams",
    "shuffle_epochs",
    "stack",
]
