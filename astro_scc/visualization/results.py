# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The figures of a measurement by their names, those of the report's files."""

from astro_scc.visualization.diagram import plot_diagram
from astro_scc.visualization.epochs import plot_epochs, plot_intervals
from astro_scc.visualization.features import plot_feature_speeds, plot_sensitivity
from astro_scc.visualization.tracks import plot_members, plot_separation, plot_tracks
from astro_scc.visualization.velocity import (
    plot_map_and_significance,
    plot_significance,
    plot_velocity_map,
)


def _of_features(plot):
    """Return a function of a result that draws its features, coloured by stream."""

    def draw(result, **options):
        own = {"component": result.features["component"], **options}
        return plot(result.tracked_features, **own)

    return draw


#: Functions of a result and of options, by the kind of figure.
FIGURES = {
    "velocity_map": plot_velocity_map,
    "significance": plot_significance,
    "paper": plot_map_and_significance,
    "diagram": plot_diagram,
    "members": plot_members,
    "speeds": plot_feature_speeds,
    "tracks": _of_features(plot_tracks),
    "separation": _of_features(plot_separation),
    "epochs": lambda result, **how: plot_epochs(result.cube, result.ssps, **how),
    "intervals": lambda result, **how: plot_intervals(result.cube, result.pairs, **how),
    "sensitivity": lambda result, **how: plot_sensitivity(result.sensitivity, **how),
}


def plot_result(result, kind, **options):
    """Return a figure of a result, see `SCCResult.plot`."""
    if kind not in FIGURES:
        raise ValueError(f"unknown figure {kind!r}: use one of {', '.join(FIGURES)}")
    return FIGURES[kind](result, **options)
