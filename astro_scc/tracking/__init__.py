# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
SSPs linked within limits of speed.

``astro-scc track`` does not use them, but ``astro_scc.features``.
"""

from astro_scc.tracking.tracker import FeatureTracker

__all__ = ["FeatureTracker"]
