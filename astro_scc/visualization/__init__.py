# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""
Visualization: functions that return matplotlib figures, and a page to explore.

Those of a measurement and of images are drawn by `SCCResult.plot
<astro_scc.measurement.SCCResult.plot>` and `EpochCube.plot
<astro_scc.epochs.EpochCube.plot>`.
"""

from astro_scc.visualization import speeds, tracks, velocity
from astro_scc.visualization.images import plot_epochs
from astro_scc.visualization.speeds import plot_profile

__all__ = ["plot_profile"]

#: Figures of a result, by their names in a report.
FIGURES = (
    "spectrum", "distance", "velocity_map", "significance", "paper", "diagram",
    "speeds", "tracks", "separation", "epochs", "sensitivity",
)  # fmt: skip


def plot_result(result, kind, **options):
    """Return a figure of a result, see `SCCResult.plot`."""
    if kind not in FIGURES:
        raise ValueError(f"unknown figure {kind!r}: use one of {', '.join(FIGURES)}")
    match kind:
        case "spectrum" | "distance":
            return getattr(speeds, f"plot_{kind}")(result, **options)
        case "tracks" | "separation":
            options.setdefault("stream", result.features["stream"])
            return getattr(tracks, f"plot_{kind}")(result.tracked_features, **options)
        case "speeds":
            return tracks.plot_feature_speeds(result, **options)
        case "epochs":
            return plot_epochs(result.cube, result.ssps, **options)
        case "sensitivity":
            return speeds.plot_sensitivity(result.sensitivity, **options)
    return getattr(velocity, f"plot_{kind}")(result, **options)
