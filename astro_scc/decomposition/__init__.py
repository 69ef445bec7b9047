# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Segmented wavelet decomposition of images into significant structural patterns."""

from astro_scc.decomposition.segmentation import Decomposer, SSPs

__all__ = ["Decomposer", "SSPs"]
