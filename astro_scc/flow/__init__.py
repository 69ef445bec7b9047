# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Flow: speed profiles of jets, acceleration, groups of scales, and fields."""

from astro_scc.flow.field import FlowField, measure_field
from astro_scc.flow.models import ProfileFit, fit_profile
from astro_scc.flow.profile import Profile, measure_profile
from astro_scc.flow.speeds import compare_scales, feature_profile, measure_acceleration

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
