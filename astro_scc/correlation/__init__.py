# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Correlation: each SSP with the images of other epochs, as matches in pixels."""

from astro_scc.correlation.blocks import PairBlock, match_block
from astro_scc.correlation.correlator import Correlator, all_pairs
from astro_scc.correlation.landing import landing_ssps
from astro_scc.correlation.matches import Matches
from astro_scc.correlation.peaks import find_peaks
from astro_scc.correlation.zncc import Template, correlate_windows, zncc

__all__ = [
    "Correlator",
    "Matches",
    "PairBlock",
    "Template",
    "all_pairs",
    "correlate_windows",
    "find_peaks",
    "landing_ssps",
    "match_block",
    "zncc",
]
