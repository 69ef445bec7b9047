# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Kinematics: axes of motion, apparent speeds, and what follows from them."""

from astro_scc.kinematics.cosmology import (
    apparent_speed,
    beta_intrinsic,
    doppler_factor,
    lorentz_factor,
    maximum_viewing_angle,
    minimum_lorentz_factor,
    paper_cosmology,
    viewing_angle,
)
from astro_scc.kinematics.frames import PositionAngleFrame, RadialFrame, SkyFrame

__all__ = [
    "PositionAngleFrame",
    "RadialFrame",
    "SkyFrame",
    "apparent_speed",
    "beta_intrinsic",
    "doppler_factor",
    "lorentz_factor",
    "maximum_viewing_angle",
    "minimum_lorentz_factor",
    "paper_cosmology",
    "viewing_angle",
]
