# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracking: features followed from epoch to epoch, one by one (WISE)."""

from astro_scc.tracking.assignment import assign, groups_of
from astro_scc.tracking.candidates import Candidates, find_candidates
from astro_scc.tracking.evidence import Evidence, chance_density
from astro_scc.tracking.linking import Links, link
from astro_scc.tracking.nesting import parents
from astro_scc.tracking.paths import Transitions, link_gains
from astro_scc.tracking.sharing import company_gain, shared_seats

__all__ = [
    "Candidates",
    "Evidence",
    "Links",
    "Transitions",
    "assign",
    "chance_density",
    "company_gain",
    "find_candidates",
    "groups_of",
    "link",
    "link_gains",
    "parents",
    "shared_seats",
]
