# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Kinematics: frames, ridge lines, apparent speeds, and relativistic flows."""

from astro_scc.kinematics.cosmology import apparent_speed, paper_cosmology
from astro_scc.kinematics.frames import (
    ExpansionFrame,
    PositionAngleFrame,
    RadialFrame,
    RidgeLine,
    SkyFrame,
    find_ridge_line,
    fit_position_angle,
)
from astro_scc.kinematics.relativity import (
    beta_intrinsic,
    doppler_factor,
    intrinsic_table,
    lorentz_factor,
    maximum_viewing_angle,
    minimum_lorentz_factor,
    two_sided_jet,
    viewing_angle,
)

__all__ = [
    "ExpansionFrame",
    "PositionAngleFrame",
    "RadialFrame",
    "RidgeLine",
    "SkyFrame",
    "apparent_speed",
    "beta_intrinsic",
    "doppler_factor",
    "find_ridge_line",
    "fit_position_angle",
    "intrinsic_table",
    "lorentz_factor",
    "maximum_viewing_angle",
    "minimum_lorentz_factor",
    "paper_cosmology",
    "two_sided_jet",
    "viewing_angle",
]
