# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Streams: the diagram of the matches, its significance, and the features in it."""

from astro_scc.streams.diagram import SearchSettings
from astro_scc.streams.search import find_streams

__all__ = ["SearchSettings", "find_streams"]
