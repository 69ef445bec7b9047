# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracking: individual features followed from epoch to epoch (WISE)."""

from astro_scc.tracking.candidates import Candidates, find_candidates
from astro_scc.tracking.likelihood import LinkLikelihood
from astro_scc.tracking.linking import Links, assign, link
from astro_scc.tracking.motion import MotionFit, ejection_epoch, fit_motion
from astro_scc.tracking.tables import plain_table
from astro_scc.tracking.tracker import FeatureTracker
from astro_scc.tracking.tracks import Tracking

__all__ = [
    "Candidates",
    "FeatureTracker",
    "LinkLikelihood",
    "Links",
    "MotionFit",
    "Tracking",
    "assign",
    "ejection_epoch",
    "find_candidates",
    "fit_motion",
    "link",
    "plain_table",
]
