# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Profiles: how the speed of a flow changes with distance."""

from astro_scc.profiles.acceleration import FlowAcceleration, measure_acceleration
from astro_scc.profiles.fits import ProfileFit, fit_profile
from astro_scc.profiles.lorentz import LorentzProfile, lorentz_profile
from astro_scc.profiles.products import write_profile
from astro_scc.profiles.profile import Profile, bins_of, measure_profile

__all__ = [
    "FlowAcceleration",
    "LorentzProfile",
    "Profile",
    "ProfileFit",
    "bins_of",
    "fit_profile",
    "lorentz_profile",
    "measure_acceleration",
    "measure_profile",
    "write_profile",
]
