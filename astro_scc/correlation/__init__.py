# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Correlation of SSPs with the images of other epochs, giving matches in pixels."""

from astro_scc.correlation.correlate import Correlator, Matches, all_pairs

__all__ = ["Correlator", "Matches", "all_pairs"]
