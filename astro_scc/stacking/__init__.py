# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Stacking of velocity samples into a diagram and a map, and the streams in them."""

from astro_scc.stacking.search_settings import SearchSettings
from astro_scc.stacking.significance import find_streams

__all__ = ["SearchSettings", "find_streams"]
