# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Recovery: injection of moving features, completeness, and planning of epochs."""

from astro_scc.recovery.completeness import completeness
from astro_scc.recovery.injection import draw_paths, inject
from astro_scc.recovery.observing_plan import plan, smallest_plan

__all__ = ["completeness", "draw_paths", "inject", "plan", "smallest_plan"]
