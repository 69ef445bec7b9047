# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Flow: speed profiles of jets, acceleration, and groups of scales."""

from astro_scc.flow.acceleration import feature_profile, measure_acceleration
from astro_scc.flow.groups import compare_speeds, scale_groups
from astro_scc.flow.models import ProfileFit, fit_profile
from astro_scc.flow.profile import Profile, measure_profile

__all__ = [
    "Profile",
    "ProfileFit",
    "compare_speeds",
    "feature_profile",
    "fit_profile",
    "measure_acceleration",
    "measure_profile",
    "scale_groups",
]
