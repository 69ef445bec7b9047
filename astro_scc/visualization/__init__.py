# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Visualization: each function returns a matplotlib figure.

Those of a measurement and of images are drawn by `SCCResult.plot
<astro_scc.measurement.SCCResult.plot>` and `EpochCube.plot
<astro_scc.epochs.EpochCube.plot>`.
"""

from astro_scc.visualization.profiles import plot_profile

__all__ = ["plot_profile"]
