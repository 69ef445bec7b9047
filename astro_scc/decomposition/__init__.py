# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Segmented wavelet decomposition of images into significant structural patterns."""

from astro_scc.decomposition.decompose import Decomposer
from astro_scc.decomposition.segmentation import SSPs

__all__ = ["Decomposer", "SSPs"]
