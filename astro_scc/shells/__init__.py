# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Shells: rates of expansion about a centre, and the centre."""

from astro_scc.shells.centre import ShellFit, fit_shell
from astro_scc.shells.compact import remove_compact
from astro_scc.shells.expansion import expansion_speed, measure_expansion

__all__ = [
    "ShellFit",
    "expansion_speed",
    "fit_shell",
    "measure_expansion",
    "remove_compact",
]
