# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Segmented wavelet decomposition: an image as significant structural patterns."""

from astro_scc.decomposition.decompose import Decomposer, Decomposition
from astro_scc.decomposition.noise import (
    local_noise,
    plane_noise,
    propagated_noise,
    shared_variance,
)
from astro_scc.decomposition.segmentation import find_ssps, quadratic_peak
from astro_scc.decomposition.ssp import SSPs
from astro_scc.decomposition.wavelet import (
    KERNELS,
    atrous_transform,
    scale_size,
    wavelet_planes,
)

__all__ = [
    "KERNELS",
    "Decomposer",
    "Decomposition",
    "SSPs",
    "atrous_transform",
    "find_ssps",
    "local_noise",
    "plane_noise",
    "propagated_noise",
    "quadratic_peak",
    "scale_size",
    "shared_variance",
    "wavelet_planes",
]
