# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracking: SSPs linked from epoch to epoch within limits of speed (WISE)."""

from astro_scc.tracking.tracker import FeatureTracker

__all__ = ["FeatureTracker"]
