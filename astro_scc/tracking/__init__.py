# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracking: features followed from epoch to epoch, one by one (WISE)."""

from astro_scc.tracking.assignment import assign, groups_of
from astro_scc.tracking.candidates import Candidates, core_ssps, find_candidates
from astro_scc.tracking.chains import chain, track_names
from astro_scc.tracking.confidence import (
    LinkedShare,
    linked_counts,
    linked_share,
    shuffled_orders,
)
from astro_scc.tracking.ejection import ejection_epoch, turn_between
from astro_scc.tracking.evidence import Evidence, chance_density
from astro_scc.tracking.fits import MotionFit, fit_motion
from astro_scc.tracking.linking import Links, link
from astro_scc.tracking.nesting import parents
from astro_scc.tracking.paths import Transitions, link_gains
from astro_scc.tracking.profile import average_with_scatter, track_profile
from astro_scc.tracking.result import Tracking, mean_fwhm
from astro_scc.tracking.sharing import company_gain, shared_seats
from astro_scc.tracking.tables import plain_table
from astro_scc.tracking.tracker import FeatureTracker

__all__ = [
    "Candidates",
    "Evidence",
    "FeatureTracker",
    "LinkedShare",
    "Links",
    "MotionFit",
    "Tracking",
    "Transitions",
    "assign",
    "average_with_scatter",
    "chain",
    "chance_density",
    "company_gain",
    "core_ssps",
    "ejection_epoch",
    "find_candidates",
    "fit_motion",
    "groups_of",
    "link",
    "link_gains",
    "linked_counts",
    "linked_share",
    "mean_fwhm",
    "parents",
    "plain_table",
    "shared_seats",
    "shuffled_orders",
    "track_names",
    "track_profile",
    "turn_between",
]
