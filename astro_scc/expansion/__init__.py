# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Expansion: the centre of a shell and its expansion rates."""

from astro_scc.expansion.centre import fit_shell
from astro_scc.expansion.sectors import expansion_speed, measure_expansion

__all__ = ["expansion_speed", "fit_shell", "measure_expansion"]
