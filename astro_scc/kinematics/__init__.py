# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Kinematics: axes of motion, apparent speeds, and what follows from them."""

from astro_scc.kinematics.cosmology import (
    apparent_speed,
    cosmology_text,
    paper_cosmology,
    table_in_c,
    to_cosmology,
    to_redshift,
)
from astro_scc.kinematics.expansion import ExpansionFrame
from astro_scc.kinematics.flow import (
    beta_intrinsic,
    doppler_factor,
    intrinsic_table,
    lorentz_factor,
    maximum_viewing_angle,
    minimum_lorentz_factor,
    two_sided_jet,
    two_sided_ratio,
    viewing_angle,
)
from astro_scc.kinematics.frames import (
    PositionAngleFrame,
    RadialFrame,
    SkyFrame,
    frame_displacements,
)
from astro_scc.kinematics.ridge_line import RidgeLine
from astro_scc.kinematics.ridge_search import (
    find_ridge_line,
    fit_position_angle,
    limb_masks,
)

__all__ = [
    "ExpansionFrame",
    "PositionAngleFrame",
    "RadialFrame",
    "RidgeLine",
    "SkyFrame",
    "apparent_speed",
    "beta_intrinsic",
    "cosmology_text",
    "doppler_factor",
    "find_ridge_line",
    "fit_position_angle",
    "frame_displacements",
    "intrinsic_table",
    "limb_masks",
    "lorentz_factor",
    "maximum_viewing_angle",
    "minimum_lorentz_factor",
    "paper_cosmology",
    "table_in_c",
    "to_cosmology",
    "to_redshift",
    "two_sided_jet",
    "two_sided_ratio",
    "viewing_angle",
]
