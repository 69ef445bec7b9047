# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Stacking of velocity samples into a diagram and a map, and the streams in them."""

from astro_scc.stacking.diagram import Rays
from astro_scc.stacking.dispersion import random_effects
from astro_scc.stacking.features import Feature
from astro_scc.stacking.permutations import EpochPermutations
from astro_scc.stacking.search_settings import SearchSettings
from astro_scc.stacking.significance import Search, Stream, find_streams
from astro_scc.stacking.stack import VelocityPeak, find_velocity_peaks, stack
from astro_scc.stacking.velocities import (
    DatePairs,
    VelocityGrid,
    VelocitySamples,
    baseline_pairs,
    consecutive_pairs,
)

__all__ = [
    "DatePairs",
    "EpochPermutations",
    "Feature",
    "Rays",
    "Search",
    "SearchSettings",
    "Stream",
    "VelocityGrid",
    "VelocityPeak",
    "VelocitySamples",
    "baseline_pairs",
    "consecutive_pairs",
    "find_streams",
    "find_velocity_peaks",
    "random_effects",
    "stack",
]
