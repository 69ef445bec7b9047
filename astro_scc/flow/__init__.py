# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Flow: speed profiles of jets, acceleration, and groups of scales."""

from astro_scc.flow.profile import Profile, ProfileFit, fit_profile, measure_profile
from astro_scc.flow.speeds import (
    compare_speeds,
    feature_profile,
    measure_acceleration,
    scale_groups,
)

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
