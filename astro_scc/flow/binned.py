# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speed against distance from the features of a measurement."""

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc.measurement import SCCResult
from astro_scc.measurement.axes import projection_of
from astro_scc.stacking.dispersion import feature_speeds, random_effects

#: Features of a bin: with fewer a dispersion has an error of half its size.
LEAST = 5
#: Most bins.
MOST_BINS = 8


def feature_profile(result: SCCResult) -> QTable:
    """
    Return the mean speeds of moving features in bins of distance.

    The features of each moving component are sorted by their distance and divided
    into bins of equal numbers, at least five in each; the mean and the dispersion are
    those of `~astro_scc.stacking.random_effects`.  Nothing is stacked again.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`

    Returns
    -------
    `~astropy.table.QTable`
        One row per component and bin: ``component``, ``n_features``, ``r_min``,
        ``r_max`` and ``r_mid``, the smallest, the largest and the mean distance,
        ``pm_parallel`` with ``pm_parallel_err``, and ``dispersion`` with
        ``dispersion_err``.  Empty if no component has five features.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.flow import feature_profile
    >>> from astro_scc.simulation import simulate_jet
    >>> scc = StackedCrossCorrelation(scales=[1, 2], position_angle=270 * u.deg)
    >>> profile = feature_profile(scc(simulate_jet(rng=1).cube, n_trials=99, rng=1))
    >>> profile["n_features"].tolist()
    [9]
    """
    project = projection_of(result)
    rows = []
    for number, stream in enumerate(result.search.streams, 1):
        beam = project.beam(stream.angle)[0]
        features = sorted(stream.features, key=lambda feature: abs(feature.place))
        n_bins = min(len(features) // LEAST, MOST_BINS)
        if stream.kind != "moving" or n_bins == 0:
            continue
        for part in np.array_split(np.arange(len(features)), n_bins):
            own = [features[k] for k in part]
            place = np.abs([f.place for f in own]) * beam
            speed, error = feature_speeds(own)
            mean = random_effects(np.abs(speed) * beam, error * beam)
            rows.append(
                (number, len(own), place.min(), place.max(), place.mean(), mean.mean,
                 mean.error, mean.dispersion, mean.dispersion_error)
            )  # fmt: skip
    component, n_features, *columns = np.reshape(rows, (-1, 9)).T
    table = QTable({"component": component.astype(int)})
    table["n_features"] = n_features.astype(int)
    names = ["r_min", "r_max", "r_mid", "pm_parallel", "pm_parallel_err", "dispersion",
             "dispersion_err"]  # fmt: skip
    for name, values in zip(names, columns, strict=True):
        table[name] = values * (u.mas if name.startswith("r_") else u.mas / u.yr)
    return table
