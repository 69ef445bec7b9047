# Licensed under a 3-clause BSD style license - see LICENSE.rst
"""Parts of what was matched: the SSPs of a place and of some scales."""

import os
import warnings
from dataclasses import replace

import astropy.units as u
import numpy as np

from astro_scc.epochs.positions import ssp_offsets
from astro_scc.exceptions import MeasurementWarning
from astro_scc.measurement.plan import centroids_inside, scales_of_pixels
from astro_scc.settings import require

__all__ = ["select_ssps", "ssp_distances", "warn_of_none_inside"]


def ssp_distances(matched, *, origin=None, ridge=None):
    """
    Distances of the centroids of SSPs.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
    origin : `~astropy.units.Quantity`, shape (2,), optional
        (east, north) of the core, by default the reference pixel.
    ridge : `~astro_scc.kinematics.RidgeLine`, optional
        Along this line instead of from a point.

    Returns
    -------
    `~astropy.units.Quantity`, shape (n_ssps,)
        In mas.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.measurement import ssp_distances
    >>> from astro_scc.simulation import simulate_two_fluid
    >>> cube = simulate_two_fluid(n_epochs=2, rng=1).cube
    >>> scc = StackedCrossCorrelation(scales=[2], max_speed=36 * u.mas / u.yr)
    >>> matched = scc.match(cube)
    >>> r = ssp_distances(matched, origin=[-5, 0] * u.mas)
    >>> r.unit, len(r) == len(matched.ssps)
    (Unit("mas"), True)
    """
    east, north = ssp_offsets(matched.ssps, matched.cube, centroid=True) * u.mas
    if ridge is not None:
        return ridge.coordinates(east, north)[0]
    origin = u.Quantity([0, 0] * u.mas if origin is None else origin)
    return np.hypot(east - origin[0], north - origin[1]).to(u.mas)


def select_ssps(
    matched,
    *,
    region=None,
    r_min=None,
    r_max=None,
    scales=None,
    origin=None,
    ridge=None,
):
    """
    The matches of the SSPs in a part of the jet and on some scales.

    Nothing is correlated again: what is chosen is whose matches are
    stacked.  An SSP belongs where its centroid is; what it is matched with
    may lie outside.

    Parameters
    ----------
    matched : `~astro_scc.measurement.MatchedEpochs`
    region : optional
        Anything that ``cube.region_mask`` takes.
    r_min, r_max : `~astropy.units.Quantity`, optional
        ``r_min <= r < r_max``.
    scales : sequence of float or `~astropy.units.Quantity`, optional
        Numbers, or angles.
    origin, ridge : optional
        From where, or along what, r is counted, see `ssp_distances`.

    Returns
    -------
    `~astro_scc.measurement.MatchedEpochs`

    Raises
    ------
    ValueError
        If ``r_min`` is not below ``r_max``, or a scale was not decomposed.

    Examples
    --------
    >>> import astropy.units as u
    >>> from astro_scc import StackedCrossCorrelation
    >>> from astro_scc.measurement import select_ssps
    >>> from astro_scc.simulation import simulate_static
    >>> matched = StackedCrossCorrelation(scales=[1, 2]).match(
    ...     simulate_static(n_epochs=3, rng=1).cube)
    >>> inner = select_ssps(matched, r_max=8 * u.mas, scales=[1])
    >>> bool(0 < inner.select.sum() < matched.select.sum())
    True
    """
    select = matched.select.copy()
    if region is not None:
        select &= centroids_inside(matched.ssps, matched.cube, region)
    if r_min is not None or r_max is not None:
        low = 0 * u.mas if r_min is None else u.Quantity(r_min)
        high = np.inf * u.mas if r_max is None else u.Quantity(r_max)
        if not low < high:
            raise ValueError(f"r_min={r_min} must be below r_max={r_max}")
        r = ssp_distances(matched, origin=origin, ridge=ridge)
        select &= (r >= low) & (r < high)
    if scales is not None:
        scales = require("scales", scales)
        numbers = scales_of_pixels(scales, matched.cube.pixel_scale)
        have = matched.scales
        missing = [s for s in numbers if s not in have]
        if missing:
            what, there = (", ".join(f"{s:g}" for s in v) for v in (missing, have))
            raise ValueError(
                f"scale {what} was not decomposed; there are scales {there}"
            )
        select &= np.isin(matched.ssps.scale, numbers)
    return replace(matched, select=select)


def warn_of_none_inside(ssps, select, region):
    """
    Say so if a region was asked for that holds none of the SSPs.

    Parameters
    ----------
    ssps : `~astro_scc.decomposition.SSPs`
    select : `~numpy.ndarray` of bool, shape (n_ssps,)
        Those with their centroid in the region.
    region : optional
        What it was, or None for everything, of which nothing is said.

    Warns
    -----
    `~astro_scc.exceptions.MeasurementWarning`
    """
    if region is None or np.any(select) or len(ssps) == 0:
        return
    name = region if isinstance(region, str | os.PathLike) else "the region"
    warnings.warn(
        f"{name}: no significant pattern has its centroid inside, {len(ssps)} in the "
        "rest of the images: check where it lies, or make it larger",
        MeasurementWarning,
        stacklevel=3,
    )
