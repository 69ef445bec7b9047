# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Visualization: one function per figure; each returns a matplotlib figure."""

from astro_scc.visualization.diagram import plot_diagram
from astro_scc.visualization.epochs import (
    plot_epoch,
    plot_epochs,
    plot_intervals,
)
from astro_scc.visualization.features import plot_feature_speeds
from astro_scc.visualization.profiles import plot_profile
from astro_scc.visualization.tracks import plot_members, plot_separation, plot_tracks
from astro_scc.visualization.velocity import (
    plot_map_and_significance,
    plot_significance,
    plot_velocity_map,
)

__all__ = [
    "plot_diagram",
    "plot_epoch",
    "plot_epochs",
    "plot_feature_speeds",
    "plot_intervals",
    "plot_map_and_significance",
    "plot_members",
    "plot_profile",
    "plot_separation",
    "plot_significance",
    "plot_tracks",
    "plot_velocity_map",
]
