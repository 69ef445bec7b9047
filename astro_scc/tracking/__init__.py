# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Tracking: SSPs linked within limits of speed, apart from ``astro_scc.features``."""

from astro_scc.tracking.tracker import FeatureTracker

__all__ = ["FeatureTracker"]
