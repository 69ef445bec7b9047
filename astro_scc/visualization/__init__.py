# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Visualization: one function a figure, each a matplotlib figure of its own."""

from astro_scc.visualization.animation import animate_epochs, write_animation
from astro_scc.visualization.diagram import plot_diagram
from astro_scc.visualization.images import plot_epoch, plot_epochs
from astro_scc.visualization.members import plot_members
from astro_scc.visualization.profiles import (
    plot_position_angles,
    plot_profile,
    plot_scale_maps,
)
from astro_scc.visualization.significance import (
    plot_map_and_significance,
    plot_significance,
)
from astro_scc.visualization.timeline import plot_intervals
from astro_scc.visualization.tracks import (
    plot_separation,
    plot_track_profile,
    plot_tracks,
)
from astro_scc.visualization.velocity import plot_velocity_map

__all__ = [
    "animate_epochs",
    "plot_diagram",
    "plot_epoch",
    "plot_epochs",
    "plot_intervals",
    "plot_map_and_significance",
    "plot_members",
    "plot_position_angles",
    "plot_profile",
    "plot_scale_maps",
    "plot_separation",
    "plot_significance",
    "plot_track_profile",
    "plot_tracks",
    "plot_velocity_map",
    "write_animation",
]
