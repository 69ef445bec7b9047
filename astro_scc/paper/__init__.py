# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
The stacked cross-correlation of Mertens & Lobanov (2016), as the paper has it.

`astro_scc.paper.method` measures a cube of images in one call; these are its steps, on
arrays.
"""

from astro_scc.paper.correlate import Correlator, Matches, all_pairs
from astro_scc.paper.stack import (
    Displacements,
    baseline_pairs,
    consecutive_pairs,
    draw_orders,
    image_pairs,
    stack_patterns,
)

__all__ = [
    "Correlator", "Displacements", "Matches", "all_pairs", "baseline_pairs",
    "consecutive_pairs", "draw_orders", "image_pairs", "stack_patterns",
]  # fmt: skip
