# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Recovery: what is found of motion that was put in."""

from astro_scc.recovery.completeness import completeness
from astro_scc.recovery.features import FeaturePaths, draw_paths, inject
from astro_scc.recovery.planning import plan, smallest_plan

__all__ = [
    "FeaturePaths",
    "completeness",
    "draw_paths",
    "inject",
    "plan",
    "smallest_plan",
]
