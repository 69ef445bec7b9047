# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""The SSPs of a measurement, their matches and their features as tables."""

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.decomposition import scale_size
from astro_scc.epochs import positions
from astro_scc.measurement.axes import projection_of
from astro_scc.stacking.search_settings import DEFAULT
from astro_scc.stacking.stack import sample_velocities
from astro_scc.units import round_to_errors

#: Columns of features: the attribute, its axis, and its unit in beams.
PER_BEAM = {
    "distance": ("place", 0, u.one),
    "motion": ("motion", 0, u.one),
    "pm": ("speed", 0, 1 / u.yr),
    "pm_err": ("error", 0, 1 / u.yr),
    "pm_transverse": ("across", 1, 1 / u.yr),
    "pm_transverse_err": ("across_error", 1, 1 / u.yr),
    "acceleration": ("acceleration", 0, 1 / u.yr**2),
    "acceleration_err": ("acceleration_error", 0, 1 / u.yr**2),
}
#: A match within this many of its standard errors belongs to a component.
MEMBER_SIGMA = 2.0


def ssp_table(ssps, cube, *, select=None):
    """
    Return the catalogue of SSPs with sky positions and errors.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
        Of all epochs.
    cube : `~astro_scc.epochs.EpochCube`
    select : array_like of bool, shape (n_ssps,), optional
        Which SSPs were used, for the column ``in_region``.

    Returns
    -------
    `~astropy.table.QTable`
        One row per SSP; ``date`` is a `~astropy.time.Time`.  ``east`` and
        ``north`` are offsets of the maximum from the reference pixel, with
        thermal errors ``beam / (sqrt(2) SNR)``.  In frames without right
        ascension, `~astro_scc.epochs.name_by_frame` gives the column names.
    """
    n = len(ssps)
    select = np.ones(n, bool) if select is None else np.asarray(select, bool)
    east, north = positions.ssp_offsets(ssps, cube)
    east_centroid, north_centroid = positions.ssp_offsets(ssps, cube, centroid=True)
    fwhm = positions.beam_fwhm(cube, ssps.epoch, ssps.scale, np.eye(2))
    error = positions.position_errors(ssps.snr, fwhm.reshape(-1, 2), 0.0)
    size = np.array([scale_size(s) for s in ssps.scale], dtype=float)
    table = QTable(
        {
            "ssp": np.arange(n),
            "epoch": ssps.epoch,
            "date": Time(cube.times[ssps.epoch], format="isot"),
            "scale": ssps.scale,
            "scale_size": size * cube.pixel_scale,
            "x": ssps.x * u.pix,
            "y": ssps.y * u.pix,
            "east": east * u.mas,
            "north": north * u.mas,
            "east_err": error[:, 0] * u.mas,
            "north_err": error[:, 1] * u.mas,
            "east_centroid": east_centroid * u.mas,
            "north_centroid": north_centroid * u.mas,
            "peak": ssps.peak * cube.unit,
            "flux": ssps.flux * cube.unit,
            "snr": ssps.snr,
            "n_pixels": ssps.n_pixels,
            "in_region": select,
        }
    )
    table["flux"].info.description = "sum of the wavelet coefficients of the pixels"
    return positions.name_by_frame(round_to_errors(table), cube)


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
        with errors, its ``acceleration``, and its velocity on the two axes of
        the velocity map, ``pm_axis1`` and ``pm_axis2``.  ``pm_err`` of features
        that are seen only near standing ones includes the pull of these.
    """
    ssps, cube, project = result.matched.ssps, result.cube, projection_of(result)
    number, features = _numbered(result)
    angle = np.array([result.search.streams[n - 1].angle for n in number])
    widths = {a: project.beam(a) for a in set(angle)}
    beam = np.reshape([widths[a] for a in angle], (-1, 2)).T * u.mas
    ends = np.reshape([ssps.epoch[f.ssp[[0, -1]]] for f in features], (-1, 2))
    first, last = (Time(cube.times[k], format="isot") for k in ends.T.astype(int))
    table = QTable(
        {
            "feature": np.arange(len(features)),
            "component": number,
            "scale": np.array([ssps.scale[f.ssp[0]] for f in features], dtype=float),
            "n_epochs": np.array([len(f) for f in features], dtype=int),
            "first": first,
            "last": last,
        }
    )
    for name, (attribute, axis, unit) in PER_BEAM.items():
        values = np.array([getattr(f, attribute) for f in features], dtype=float)
        if name != "motion" and not name.endswith("_err"):
            values *= _sense(result)
        table[name] = (values * beam[axis] * unit).to(unit * u.mas)
    pulled = np.array([f.pulled for f in features], dtype=float)
    table["pm_err"] = np.hypot(
        table["pm_err"], DEFAULT.pulled_error * pulled * table["pm"]
    )
    along, across = (_sense(result) * table[name] for name in ("pm", "pm_transverse"))
    on_map = {
        "pm_axis1": np.cos(angle) * along - np.sin(angle) * across,
        "pm_axis2": np.sin(angle) * along + np.cos(angle) * across,
    }
    for name, speed in on_map.items():
        table[name] = speed.to(u.mas / u.yr)
        table[name].info.description = f"along axis {name[-1]} of the velocity map"
    table["pm"].info.description = "along the first component"
    table["pm_transverse"].info.description = "across the first component"
    return round_to_errors(table)


def _numbered(result):
    """Return the features of all streams, after the numbers of their components."""
    streams = result.search.streams
    number = np.repeat(np.arange(len(streams)) + 1, [len(s.features) for s in streams])
    return number, [feature for stream in streams for feature in stream.features]


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
    ssps, cube, project = result.matched.ssps, result.cube, projection_of(result)
    along = [
        project(stream.angle).position[:, 0] * project.beam(stream.angle)[0]
        for stream in result.search.streams
    ]
    rows = [
        (component, k, ssp, along[component - 1][ssp])
        for k, (component, feature) in enumerate(zip(*_numbered(result), strict=True))
        for ssp in feature.ssp
    ]
    *numbers, distance = np.reshape(rows, (-1, 4)).T
    component, feature, ssp = np.array(numbers, dtype=int)
    table = QTable({"component": component, "feature": feature, "ssp": ssp})
    table["epoch"] = ssps.epoch[ssp]
    table["date"] = Time(cube.times[ssps.epoch[ssp]], format="isot")
    table["distance"] = _sense(result) * distance * u.mas
    return round_to_errors(table)


def member_table(result, number):
    """
    Return the matches that belong to a component, see `SCCResult.members`.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    number : int
        From 1.

    Returns
    -------
    `~astropy.table.QTable`

    Raises
    ------
    ValueError
        If there is no such component.
    """
    if not 1 <= number <= len(result.maxima):
        raise ValueError(f"no component {number}: there are {len(result.maxima)}")
    d, cube, ssps = result.displacements, result.cube, result.matched.ssps
    match = _matches_of(result, number)
    ssp, start, end = d.ssp[match], d.reference[match], d.target[match]
    east, north = d.position[ssp].T * u.mas
    table = QTable(
        {
            "match": match,
            "ssp": ssp,
            "target_ssp": d.target_ssp[match],
            "scale": ssps.scale[ssp],
            "epoch": start,
            "target_epoch": end,
            "date": Time(cube.times[start], format="isot"),
            "target_date": Time(cube.times[end], format="isot"),
            "interval": (cube.years[end] - cube.years[start]).to(u.yr),
            "east": east,
            "north": north,
        }
    )
    axes = (d.d1, d.s1), (d.d2, d.s2)
    for name, (values, errors) in zip(result.frame.axis_names, axes, strict=True):
        table[f"displacement_{name}"] = values[match] * u.mas
        table[f"displacement_{name}_err"] = errors[match] * u.mas
    table["weight"] = d.weight[match]
    table["weight"].info.description = "correlation coefficient"
    return positions.name_by_frame(round_to_errors(table), cube)


def _matches_of(result, number):
    """Return the indices of the matches of a component."""
    d, features = result.displacements, result.search.streams[number - 1].features
    if features:
        label = np.full(len(result.matched.ssps), -1)
        for k, feature in enumerate(features):
            label[feature.ssp] = k
        there = np.where(d.target_ssp >= 0, label[d.target_ssp], -1)
        return np.flatnonzero((there >= 0) & (label[d.ssp] == there))
    index, *v, s1, s2, _ = sample_velocities(d, result.pairs)
    apart = np.abs(np.transpose(v) - result.velocities[number - 1].value)
    return index[np.all(apart <= MEMBER_SIGMA * np.stack([s1, s2], axis=1), axis=1)]
