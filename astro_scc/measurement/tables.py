# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Results as tables of quantities."""

from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version

import astropy.units as u
import numpy as np
from astropy.table import QTable
from astropy.time import Time

from astro_scc.decomposition import scale_size
from astro_scc.epochs import beam_fwhm, name_by_frame, position_errors, ssp_offsets
from astro_scc.measurement.axes import AxisProjection


def versions():
    """
    Versions of this package and of what its numbers depend on.

    Returns
    -------
    dict of str
        numba is among them where it is installed.

    Examples
    --------
    >>> from astro_scc.measurement import versions
    >>> {"astro_scc", "numpy", "scipy"} <= set(versions())
    True
    """
    found = {}
    for name in ("astro_scc", "numpy", "scipy", "astropy", "scikit-image"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    with suppress(PackageNotFoundError):
        found["numba"] = version("numba")
    return found


def ssp_table(ssps, cube, *, select=None):
    """
    The catalogue of SSPs with sky positions and errors.

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
        One row an SSP, its ``date`` a `~astropy.time.Time`.  Positions
        ``east`` and ``north`` are offsets of the maximum from the reference
        pixel, with thermal errors ``beam / (sqrt(2) SNR)``.  In frames
        without right ascension columns are called as
        `~astro_scc.epochs.name_by_frame` says.
    """
    n = len(ssps)
    select = np.ones(n, bool) if select is None else np.asarray(select, bool)
    east, north = ssp_offsets(ssps, cube)
    east_centroid, north_centroid = ssp_offsets(ssps, cube, centroid=True)
    fwhm = beam_fwhm(cube, ssps.epoch, ssps.scale, np.eye(2))
    error = position_errors(ssps.snr, fwhm.reshape(-1, 2), 0.0)
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
    return name_by_frame(table, cube)


def feature_table(result):
    """
    The features that were followed, each with its own speed.

    Parameters
    ----------
    result : `~astro_scc.measurement.SCCResult`

    Returns
    -------
    `~astropy.table.QTable`
        A row a feature: the ``component`` that it is of, its ``scale``, the
        number of epochs and its ``first`` and ``last`` date, its mean
        ``distance`` from the reference pixel along the component, the
        ``motion`` in that time, its speed ``pm`` along and ``pm_transverse``
        across the component with errors, and its ``acceleration``.
    """
    ssps, cube = result.matched.ssps, result.cube
    project = AxisProjection(result.displacements, ssps, cube, result.frame)
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
            "component": np.array([number for number, *_ in rows], dtype=int),
            "scale": np.array([ssps.scale[f.ssp[0]] for f in features], dtype=float),
            "n_epochs": np.array([len(f) for f in features], dtype=int),
            "first": first,
            "last": last,
        }
    )
    for name, (attribute, axis, unit) in per_beam.items():
        values = np.array([getattr(f, attribute) for f in features], dtype=float)
        table[name] = (values * beam[axis] * unit).to(unit * u.mas)
    table["pm"].info.description = "along the component"
    table["pm_transverse"].info.description = "across the component"
    return table
