# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Matching: from a cube to the patterns of its epochs and their matches."""

from astro_scc.matching.matched import DecomposedEpochs, MatchedEpochs, select_ssps
from astro_scc.matching.plan import SearchPlan

__all__ = ["DecomposedEpochs", "MatchedEpochs", "SearchPlan", "select_ssps"]
