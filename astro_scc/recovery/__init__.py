# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Recovery: injection of moving features, and completeness."""

from astro_scc.recovery.completeness import completeness
from astro_scc.recovery.injection import draw_paths, inject

__all__ = ["completeness", "draw_paths", "inject"]
