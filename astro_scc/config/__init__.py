# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
What determines a measurement, as settings in TOML files.

The keys are those of the command line, ``max_speed`` for ``--max-speed``.
Quantities are text with a unit, ``"2 mas / yr"``.
"""

from astro_scc.config.files import format_config, read_config
from astro_scc.config.measuring import (
    distance_of,
    read_epochs,
    select_epochs,
    settings_as_used,
)
from astro_scc.config.settings import parse_setting, plain_settings
from astro_scc.quantities import parse_quantities, to_time

__all__ = [
    "distance_of",
    "format_config",
    "parse_quantities",
    "parse_setting",
    "plain_settings",
    "read_config",
    "read_epochs",
    "select_epochs",
    "settings_as_used",
    "to_time",
]
