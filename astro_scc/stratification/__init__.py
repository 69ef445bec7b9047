# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Stratification: do scales, or limbs, of a jet differ in speed and in place?"""

from astro_scc.stratification.groups import limb_groups, scale_groups
from astro_scc.stratification.positions import compare_positions
from astro_scc.stratification.speeds import compare_speeds

__all__ = [
    "compare_positions",
    "compare_speeds",
    "limb_groups",
    "scale_groups",
]
