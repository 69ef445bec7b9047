# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The features of a measurement as tables: one row each, and one row per epoch."""

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.measurement.axes import projection_of


def feature_table(result):
    """
    Return the features that were followed, each with its own speed.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`

    Returns
    -------
    `~astropy.table.QTable`
        One row per feature: its number, its ``component``, its ``scale``, the
        number of epochs, its ``first`` and ``last`` date and its ``motion``
        between them, its mean ``distance`` from the reference pixel along the
        first component, its speed ``pm`` along and ``pm_transverse`` across it
        with errors, and its ``acceleration``.
    """
    ssps, cube = result.matched.ssps, result.cube
    project = projection_of(result)
    rows = [
        (number, feature, project.beam(stream.angle))
        for number, stream in enumerate(result.search.streams, 1)
        for feature in stream.features
    ]
    features = [feature for _, feature, _ in rows]
    beam = np.reshape([beam for *_, beam in rows], (-1, 2)).T * u.mas
    ends = np.reshape([ssps.epoch[f.ssp[[0, -1]]] for f in features], (-1, 2))
    first, last = (Time(cube.times[k], format="isot") for k in ends.T.astype(int))
    per_beam = {
        "distance": ("place", 0, u.one),
        "motion": ("motion", 0, u.one),
        "pm": ("speed", 0, 1 / u.yr),
        "pm_err": ("error", 0, 1 / u.yr),
        "pm_transverse": ("across", 1, 1 / u.yr),
        "pm_transverse_err": ("across_error", 1, 1 / u.yr),
        "acceleration": ("acceleration", 0, 1 / u.yr**2),
        "acceleration_err": ("acceleration_error", 0, 1 / u.yr**2),
    }
    table = QTable(
        {
            "feature": np.arange(len(rows)),
            "component": np.array([number for number, *_ in rows], dtype=int),
            "scale": np.array([ssps.scale[f.ssp[0]] for f in features], dtype=float),
            "n_epochs": np.array([len(f) for f in features], dtype=int),
            "first": first,
            "last": last,
        }
    )
    for name, (attribute, axis, unit) in per_beam.items():
        values = np.array([getattr(f, attribute) for f in features], dtype=float)
        if name != "motion" and not name.endswith("_err"):
            values *= _sense(result)
        table[name] = (values * beam[axis] * unit).to(unit * u.mas)
    table["pm"].info.description = "along the first component"
    table["pm_transverse"].info.description = "across the first component"
    return table


def _sense(result):
    """Return the sign of the first component's speed along the axis of the search."""
    streams = result.search.streams
    return -1.0 if streams and streams[0].along.mean < 0 else 1.0


def feature_positions(result):
    """
    Return where each feature was seen.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`

    Returns
    -------
    `~astropy.table.QTable`
        A row for each feature and epoch: ``component``, ``feature``, its number in
        `feature_table`, ``ssp``, ``epoch``, ``date``, and the ``distance`` from the
        reference pixel along the first component.
    """
    ssps, cube = result.matched.ssps, result.cube
    project = projection_of(result)
    parts, n_features = [np.zeros((4, 0))], 0
    for number, stream in enumerate(result.search.streams, 1):
        along = project(stream.angle).position[:, 0] * project.beam(stream.angle)[0]
        for feature in stream.features:
            same = np.ones(len(feature))
            parts.append(
                [number * same, n_features * same, feature.ssp, along[feature.ssp]]
            )
            n_features += 1
    *numbers, distance = np.concatenate(parts, axis=1)
    component, feature, ssp = np.array(numbers, dtype=int)
    table = QTable({"component": component, "feature": feature, "ssp": ssp})
    table["epoch"] = ssps.epoch[ssp]
    table["date"] = Time(cube.times[ssps.epoch[ssp]], format="isot")
    table["distance"] = _sense(result) * distance * u.mas
    return table
