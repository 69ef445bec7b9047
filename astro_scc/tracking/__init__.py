# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracking: SSPs linked from epoch to epoch within limits of speed (WISE)."""

from astro_scc.tracking.candidates import Candidates, find_candidates
from astro_scc.tracking.likelihood import LinkLikelihood
from astro_scc.tracking.linking import Links, assign, link
from astro_scc.tracking.tracker import FeatureTracker

__all__ = [
    "Candidates",
    "FeatureTracker",
    "LinkLikelihood",
    "Links",
    "assign",
    "find_candidates",
    "link",
]
