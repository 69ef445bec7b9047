# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Visualization: functions that return matplotlib figures, and a page to explore.

Those of a measurement and of images are drawn by `SCCResult.plot
<astro_scc.measurement.SCCResult.plot>` and `EpochCube.plot
<astro_scc.epochs.EpochCube.plot>`.
"""

from astro_scc.visualization import spectrum, tracks, velocity
from astro_scc.visualization.images import plot_epochs
from astro_scc.visualization.speeds import (
    plot_feature_speeds,
    plot_profile,
    plot_sensitivity,
)

__all__ = ["plot_profile"]


def _of_features(plot):
    """Return a function of a result that draws its features, coloured by stream."""

    def draw(result, **options):
        own = {"stream": result.features["stream"], **options}
        return plot(result.tracked_features, **own)

    return draw


#: Functions of a result and of options, by the kind of figure, its name in a report.
FIGURES = {
    "spectrum": spectrum.plot_spectrum,
    "distance": spectrum.plot_distance,
    "velocity_map": velocity.plot_velocity_map,
    "significance": velocity.plot_significance,
    "paper": velocity.plot_map_and_significance,
    "diagram": velocity.plot_diagram,
    "speeds": plot_feature_speeds,
    "tracks": _of_features(tracks.plot_tracks),
    "separation": _of_features(tracks.plot_separation),
    "epochs": lambda result, **how: plot_epochs(result.cube, result.ssps, **how),
    "sensitivity": lambda result, **how: plot_sensitivity(result.sensitivity, **how),
}


def plot_result(result, kind, **options):
    """Return a figure of a result, see `SCCResult.plot`."""
    if kind not in FIGURES:
        raise ValueError(f"unknown figure {kind!r}: use one of {', '.join(FIGURES)}")
    return FIGURES[kind](result, **options)
