# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stacked cross-correlation of Mertens & Lobanov (2016), as the paper has it."""

from astro_scc.paper.components import PaperComponent, PaperStack, stack_patterns
from astro_scc.paper.stack import Displacements, VelocityGrid
from astro_scc.paper.trials import (
    DatePairs,
    baseline_pairs,
    consecutive_pairs,
    draw_orders,
    image_pairs,
)

__all__ = [
    "DatePairs",
    "Displacements",
    "PaperComponent",
    "PaperStack",
    "VelocityGrid",
    "baseline_pairs",
    "consecutive_pairs",
    "draw_orders",
    "image_pairs",
    "stack_patterns",
]
