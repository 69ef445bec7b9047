# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features: found in the images of all epochs, followed, each with its own speed."""

from astro_scc.features.detections import Detections
from astro_scc.features.finder import Features, find_features
from astro_scc.features.gaussians import Gaussians, fit_gaussians
from astro_scc.features.motion import Motion, fit_motion
from astro_scc.features.track_settings import TrackSettings
from astro_scc.features.tracks import Track, find_tracks

__all__ = [
    "Detections",
    "Features",
    "Gaussians",
    "Motion",
    "Track",
    "TrackSettings",
    "find_features",
    "find_tracks",
    "fit_gaussians",
    "fit_motion",
]
