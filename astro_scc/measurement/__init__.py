# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Measurement: the result and its tables."""

from astro_scc.measurement.result import SCCResult
from astro_scc.measurement.tables import false_discovery_rate
from astro_scc.measurement.tables import stream_table as stream_table

__all__ = ["SCCResult", "false_discovery_rate"]
