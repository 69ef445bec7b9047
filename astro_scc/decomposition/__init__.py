# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Segmented wavelet decomposition of images into significant structural patterns."""

from astro_scc.decomposition.decompose import Decomposer, Decomposition
from astro_scc.decomposition.noise import plane_noise, propagated_noise
from astro_scc.decomposition.segmentation import SSPs, find_ssps
from astro_scc.decomposition.wavelet import scale_size, wavelet_planes

__all__ = [
    "Decomposer",
    "Decomposition",
    "SSPs",
    "find_ssps",
    "plane_noise",
    "propagated_noise",
    "scale_size",
    "wavelet_planes",
]
