# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The stacked cross-correlation of Mertens & Lobanov (2016), as the paper has it."""

from astro_scc.paper.components import stack_patterns
from astro_scc.paper.stack import Displacements
from astro_scc.paper.trials import (
    baseline_pairs,
    consecutive_pairs,
    draw_orders,
    image_pairs,
)  # fmt: skip

__all__ = [
    "Displacements", "baseline_pairs", "consecutive_pairs", "draw_orders",
    "image_pairs", "stack_patterns",
]  # fmt: skip
