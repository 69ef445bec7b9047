# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Speed against distance from the features of a measurement."""

import astropy.units as u
import numpy as np
from astropy.table import QTable

from astro_scc.measurement.axes import projection_of
from astro_scc.stacking.streams import feature_speeds, random_effects

#: Features of a bin: with fewer a dispersion has an error of half its size.
LEAST = 5
#: Most bins.
MOST_BINS = 8


def feature_profile(result):
    """
    Return the mean speed of the moving features in bins of distance.

    The features of all moving components are sorted by their distance and divided
    into bins of equal numbers, at least five in each; the mean and the dispersion are
    those of `~astro_scc.stacking.random_effects`.  Nothing is stacked again.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`

    Returns
    -------
    `~astropy.table.QTable`
        A row a bin: ``r_min``, ``r_max`` and ``r_mid``, the smallest, the largest and
        the mean distance along the component, ``n_features``, ``pm_parallel`` with
        ``pm_parallel_err``, and ``dispersion`` with ``dispersion_err``.  Empty with
        fewer than five features.

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
    moving = [
        (feature, project.beam(stream.angle)[0])
        for stream in result.search.streams
        if stream.kind == "moving"
        for feature in stream.features
    ]
    moving.sort(key=lambda own: abs(own[0].place) * own[1])
    n_bins = min(len(moving) // LEAST, MOST_BINS)
    rows = []
    for part in np.array_split(np.arange(len(moving)), n_bins) if n_bins else ():
        features = [moving[k][0] for k in part]
        beam = np.array([moving[k][1] for k in part])
        place = np.abs([f.place for f in features]) * beam
        speed, error = feature_speeds(features)
        mean = random_effects(np.abs(speed) * beam, error * beam)
        rows.append(
            (place.min(), place.max(), place.mean(), len(part), mean.mean, mean.error,
             mean.dispersion, mean.dispersion_error)
        )  # fmt: skip
    columns = np.reshape(rows, (-1, 8)).T
    names = ["r_min", "r_max", "r_mid", "n_features", "pm_parallel", "pm_parallel_err",
             "dispersion", "dispersion_err"]  # fmt: skip
    table = QTable(dict(zip(names, columns, strict=True)))
    table["n_features"] = table["n_features"].astype(int)
    for name in names[:3]:
        table[name].unit = u.mas
    for name in names[4:]:
        table[name].unit = u.mas / u.yr
    return QTable(table)
