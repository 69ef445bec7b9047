# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Flow: speed profiles of jets, acceleration, groups of scales, and fields."""

from astro_scc.flow.models import ProfileFit, fit_profile, measure_acceleration
from astro_scc.flow.profile import Profile, measure_profile
from astro_scc.flow.speeds import (
    FlowField,
    compare_scales,
    feature_profile,
    measure_field,
)

__all__ = [
    "FlowField",
    "Profile",
    "ProfileFit",
    "compare_scales",
    "feature_profile",
    "fit_profile",
    "measure_acceleration",
    "measure_field",
    "measure_profile",
]
