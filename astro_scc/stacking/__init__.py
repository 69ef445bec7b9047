# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Stacking: matches as a map of velocities, its maxima and what they are worth."""

from astro_scc.stacking.acceleration import (
    Acceleration,
    fit_acceleration,
    flow_blocks,
    flow_speed,
)
from astro_scc.stacking.components import (
    Component,
    component_near,
    find_components,
    fit_gaussian,
)
from astro_scc.stacking.contrast import Contrast
from astro_scc.stacking.displacements import Displacements
from astro_scc.stacking.expansion import Expansion, fit_expansion
from astro_scc.stacking.features import Feature, find_features
from astro_scc.stacking.diagram import AxisDisplacements, Diagram, EpochPermutations
from astro_scc.stacking.search import SearchSettings
from astro_scc.stacking.grid import VelocityGrid
from astro_scc.stacking.groups import GroupSpeeds, compare_groups, paired_p_value
from astro_scc.stacking.jitter import JitteredVelocity, jitter_positions
from astro_scc.stacking.lags import LagTest, lag_test
from astro_scc.stacking.misalignment import alignment_scatter
from astro_scc.stacking.nulls import (
    NULL_HYPOTHESES,
    NULLS,
    NullTest,
    Scene,
    ScrambleNull,
    ShuffleNull,
)
from astro_scc.stacking.orders import (
    AllOrders,
    BlockOrders,
    ReversedBlocks,
    WithoutSuccessors,
)
from astro_scc.stacking.pair_maps import PairMaps
from astro_scc.stacking.pairs import DatePairs, baseline_pairs, consecutive_pairs
from astro_scc.stacking.sampling import sampling_scatter
from astro_scc.stacking.scatter import epoch_scatter, feature_scatter
from astro_scc.stacking.shuffle import ShuffledStacks, random_orders, shuffle_epochs
from astro_scc.stacking.sightings import Sightings
from astro_scc.stacking.significance import Search, Stream, find_streams
from astro_scc.stacking.streams import Population, random_effects, separate_streams
from astro_scc.stacking.stack import gaussian_sum, stack
from astro_scc.stacking.witnesses import Witnesses, find_witnesses

__all__ = [
    "NULLS",
    "NULL_HYPOTHESES",
    "AllOrders",
    "BlockOrders",
    "Acceleration",
    "Component",
    "Contrast",
    "DatePairs",
    "Displacements",
    "Expansion",
    "GroupSpeeds",
    "JitteredVelocity",
    "LagTest",
    "NullTest",
    "PairMaps",
    "ReversedBlocks",
    "Scene",
    "ScrambleNull",
    "ShuffleNull",
    "ShuffledStacks",
    "Sightings",
    "VelocityGrid",
    "WithoutSuccessors",
    "Witnesses",
    "alignment_scatter",
    "baseline_pairs",
    "compare_groups",
    "component_near",
    "consecutive_pairs",
    "epoch_scatter",
    "feature_scatter",
    "find_components",
    "find_witnesses",
    "fit_acceleration",
    "fit_expansion",
    "fit_gaussian",
    "flow_blocks",
    "flow_speed",
    "gaussian_sum",
    "jitter_positions",
    "lag_test",
    "paired_p_value",
    "random_orders",
    "sampling_scatter",
    "shuffle_epochs",
    "stack",
]
