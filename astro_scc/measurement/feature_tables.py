# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""SSPs and matches of a measurement as tables, and the components of features."""

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.columns import build_table, describe, round_to_errors
from astro_scc.decomposition.wavelet import scale_size
from astro_scc.images import positions
from astro_scc.stacking.stack import sample_velocities

#: A match or feature within this many of its standard errors belongs to a component.
MEMBER_SIGMA = 2.0
#: What is at rest is slower than this many standard errors.
REST_SIGMA = 3.0


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
    centroid = positions.ssp_offsets(ssps, cube, centroid=True)
    fwhm = positions.beam_fwhm(cube, ssps.epoch, ssps.scale, np.eye(2))
    error = positions.position_errors(ssps.snr, fwhm.reshape(-1, 2), 0.0)
    size = np.array([scale_size(s) for s in ssps.scale], dtype=float)
    columns = {
        "ssp": np.arange(n),
        "epoch": ssps.epoch,
        "date": Time(cube.times[ssps.epoch], format="isot"),
        "scale": ssps.scale,
        "scale_size": size * cube.pixel_scale,
        "x": ssps.x * u.pix,
        "y": ssps.y * u.pix,
        "peak": ssps.peak * cube.unit,
        "coefficient_sum": ssps.flux * cube.unit,
        "snr": ssps.snr,
        "n_pixels": ssps.n_pixels,
        "in_region": select,
    }
    for name, offset, own, middle in (
        ("east", east, error[:, 0], centroid[0]),
        ("north", north, error[:, 1], centroid[1]),
    ):
        columns[name], columns[f"{name}_err"] = offset * u.mas, own * u.mas
        columns[f"{name}_centroid"] = middle * u.mas
    table = build_table("ssps", **columns)
    return positions.name_by_frame(round_to_errors(table), cube)


def components_of(result, features):
    """
    Return the velocity component to which each feature belongs.

    It is the one whose velocity is nearest in units of the errors, if it is within
    two both along and across its direction.  The errors are those of the feature and
    of the component, and the component's dispersion: directions scatter as speeds do.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`
    features : `~astro_scc.features.Features`

    Returns
    -------
    `~numpy.ndarray` of int, shape (n_features,)
        Numbers of components, 0 for none: for features where the frame has no axes,
        and for all that only a component that is not significant would suit.
        Stationary ones take features slower than three standard errors alone.
    """
    streams, velocities = result.search.streams, result.velocities
    velocity, of_axes = frame_velocities(result.frame, features)
    slow = [m.speed < REST_SIGMA * m.speed_err for m in features.motions]
    away = np.full((len(streams) + 1, len(features)), np.inf)
    away[0] = MEMBER_SIGMA
    pairs = zip(streams, velocities, strict=False)
    for k, (stream, own) in enumerate(pairs, start=1):
        cos, sin = np.cos(stream.angle), np.sin(stream.angle)
        turn = np.array([[cos, sin], [-sin, cos]])
        covariance = turn @ (of_axes + np.nan_to_num(own.covariance)) @ turn.T
        variance = np.diagonal(covariance, axis1=1, axis2=2).copy()
        variance += np.nan_to_num(own.dispersion) ** 2
        off = np.abs((velocity - own.value) @ turn.T) / np.sqrt(variance)
        suits = {"moving": True, "stationary": slow}.get(stream.kind, False)
        away[k] = np.where(suits, np.nan_to_num(off.max(axis=1), nan=np.inf), np.inf)
    return away.argmin(axis=0)


def core_streams(result):
    """
    Return the numbers of the stationary streams of which each SSP is at the core.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`

    Returns
    -------
    list of int
    """
    if result.cube.beams is None:
        return []
    near = max(beam.major for beam in result.cube.beams).to_value(u.mas) / 2
    distance = np.hypot(*positions.ssp_offsets(result.matched.ssps, result.cube))
    kinds = enumerate([stream.kind for stream in result.search.streams], start=1)
    standing = [n for n, kind in kinds if kind == "stationary"]
    ssps = {n: result.displacements.ssp[_matches_of(result, n)] for n in standing}
    return [n for n, k in ssps.items() if len(k) and distance[k].max() <= near]


def frame_velocities(frame, features):
    """
    Return the velocities of features along the axes of a frame.

    Parameters
    ----------
    frame : frame of `astro_scc.kinematics`
    features : `~astro_scc.features.Features`

    Returns
    -------
    velocity, covariance : `~numpy.ndarray`, shapes (n, 2) and (n, 2, 2)
        In mas/yr and its square; NaN where the frame has no axes.
    """
    motions = features.motions
    place, velocity, error = (
        np.reshape([getattr(motion, name) for motion in motions], (-1, 2))
        for name in ("place", "velocity", "velocity_err")
    )
    axes = np.asarray(frame.matrix(*place.T))
    turned = axes * error[:, None, :]
    return (axes @ velocity[..., None])[..., 0], turned @ turned.swapaxes(-1, -2)


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
        raise ValueError(f"no stream {number}: there are {len(result.maxima)}")
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
        name, about = f"displacement_{name}", f"displacement of the match, {name}"
        table[name], table[f"{name}_err"] = values[match] * u.mas, errors[match] * u.mas
        table[name].info.description = about
        table[f"{name}_err"].info.description = f"standard error of {name}"
    table["weight"] = d.weight[match]
    describe(describe(table, "ssps"), "members")
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
