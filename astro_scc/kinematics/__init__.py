# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Kinematics: frames, ridge lines, apparent speeds, and the flows behind them."""

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
from astro_scc.kinematics.frames import (
    ExpansionFrame,
    PositionAngleFrame,
    RadialFrame,
    RidgeLine,
    SkyFrame,
    find_ridge_line,
    fit_position_angle,
)

__all__ = [
    "ExpansionFrame", "PositionAngleFrame", "RadialFrame", "RidgeLine", "SkyFrame",
    "apparent_speed", "beta_intrinsic", "doppler_factor", "find_ridge_line",
    "fit_position_angle", "lorentz_factor", "maximum_viewing_angle",
    "minimum_lorentz_factor", "paper_cosmology", "viewing_angle",
]  # fmt: skip
