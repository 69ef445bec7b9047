# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Features: found in the images of all epochs, followed, each with its own speed."""

from astro_scc.features.finder import Features, find_features
from astro_scc.features.tracks import TrackSettings

__all__ = ["Features", "TrackSettings", "find_features"]
